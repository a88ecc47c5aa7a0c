# SPDX-License-Identifier: GPL-3.0-or-later
"""Raw samples with an ESRI header beside them: .bil, .bip, .bsq, .flt and GTOPO30's .dem with a .hdr of that name."""

import re
from pathlib import Path

from ..errors import TerrainError, shown
from ..run.named_file import open_regular

HEADER_DRIVER = "EHdr"
RAW_WITHOUT_HEADER = (".bil", ".bip", ".bsq", ".flt")
HEADER_SUFFIXES = (*RAW_WITHOUT_HEADER, ".dem")  # a .dem without one is most often a text of the USGS
MAX_HEADER_BYTES = 1 << 20


def header_of(path: Path) -> Path | None:
    """Return the header beside a file of such a suffix, or None if there is none."""
    try:
        found = [path.with_suffix(suffix) for suffix in (".hdr", ".HDR") if path.with_suffix(suffix).is_file()]
    except (OSError, ValueError):
        return None
    return found[0] if found and path.suffix.lower() in HEADER_SUFFIXES else None


def is_plain_raw(path: Path) -> bool:
    """Return whether a file holds raw samples by its suffix and has no header beside it."""
    return path.suffix.lower() in RAW_WITHOUT_HEADER and header_of(path) is None


def headless_warning(path: Path) -> str:
    """Return the warning about a file without its header."""
    return (
        f"There is no header {shown(path.with_suffix('.hdr').name)} beside the file, so size and type of its samples "
        "are those of the RAW settings (--raw-size, --raw-type, --big-endian), without georeference and no-data value."
    )


def check_header(path: Path) -> None:
    """Refuse a missing header, and one that GDAL does not read. Raises TerrainError."""
    header = header_of(path)
    if header is None:
        raise TerrainError(
            f"{shown(path)} has no header {shown(path.with_suffix('.hdr').name)} beside it: put it there, or convert "
            "another kind of file to GeoTIFF (gdal_translate)."
        )
    with open_regular(header, links=True) as file:
        if file.read(4) == b"ENVI":
            raise TerrainError(
                f"{shown(path)} has a header of ENVI's kind, expected one of ESRI's: write it as a GeoTIFF "
                "(gdal_translate)."
            )


def check_length(path: Path, dataset) -> None:
    """Refuse a file that is shorter than its header says, since GDAL reads zeros there. Raises TerrainError."""
    with open_regular(header_of(path), links=True) as file:
        text = file.read(MAX_HEADER_BYTES).decode("latin-1")
    skipped = re.search(r"(?im)^\s*skipbytes\s+(\d{1,18})", text)
    bits = int(dataset.tags(1, ns="IMAGE_STRUCTURE").get("NBITS", 0)) or 8 * _item_size(dataset)
    needed = dataset.width * dataset.height * dataset.count * bits // 8 + (int(skipped[1]) if skipped else 0)
    size = path.stat().st_size
    if size < needed:
        raise TerrainError(
            f"{shown(path)} has {size:,} bytes, expected {needed:,} by its header: it is damaged or the header is of "
            "another file; get both again."
        )


def _item_size(dataset) -> int:
    import numpy as np

    return np.dtype(dataset.dtypes[0]).itemsize
