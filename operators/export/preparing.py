# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the stores, land and maps of a scene once ahead of its frames, so that no two workers make them at once.

A store of a large source may be incomplete: it has every n-th sample. Then the tiles of the raster that the frames see
can be loaded in more detail. A farm's job does that in a copy of the store (its job store), or, if that is not enough,
begins an import of all samples into the terrain's own store. Several processes may share the tiles of either.

A function that makes a part gets a terrain (`obj`) and the Preparation `task`: the frames, where to report, the folder
of the job's stores and this process's share.
"""

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.store import JSON_NAME, read_json
from ...cbt_terrain.height_operators.derived_store import field_of_land, raster_of
from ...cbt_terrain.importing.import_process import import_source
from ...cbt_terrain.importing.thinning import loaded_m
from ...cbt_terrain.importing.tile_import import FILL, MEASURE, READ_TILES
from ..bridge.evaluated import raster_placement_of
from ..bridge.scene_paths import store_path
from ..importing.import_terrain import settings_of
from ..importing.import_terrain import summary as import_summary
from ..importing.shot_import import begin_import, forget_import, import_part, is_begun, shared_tiles
from ..importing.shot_tiles import can_load_tiles, job_store, load_tiles, plan_tiles, read_tiles, use_job_stores
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


class Preparation(NamedTuple):
    """What is made for the frames of a scene, and how it is reported.

    Attributes:
        say: prints a line.
        on_progress: takes the fraction of a terrain's part that is done.
        stores: folder of the stores of a farm's job, in which tiles in view are loaded; None for the terrains' own.
        share: this process's number, from 1, and the number of processes that share the work.
    """

    frames: Sequence[int]
    say: Say
    on_progress: OnProgress
    stores: Path | None = None
    share: tuple[int, int] = (1, 1)


def store_folder_of(obj) -> Path:
    """Return the store folder that a terrain's settings name. Raises TerrainError if they name none."""
    return Path(store_path(obj))


def is_missing(store: Path) -> bool:
    """Return whether a folder has no complete store yet; False for a damaged one: opening it reports the damage."""
    if not os.path.exists(store / JSON_NAME):
        return True
    with suppress(TerrainError):
        return loaded_m(read_json(store)["provenance"]) is not None  # None: all samples are loaded
    return False


def import_store(obj, task: Preparation) -> None:
    """Import a terrain's height map into the store that its settings name, unless the complete store exists.

    Of an incomplete store of a large source only the tiles that the frames see are loaded, if these are fine enough.
    Raises TerrainError, also for a damaged store.
    """
    store = store_folder_of(obj)
    if can_load_tiles(store) and not is_begun(obj, task.stores):  # is_begun: a job has begun to import all samples
        if text := load_tiles(obj, task.frames, task.stores, task.on_progress):
            task.say(f"{obj.name}: {text}")
            return
        task.say(f"{obj.name}: the frames need more detail than tiles in view have, so all samples are imported")
    if is_missing(store):  # or incomplete
        report = import_source(settings_of(obj), store, lambda fraction, _message: task.on_progress(fraction))
        task.say(f"{obj.name}: imported, {import_summary(report)}")
    else:
        session.open_field(str(store))  # raises the error of a damaged store
        task.say(f"{obj.name}: its store is there")


def find_view(obj, task: Preparation) -> None:
    """Choose the tiles that the frames see, if the store is incomplete; `read_view` then reads them.

    If a job's frames need more detail than tiles have, begin the import of all samples. Raises TerrainError.
    """
    if can_load_tiles(store_folder_of(obj)):
        text = plan_tiles(obj, task.frames, task.stores) or _begin_import(obj, task)
        task.say(f"{obj.name}: {text}")


def read_view(obj, task: Preparation) -> None:
    """Read this process's share of the tiles that `find_view` has chosen into files, which `load_view` then loads.

    Raises TerrainError.
    """
    scene_store = store_folder_of(obj)
    if can_load_tiles(scene_store):
        store = scene_store if task.stores is None else job_store(obj, task.stores)
        task.say(f"{obj.name}: {read_tiles(obj, store, task.share, task.on_progress):,} tiles read")


def load_view(obj, task: Preparation) -> None:
    """Load the tiles that the frames see into a job's store; if that is not enough, begin the import of all samples.

    Also begin the import of a missing store that several computers share; remove the record of an earlier one if one
    computer is enough. `import_share` and `import_store` then do the rest. Raises TerrainError.
    """
    store = store_folder_of(obj)
    if can_load_tiles(store):
        if not is_begun(obj, task.stores, task.frames):
            text = load_tiles(obj, task.frames, task.stores, task.on_progress)
            task.say(f"{obj.name}: {text or _begin_import(obj, task)}")
    elif is_missing(store):
        if shared_tiles(obj):  # the number of tiles, 0 if one computer imports all
            task.say(f"{obj.name}: {_begin_import(obj, task)}")
        else:
            forget_import(obj, task.stores)


def _begin_import(obj, task: Preparation) -> str:
    """Begin the import of all samples by the workers of a job, and return a text about it. Raises TerrainError."""
    assert task.stores is not None, "only a job begins it"
    why = "the frames need all samples" if can_load_tiles(store_folder_of(obj)) else "the store needs all samples"
    return f"{why}, of which {begin_import(obj, task.frames, task.stores):,} tiles are imported by several computers"


def import_share(step: str, obj, task: Preparation) -> None:
    """Do this process's share of a step of the import that `load_view` has begun, if any. Raises TerrainError.

    step: one of IMPORT_PARTS.
    """
    assert task.stores is not None, "the command line has checked it"
    if is_missing(store_folder_of(obj)):
        if text := import_part(obj, task.stores, step, task.share, task.on_progress):
            task.say(f"{obj.name}: {text}")


def shape_land(obj, task: Preparation) -> None:
    """Shape a terrain's land, and bake the maps that its materials show; existing ones are reused.

    A terrain that is hidden in renders needs none. Depending on its settings this is done for the whole terrain, or for
    the ground that the camera sees in the frames.
    """
    frames, say = task.frames, task.say
    scene, depsgraph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    if obj.hide_render:
        return
    land = land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=True)
    if land is not None:
        views = []
        if land.of_views:
            # Views relative to the raster's middle instead of the object's origin, as `wanted_land` takes them.
            *_, views = visit_views(obj, scene, frames, raster_placement_of(obj), about_middle=True)
        wanted = wanted_land(obj, bpy.context.evaluated_depsgraph_get(), views)
        field_of_land(wanted, session.open_field, verified=True)  # shapes it, or checks all its files
        say(f"{obj.name}: its land is shaped")
    if names := maps_shown_by_materials(obj):
        shot = frames if obj.adaptive_terrain.maps.frames == SHOT else None
        *_, request = visit_for_request(obj, scene, names, shot)  # the last item, after fractions of the work
        field = raster_of(request.store, request.land, session.open_field, verified=True)
        say(maps_summary(bake_maps(request, field, task.on_progress), obj.name))


SHARED_PARTS = "tiles", READ_TILES, MEASURE  # those of which each process does a share
IMPORT_PARTS = READ_TILES, FILL, MEASURE  # parts of an import of all samples
PARTS = {
    "stores": import_store,
    "land": shape_land,
    "view": find_view,
    "tiles": read_view,
    "load": load_view,
    **{step: partial(import_share, step) for step in IMPORT_PARTS},
}
DEFAULT_PARTS = "stores", "land"  # all that one machine needs


def prepare(
    objects: Sequence,
    frames: Sequence[int],
    parts: Sequence[str],
    say: Say,
    on_progress: OnProgress,
    stores: Path | None = None,
    share: tuple[int, int] = (1, 1),
) -> None:
    """Make the `parts` (of PARTS) that frames of the open file need, for the terrains `objects`. Raises TerrainError.

    say: prints a line. on_progress: takes the number of finished terrains, counted for each part, with fractions.
    stores: folder of a farm job's stores, None for the terrains' own. share: this process's number, from 1, and the
    number of processes that share the work.
    """
    work = [(part, obj) for part in parts for obj in objects]
    for done, (part, obj) in enumerate(work):
        on_progress(done)
        if part == "land" and stores is not None:  # other parts have loaded the tiles into the job's stores
            use_job_stores([obj], stores)
        report = partial(_add_fraction, on_progress, done)
        PARTS[part](obj, Preparation(frames, say, report, stores, share))
    on_progress(len(work))


def _add_fraction(on_progress: OnProgress, done: int, fraction: float) -> None:
    """Report that `done` terrains and a fraction of another one are finished."""
    on_progress(done + fraction)
