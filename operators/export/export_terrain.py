# SPDX-License-Identifier: GPL-3.0-or-later
"""Export the terrain of the current frame, at the detail of the render."""

from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

import bpy
from bpy_extras.io_utils import ExportHelper

from ...cbt_terrain.errors import TerrainError
from ..bridge.scene_paths import propose_file, store_path
from ..kernel_operator import KernelOperator
from ..session import session
from ..session.polls import (
    TerrainObjectOperator,
    cancelled_by_errors,
    invoke_with_file,
    remember_object,
    remembered_object,
)
from ..terrain.request import RENDER, gather
from ..terrain.request_kernels import kernels_for
from ..text.gap_note import gap_note
from .formats import FORMATS, format_of

NAMES = [f".{name}" for name, form in FORMATS.items() if not form.is_whole_scene]
GLOB = ";".join(f"*{name}" for name in NAMES)


def draw_formats(layout, names: Iterable[str]) -> None:
    """Draw the formats of a file browser's file. names: endings of file names, such as ".ply"."""
    column = layout.column(align=True)
    column.label(text="The name's ending is the format:", icon="INFO")
    column.label(text=" ".join(names), icon="BLANK1", translate=False)


class ExportTerrain(KernelOperator, TerrainObjectOperator, bpy.types.Operator, ExportHelper):
    """Write the terrain of this frame to a file, as detailed as in a render. The ending of the file name is the
    format"""

    bl_idname = "adaptive_terrain.export"
    bl_label = "Export"

    filename_ext = ".ply"
    check_extension = None  # the suffix that the user types is the format
    filter_glob: bpy.props.StringProperty(default=GLOB, options={"HIDDEN"})

    # Set for the second run of the operator, with the chosen file, which first compiles missing kernels.
    is_chosen: bpy.props.BoolProperty(options={"HIDDEN", "SKIP_SAVE"})

    def kernels(self, context) -> list[ModuleType]:
        """Return the kernel modules that an export in render quality needs, to compile them before."""
        return kernels_for(gather(context.object, context.evaluated_depsgraph_get(), RENDER))

    def invoke(self, context, event):
        """Ask for a file, or write once it is chosen and the kernels are ready."""
        if self.is_chosen:
            return KernelOperator.invoke(self, context, event)
        remember_object(self, context)
        propose_file(self, context.object)
        return ExportHelper.invoke(self, context, event)

    def draw(self, _context):
        """Draw the formats in the file browser, and a line that says what a file holds."""
        self.layout.label(text="This frame, as fine as in a render", icon="INFO")
        draw_formats(self.layout, NAMES)

    @cancelled_by_errors
    def execute(self, context):
        """Write the terrain for which the dialog was opened, and restore the viewport's detail even after an error.

        After the dialog, if kernels are missing, the operator invokes itself anew (`is_chosen`), and that run waits for
        them. Otherwise it writes at once, because Blender shows no report of a nested operator.
        """
        with remembered_object(self, context):
            if self.options.is_invoke and not self.is_chosen and not self._has_kernels(context):
                return invoke_with_file(self, context)
            try:
                self._write(context, Path(self.filepath))
            finally:
                self._restore_viewport(context.object)
        return {"FINISHED"}

    def _write(self, context, path: Path):
        """Refine the terrain for a render of this frame and write it; the suffix of `path` is the format.

        Raises TerrainError.
        """
        from ...cbt_terrain.run.partial_files import remove_abandoned
        from .exporting import check_target, figures, write_piece
        from .frame_sources import scene_piece

        format_of(path)  # raises for an unknown suffix, before any work
        check_target(path)
        remove_abandoned(path.parent)  # partial files of killed processes
        piece = scene_piece(context.object, context.evaluated_depsgraph_get(), context.scene.frame_current)
        write_piece(piece, path)
        triangles = figures(piece)["triangles"]
        if triangles:
            note = gap_note(session.open_field(store_path(context.object)))
            self.report({"INFO"}, f"{path.name}: {triangles:,} triangles{note}")
        else:
            self.report({"WARNING"}, f"{path.name}: nothing is left of the terrain; check its clean-up, and its holes")

    def _restore_viewport(self, obj):
        """Give the viewport its detail back if the mesh is a render's, also after a failed export; report an error."""
        if session.record_of(obj).status.mode != RENDER:
            return
        try:
            session.update_object(obj)
        except TerrainError as error:
            self.report({"WARNING"}, str(error))
