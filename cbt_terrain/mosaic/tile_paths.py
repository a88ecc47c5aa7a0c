# SPDX-License-Identifier: GPL-3.0-or-later
"""The files of a mosaic: those that its sources name, also in tile indexes and archives; pictures among them."""

from collections.abc import Collection, Sequence
from pathlib import Path

from ..errors import TerrainError, shown
from ..formats.archives import NO_HEIGHT_MAP, height_maps, is_archive
from ..importing.source_list import INDEX_SUFFIXES, absolute_source, files_of
from ..rasters.raster import ImportSettings
from .index_files import paths_in

NAMED_PICTURES = 3  # in the note on pictures that are left out


def height_maps_of(settings: ImportSettings) -> list[Path]:
    """Return the height maps that the sources name, also in tile indexes and archives, in order and once each.

    An archive without a height map is left out if a folder or a pattern names it and others have one. Raises
    TerrainError.
    """
    named = named_files(settings)
    paths: dict[Path, None] = {}  # a file that is named twice has its last place
    left_out: TerrainError | None = None
    for path in files_of(settings):
        try:
            files = _tiles_in(path)
        except TerrainError as error:
            if error.code != NO_HEIGHT_MAP or str(path) in named:
                raise
            files, left_out = [], error
        for file in files:
            paths.pop(file, None)
            paths[file] = None
    if not paths and left_out is not None:
        raise left_out
    return list(paths)


def named_files(settings: ImportSettings) -> Collection[str]:
    """Return the absolute paths that the sources are, so not those of files in a folder or of a pattern."""
    return {*map(absolute_source, settings.sources)}


def picture_notes(pictures: Sequence[Path]) -> list[str]:
    """Return a sentence about pictures that are left out of a mosaic; [] without any."""
    if not pictures:
        return []
    names = ", ".join(shown(path.name) for path in pictures[:NAMED_PICTURES])
    more = f" and {len(pictures) - NAMED_PICTURES:,} more" if len(pictures) > NAMED_PICTURES else ""
    return [
        f"Pictures beside the heights are left out (3 or 4 bands of 8 bits): {names}{more}. If they hold heights, name "
        "the files themselves, or the encoding of their colours (--encoding)."
    ]


def _tiles_in(path: Path) -> list[Path]:
    """Return the height maps that a tile index or an archive holds; any other file itself. Raises TerrainError."""
    if path.suffix.lower() in INDEX_SUFFIXES:
        return paths_in(path)
    return height_maps(path) if is_archive(path) else [path]
