# SPDX-License-Identifier: GPL-3.0-or-later
"""Which files of a folder, or of an archive, may be tiles of a mosaic, by their names."""

import os
from collections.abc import Collection

from .source_formats import FORMATS

# A picture in a folder of tiles is a height map only if one of these files places it.
PICTURE, WORLD_FILES = ".png", (".pgw", ".pngw", ".wld", ".png.aux.xml")
# In a folder these would name the same heights again.
NOT_IN_FOLDERS = (".vrt",)


def is_tile(name: str, lower: Collection[str]) -> bool:
    """Return whether a file of a folder may hold a part of the terrain. lower: names of all files in small letters.

    A picture needs a file that places it. An archive does not count if its content is there, too.
    """
    suffix = suffix_of(name)
    stem = name.lower().removesuffix(suffix)
    if is_archive_name(name):
        # A .gz names its content; any .zip may hold tiles.
        return (suffix != ".gz" or _has_driver(stem)) and not _is_beside(stem, lower)
    if not _has_driver(name):  # by its suffix no raster with a position
        return False
    return suffix != PICTURE or any(stem + world in lower for world in WORLD_FILES)


def is_archive_name(name: str) -> bool:
    """Return whether a file is an archive of rasters, by its name."""
    suffix = suffix_of(name)
    return suffix in FORMATS and FORMATS[suffix].is_archive


def _has_driver(name: str) -> bool:
    """Return whether a file may be a raster with a position, and is none of NOT_IN_FOLDERS, by its name."""
    suffix = suffix_of(name)
    return suffix in FORMATS and bool(FORMATS[suffix].driver) and suffix not in NOT_IN_FOLDERS


def _is_beside(stem: str, lower: Collection[str]) -> bool:
    """Return whether a folder holds the height map of an archive unpacked, by the archive's name without its suffix.

    lower: names of all files in small letters.
    """
    return stem in lower or any(_has_driver(stem + suffix) and stem + suffix in lower for suffix in FORMATS)


def suffix_of(name: str) -> str:
    """Return the suffix of a file's name in lower case, "" without one."""
    return os.path.splitext(name)[1].lower()
