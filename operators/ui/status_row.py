# SPDX-License-Identifier: GPL-3.0-or-later
"""The row of the panel with the terrain's state: progress, an error, or why it is out of sight.

It is always one row, so that nothing below it moves while a user aims at it.
"""

from contextlib import suppress

import bpy
import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run import warmup
from .. import jobs
from ..bridge import camera as cameras
from ..bridge.evaluated import is_animated
from ..bridge.scene_paths import NO_HEIGHTS
from ..importing.view_tiles import loaded_here
from ..scatter.request import is_scatter
from ..session import session
from ..terrain import sight
from ..terrain.camera_source import follows_viewport
from ..terrain.properties import VIEWPORT_VIEW
from .panel_parts import error_lines, wrap_words

POPUP_LINE = 80
NOTICE_WIDTH = 0.7  # of the row; the button that mends it has the rest
UNDERGROUND, SEES_NOTHING = "Camera underground", "Camera sees nothing"
NO_VIEW = UNDERGROUND, SEES_NOTHING
BUTTON_UNITS = 3.3  # width of the second button, in the interface's units
LOAD_ALL = "adaptive_terrain.import_source", "Load All"
FRAME, CAMERA_TO_VIEW, MOVE_WORLD = "adaptive_terrain.frame", "view3d.camera_to_view", "adaptive_terrain.move_world"


def draw_status(layout, context, obj, below) -> None:
    """Draw one row about the terrain's state: the first that applies of progress, failure, state and visibility.

    layout: of a panel. obj: the shown terrain, which need not be the active object. below: the next row, for a second
    button. A notice about visibility is harmless if viewports replace the camera that sees nothing.
    """
    row = layout.row(align=True)
    status = session.record_of(obj).status
    if _draw_progress(row, context, obj):
        return
    if not _waits_for_import(obj, status) and draw_failure(row, obj):
        return
    if obj.mode != "OBJECT":
        row.label(text="Stands still in Edit Mode", icon="PAUSE")
    elif not obj.adaptive_terrain.store:
        row.label(text="No height map yet: press Import", icon="INFO")
    elif not obj.visible_get():
        row.label(text="Hidden: stays as it is", icon="HIDE_ON")
    elif status.mode and not status.triangles_left:  # an update left no triangle
        row.label(text="Nothing is left: all is cut away", icon="ERROR")
    elif obj.adaptive_terrain.frozen:
        row = row.split(factor=NOTICE_WIDTH)
        row.label(text="Frozen: keeps its triangles", icon="FREEZE")
        row.operator("adaptive_terrain.freeze", text="Release")
    else:
        text, operator, button = sight_notice(context, obj)
        harmless = text in NO_VIEW and follows_viewport(obj, context.scene)
        # loaded: the detail of an incomplete store here, "" for a complete one.
        if (harmless or not text) and (loaded := loaded_here(context, obj)):
            text, harmless, (operator, button) = loaded, False, LOAD_ALL
        row = row.split(factor=NOTICE_WIDTH) if text else row
        icon = "INFO" if harmless else "ERROR" if text else "CHECKMARK"
        row.label(text=text or "In sight", icon=icon)
        if text in NO_VIEW and not harmless:  # two buttons: the detail for viewports here, the operator's in `below`
            row.prop_enum(obj.adaptive_terrain, "camera_source", VIEWPORT_VIEW)
            row = below.row()
            row.ui_units_x = BUTTON_UNITS
        if operator:
            row.operator(operator, text=button)


def _waits_for_import(obj, status) -> bool:
    """Return whether the terrain's only problem is that nothing was imported yet, which is no error to show."""
    failure = status.failure
    if obj.adaptive_terrain.store or failure is None or failure.code != NO_HEIGHTS:
        return False
    return str(failure) == status.error  # otherwise the import has failed since then


def draw_preparation(layout) -> bool:
    """Draw the progress of preparing the kernels; return whether they are being prepared: False once they are ready."""
    fraction = warmup.progress()
    if fraction is None or not warmup.preparing():
        return False
    layout.progress(factor=fraction, text=jobs.PREPARING)
    return True


def _draw_progress(row, context, obj) -> bool:
    """Draw the progress of preparing kernels, importing or packing, the first that runs; return whether one runs."""
    if draw_preparation(row):
        return True
    job = jobs.find(jobs.IMPORT, obj) or jobs.find(jobs.PACK)
    if job is not None:
        jobs.draw_progress(row, job, loaded_here(context, obj) or job.text)
    return job is not None


def sight_notice(context, obj) -> tuple[str, str, str]:
    """Return a notice about the view of the terrain, the operator that fixes it, and its button's text.

    It is the first that applies: the viewport beside the panel cuts the terrain off; the camera is underground, far
    from the origin, sees nothing of it or cuts it off. Three times "" if all is well or the view cannot be known; no
    operator moves a camera that is animated or is not the scene's.
    """
    with suppress(TerrainError):  # the update reports it
        box = sight.box_of(obj)
        if _viewport_cuts(context, box):
            return "View cuts it off", FRAME, "Frame"
        camera = sight.camera_of(obj, context.scene)
        if camera is None:
            return "", "", ""
        view = sight.view_of_camera(context.scene, camera)
        can_move = camera == context.scene.camera and not is_animated(camera)
        to_view = (CAMERA_TO_VIEW, "To View") if can_move else ("", "")
        if sight.is_below_ground(obj, np.array(camera.matrix_world.translation)):
            return UNDERGROUND, *to_view
        if sight.is_far_out(camera.matrix_world.translation):
            return "Camera far from origin", MOVE_WORLD, "Move"
        if not sight.is_in_sight(box, view):
            return SEES_NOTHING, *to_view
        if sight.is_cut_off(box, view):
            return "Camera cuts it off", FRAME, "Frame"
        if _no_ground_was_in(view, obj):
            return SEES_NOTHING, *to_view
    return "", "", ""


def _no_ground_was_in(view, obj) -> bool:
    """Return whether the last update was for this view alone and met no ground.

    The box of a terrain may be in a frame which its ground is not in, such as that of a camera between two summits.
    """
    status = session.record_of(obj).status
    keys = [shown.key() for shown in status.request.views] if status.mode else []
    return keys == [view.key()] and status.bounds.bound_px == 0.0


def has_view(context, obj) -> bool:
    """Return whether the terrain is refined for a view of it; without one, a bound of 0 px is no sign of accuracy."""
    return follows_viewport(obj, context.scene) or sight_notice(context, obj)[0] not in NO_VIEW


def _viewport_cuts(context, box: np.ndarray) -> bool:
    """Return whether the clip range of the viewport beside the panel cuts the terrain's box off.

    False in camera view, where the camera's own clip range has another notice.
    """
    space = context.space_data
    if space is None or space.type != "VIEW_3D" or space.region_3d.view_perspective == "CAMERA":
        return False
    region = next(region for region in context.area.regions if region.type == "WINDOW")
    return sight.is_cut_off(box, cameras.view_from_region(space, region, space.region_3d))


def draw_failure(layout, terrain) -> bool:
    """Draw a button that opens the error of a terrain's last update; return whether there is one."""
    if session.record_of(terrain).status.error:
        row = layout.row(align=True)
        row.alert = True
        row.operator("adaptive_terrain.show_message", text="Not up to date: read why", icon="ERROR")
        return True
    return False


def _terrain_of(obj):
    """Return the terrain that an object is, or on which it is a scatter; None for any other object."""
    terrain = obj.parent if obj is not None and is_scatter(obj) else obj
    return terrain if terrain is not None and session.is_terrain(terrain) else None


class ShowMessage(bpy.types.Operator):
    """Show what went wrong, and what to do"""

    bl_idname = "adaptive_terrain.show_message"
    bl_label = "Show Message"

    @classmethod
    def poll(cls, context):
        """Return whether the active object is a terrain or a scatter on one."""
        return _terrain_of(context.object) is not None

    def execute(self, context):
        """Show the error of the terrain's last update in a popup."""
        terrain = _terrain_of(context.object)
        texts = error_lines(session.record_of(terrain).status)

        def draw(popup, _context):
            """Draw the texts as lines of the popup."""
            for text, icon in texts:
                # The first line has the icon; that of errors is in the popup's title.
                for number, line in enumerate(wrap_words(text, POPUP_LINE)):
                    popup.layout.label(text=line, icon=icon if number == 0 and icon != "ERROR" else "NONE")

        context.window_manager.popup_menu(draw, title=terrain.name, icon="ERROR")
        return {"FINISHED"}
