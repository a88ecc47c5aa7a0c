# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths that a .blend file holds, as this machine opens them."""

import os
import re
from pathlib import Path

from ...cbt_terrain.errors import TerrainError

NO_HEIGHTS = "terrain.no_heights"  # code of the error of a terrain without a store
_DRIVE = re.compile(r"^[A-Za-z]:[\\/]")


def absolute_path(text: str, library=None) -> str:
    r"""Return the absolute form of a path property, whatever system it was saved on.

    Blender on Windows saves `//terrain\store`, and `bpy.path.abspath` elsewhere takes that for one name. A backslash
    counts as a separator unless a file of exactly that name exists. A path with a drive letter names a place on another
    machine, and is returned as it is. library: the library that the path's owner is linked from, None for this file.
    """
    import bpy  # an export of .npz imports this module without Blender

    path = bpy.path.abspath(text, library=library)
    if os.sep == "\\" or "\\" not in path or _DRIVE.match(text) or os.path.lexists(path):
        return path
    return bpy.path.abspath(text.replace("\\", "/"), library=library)


def store_path(obj) -> str:
    """Return the absolute path of a terrain's store. Raises TerrainError if the terrain has none."""
    if not obj.adaptive_terrain.store:
        raise no_heights(obj)
    return absolute_path(obj.adaptive_terrain.store)


def propose_file(operator, obj, name_end: str = "") -> None:
    """Let the file dialog of an operator propose the terrain's name, unless it has a path already.

    The folder is that of the .blend file, or before it is saved that of the terrain's height map; without both the
    dialog chooses it. `name_end`: added to the name, which keeps a proposal from replacing that height map.
    """
    import bpy

    if operator.filepath:
        return
    settings, name = obj.adaptive_terrain, bpy.path.clean_name(obj.name) + name_end + operator.filename_ext
    beside = bpy.data.filepath or (absolute_path(settings.source_path) if settings.source == "FILE" else "")
    operator.filepath = str(Path(beside).with_name(name)) if beside else name


def no_heights(obj) -> TerrainError:
    """Return the error for a terrain without a store."""
    what = f"The terrain {obj.name!r} has no height field"
    return TerrainError(what, fix="import one from its panel", code=NO_HEIGHTS)
