# SPDX-License-Identifier: GPL-3.0-or-later
"""The catalogue of a mosaic: what its files' headers say. Each header is read once, and the store keeps the result.

It runs in the import's child process. A kept entry is used again if the size and the modification time of its files are
the same. A damaged catalogue is built again.
"""

import dataclasses
import hashlib
import itertools
import json
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import TerrainError, shown
from ..field.georeference import Transform, without_rounded_skew
from ..field.store_folder import named_folder
from ..formats.archives import UnpackedFiles, archive_of, files_of_tile, is_inside
from ..formats.gdal_files import ignore_neighbours
from ..formats.sources import check_named, open_tile_source
from ..importing.source_list import INDEX_SUFFIXES, absolute_source, file_stat, files_of
from ..rasters.coded_heights import tile_of
from ..rasters.raster import ORDER, ImportSettings, Raster
from ..rasters.rounding import SourceRounding
from ..rasters.sidecars import sidecars
from ..run.named_file import read_regular
from ..run.owned_files import without_dots
from .systems import names_of, period_of
from .tile_paths import height_maps_of, named_files

FILE_NAME = "catalogue.json"
VERSION = 1
UNPLACED_PICTURE = "mosaic.unplaced_picture"  # code of the error about a picture without a position
MAX_BYTES = 1 << 30
MAX_SIDE = 1 << 30  # samples
_SYSTEM = re.compile(r"([A-Z]+:\w{1,16}|[A-Z_]+\[.*)?", re.DOTALL)


@dataclass(frozen=True)
class SourceTile:
    """The header of one file of a mosaic.

    Attributes:
        path: absolute path.
        files: path, size and modification time (ns) of the file and of those that belong to it; of a tile in a .zip,
            those of members (archives.files_of_tile).
        width: columns.
        height: rows.
        transform: from columns and rows of cells' corners to x and y of the CRS.
        crs: name of the horizontal coordinate system; "" if the file names none.
        datum: name of the vertical datum; "" if the file names none.
        stored: type of the samples.
        format: GDAL's driver.
        scale: a height is value * scale + offset metres.
        offset: see scale.
        block_rows: number of rows that are best read together.
        roundings: rounding errors of the stored values, before scale and offset.
        warnings: sentences for the report.
    """

    path: str
    files: tuple[tuple[str, int, int], ...]
    width: int
    height: int
    transform: Transform
    crs: str
    datum: str
    stored: str
    format: str
    scale: float
    offset: float
    block_rows: int
    roundings: tuple[SourceRounding, ...]
    warnings: tuple[str, ...]

    @property
    def is_straight(self) -> bool:
        """Return whether columns run along x and rows along y."""
        return self.transform[1] == self.transform[3] == 0.0

    @property
    def changed_ns(self) -> int:
        """Return the modification time of the file itself, ns."""
        return self.files[0][2]

    def position(self, column: Any, row: Any) -> tuple[Any, Any]:
        """Return x and y of a sample, or of arrays of them; columns and rows may be fractions."""
        a, b, c, d, e, f = self.transform
        column, row = column + 0.5, row + 0.5
        return a * column + b * row + c, d * column + e * row + f

    def indices(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return columns and rows, float64, of positions in the tile's system, also a turn of 360 degrees away."""
        a, b, _, d, e, _ = self.transform
        x0, y0 = self.position(0, 0)
        period = period_of(self.crs)
        if period:
            x = x - period * np.round((x - self.position(self.width / 2, self.height / 2)[0]) / period)
        area = a * e - b * d  # by which the inverse of the transform divides
        with np.errstate(invalid="ignore"):
            return (e * (x - x0) - b * (y - y0)) / area, (a * (y - y0) - d * (x - x0)) / area

    def files_now(self) -> Sequence[tuple[str, int, int] | None]:
        """Return `files` as they are now, None for a missing one. Raises TerrainError for a damaged archive."""
        path = Path(self.path)
        return files_of_tile(path) if is_inside(path) else [_stat(entry[0]) for entry in self.files]

    def check_unchanged(self) -> None:
        """Raise TerrainError if one of the files is another than when its header was read."""
        for entry, now in zip(self.files, self.files_now(), strict=False):
            if entry != now:
                raise TerrainError(
                    f"{shown(entry[0])} has changed while it was imported",
                    expected="the file as it was at the beginning",
                    fix="import again when it is complete",
                    code="source.changed",
                )

    def check_header(self, raster: Raster) -> None:
        """Raise TerrainError if the opened file has another size, place, type or unit than the catalogue says."""
        transform = raster.grid.transform if raster.grid is not None else None
        header = raster.width, raster.height, raster.stored, float(raster.scale), float(raster.offset)
        expected = self.width, self.height, self.stored, self.scale, self.offset
        if header != expected or transform is None or _transform_of(transform) != self.transform:
            raise TerrainError(
                f"{shown(self.path)} has {raster.width} x {raster.height} samples of {raster.stored} at {transform}",
                expected=f"{self.width} x {self.height} of {self.stored} at {self.transform} as before",
                fix="import again when it is complete",
                code="source.changed",
            )


class Catalogue(NamedTuple):
    """The tiles (headers) of a mosaic's files, in the order of the sources, and the pictures that are left out."""

    tiles: list[SourceTile]
    pictures: list[Path]


def build_catalogue(
    settings: ImportSettings,
    store: Path | None,
    on_progress: Callable[[float], None] = lambda _fraction: None,
    unpacked: UnpackedFiles | None = None,
) -> Catalogue:
    """Return the tiles of all files that the settings' sources name.

    Pictures that only a folder, a pattern, an index or an archive names are left out if another file has heights: they
    are photos of the same ground. The catalogue of pictures alone has them as tiles.

    store: a store or a folder of arrays, whose catalogue is used where files have not changed; None for none.
    on_progress: gets the fraction of headers that are known. unpacked: height maps of archives. Raises TerrainError for
    a file that cannot be a part of a mosaic.
    """
    unpacked = unpacked or UnpackedFiles()
    paths, named = height_maps_of(settings), named_files(settings)
    stored = _stored_tiles(store, settings) if store is not None else {}
    found: list[tuple[Path, SourceTile | None, bool]] = []  # path, tile, and whether it is a picture to be left out
    unplaced: TerrainError | None = None
    for number, path in enumerate(paths):
        tile, is_picture = stored.get(str(path)), False
        now = tuple(_with_sidecars(path))
        # `files` begins with the tile and its sidecars. A new sidecar may change the header, too; further files are
        # sources that a VRT names. Entries do not tell whether a tile of 8 bits is a picture.
        if (
            tile is None
            or tile.stored == "uint8"
            or now != tile.files[: len(now)]
            or list(tile.files) != list(tile.files_now())
        ):
            try:
                tile, is_picture = _read_tile(path, settings, unpacked)
            except TerrainError as error:
                if error.code != UNPLACED_PICTURE or str(path) in named:
                    raise
                tile, is_picture, unplaced = None, True, error
        found.append((path, tile, is_picture and str(path) not in named))
        on_progress((number + 1) / len(paths))
    if all(is_left_out for *_, is_left_out in found):
        if unplaced is not None:
            raise unplaced
        return Catalogue([tile for _, tile, _ in found if tile is not None], [])
    tiles = [tile for _, tile, is_left_out in found if tile is not None and not is_left_out]
    return Catalogue(tiles, [path for path, _, is_left_out in found if is_left_out])


def open_tile(path: Path, settings: ImportSettings) -> Raster:
    """Open one file of a mosaic; the caller closes it. Its samples are as the file stores them. Raises TerrainError.

    path: the file, or the unpacked copy of one in an archive. From now on GDAL ignores files beside those that it
    opens, until the next tile is opened.
    """
    # Without the settings of the mosaic as a whole.
    of_one_file = dataclasses.replace(
        settings, source=str(path), more_sources=(), priority=ORDER, step=None, blend=True, project=""
    )
    raster = open_tile_source(of_one_file)
    ignore_neighbours()  # a VRT opens its sources later, while it is read
    return raster


def keep_catalogue(tiles: Sequence[SourceTile], settings: ImportSettings, folder: Path) -> None:
    """Write a catalogue, the headers of a mosaic's files, into a store's folder of arrays, for the next import.

    settings: those with which the headers were read.
    """
    entries = [dataclasses.asdict(tile) for tile in tiles]
    content = {"version": VERSION, "settings": _header_settings(settings), "tiles": entries}
    text = json.dumps(content)
    (folder / FILE_NAME).write_text(json.dumps({"sum": _sum(text), "content": text}), encoding="utf-8")


def earlier_paths(store: Path, settings: ImportSettings) -> dict[str, str]:
    """Return paths with `..`, which older versions wrote into a store's catalogue, by the same paths without `..`.

    An import that finds such paths takes their files as those of the store, instead of reading them again.
    """
    written = (entry[0] for tile in _stored_tiles(store, settings).values() for entry in tile.files)
    paths = {absolute_source(path): path for path in written if ".." in Path(path).parts}
    # The catalogue does not list tile indexes, only their files, whose paths begin with the folder of the index. So an
    # index was written with that of their parent folders that contains `..` and leads to its own folder.
    indexes = [path for path in files_of(settings) if paths and path.suffix.lower() in INDEX_SUFFIXES]
    folders = [folder for path in paths.values() for folder in Path(path).parents] if indexes else []
    for index in indexes:
        matching = (folder for folder in folders if ".." in folder.parts and without_dots(folder) == index.parent)
        paths |= {str(index): str(folder / index.name) for folder in itertools.islice(matching, 1)}  # the first, if any
    return paths


def _with_sidecars(path: Path) -> list[tuple[str, int, int] | None]:
    """Return path, size and modification time of a tile and of its sidecars; None for a file that cannot be read."""
    return [*files_of_tile(path)] if is_inside(path) else [*map(_stat, [path, *sidecars(path)])]


def _stat(path: str | Path) -> tuple[str, int, int] | None:
    """Return path, size and modification time of a file; None if it cannot be read."""
    try:
        return file_stat(path)
    except OSError:
        return None


def _read_tile(path: Path, settings: ImportSettings, unpacked: UnpackedFiles) -> tuple[SourceTile, bool]:
    """Read the header of one file; return it, and whether the file is a picture.

    unpacked: height maps of archives. Raises TerrainError for a file that cannot be a part of a mosaic, with the code
    UNPLACED_PICTURE for a picture.
    """
    check_named(archive_of(path))
    files = filter(None, _with_sidecars(path))  # entries (path, size, modification time); None: it cannot be read
    raster = open_tile(unpacked.path_of(path), settings)
    try:
        grid = raster.grid
        is_web_tile = tile_of(path) is not None  # it has its position by its name
        is_picture = raster.is_picture and not is_web_tile
        if grid is None or raster.window is None or grid.transform is None:
            problem = "its rows and columns are not perpendicular" if raster.projected_from else "it has no position"
            problem = grid.problem if grid is not None and grid.problem else problem
            raise TerrainError(
                f"{shown(path)} cannot be a part of a mosaic ({problem})",
                expected="a coordinate system and the position of its samples",
                fix="name the encoding of its colours (--encoding)"
                if is_web_tile
                else "place it first (gdal_translate -a_ullr, gdalwarp), or import it by itself",
                code=UNPLACED_PICTURE if is_picture else "",
            )
        crs, datum = names_of(grid.crs) if grid.crs is not None else ("", "")
        tile = SourceTile(
            path=str(path),
            files=(*files, *map(file_stat, raster.sources)),
            width=raster.width,
            height=raster.height,
            transform=_transform_of(grid.transform),
            crs=crs,
            datum=datum,
            stored=raster.stored,
            format=raster.format,
            scale=float(raster.scale),
            offset=float(raster.offset),
            block_rows=int(raster.block_rows),
            roundings=tuple(raster.roundings),
            warnings=tuple(map(unpacked.with_names, raster.warnings)),
        )
        return tile, is_picture
    finally:
        raster.close()


def _transform_of(numbers: Sequence[float]) -> Transform:
    """Return six numbers as floats. Raises ValueError for another count."""
    a, b, c, d, e, f = map(float, numbers)
    return a, b, c, d, e, f


def _header_settings(settings: ImportSettings) -> list:
    """Return the settings that decide how headers are read, as a JSON list; no-data as a text, since it may be NaN."""
    return [settings.band, str(settings.no_data), settings.encoding, settings.cell]


def _sum(text: str) -> str:
    """Return the checksum of a catalogue's content."""
    return hashlib.sha256(text.encode()).hexdigest()


def _stored_tiles(store: Path, settings: ImportSettings) -> dict[str, SourceTile]:
    """Return the tiles of a store's catalogue by path, {} without one that can be used with these settings.

    store: a store, or the folder of arrays in it.
    """
    folder = store if (store / FILE_NAME).exists() else named_folder(store)
    if folder is None:
        return {}
    try:
        outer = json.loads(read_regular(folder / FILE_NAME, MAX_BYTES, links=False).decode("utf-8"))
        content = json.loads(outer["content"])
        if outer["sum"] != _sum(outer["content"]) or content["version"] != VERSION:
            return {}
        if content["settings"] != _header_settings(settings):
            return {}
        tiles = [_tile_of(entry) for entry in content["tiles"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError, TerrainError):
        return {}
    return {tile.path: tile for tile in tiles}


def _tile_of(entry: dict) -> SourceTile:
    """Return the tile of a catalogue's entry.

    Raises ValueError, TypeError, KeyError or TerrainError for an invalid one.
    """
    values = {field.name: entry[field.name] for field in dataclasses.fields(SourceTile)}
    values["files"] = tuple((str(path), int(size), int(changed)) for path, size, changed in entry["files"])
    values["transform"] = _transform_of(entry["transform"])
    values["roundings"] = tuple(_rounding_of(rounding) for rounding in entry["roundings"])
    values["warnings"] = tuple(map(shown, entry["warnings"]))
    tile = SourceTile(**values)
    if not tile.files or not tile.roundings:
        raise ValueError("a tile lacks files or roundings")
    _check_types([tile.path, tile.crs, tile.datum, tile.format, *(entry[0] for entry in tile.files)], str)
    _check_numbers(*tile.transform, tile.scale, tile.offset)
    without_rounded_skew(tile.transform)  # raises TerrainError for cells without an area
    _check_kind(tile.stored)
    counts = tile.width, tile.height, tile.block_rows
    _check_types(counts, int)
    if not all(0 < count <= MAX_SIDE for count in counts):
        raise ValueError("a tile has an impossible size")
    # GDAL's other notations for a coordinate system may name a file.
    if not _SYSTEM.fullmatch(tile.crs):
        raise ValueError("a coordinate system is neither a code nor WKT")
    return tile


def _rounding_of(entry: dict) -> SourceRounding:
    """Return a rounding from its dictionary in the catalogue, which holds the rounding before it as another one.

    Raises ValueError, TypeError or KeyError for an invalid one.
    """
    before = _rounding_of(entry["before"]) if entry["before"] is not None else None
    rounding = SourceRounding(**{**entry, "before": before})
    _check_kind(rounding.stored)
    _check_numbers(rounding.error, rounding.scale, rounding.offset)
    _check_types([rounding.bits], int)
    _check_types([rounding.lossy], str)
    if not 0 <= rounding.bits <= 64 or rounding.error < 0.0:
        raise ValueError("a rounding is negative")
    return rounding


def _check_types(values: Iterable, kind: type) -> None:
    """Raise ValueError unless all values have a type."""
    if not all(type(value) is kind for value in values):
        raise ValueError("a value has another type")


def _check_numbers(*numbers: float) -> None:
    """Raise ValueError unless all numbers are finite floats."""
    _check_types(numbers, float)
    if not all(map(math.isfinite, numbers)):
        raise ValueError("a number is not finite")


def _check_kind(stored: str) -> None:
    """Raise ValueError or TypeError unless a text names a type of real numbers."""
    _check_types([stored], str)
    if np.dtype(stored).kind not in "iuf":
        raise ValueError("samples are no real numbers")
