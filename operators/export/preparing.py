# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the stores, land and maps of a scene once ahead of its frames, so that no two workers make them at once."""

from collections.abc import Callable, Sequence
from pathlib import Path

import bpy
import numpy as np

from ...cbt_terrain.field.store import JSON_NAME
from ...cbt_terrain.height_operators.derived_store import raster_of
from ...cbt_terrain.importing.import_process import import_source
from ..bridge.scene_paths import store_path
from ..importing.import_terrain import settings_of
from ..importing.import_terrain import summary as import_summary
from ..land.request import land_of
from ..land.shape_land import wanted_land
from ..maps.baking import carry_out
from ..maps.baking import summary as maps_summary
from ..maps.properties import SHOT
from ..maps.request import gathered, read_as_images
from ..session import session
from ..session.shot import look_through

Say = Callable[[str], None]
To = Callable[[float], None]  # part of a terrain that is done, 0 .. 1


def store_of(obj) -> Path:
    """Return the folder that a terrain's settings name. Raises TerrainError if they name none."""
    return Path(store_path(obj))


def is_missing(store: Path) -> bool:
    return not (store / JSON_NAME).exists()


def import_store(obj, _frames: Sequence[int], say: Say, to: To) -> None:
    """Import a terrain's height map into the store that its settings name, where there is none."""
    store = store_of(obj)
    if is_missing(store):
        report = import_source(settings_of(obj), store, on_progress=lambda fraction, _message: to(fraction))
        say(f"{obj.name}: imported, {import_summary(report)}")
    else:
        session.open_field(str(store))
        say(f"{obj.name}: its store is there")


def shape_land(obj, frames: Sequence[int], say: Say, to: To) -> None:
    """Shape a terrain's land, and bake the maps that its materials show.

    This is done for the whole terrain, or for the ground that the camera sees in `frames`, as its settings choose.
    Existing land and maps are kept.
    """
    scene, depsgraph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    if obj.hide_render:
        return
    land = land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=True)
    if land is not None:
        views = []
        if land.of_views:
            *_, views = look_through(obj, scene, frames, np.array(obj.matrix_world, np.float64))
        raster_of("", wanted_land(obj, bpy.context.evaluated_depsgraph_get(), views), session.open_field, verified=True)
        say(f"{obj.name}: its land is shaped")
    if names := read_as_images(obj):
        shot = frames if obj.adaptive_terrain.maps.frames == SHOT else None
        *_, request = gathered(obj, scene, names, shot)
        field = raster_of(request.store, request.land, session.open_field, verified=True)
        say(maps_summary(carry_out(request, field, to), obj.name))


PARTS = {"stores": import_store, "land": shape_land}


def prepare(objects: Sequence, frames: Sequence[int], parts: Sequence[str], say: Say, to: To) -> None:
    """Make the `parts` of the terrains `objects` of the open file, for `frames`.

    `to` is called with the number of terrains that are finished. Raises TerrainError.
    """
    work = [(PARTS[part], obj) for part in parts for obj in objects]
    for done, (make, obj) in enumerate(work):
        to(done)
        make(obj, frames, say, lambda fraction, done=done: to(done + fraction))
    to(len(work))
