# SPDX-License-Identifier: GPL-3.0-or-later
"""Raw samples with an ESRI header: .bil, .bip, .bsq, .flt and GTOPO30's .dem, each with a .hdr of the same name."""

import re
from pathlib import Path

import numpy as np

from ..errors import TerrainError, shown
from ..rasters.rasterio_types import DatasetReader
from ..rasters.source_formats import FORMATS
from ..run.named_file import read_start

MAX_HEADER_BYTES = 1 << 20


def header_of(path: Path) -> Path | None:
    """Return the .hdr file beside a raster; None without one, or if the raster's format has no such header."""
    try:
        headers = [path.with_suffix(suffix) for suffix in (".hdr", ".HDR") if path.with_suffix(suffix).is_file()]
    except (OSError, ValueError):
        return None
    form = FORMATS.get(path.suffix.lower())
    return headers[0] if headers and form is not None and form.has_header else None


def lacks_header(path: Path) -> bool:
    """Return whether a file such as .bil or .flt lacks its header, so that its samples are read as RAW."""
    form = FORMATS.get(path.suffix.lower())
    return form is not None and form.is_raw_alone and header_of(path) is None


def headless_warning(path: Path) -> str:
    """Return the warning about raw samples that lack their .hdr file."""
    return (
        f"There is no header {shown(path.with_suffix('.hdr').name)} beside the file, so size and type of its samples "
        "are those of the RAW settings (--raw-size, --raw-type, --big-endian), without georeference and no-data value."
    )


def check_header(path: Path) -> Path:
    """Return a file's header. Raises TerrainError for a missing one, and for that of ENVI, which GDAL does not read."""
    header = header_of(path)
    if header is None:
        raise TerrainError(
            f"{shown(path)} has no header {shown(path.with_suffix('.hdr').name)} beside it",
            fix="put it there, or convert another kind of file to GeoTIFF (gdal_translate)",
        )
    if read_start(header, 4) == b"ENVI":
        raise TerrainError(
            f"{shown(path)} has an ENVI header",
            expected="an ESRI header",
            fix="write it as a GeoTIFF (gdal_translate)",
        )
    return header


def check_length(path: Path, header: Path, dataset: DatasetReader) -> None:
    """Raise TerrainError for a file that is shorter than its header requires, since GDAL would read zeros.

    dataset: the opened file, for its size and type.
    """
    text = read_start(header, MAX_HEADER_BYTES).decode("latin-1")
    skipped = re.search(r"(?im)^\s*skipbytes\s+(\d{1,18})", text)
    bits = int(dataset.tags(1, ns="IMAGE_STRUCTURE").get("NBITS", 0)) or 8 * np.dtype(dataset.dtypes[0]).itemsize
    needed = dataset.width * dataset.height * dataset.count * bits // 8 + (int(skipped[1]) if skipped else 0)
    size = path.stat().st_size
    if size < needed:
        raise TerrainError(
            f"{shown(path)} has {size:,} bytes, so it is damaged or its header belongs to another file",
            expected=f"{needed:,} bytes by its header",
            fix="get both again",
        )
