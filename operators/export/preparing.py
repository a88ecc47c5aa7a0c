# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the stores, land and maps of a scene once ahead of its frames, so that no two workers make them at once."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.store import JSON_NAME, read_json
from ...cbt_terrain.height_operators.derived_store import raster_of
from ...cbt_terrain.importing.import_process import import_source
from ...cbt_terrain.importing.thinning import loaded_m
from ..bridge.evaluated import raster_placement_of
from ..bridge.scene_paths import store_path
from ..importing.import_terrain import settings_of
from ..importing.import_terrain import summary as import_summary
from ..land.request import land_of
from ..land.shape_land import wanted_land
from ..maps.baking import bake_maps
from ..maps.baking import summary as maps_summary
from ..maps.properties import SHOT
from ..maps.request import maps_shown_by_materials, visit_for_request
from ..session import session
from ..session.shot import visit_views

Say = Callable[[str], None]
OnProgress = Callable[[float], None]


def store_folder_of(obj) -> Path:
    """Return the store folder that a terrain's settings name. Raises TerrainError if they name none."""
    return Path(store_path(obj))


def is_missing(store: Path) -> bool:
    """Return whether a folder has no complete store yet; False for a damaged one: opening it reports the damage."""
    if not (store / JSON_NAME).exists():
        return True
    with suppress(TerrainError):  # who opens a damaged store reports it
        return loaded_m(read_json(store)["provenance"]) is not None
    return False


def import_store(obj, _frames: Sequence[int], say: Say, on_progress: OnProgress) -> None:
    """Import a terrain's height map into the store that its settings name, unless the complete store exists.

    say: prints a line. on_progress: takes the fraction done. Raises TerrainError, also for a damaged store.
    """
    store = store_folder_of(obj)
    if is_missing(store):
        report = import_source(settings_of(obj), store, on_progress=lambda fraction, _message: on_progress(fraction))
        say(f"{obj.name}: imported, {import_summary(report)}")
    else:
        session.open_field(str(store))
        say(f"{obj.name}: its store is there")


def shape_land(obj, frames: Sequence[int], say: Say, on_progress: OnProgress) -> None:
    """Shape a terrain's land, and bake the maps that its materials show; existing ones are reused.

    A terrain that is hidden in renders needs none.

    Depending on its settings this is done for the whole terrain, or for the ground that the camera sees in `frames`.
    say: prints a line. on_progress: takes the fraction of the maps that is done.
    """
    scene, depsgraph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    if obj.hide_render:
        return
    land = land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=True)
    if land is not None:
        views = []
        if land.of_views:
            *_, views = visit_views(obj, scene, frames, raster_placement_of(obj), about_middle=True)
        # "": the store counts only without land
        raster_of("", wanted_land(obj, bpy.context.evaluated_depsgraph_get(), views), session.open_field, verified=True)
        say(f"{obj.name}: its land is shaped")
    if names := maps_shown_by_materials(obj):
        shot = frames if obj.adaptive_terrain.maps.frames == SHOT else None
        *_, request = visit_for_request(obj, scene, names, shot)
        field = raster_of(request.store, request.land, session.open_field, verified=True)
        say(maps_summary(bake_maps(request, field, on_progress), obj.name))


PARTS = {"stores": import_store, "land": shape_land}


def prepare(objects: Sequence, frames: Sequence[int], parts: Sequence[str], say: Say, on_progress: OnProgress) -> None:
    """Make the `parts` ("stores", "land") that frames of the open file need, for the terrains `objects`.

    say: prints a line. on_progress: takes the number of finished terrains, counted for each part, with fractions.
    Raises TerrainError.
    """
    work = [(PARTS[part], obj) for part in parts for obj in objects]
    for done, (make, obj) in enumerate(work):
        on_progress(done)
        make(obj, frames, say, lambda fraction, done=done: on_progress(done + fraction))
    on_progress(len(work))
