# SPDX-License-Identifier: GPL-3.0-or-later
"""Where heights come from: a raster opened from a file or made up, read by rows, with its place and its warnings."""

import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from . import island
from .errors import TerrainError, shown
from .georeference import LARGEST_EXTENT, SMALLEST_EXTENT, Georeference

ISLAND = "island"
RAW_SUFFIXES = (".raw", ".r16", ".r32", ".bin", ".bil")
# Of files that can say where on Earth they are.
PLACED_SUFFIXES = (".tif", ".tiff", ".hgt", ".png", ".asc", ".vrt")
_PROJECT = re.compile(r"(utm|epsg:\d{1,7})?", re.IGNORECASE)
RAW_TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float16", "float32", "float64")


@dataclass(frozen=True)
class ImportSettings:
    """What to import and how.

    source: path of a file, or "island". raw_size (columns, rows; None: a square), raw_dtype (one of RAW_TYPES) and
    raw_little_endian describe a RAW file. extent: metres from the first to the last sample in x and y, instead of what
    the file says. A height is `value * height_scale + height_offset` metres. no_data: the value that stands for missing
    samples, instead of the file's own; NaN: no value does. size, seed: samples a side and seed of the island. band:
    number of the band, from 1. channel: name of an EXR channel, "" for the first that looks like a height.
    first_row_south: for files that do not say where north is; pictures begin in the north. project: the coordinate
    system to bring the raster into, "utm" or "EPSG:n"; "": as it is.
    """

    source: str
    raw_size: tuple[int, int] | None = None
    raw_dtype: str = "uint16"
    raw_little_endian: bool = True
    extent: tuple[float, float] | None = None
    height_scale: float = 1.0
    height_offset: float = 0.0
    no_data: float | None = None
    size: int = island.DEFAULT_SIZE
    seed: int = island.DEFAULT_SEED
    band: int = 1
    channel: str = ""
    first_row_south: bool = False
    project: str = ""

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
        if self.source == ISLAND and not 2 <= self.size <= 1 << 16:
            raise TerrainError(f"An island of {self.size} samples a side: expected 2 to 65536.")
        if not _PROJECT.fullmatch(self.project):
            raise TerrainError(
                f"The coordinate system {shown(self.project)!r} to reproject to: expected utm or EPSG:n, as EPSG:32632."
            )
        if self.project and (self.source == ISLAND or Path(self.source).suffix.lower() not in PLACED_SUFFIXES):
            raise TerrainError(
                f"{shown(self.source)} has no coordinate system, so it cannot be reprojected: import it as it is."
            )


@dataclass
class Raster:
    """An opened source: `read(first, count)` gives `count` rows from row `first` on, NaN where a sample is missing.

    `block_rows`: rows that are best read together. A height is the value * scale + offset metres, before the settings'
    own scale and offset. `georeference` is None where the file does not say how large and where it is.
    `projected_from`: the coordinate system that it was reprojected from, if it was. `sources`: other files that it is
    made of.
    """

    width: int
    height: int
    read: Callable[[int, int], np.ndarray]
    stored: str
    format: str
    georeference: Georeference | None = None
    block_rows: int = 1
    scale: float = 1.0
    offset: float = 0.0
    projected_from: str = ""
    warnings: list[str] = field(default_factory=list)
    sources: tuple[Path, ...] = ()
    close: Callable[[], None] = lambda: None


def open_source(settings: ImportSettings) -> Raster:
    """Open what the settings name. Raises TerrainError; to be called in the import's child process."""
    settings.check()
    if settings.source == ISLAND:
        return _open_island(settings)
    path = Path(settings.source)
    check_file(path)
    suffix = path.suffix.lower()
    try:
        if suffix in RAW_SUFFIXES:
            return _open_raw(path, settings)
        if suffix == ".npy":
            return _open_npy(path, settings)
        if suffix == ".exr":
            from .exr_source import open_exr

            return open_exr(path, settings)
        from .gdal_source import DRIVERS, open_raster

        if suffix in DRIVERS:
            return open_raster(path, settings)
    except OSError as reason:
        raise TerrainError(f"{path} cannot be read ({reason.strerror or reason}): check the file.") from reason
    known = ", ".join((*DRIVERS, ".exr", ".npy", *RAW_SUFFIXES))
    raise TerrainError(f"{path} is of no known kind of height map: expected one of {known}.")


def check_file(path: Path) -> None:
    """Raise TerrainError if there is no readable, non-empty file."""
    try:
        what = "is a folder" if path.is_dir() else "is not a regular file" if path.exists() else "does not exist"
        regular = path.is_file()
    except (OSError, ValueError) as reason:
        said = getattr(reason, "strerror", None) or reason
        raise TerrainError(f"{shown(path)} cannot be read ({said}): expected the file of a height map.") from reason
    if not regular:
        raise TerrainError(f"{shown(path)} {what}: expected the file of a height map.")
    if not os.access(path, os.R_OK):
        raise TerrainError(f"{path} may not be read by this user: change its permissions.")
    if path.stat().st_size == 0:
        raise TerrainError(f"{path} is empty: expected the file of a height map.")


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


def _open_island(settings: ImportSettings) -> Raster:
    size = settings.size

    def read(first: int, count: int) -> np.ndarray:
        rows = np.empty((count, size), np.float32)
        island.island_rows(size, first, rows, settings.seed)
        return rows

    step = island.SIDE / (size - 1)
    place = Georeference(step, step, first_row_south=True)
    return Raster(size, size, read, "float32", ISLAND, georeference=place, block_rows=64)


def _open_raw(path: Path, settings: ImportSettings) -> Raster:
    kind = np.dtype(settings.raw_dtype).newbyteorder("<" if settings.raw_little_endian else ">")
    size = path.stat().st_size
    samples, rest = divmod(size, kind.itemsize)
    width, height = settings.raw_size or (math.isqrt(samples), math.isqrt(samples))
    if width * height * kind.itemsize != size or rest:
        asked = f"{width} x {height} samples of {settings.raw_dtype} need {width * height * kind.itemsize}"
        raise TerrainError(
            f"{path} has {size} bytes, but {asked}: give its size and type as they are (on the command line "
            "--raw-size WxH and --raw-type)."
        )
    values = np.memmap(path, kind, "r", shape=(height, width))
    return _from_array(values, settings, "RAW")


def _open_npy(path: Path, settings: ImportSettings) -> Raster:
    try:
        values = np.lib.format.open_memmap(path, mode="r")  # np.load would also open zips and pickles
    except Exception as reason:  # whatever the parser of a damaged header raises
        said = shown(reason).rstrip(".") or type(reason).__name__
        raise TerrainError(f"{path} is not a whole .npy file of numbers ({said}): get the file again.") from reason
    if values.ndim != 2 or values.dtype.kind not in "fiu" or values.size == 0:
        raise TerrainError(f"{path} holds {values.dtype} {values.shape}: expected a 2-D array of real numbers.")
    return _from_array(values, settings, "NumPy")


def _from_array(values: np.ndarray, settings: ImportSettings, format_name: str) -> Raster:
    def read(first: int, count: int) -> np.ndarray:
        rows = np.asarray(values[first : first + count])
        return blank(rows.astype(rows.dtype.newbyteorder("=")), settings.no_data)

    height, width = values.shape
    return Raster(width, height, read, values.dtype.name, format_name, block_rows=64)
