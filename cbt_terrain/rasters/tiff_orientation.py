# SPDX-License-Identifier: GPL-3.0-or-later
"""The TIFF tag Orientation (274), the position of a picture's first row and column, which GDAL does not report."""

import os
import struct
from collections.abc import Iterable
from pathlib import Path

from ..errors import shown
from ..field.georeference import Georeference
from ..run.named_file import open_regular

ORIENTATION, SHORT = 274, 3  # number of the tag, and of the type of its value
MAX_TAGS = 4096  # tags of a file's first directory that are searched


def orientation_of(path: Path) -> int:
    """Return the orientation of a TIFF's first picture, 1 to 8; 1 if the file has no such tag or is no whole TIFF.

    Raises OSError.
    """
    with open_regular(path, links=True) as file:
        head = file.read(16)
        order = {b"II": "<", b"MM": ">"}.get(head[:2])
        if order is None or len(head) < 16:
            return 1
        (version,) = struct.unpack_from(order + "H", head, 2)
        # In BigTIFF, a directory's count, an entry's count and its value have 8 bytes.
        # offset_at: where the directory's offset is in the file. value_at: where the value is in an entry.
        offset_at, offset_code, entry_bytes, value_at = (8, "Q", 20, 12) if version == 43 else (4, "I", 12, 8)
        (offset,) = struct.unpack_from(order + offset_code, head, offset_at)
        count_code = "Q" if version == 43 else "H"
        if offset > os.fstat(file.fileno()).st_size:
            return 1
        file.seek(offset)
        count_bytes = file.read(struct.calcsize(count_code))
        if len(count_bytes) < struct.calcsize(count_code):
            return 1
        (num_tags,) = struct.unpack(order + count_code, count_bytes)
        entries = file.read(min(num_tags, MAX_TAGS) * entry_bytes)
    for first in range(0, len(entries) - entry_bytes + 1, entry_bytes):
        tag, type_ = struct.unpack_from(order + "HH", entries, first)
        if tag == ORIENTATION and type_ == SHORT:
            (orientation,) = struct.unpack_from(order + "H", entries, first + value_at)
            return orientation if 1 <= orientation <= 8 else 1
    return 1


def orientation_notes(paths: Iterable[Path]) -> list[str]:
    """Return a warning about files of a mosaic whose tag Orientation turns or mirrors them."""
    turned = [path for path in paths if path.suffix.lower() in (".tif", ".tiff") and orientation_of(path) != 1]
    if not turned:
        return []
    more = f" and {len(turned) - 1} more" if len(turned) > 1 else ""
    return [
        f"The TIFF tag Orientation of {shown(turned[0].name)}{more} turns or mirrors the picture, and the VRT takes "
        "its rows as they are stored: import the file itself, or give the VRT a geotransform (gdal_edit.py -a_ullr)."
    ]


def orientation_georeference(orientation: int) -> Georeference | None:
    """Return the directions of rows and columns of a picture without a georeference; None for the usual ones.

    They are the corner of the first sample, and whether rows run along y. orientation: TIFF tag 274, 1 to 8.
    """
    if orientation == 1:
        return None
    return Georeference(
        first_row_south=orientation in (3, 4, 7, 8),
        first_column_east=orientation in (2, 3, 6, 7),
        transposed=orientation >= 5,
    )
