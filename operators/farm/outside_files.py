# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that a job would copy from outside the scene's folder: an untrusted scene may name any file of the user."""

import os
from collections.abc import Sequence
from pathlib import Path

import bpy

from ...cbt_terrain.attributes.folder import JSON_NAME as MAPS_JSON
from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.field.store import JSON_NAME as STORE_JSON
from ...cbt_terrain.rasters.sidecars import SUFFIXES
from ...cbt_terrain.rasters.source_formats import FORMATS
from ...cbt_terrain.run.owned_files import LAND, real_path

HEIGHT_MAP_ENDS = (*FORMATS, *SUFFIXES)  # of the names of height maps and files beside them
MAX_NAMED = 10


def check_outside(
    home: Path, files: Sequence[Path], height_maps: Sequence[Path], folders: Sequence[Path], allowed: bool
) -> list[Path]:
    """Return the files and folders of a job that are outside `home`, the scene's folder, with links resolved.

    Images, height maps, stores, shaped land and baked maps may be outside. Raises TerrainError for anything else,
    unless `allowed`: an untrusted scene may name any file. The suffix of a link's target counts, not that of the
    link.

    files: of the job, height maps included. height_maps: files that an import reads. folders: of the job.
    """
    home = real_path(home)
    terrain_folders = [real_path(folder) for folder in folders if _is_terrain_folder(folder)]
    # The job copies what these links point to; files of a terrain's own folders need no check.
    links = [link for folder in terrain_folders for link in _links_in(folder)]
    paths = dict.fromkeys(real_path(path) for path in (*files, *folders, *links))
    outside = [path for path in paths if not path.is_relative_to(home)]
    height_maps = {real_path(path) for path in height_maps}
    refused = [
        path
        for path in outside
        if not any(path.is_relative_to(folder) for folder in terrain_folders)
        and path.suffix.lower() not in bpy.path.extensions_image
        and not (path in height_maps and path.name.lower().endswith(HEIGHT_MAP_ENDS))
    ]
    if refused and not allowed:
        raise TerrainError(
            f"The job would copy files from outside the scene's folder {shown(home)} that are neither images, height "
            f"maps nor stores: {named_some(refused)}",
            expected="them in that folder",
            fix="move them there, or use --allow-outside (Allow Outside)",
        )
    return outside


def named_some(paths: Sequence[Path]) -> str:
    """Return the first paths as text, with the number of the others."""
    more = f" and {len(paths) - MAX_NAMED:,} more" if len(paths) > MAX_NAMED else ""
    return ", ".join(shown(path) for path in paths[:MAX_NAMED]) + more


def _is_terrain_folder(folder: Path) -> bool:
    """Return whether a folder is a store, has the shaped land of a store in the same folder, or has baked maps."""
    store = folder.parent / folder.name.removesuffix(LAND)
    return (store / STORE_JSON).is_file() or (folder / MAPS_JSON).is_file()


def _links_in(folder: Path) -> list[Path]:
    """Return the links in a folder and its subfolders."""
    walked = (os.path.join(inner, name) for inner, dirs, names in os.walk(folder) for name in (*dirs, *names))
    return [Path(path) for path in walked if os.path.islink(path)]
