# SPDX-License-Identifier: GPL-3.0-or-later
"""The files that the sources of an import name: files, folders, patterns and tile indexes."""

import errno
import glob
import itertools
import os
from collections.abc import Collection
from pathlib import Path

from ..errors import TerrainError, check_path, shown
from ..field.lands import LANDS
from ..field.store_folder import JSON_NAME
from ..formats.file_options import FILE, LAND, check_applies, options_of
from ..rasters.coded_heights import HALF_WORLD, tile_of
from ..rasters.raster import ImportSettings
from ..rasters.source_formats import BAND, CELL, ENCODING, FORMATS
from ..rasters.tile_names import is_archive_name, is_tile, suffix_of
from ..run.owned_files import without_dots

# Tile indexes of GDAL: XML or a database that names files.
INDEX_SUFFIXES = (".gti", ".gpkg", ".shp")
WEB_SUFFIXES = (".png", ".webp")  # of web map tiles
MAX_FILES = 1_000_000


def names_several(settings: ImportSettings) -> bool:
    """Return whether an import has several files: further sources, a folder, a pattern or a tile index."""
    source = settings.source
    if settings.more_sources:
        return True
    return source not in LANDS and (_is_folder(source) or _is_pattern(source) or _is_index(source))


def may_name_several(settings: ImportSettings) -> bool:
    """Return whether an import may have several files: it names several, or one .zip, which may hold several tiles.

    Nothing is opened. Only the import's child process looks into an archive.
    """
    return names_several(settings) or suffix_of(Path(settings.source).name) == ".zip"  # without a last "/"


def check_options(settings: ImportSettings, given: Collection[str]) -> None:
    """Raise TerrainError for a setting that the sources do not have, by their names. given: names of those to check.

    A single .zip may have any: what is in it is checked when it is opened.
    """
    if names_several(settings):
        check_applies(settings, options_of_several(settings), given)
    elif not may_name_several(settings):
        check_applies(settings, (LAND,) if settings.source in LANDS else options_of(Path(settings.source)), given)


def options_of_several(settings: ImportSettings) -> set[str]:
    """Return the options that several files have: those that one of them has, by its name.

    Files of an archive or a tile index may have any that belongs to files with a position.
    """
    suffixes = {suffix_of(path.name.lower().removesuffix(".gz")) for path in files_of(settings)}
    options = {BAND, ENCODING, CELL}
    if suffixes.isdisjoint({".zip", *INDEX_SUFFIXES}):
        options &= {option for suffix in suffixes & FORMATS.keys() for option in FORMATS[suffix].options}
    return {*options, FILE}


def files_of(settings: ImportSettings) -> list[Path]:
    """Return the absolute paths of all files and tile indexes that the sources name, in order and once each.

    A file that is named twice has its last position. Files of a folder or a pattern are sorted by name. Nothing is
    opened; a file that is named alone need not exist. Raises TerrainError for a folder or a pattern without a height
    map, for a built-in terrain, and for more than MAX_FILES files.
    """
    files: dict[Path, None] = {}
    for source in settings.sources:
        if source in LANDS:
            what = f"The built-in terrain {source} cannot be one of several sources"
            raise TerrainError(what, fix="import it by itself")
        check_path("The source", source)
        for path in _files_of_one(source, settings.step):
            files.pop(path, None)
            files[path] = None
    if len(files) > MAX_FILES:
        what = f"The sources name {len(files):,} files"
        raise TerrainError(what, expected=f"{MAX_FILES:,} at most", fix="import a part of them")
    return list(files)


def holds_height_maps(folder: str) -> bool:
    """Return whether a folder is no store and holds height maps that may have a position, by their names.

    Raises TerrainError for a folder that cannot be read.
    """
    return not os.path.lexists(os.path.join(folder, JSON_NAME)) and bool(_files_in(Path(folder).absolute(), None))


def file_stat(path: str | os.PathLike) -> tuple[str, int, int]:
    """Return a file's path, size and modification time (ns). Raises OSError."""
    stat = os.stat(path)
    return str(path), stat.st_size, stat.st_mtime_ns


def absolute_source(source: str) -> str:
    """Return the absolute path of a source without `..`, unless these follow a link; the name of a built-in terrain.

    An import thus has one path for a file, from whatever folder it is named.
    """
    return source if source in LANDS else str(without_dots(Path(source).absolute()))


def has_archives(settings: ImportSettings) -> bool:
    """Return whether one of the files that the sources name is an archive."""
    return any(is_archive_name(path.name) for path in files_of(settings))


def _files_of_one(source: str, step: float | None) -> list[Path]:
    """Return the absolute paths of the files of one source: a folder, a pattern or a file.

    step: metres of a pixel that decides the zoom level of web map tiles; None for the finest. Raises TerrainError for a
    folder or a pattern without a height map.
    """
    whole = absolute_source(source)
    if _is_folder(source):
        files = _files_in(Path(whole), step)
        if not files:
            raise TerrainError(
                f"The folder {shown(source)} holds no height map with a position",
                expected="files such as .tif, .hgt or .asc",
                fix="choose other files; for those of inner folders type a pattern such as DIR/**/*.tif as the source, "
                "in a command or in the tab of a terrain",
            )
        return files
    if _is_pattern(source):
        # The folder before the first wildcard must be readable, else nothing would seem to match.
        _check_right(Path(*itertools.takewhile(lambda part: not glob.has_magic(part), Path(source).parts)))
        names = sorted(glob.glob(whole, recursive=True))
        files = [Path(name) for name in names if os.path.isfile(name) and suffix_of(name) in FORMATS]
        if not files:
            what = f"No height map matches the pattern {shown(source)}"
            raise TerrainError(what, fix="check the folder and the suffix")
        return files
    return [Path(whole)]


def _files_in(folder: Path, step: float | None) -> list[Path]:
    """Return the height maps of a folder that may have a position, sorted by name.

    Inner folders are searched for web map tiles, if there is nothing else. A link counts as the file that it leads to.
    step: metres of a pixel that decides the zoom level of web map tiles (`_web_tiles`); None for the finest. Raises
    TerrainError for a folder that cannot be read.
    """
    _check_right(folder)
    try:
        with os.scandir(folder) as entries:
            names = {entry.name for entry in entries if suffix_of(entry.name) and os.path.isfile(entry.path)}
    except OSError as reason:
        raise _unreadable(folder, reason.strerror or str(reason)) from reason
    lower_names = {name.lower() for name in names}  # a picture counts only beside a file that places it
    return [folder / name for name in sorted(names) if is_tile(name, lower_names)] or _web_tiles(folder, step)


def _check_right(folder: Path) -> None:
    """Raise TerrainError for a folder whose files this user may not list or not open, which would look empty."""
    if os.path.isdir(folder) and not os.access(folder, os.R_OK | os.X_OK):
        raise _unreadable(folder, os.strerror(errno.EACCES))


def _unreadable(folder: Path, reason: str) -> TerrainError:
    """Return the error for a folder that cannot be read."""
    return TerrainError(f"The folder {shown(folder)} cannot be read ({reason})", fix="change its permissions")


def _web_tiles(folder: Path, step: float | None) -> list[Path]:
    """Return the web map tiles z/x/y.png in a folder, or x/y.png in a folder named z, of one zoom level.

    The level is the coarsest one with pixels of at most `step` metres (of web mercator), or else the finest one.
    Without such tiles the list is empty.
    """
    levels: dict[int, list[tuple]] = {}  # by zoom level z: (z, x, y, path) of each tile
    for pattern in ("[0-9]*/[0-9]*/[0-9]*", "[0-9]*/[0-9]*"):
        for path in folder.glob(pattern):
            place = tile_of(path) if path.suffix.lower() in WEB_SUFFIXES and os.path.isfile(path) else None
            if place is not None:
                levels.setdefault(place[0], []).append((*place, path))
        if levels:
            break
    # A tile of level `zoom` has 256 pixels a side, and 2^zoom of them span the world.
    fine_enough = [zoom for zoom in levels if step is not None and 2.0 * HALF_WORLD / (256 << zoom) <= step]
    chosen = min(fine_enough, default=max(levels, default=0))
    return [path for *_, path in sorted(levels.get(chosen, ()))]


def _is_folder(source: str) -> bool:
    """Return whether a source is a folder; a name that no file can have is none."""
    try:
        return os.path.isdir(source)
    except ValueError:  # a NUL in the name
        return False


def _is_pattern(source: str) -> bool:
    """Return whether a source is a pattern; a file whose name holds such characters is none."""
    return glob.has_magic(source) and not os.path.lexists(source)


def _is_index(source: str) -> bool:
    """Return whether a source is a file that lists other files, by its suffix."""
    return suffix_of(source) in INDEX_SUFFIXES
