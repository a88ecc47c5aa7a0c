# SPDX-License-Identifier: GPL-3.0-or-later
"""The shaped land as a store that needs no stack, and as rasters for other programs."""

from collections.abc import Callable
from pathlib import Path

import bpy
from bpy_extras.io_utils import ExportHelper

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.packing import copy_store
from ...cbt_terrain.height_operators import derived_store
from ...cbt_terrain.height_operators.export import WRITERS, check_export, export_raster
from ..bridge.scene_paths import absolute_path, propose_file, store_path
from ..importing import imported
from ..importing.store_location import baked_folder
from ..session import session
from ..session.polls import TerrainObjectOperator, cancelled_by_errors
from . import shape_land
from .request import land_of

GLOB = ";".join(f"*{suffix}" for suffix in WRITERS)


class LandOperator(TerrainObjectOperator):
    """Base of operators that need land that is shaped at all levels; a subclass has `_carry_out`."""

    def invoke(self, context, event):
        """Refuse land that is not shaped yet: shaping it here would block the window.

        Then ask for a file if one is needed.
        """
        try:
            shape_land.check_is_shaped(context.object, context.evaluated_depsgraph_get())
        except TerrainError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not hasattr(self, "filepath"):
            return self.execute(context)
        propose_file(self, context.object, "_heights")
        return ExportHelper.invoke(self, context, event)

    @cancelled_by_errors
    def execute(self, context):
        """Carry out the operator on the active terrain; errors of the terrain or of the disk cancel it."""
        store_path(context.object)  # raises TerrainError before any work
        return self._carry_out(context.object, context.evaluated_depsgraph_get())


def shaped_field(obj, depsgraph) -> Callable[[], HeightField]:
    """Return a function that opens the height field of a terrain's shaped land, on any thread.

    It shapes the land first, which takes long, if it is not shaped yet. Without a stack this is the imported height
    field. Both raise TerrainError.
    """
    store, land = store_path(obj), land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=True)
    return lambda: derived_store.raster_of(store, land, session.open_field, verified=True)


class BakeLand(LandOperator, bpy.types.Operator):
    """Make the shaped land the terrain's own heights, and empty the list. The imported heights stay on disk"""

    bl_idname = "adaptive_terrain.bake_land"
    bl_label = "Bake to Store"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        if not super().poll(context):
            return False
        cls.poll_message_set("There is nothing to bake: the list is empty, or all its entries are switched off")
        return any(entry.on for entry in context.object.adaptive_terrain.land.entries)

    def _carry_out(self, obj, depsgraph):
        """Copy the shaped land to a new store beside the old one, make it the terrain's store, and empty the stack."""
        land = shape_land.wanted_land(obj, depsgraph)
        derived_store.raster_of("", land, session.open_field, verified=True)
        settings = obj.adaptive_terrain
        folder = unused_path(baked_folder(obj))
        copy_store(land.folder, absolute_path(folder))
        settings.store, settings.frozen, settings.land.active = folder, "", 0
        settings.land.entries.clear()
        derived_store.release(obj.session_uid)
        imported.tag_object(obj)
        obj.update_tag()
        self.report({"INFO"}, f"The land is in {folder}; Clear Land Cache frees what shaping it has left elsewhere")
        return {"FINISHED"}


def unused_path(wanted: str) -> str:
    """Return a path that does not exist yet: `wanted`, or `wanted` with the first free number.

    The path may begin with "//", the .blend file's folder.
    """
    number, folder = 1, wanted
    while Path(absolute_path(folder)).exists():
        number += 1
        folder = f"{wanted}_{number}"
    return folder


class ExportHeights(LandOperator, bpy.types.Operator, ExportHelper):
    """Write the heights of the shaped land as a 32-bit GeoTIFF or EXR with its place on Earth, and each by-product as
    another file"""

    bl_idname = "adaptive_terrain.export_heights"
    bl_label = "Export Heights"

    filename_ext = ".tif"
    check_extension = None  # the suffix that the user types is the format
    filter_glob: bpy.props.StringProperty(default=GLOB, options={"HIDDEN"})

    def _carry_out(self, obj, depsgraph):
        """Write the heights and the layers of the shaped land as rasters named after the chosen file."""
        check_export(self.filepath)
        files = export_raster(shaped_field(obj, depsgraph)().path, self.filepath)
        self.report({"INFO"}, f"Written: {', '.join(file.name for file in files)}")
        return {"FINISHED"}
