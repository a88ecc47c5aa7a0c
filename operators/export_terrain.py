# SPDX-License-Identifier: GPL-3.0-or-later
"""Export the terrain of the current frame, at the detail of the render."""

from pathlib import Path

import bpy
from bpy_extras.io_utils import ExportHelper

from ..cbt_terrain.errors import TerrainError
from . import session


class ExportTerrain(bpy.types.Operator, ExportHelper):
    """Write the terrain as the camera sees it at this frame, at the detail of the render, to a file"""

    bl_idname = "adaptive_terrain.export"
    bl_label = "Export"

    filename_ext = ".ply"
    check_extension = None  # the suffix that the user types is the format
    filter_glob: bpy.props.StringProperty(default="*.ply;*.obj;*.glb;*.stl;*.npz", options={"HIDDEN"})

    @classmethod
    def poll(cls, context):
        return context.object is not None and session.is_terrain(context.object) and context.mode == "OBJECT"

    def execute(self, context):
        from .exporting import FORMATS, write_piece
        from .frame_sources import scene_piece

        obj, path = context.object, Path(self.filepath)
        try:
            if path.suffix[1:].lower() not in FORMATS:
                raise TerrainError(f"The file {path.name!r} has no known suffix; expected one of {', '.join(FORMATS)}.")
            piece = scene_piece(obj, context.evaluated_depsgraph_get(), context.scene.frame_current)
            write_piece(piece, path)
            self.report({"INFO"}, f"{path.name}: {piece.update.triangles:,} triangles")
            session.update_object(obj)  # the viewport gets its own detail back
        except TerrainError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


def register() -> None:
    bpy.utils.register_class(ExportTerrain)


def unregister() -> None:
    bpy.utils.unregister_class(ExportTerrain)
