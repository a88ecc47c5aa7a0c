# SPDX-License-Identifier: GPL-3.0-or-later
"""What an import is asked for, and what it gets: settings, and a raster that is read by rows."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import TerrainError, shown
from ..field import island
from ..field.georeference import LARGEST_EXTENT, SMALLEST_EXTENT, Georeference
from ..field.lands import LANDS
from ..plain_numbers import keep_plain_numbers
from .header_files import HEADER_SUFFIXES
from .rounding import SourceRounding

ISLAND = "island"
RAW_SUFFIXES = (".raw", ".r16", ".r32", ".bin")
# Of files that can say where on Earth they are.
PLACED_SUFFIXES = (".tif", ".tiff", ".hgt", ".png", ".asc", ".vrt", *HEADER_SUFFIXES)
EXR_SUFFIX = ".exr"
_PROJECT = re.compile(r"(utm|epsg:\d{1,7})?", re.IGNORECASE)
RAW_TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float16", "float32", "float64")


@dataclass(frozen=True)
class ImportSettings:
    """What to import and how.

    source: path of a file, or name of a built-in land. raw_size (columns, rows; None: a square), raw_dtype (one of
    RAW_TYPES) and raw_little_endian describe a RAW file. extent: metres from the first to the last sample in x and y,
    instead of what the file says. A height is `value * height_scale + height_offset` metres. no_data: the value that
    stands for missing samples, instead of the file's own; NaN: no value does. holes: cut them out instead of filling
    them. size, seed: samples a side and seed of a built-in land. band: number of the band, from 1. channel: name of an
    EXR channel, "" for the first that looks like a height. first_row_south: for files that do not say where north is;
    pictures begin in the north. project: the coordinate system to bring the raster into, "utm" or "EPSG:n"; "": as it
    is.
    """

    source: str
    raw_size: tuple[int, int] | None = None
    raw_dtype: str = "uint16"
    raw_little_endian: bool = True
    extent: tuple[float, float] | None = None
    height_scale: float = 1.0
    height_offset: float = 0.0
    no_data: float | None = None
    holes: bool = False
    size: int = island.DEFAULT_SIZE
    seed: int = island.DEFAULT_SEED
    band: int = 1
    channel: str = ""
    first_row_south: bool = False
    project: str = ""

    def __post_init__(self):
        keep_plain_numbers(self, "The import's")

    def check(self) -> None:
        """Raise TerrainError for settings that cannot mean anything."""
        if self.extent is not None and not all(SMALLEST_EXTENT < e < LARGEST_EXTENT for e in self.extent):
            raise TerrainError(
                f"The extent {tuple(self.extent)} m cannot be used: expected positive lengths, between "
                f"{SMALLEST_EXTENT:g} and {LARGEST_EXTENT:g} m."
            )
        if not (math.isfinite(self.height_scale) and math.isfinite(self.height_offset)) or self.height_scale == 0.0:
            raise TerrainError(
                f"Height scale {self.height_scale} and offset {self.height_offset} m cannot be used: expected finite "
                "numbers and a scale other than 0."
            )
        if self.raw_dtype not in RAW_TYPES:
            raise TerrainError(f"RAW type {self.raw_dtype!r} is not known: choose one of {', '.join(RAW_TYPES)}.")
        if self.raw_size is not None and min(self.raw_size) < 1:
            raise TerrainError(f"A RAW size of {tuple(self.raw_size)} samples: expected two positive counts.")
        if self.source in LANDS and not 2 <= self.size <= 1 << 16:
            raise TerrainError(f"A built-in {self.source} of {self.size} samples a side: expected 2 to 65536.")
        if not _PROJECT.fullmatch(self.project):
            raise TerrainError(
                f"The coordinate system {shown(self.project)!r} to reproject to: expected utm or EPSG:n, as EPSG:32632."
            )
        if self.project and (self.source in LANDS or Path(self.source).suffix.lower() not in PLACED_SUFFIXES):
            raise TerrainError(
                f"{shown(self.source)} has no coordinate system, so it cannot be reprojected: import it as it is."
            )


@dataclass
class Raster:
    """An opened source: `read(first, count)` gives `count` rows from row `first` on, NaN where a sample is missing.

    `block_rows`: rows that are best read together. A height is the value * scale + offset metres, before the settings'
    own scale and offset. `roundings`: of the files that hold the samples, before scale and offset; without any, that of
    the type `stored`. `georeference` is None where the file does not say how large it is, where, and which way round.
    `is_sized`: whether the file gives its size. `projected_from`: the coordinate system that it was reprojected
    from, if it was. `original`: the raster it was resampled from, if it was. `sources`: other files that it is made
    of.
    """

    width: int
    height: int
    read: Callable[[int, int], np.ndarray]
    stored: str
    format: str
    georeference: Georeference | None = None
    is_sized: bool = False
    block_rows: int = 1
    scale: float = 1.0
    offset: float = 0.0
    projected_from: str = ""
    original: "Raster | None" = None
    roundings: tuple[SourceRounding, ...] = ()
    warnings: list[str] = field(default_factory=list)
    sources: tuple[Path, ...] = ()
    close: Callable[[], None] = lambda: None

    def __post_init__(self):
        self.roundings = self.roundings or (SourceRounding(self.stored),)


def stands_for_missing(no_data: float | None, kind: np.dtype) -> bool:
    """Whether a value of type `kind` can be the number `no_data`, so that it stands for a missing sample."""
    if no_data is None or math.isnan(no_data):
        return False
    with np.errstate(over="ignore", invalid="ignore"):
        return kind.kind not in "iu" or float(np.array(no_data).astype(kind)) == no_data


def blank(rows: np.ndarray, no_data: float | None) -> np.ndarray:
    """Rows with the value `no_data` made NaN; as they are if it is None or cannot occur in their type."""
    if not stands_for_missing(no_data, rows.dtype):
        return rows
    with np.errstate(over="ignore", invalid="ignore"):
        missing = rows == np.array(no_data).astype(rows.dtype)
    if missing.any():
        rows = rows.astype(np.float64 if rows.dtype.kind in "iu" and rows.itemsize > 2 else np.result_type(rows, "f4"))
        rows[missing] = np.nan
    return rows


def cause(reason: BaseException) -> str:
    """A library's message as part of a sentence: GDAL's own is behind rasterio's."""
    return shown(reason.__cause__ or reason, 300).rstrip(".")
