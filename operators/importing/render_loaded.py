# SPDX-License-Identifier: GPL-3.0-or-later
"""F12 during a large import: wait beside the window until the tiles of the picture are loaded, then render.

A render that waits itself locks the window (*Lock Interface*), and no key can end that wait.
"""

import bpy

from ...cbt_terrain.errors import TerrainError
from .. import jobs
from ..bridge.writing import allow_writing
from ..land.shape_land import ShapeAndRender
from ..session import session
from ..text.translations import phrase
from . import view_tiles
from .imported import loaded_text

LOOK_S = 0.5  # between looks at the loaded tiles


def unfinished(scene) -> list:
    """Return the terrains of a scene that renders show and whose import goes on after a first picture."""
    return [
        obj
        for obj in session.terrains_of(scene)
        if not obj.hide_render and jobs.find(jobs.IMPORT, obj) is not None and loaded_text(obj.adaptive_terrain)
    ]


class RenderLoaded(bpy.types.Operator):
    """Load the tiles that a render sees, then render. Esc cancels the render; the import goes on"""

    bl_idname = "adaptive_terrain.render_loaded"
    bl_label = "Load and Render"

    timer = None

    @classmethod
    def poll(cls, context):
        """Return whether a terrain that renders show is being imported, in Object Mode; if not, set the reason."""
        cls.poll_message_set("No terrain is being imported: render as usual")
        return context.mode == "OBJECT" and bool(unfinished(context.scene))

    def invoke(self, context, _event):
        """Begin to wait, with a text in the status bar."""
        self.timer = context.window_manager.event_timer_add(LOOK_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(phrase("Renders once its tiles are loaded; Esc: cancel"))
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Render once all tiles are loaded; end without a render when Esc is pressed. A second F12 has no effect."""
        if event.type == "ESC" and event.value == "PRESS":
            self.cancel(context)
            self.report({"INFO"}, "The render was cancelled; the import goes on")
            return {"CANCELLED"}
        if event.type == "F12":
            return {"RUNNING_MODAL"}
        if event.type != "TIMER" or not _is_loaded(context):
            return {"PASS_THROUGH"}
        self.cancel(context)
        _render_soon(context.window)
        return {"FINISHED"}

    def cancel(self, context):
        """Stop waiting, also because another file is opened."""
        context.window_manager.event_timer_remove(self.timer)
        context.workspace.status_text_set(None)


def _is_loaded(context) -> bool:
    """Return whether a render lacks no tiles; if it does, load them or wait for the import.

    True too if a store cannot be read, which the render reports.
    """
    depsgraph = context.evaluated_depsgraph_get()
    loaders = [(view_tiles.loader_of(obj), obj) for obj in unfinished(context.scene)]
    try:
        # A list: `all` alone would stop at the first terrain whose tiles are being loaded.
        return all([loader is not None and loader.load_for_render(obj, depsgraph) for loader, obj in loaders])
    except TerrainError:
        return True


def _render_soon(window) -> None:
    """Render, or shape land first and then render, after the present operator has ended."""

    @allow_writing
    def go_on() -> None:
        """Call the operator that renders; a timer does it once."""
        with bpy.context.temp_override(window=window):
            shapes = ShapeAndRender.poll(bpy.context)
            operator = bpy.ops.adaptive_terrain.shape_and_render if shapes else bpy.ops.render.render
            operator("INVOKE_DEFAULT")

    bpy.app.timers.register(go_on, first_interval=0.0)
