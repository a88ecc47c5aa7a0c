# SPDX-License-Identifier: GPL-3.0-or-later
"""The shaped land as a store that needs no stack."""

import os
from collections.abc import Callable

import bpy

from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.packing import copy_store
from ...cbt_terrain.height_operators import derived_store
from ...cbt_terrain.height_operators.derived_store import Land
from ...cbt_terrain.run import stopping
from .. import jobs
from ..bridge.scene_paths import absolute_path, store_path
from ..importing import imported
from ..importing.store_location import after_save, baked_folder
from ..session import session
from .request import land_of
from .shape_land import ShapedLandJob, wanted_land


def shaped_field(obj, depsgraph) -> Callable[[], HeightField]:
    """Return a function that checks and opens the height field of a terrain's shaped land, on any thread.

    That function shapes the land first, which takes long, if it is not shaped yet. Without a stack it opens the
    imported height field. Both functions raise TerrainError.
    """
    # waits=True: the land in full detail, not a preview
    store, land = store_path(obj), land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=True)
    return lambda: derived_store.raster_of(store, land, session.open_field, verified=True)


class BakeLand(ShapedLandJob, bpy.types.Operator):
    """Make the shaped land the terrain's own heights, and empty the list. The imported heights stay on disk"""

    bl_idname = "adaptive_terrain.bake_land"
    bl_label = "Bake to Store"
    bl_options = {"REGISTER", "UNDO"}

    kind = jobs.BAKE_LAND

    @classmethod
    def poll(cls, context):
        """Return whether the active terrain has an entry that is on; otherwise set the reason that Blender shows."""
        if not super().poll(context):
            return False
        cls.poll_message_set("There is nothing to bake: the list is empty, or all its entries are switched off")
        return any(entry.on for entry in context.object.adaptive_terrain.land.entries)

    def steps(self, context, job: jobs.BackgroundJob) -> jobs.Steps:
        """Copy the shaped land to a new store on a thread; return the land, and the store's path for the settings.

        The new store is beside the old one, or beside the .blend file if the old one may be shared with other files.
        """
        store_path(context.object)  # raises TerrainError before any work
        land = wanted_land(context.object, context.evaluated_depsgraph_get())
        folder = unused_path(baked_folder(context.object))
        target = absolute_path(folder)

        def copy() -> tuple[Land, str]:
            """Check the shaped land, which is shaped first if a script has not done that, and copy it.

            Both steps call `raise_if_stopped`, so a cancelled job ends in them.
            """
            with stopping.checking(job.raise_if_stopped):
                derived_store.field_of_land(land, session.open_field, verified=True)
                copy_store(land.folder, target, job.progress)
            return land, folder

        job.progress(0.0, jobs.CHECKING)
        return (yield from jobs.run_on_thread(job, copy))

    def finish(self, context, obj, result: tuple[Land, str]) -> None:
        """Make the copy the terrain's store, and empty the stack; only report the copy if the stack has changed since.

        result: the land that was copied, and the path of the copy.
        """
        (land, folder), settings, depsgraph = result, obj.adaptive_terrain, context.evaluated_depsgraph_get()
        folder = after_save(folder, self.job.file)
        if land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=True) != land:
            self.report({"WARNING"}, f"The list has changed, and stays; the land that it made before is in {folder}")
            return
        settings.store, settings.frozen, settings.land.active = folder, "", 0
        settings.land.entries.clear()
        derived_store.release(obj.session_uid)  # the land before is no longer used, and may be removed
        imported.tag_object(obj)  # custom properties with the coordinate system of the new store
        obj.update_tag()
        self.report({"INFO"}, f"The land is in {folder}; Clear Land Cache frees what shaping it has left elsewhere")


def unused_path(wanted: str) -> str:
    """Return a path that does not exist yet: `wanted`, or `wanted` with the first free number from 2 on.

    The path may begin with "//", the .blend file's folder.
    """
    number, folder = 1, wanted
    while os.path.exists(absolute_path(folder)):
        number += 1
        folder = f"{wanted}_{number}"
    return folder
