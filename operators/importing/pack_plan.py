# SPDX-License-Identifier: GPL-3.0-or-later
"""What packing copies beside a .blend file: stores, and the shaped land and the baked maps that belong to them."""

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field import store as stores
from ...cbt_terrain.field.moving import copy_entry
from ...cbt_terrain.field.packing import copy_store
from ...cbt_terrain.height_operators import requested_tiles
from ...cbt_terrain.height_operators.land_folder import bytes_in
from ...cbt_terrain.height_operators.land_folder import folder_beside as land_beside
from ...cbt_terrain.run.owned_files import MAPS, open_folder, real_path
from ..bridge.scene_paths import absolute_path
from ..land.request import land_of
from ..maps.properties import map_folder
from ..session import session
from ..text.numbers import plain
from .incomplete import check_complete
from .store_location import folder_beside, is_beside, lies_beside, source_name

OnProgress = Callable[[float], None]


@dataclass
class PackPlan:
    """Copies that packing makes.

    `stores`: the folder of each store, its new path, which may be relative, and the terrains (session_uid) that use it.
    `lands`, `maps`: folders and their new folders.
    """

    stores: dict[str, tuple[str, list[int]]] = field(default_factory=dict)
    lands: dict[str, str] = field(default_factory=dict)
    maps: dict[str, str] = field(default_factory=dict)

    def copies(self) -> list[Callable[[OnProgress], None]]:
        """Return the functions that make the copies: stores, then land, then maps. Each raises TerrainError.

        A function calls its argument with the fraction done, 0 .. 1, or not at all if nothing is to be copied.
        """
        found = [partial(copy_store, source, absolute_path(target)) for source, (target, _) in self.stores.items()]
        found += [partial(_copy_land, source, target) for source, target in self.lands.items()]
        return found + [partial(_copy_maps, source, target) for source, target in self.maps.items()]


def _copy_land(source: str, target: str, on_progress: OnProgress) -> None:
    """Copy a shaped store, with the record of the tiles that it was made for. Raises TerrainError.

    An existing store in `target` stays: another terrain has the same land.
    """
    if not stores.changed_ns(target):  # 0 without a store
        copy_store(source, target, on_progress)
        requested_tiles.note(target, requested_tiles.read_requested(source) or None)


def _copy_maps(source: str, target: str, on_progress: OnProgress) -> None:
    """Copy the folder of a terrain's maps, unless `target` exists. Raises TerrainError."""
    on_progress(0.0)
    try:
        with open_folder(Path(target).parent, make=True):
            if not os.path.lexists(target):
                copy_entry(Path(source), Path(target))
    except (OSError, TerrainError) as reason:
        why = getattr(reason, "strerror", None) or reason
        raise TerrainError(
            f"The maps {source} cannot be copied to {target} ({why})", fix="make room or save the file elsewhere"
        ) from reason


def terrains_to_pack() -> list:
    """Return the terrains of a saved file whose store is not in the file's folder; [] for an unsaved file."""
    if not bpy.data.filepath:
        return []
    with_store = [obj for obj in session.all_terrains() if obj.adaptive_terrain.store]
    return [obj for obj in with_store if not lies_beside(obj.adaptive_terrain)]


def plan_packing(objects: list) -> PackPlan:
    """Plan the copies for these terrains, with their shaped land and baked maps.

    Raises TerrainError for a store that is incomplete or cannot be read.
    """
    planned = PackPlan()
    for obj in objects:
        check_complete(obj, "press Load All, and pack when the import is done")
        folder = real_path(absolute_path(obj.adaptive_terrain.store))
        content = stores.read_json(folder)
        # By folder of a store: the path of its copy, which no other copy has, and the uids of its terrains.
        if str(folder) not in planned.stores:
            targets = {target for target, _ in planned.stores.values()}
            planned.stores[str(folder)] = _packed_path(obj, folder, content, targets), []
        target, uids = planned.stores[str(folder)]
        uids.append(obj.session_uid)
        if real_path(absolute_path(target)) != folder:  # else the store is below the .blend file already
            planned.lands |= _lands_of(obj, target)
            planned.maps |= _maps_of(obj, target)
    return planned


def _lands_of(obj, target: str) -> dict[str, str]:
    """Return {folder of shaped land that a terrain uses: folder of its copy}.

    A terrain has up to two: the land that renders wait for, and the one with only the parts in view fine. {} without a
    stack that can be applied; land that is missing or damaged is left out. target: new path of the terrain's store;
    copies of land are in a folder beside it.
    """
    depsgraph = bpy.context.evaluated_depsgraph_get()
    try:
        land = land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=True)
    except TerrainError:
        return {}  # a stack that cannot be applied has no land
    copies, found = land_beside(absolute_path(target)), {}
    for folder in (land.folder, land.of_views_alone.folder) if land is not None else ():
        with suppress(TerrainError):  # missing or damaged land is shaped again
            stores.open_store(folder)
            found[folder] = str(copies / Path(folder).name)
    return found


def _maps_of(obj, target: str) -> dict[str, str]:
    """Return {folder of a terrain's maps: folder of their copy}; {} if nothing is to be copied.

    That is the case if the user chose a folder for the maps (`maps.folder`), or no maps have been baked. `maps.mark`
    is the name of the terrain's folder, which the first baking sets. target: new path of the terrain's store.
    """
    maps, folder = obj.adaptive_terrain.maps, real_path(map_folder(obj))
    if maps.folder or not maps.mark or not os.path.isdir(folder):
        return {}
    store = Path(absolute_path(target))
    return {str(folder): str(store.with_name(store.name + MAPS) / folder.name)}


def _packed_path(obj, folder: Path, content: dict, targets: set[str]) -> str:
    """Return the path where packing puts a terrain's store.

    folder: its present folder. Beside the .blend file (`is_beside`) it stays, under a relative path; otherwise a free
    folder there is chosen. content: the store's JSON. targets: paths that other stores get. Raises TerrainError if
    packing may not write there.
    """
    if is_beside(folder):
        return bpy.path.relpath(str(folder))
    return _free_folder(folder_beside(obj, source_name(obj)), content, targets)


def _free_folder(wanted: str, content: dict, targets: set[str]) -> str:
    """Return `wanted`, or `wanted` with the first number whose path no other store has and `targets` lacks.

    content: JSON of the store to copy: a folder with the same store counts as free.
    """
    number = 1
    while True:
        folder = wanted if number == 1 else f"{wanted}_{number}"
        try:
            existing = stores.read_json(Path(absolute_path(folder)))
            is_free = (existing["key"], existing["data"]) == (content["key"], content["data"])
        except TerrainError:
            # A damaged store is not replaced.
            is_free = not os.path.exists(os.path.join(absolute_path(folder), stores.JSON_NAME))
        if is_free and folder not in targets:
            return folder
        number += 1


def room_text(planned: PackPlan) -> str:
    """Return the size of all that packing copies, for the question to the user. Raises OSError.

    On the same disk the arrays of stores are shared with the copy and take no room; maps always do.
    """
    folders = [*planned.stores, *planned.lands, *planned.maps]
    disk = os.stat(Path(bpy.data.filepath).parent).st_dev
    with_arrays = [*planned.stores, *planned.lands]
    takes_room = [f for f in folders if f not in with_arrays or os.stat(f).st_dev != disk]
    size = f"{plain(sum(bytes_in(Path(folder)) for folder in folders) / 1e6)} MB"
    return f"{size}, which take no more room on this disk" if not takes_room else size
