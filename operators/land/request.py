# SPDX-License-Identifier: GPL-3.0-or-later
"""The shaped land that a terrain's settings ask for."""

from pathlib import Path

from ...cbt_terrain.field import store_folder
from ...cbt_terrain.height_operators import derived_store
from ...cbt_terrain.height_operators.derived_store import Land
from ...cbt_terrain.height_operators.land_folder import MASKS, folder_beside
from ...cbt_terrain.run import owned_files
from ..bridge.scene_paths import absolute_path
from ..text.console import print_line
from . import stack as land_stack
from .properties import SEEN

derived_store.notify = lambda sentence: print_line(f"Adaptive Terrain: {sentence}")


def land_of(obj, evaluated, depsgraph, waits: bool) -> Land | None:
    """Return the Land to shape from a terrain's store by its stack; None without an active stack.

    None, too, for a terrain hidden in viewports unless `waits`. `waits`: the caller, such as a render, waits for shaped
    land; otherwise a preview is enough. evaluated: `obj` as `depsgraph` evaluated it. Nothing is shaped, but files of
    masks are written, and the engine notes that this terrain uses the land. Raises TerrainError for an invalid entry.
    """
    settings = evaluated.adaptive_terrain
    if not settings.store or not any(entry.on for entry in settings.land.entries):
        derived_store.release(obj.session_uid)  # files of its land are no longer kept for this terrain
        return None
    if not waits and not obj.visible_get(view_layer=depsgraph.view_layer):
        return None
    # Save As to another folder gives the store's path `..`, and the land stays the same.
    source = str(owned_files.without_dots(Path(absolute_path(settings.store))))
    folder = folder_beside(source)
    owned_files.check_folder(folder, MASKS, store_folder.TILES)  # raises if one of these is a link or a user's file
    stack = land_stack.stack_of(evaluated, depsgraph, folder / MASKS)
    if not stack.active:
        return None
    land = Land.of(source, stack, waits)
    derived_store.use(obj.session_uid, land)
    # in_shots: fine only in view of the scene's frames, or everywhere if that costs less
    return land.in_shots if settings.land.where == SEEN else land
