# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of an import, and the raster that it reads by rows."""

import math
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import TerrainError, check_kind, shown
from ..field import island
from ..field.georeference import LARGEST_EXTENT, SMALLEST_EXTENT, Georeference
from ..field.lands import LANDS
from ..plain_numbers import keep_plain_numbers, plain_number, plain_sequence
from .file_grid import FileGrid
from .rounding import SourceRounding
from .source_formats import BAND, suffixes_with

ISLAND = "island"
BLOCK_SAMPLES = 1 << 20  # read at a time, about
_PROJECT = re.compile(r"(utm|epsg:\d{1,7})?", re.IGNORECASE)
ENCODINGS = ("", "terrarium", "mapbox", "plain")  # coded_heights.py
ORDER, RESOLUTION, NEWEST = "order", "resolution", "newest"
PRIORITIES = (ORDER, RESOLUTION, NEWEST)
MOSAIC = "mosaic"  # format of a raster of several files
_TEXTS, _PATH = ("raw_dtype", "channel", "project", "encoding", "priority"), (str, os.PathLike)
RAW_TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float16", "float32", "float64")


def _path_text(path: str | os.PathLike) -> str:
    """Return a path as Python's own text, also one of numpy."""
    return str(os.fspath(path))


@dataclass(frozen=True)
class ImportSettings:
    """Source of an import, and the properties that its file does not define.

    Attributes:
        source: path of a file, or name of a built-in terrain. A folder, a pattern or a tile index names several files.
        more_sources: further sources, which form one terrain with the first.
        priority: which of several files is used where they overlap: the last in order (ORDER), the finest (RESOLUTION)
            or the one that was changed last (NEWEST).
        step: metres between samples of a terrain of several files; None for those of the finest file.
        quick: number of samples at most to which a large raster is thinned (thinning.py); 0 imports all.
        loaded_tiles: numbers of tiles that a quick import loads in more detail (importing/refining.py).
        loaded_finer: numbers of squares in which it then loads the finest files (importing/finer_squares.py).
        blend: whether finer files blend to coarser ones below them within a ring at their borders.
        raw_size: columns and rows of a RAW file; None for a square.
        raw_dtype: type of its samples, one of RAW_TYPES.
        raw_little_endian: order of their bytes.
        extent: metres from the first to the last sample in x and y, instead of the file's.
        height_scale: a height is value * height_scale + height_offset, metres. None: 1, except for an image without a
            unit, which has heights from 0 to a quarter of its width (height_range.py).
        height_offset: see height_scale.
        lowest: height of the lowest sample in metres, instead of a scale; None: 0 if `highest` is given.
        highest: height of the highest sample; None: a quarter of the width above `lowest` if that is given.
        no_data: value of missing samples, instead of the file's; NaN for none.
        holes: whether missing samples are cut out instead of filled.
        size: samples a side of a built-in terrain.
        seed: its random seed.
        band: number of the band, from 1.
        channel: name of an EXR channel; "" for the likeliest one.
        first_row_south: row order of files that do not define it; pictures begin in the north.
        project: coordinate system to reproject to, "utm" or "EPSG:n"; "" for none, and for the first projected one of
            several files.
        cell: side of the cells of gridded points in metres; None for four points in the mean.
        encoding: of heights in an image's colours, one of ENCODINGS; "" recognises those of web map tiles.
    """

    source: str
    raw_size: tuple[int, int] | None = None
    raw_dtype: str = "uint16"
    raw_little_endian: bool = True
    extent: tuple[float, float] | None = None
    height_scale: float | None = None
    height_offset: float = 0.0
    lowest: float | None = None
    highest: float | None = None
    no_data: float | None = None
    holes: bool = False
    size: int = island.DEFAULT_SIZE
    seed: int = island.DEFAULT_SEED
    band: int = 1
    channel: str = ""
    first_row_south: bool = False
    project: str = ""
    encoding: str = ""
    cell: float | None = None
    more_sources: tuple[str, ...] = ()
    priority: str = ORDER
    step: float | None = None
    quick: int = 0
    blend: bool = True
    loaded_tiles: tuple[int, ...] = ()
    loaded_finer: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Convert numbers to plain ones, paths to texts and sequences to tuples.

        Raises TerrainError for a value of another type. `check` refuses numbers that are not finite or out of range.
        """
        keep_plain_numbers(self, "The import's")
        for name in _TEXTS:
            check_kind(getattr(self, name), str, f"The import's {name}", "a text")
        check_kind(self.source, _PATH, "The import's source", "the path of a height map")
        more = plain_sequence(self.more_sources, _PATH, "The import's more_sources", "paths of height maps")
        values: dict[str, object] = {"source": _path_text(self.source), "more_sources": tuple(map(_path_text, more))}
        for name in ("loaded_tiles", "loaded_finer"):
            numbers = plain_sequence(getattr(self, name), object, f"The import's {name}", "whole numbers")
            values[name] = tuple(plain_number(n, int, f"One of the import's {name}") for n in numbers)
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def sources(self) -> tuple[str, ...]:
        """Return all sources in order."""
        return self.source, *self.more_sources

    @property
    def name(self) -> str:
        """Return the sources as a noun, for errors."""
        return f"{self.source} and {len(self.more_sources):,} more" if self.more_sources else self.source

    def check(self) -> None:
        """Raise TerrainError for settings that cannot be used."""
        if self.extent is not None and not all(SMALLEST_EXTENT < e < LARGEST_EXTENT for e in self.extent):
            raise TerrainError(
                f"The extent {tuple(self.extent)} m cannot be used",
                expected=f"lengths between {SMALLEST_EXTENT:g} and {LARGEST_EXTENT:g} m",
            )
        scale = 1.0 if self.height_scale is None else self.height_scale
        if not (math.isfinite(scale) and math.isfinite(self.height_offset)) or scale == 0.0:
            raise TerrainError(
                f"Height scale {scale} and offset {self.height_offset} m cannot be used",
                expected="finite numbers and a scale other than 0",
            )
        ends = [end for end in (self.lowest, self.highest) if end is not None]
        if not all(map(math.isfinite, ends)) or len(ends) == 2 and ends[0] >= ends[1]:
            raise TerrainError(
                f"The heights {' to '.join(f'{end:g}' for end in ends)} m cannot be used",
                expected="finite numbers, the lowest below the highest",
            )
        if ends and (self.height_scale is not None or self.height_offset != 0.0 or self.source in LANDS):
            raise TerrainError(
                "The lowest and highest height replace a scale and an offset, of files only",
                fix="give either the heights or the scale",
            )
        if self.raw_dtype not in RAW_TYPES:
            raise TerrainError(f"RAW type {self.raw_dtype!r} is not known", fix=f"choose one of {', '.join(RAW_TYPES)}")
        if self.raw_size is not None and min(self.raw_size) < 1:
            raise TerrainError(f"The RAW size is {tuple(self.raw_size)} samples", expected="two positive counts")
        if self.source in LANDS and not 2 <= self.size <= 1 << 16:
            raise TerrainError(f"The built-in {self.source} has {self.size} samples a side", expected="2 to 65536")
        if self.cell is not None and not (math.isfinite(self.cell) and self.cell > 0.0):
            raise TerrainError(f"The cell size is {self.cell} m", expected="a positive length")
        if self.quick < 0:
            raise TerrainError(f"A quick import of {self.quick} samples is not possible", expected="a positive count")
        if self.encoding not in ENCODINGS:
            known = ", ".join(ENCODINGS[1:])
            raise TerrainError(f"The encoding {shown(self.encoding)!r} is not known", fix=f"choose one of {known}")
        if not _PROJECT.fullmatch(self.project):
            raise TerrainError(
                f"The raster cannot be reprojected to {shown(self.project)!r}", expected="utm or EPSG:n, as EPSG:32632"
            )
        if self.priority not in PRIORITIES:
            what = f"The priority {shown(self.priority)!r} is not known"
            raise TerrainError(what, fix=f"choose one of {', '.join(PRIORITIES)}")
        if self.step is not None and not SMALLEST_EXTENT < self.step < LARGEST_EXTENT:
            expected = f"a length between {SMALLEST_EXTENT:g} and {LARGEST_EXTENT:g} m"
            raise TerrainError(f"The step is {self.step:g} m", expected=expected)

    def check_file(self) -> None:
        """Raise TerrainError for settings that the one file of the import cannot have."""
        if self.step is not None or self.priority != ORDER or not self.blend:
            raise TerrainError(
                "A step and a priority are of several files, as is blending",
                where=shown(self.source),
                fix="leave them out for one file",
            )
        if self.project and (self.source in LANDS or Path(self.source).suffix.lower() not in suffixes_with(BAND)):
            raise TerrainError(
                f"{shown(self.source)} has no coordinate system, so it cannot be reprojected", fix="import it as it is"
            )


@dataclass(frozen=True, eq=False)
class FinerSource:
    """Finer files of a mosaic, on the raster of its coarser ones.

    Attributes:
        bits: a cell of the raster has 2^bits finer cells a side.
        boxes: int64 [files, 4], first column and row and last ones of each file, in finer samples.
        window: window(first, count, column, columns) returns finer samples, NaN where missing.
        inputs: inputs(first, count, column, columns) returns a digest of all that determines the samples of a window;
            None if the tiles of an earlier import are not used again.
        keep_seams: keep_seams(find, note) uses records of the borders of files: find(row, column) returns the values of
            the record of a block of the finest grid, None without one, and note(row, column, **values) writes one.
        squares: numbers of the squares to load (importing/finer_squares.py), None for all.
        continues: whether heights beside known samples continue these, for files without coarser ones below.
    """

    bits: int
    boxes: np.ndarray
    window: Callable[[int, int, int, int], np.ndarray]
    inputs: Callable[[int, int, int, int], str] | None = None
    keep_seams: Callable[[Callable, Callable], None] | None = None
    squares: frozenset[int] | None = None
    continues: bool = False


@dataclass
class Raster:
    """An opened source.

    Attributes:
        width: columns.
        height: rows.
        read: read(first, count) returns `count` rows from row `first` on, NaN for missing samples.
        window: window(first, count, column, columns) returns a part of these rows; None for a raster that is read by
            whole rows only.
        pick: pick(rows, columns) returns the samples of these rows in these columns, [rows, columns] with NaN where
            missing; None for a raster that is read by rows.
        grid: coordinate system and geotransform of the samples, if the file places them.
        stored: name of the samples' type in the file.
        format: name of the file's format.
        georeference: size, position and orientation; None if the file does not define them.
        is_sized: whether the file defines its size.
        read_grid: grid of the samples as they are read, after reprojection; None unless the file defines its size.
        has_unit: whether the file defines the unit of its values.
        is_picture: whether the samples are the first of 3 or 4 bands of 8 bits, and no setting names the band or an
            encoding of heights.
        block_rows: number of rows that are best read together.
        scale: a height is value * scale + offset metres, before the scale and offset of the settings.
        offset: see scale.
        projected_from: coordinate system before reprojection; "" if there was none.
        original: raster before resampling; None if there was none.
        roundings: rounding errors of the files that hold the samples, before scale and offset; by default that of
            `stored`.
        warnings: sentences for the report.
        sources: other files that hold the samples.
        earlier_paths: earlier_paths() returns the paths of `sources` as an older version has recorded them in the store
            to be replaced, with `..`, by their paths without.
        overview: overview(max_factor) returns the coarsest raster of means of 2, 4, 8 ... `max_factor` samples a
            side, which the caller closes; None if the file has none.
        full_size: columns and rows of the raster of which this one has every n-th sample; None for all samples.
        method: version of a method that makes the samples and that older versions lack; 0 for none.
        moved: largest difference that interpolated positions have made to a sample that was read, before scale.
        shifted: largest error of a conversion between vertical datums of samples that were read, before scale.
        details: further entries of the report.
        inputs: inputs(first, count, column, columns) returns a digest of all that determines the samples of a window;
            None if that is the whole raster.
        finer: finer files on some parts of the raster; None without any.
        finest: the finer files of a raster with their step, and how many times coarser the others are; None unless they
            cover little of it.
        squares: the finer files on a raster of fewer samples, of which squares can be loaded; None without any.
        finish: writes further files into the store's new folder; raises TerrainError if a source has changed.
        close: closes the files.
    """

    width: int
    height: int
    read: Callable[[int, int], np.ndarray]
    stored: str
    format: str
    window: Callable[[int, int, int, int], np.ndarray] | None = None
    pick: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    grid: FileGrid | None = None
    georeference: Georeference | None = None
    is_sized: bool = False
    read_grid: FileGrid | None = None
    has_unit: bool = False
    is_picture: bool = False
    block_rows: int = 1
    scale: float = 1.0
    offset: float = 0.0
    projected_from: str = ""
    original: "Raster | None" = None
    roundings: tuple[SourceRounding, ...] = ()
    warnings: list[str] = field(default_factory=list)
    sources: tuple[Path, ...] = ()
    earlier_paths: Callable[[], Mapping[str, str]] = dict
    overview: Callable[[int], "Raster | None"] = lambda _max_factor: None
    full_size: tuple[int, int] | None = None
    method: int = 0
    moved: float = 0.0
    shifted: float = 0.0
    details: dict = field(default_factory=dict)
    inputs: Callable[[int, int, int, int], str] | None = None
    finer: FinerSource | None = None
    finest: FinerSource | None = None
    squares: FinerSource | None = None
    finish: Callable[[Path], None] = lambda _folder: None
    close: Callable[[], None] = lambda: None

    def __post_init__(self) -> None:
        self.roundings = self.roundings or (SourceRounding(self.stored),)

    @property
    def rows_at_once(self) -> int:
        """Return the number of rows to read together."""
        return self.block_rows * max(1, BLOCK_SAMPLES // (self.width * self.block_rows))

    def blocks(self) -> Iterator[tuple[float, np.ndarray]]:
        """Yield the rows in blocks, each with the fraction of rows read including this block."""
        for first in range(0, self.height, self.rows_at_once):
            rows = self.read(first, min(self.rows_at_once, self.height - first))
            yield (first + len(rows)) / self.height, rows


def stands_for_missing(no_data: float | None, kind: np.dtype) -> bool:
    """Return whether a sample of type `kind` can equal `no_data` and hence be a missing one.

    False for None and NaN: samples that are NaN are missing anyway. Floats are compared with `no_data` rounded to them.
    """
    if no_data is None or math.isnan(no_data):
        return False
    with np.errstate(over="ignore", invalid="ignore"):
        return kind.kind not in "iu" or float(np.array(no_data).astype(kind)) == no_data


def blank(rows: np.ndarray, no_data: float | None) -> np.ndarray:
    """Return rows with NaN for `no_data`, unchanged if it is None or cannot occur in their type.

    Rows with NaN are float64 if they were integers of more than 16 bits, else of the smallest float that holds them.
    """
    if not stands_for_missing(no_data, rows.dtype):
        return rows
    with np.errstate(over="ignore", invalid="ignore"):
        missing = rows == np.array(no_data).astype(rows.dtype)
    if missing.any():
        rows = rows.astype(np.float64 if rows.dtype.kind in "iu" and rows.itemsize > 2 else np.result_type(rows, "f4"))
        rows[missing] = np.nan
    return rows


def cause(reason: BaseException) -> str:
    """Return a library's message without a full stop, as part of a sentence.

    Errors of rasterio wrap GDAL's, which is then returned.
    """
    return shown(reason.__cause__ or reason, 300).rstrip(".")
