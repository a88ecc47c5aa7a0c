# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape the land in a child process: Blender stays usable, and the mesh shows the result when it is there."""

import time
from dataclasses import replace

import bpy
import numpy as np

from ...cbt_terrain.ask.view import View
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.land import derived_store
from ...cbt_terrain.land.derived_store import Land
from ...cbt_terrain.land.requested_tiles import SeenTiles
from ...cbt_terrain.run import warmup
from ..properties.land_properties import SEEN
from ..request.land_request import land_of
from ..scene import session
from ..scene.land_jobs import Work, running, stop_all
from ..scene.polls import on_terrain
from ..scene.shot import frames_of, look_through
from ..viewport import live

POLL_S = 0.1
TURN_S = 0.05  # so long frames are looked at before the window has its turn


def wanted_land(obj, depsgraph, views: list[View] = ()) -> Land:
    """What is to be shaped: everywhere, or where these views look. Raises TerrainError where there is nothing."""
    evaluated = obj.evaluated_get(depsgraph)
    land = land_of(obj, evaluated, depsgraph, waits=True)
    if land is not None and views:
        settings, placement = evaluated.adaptive_terrain, np.array(evaluated.matrix_world, np.float64)
        scale = settings.vertical_scale, settings.vertical_offset
        land = replace(land, seen=SeenTiles(tuple(views), placement, settings.render.error_px, *scale))
    if land is None:
        raise TerrainError(
            f"The terrain {obj.name!r} has nothing to shape: its stack is empty or switched off; add an effect."
        )
    return land


def check_is_shaped(obj, depsgraph) -> None:
    """For a button that needs the land at once: shaping it there and then would hold up the window. Raises
    TerrainError."""
    land = land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=True)
    if land is not None and not land.is_shaped:
        raise TerrainError(
            f"The land of {obj.name!r} is not shaped at all its levels yet: press Shape Now first, which runs "
            "beside the window."
        )


def _check_is_seen(obj, depsgraph) -> None:
    if obj.hide_render and not obj.visible_get(view_layer=depsgraph.view_layer):
        raise TerrainError(
            f"The terrain {obj.name!r} is hidden in viewports and in renders, and is not shaped: show it."
        )


def _views(obj, scene):
    """Turn by turn: the views of the shot, where only what it sees is to be fine."""
    if obj.adaptive_terrain.land.where != SEEN:
        yield []
        return
    placement = np.array(obj.matrix_world, np.float64)
    yield from look_through(obj, scene, frames_of(scene), placement)


class ShapeLand(bpy.types.Operator):
    """Apply the stack at all its levels; Blender stays usable meanwhile"""

    bl_idname = "adaptive_terrain.shape"
    bl_label = "Shape Now"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context):
        if not on_terrain(cls, context):
            return False
        cls.poll_message_set("This land is being shaped already: wait for it, or end that beside its bar")
        return context.object.session_uid not in running

    def invoke(self, context, event):
        obj = context.object
        self.uid, self.looking = obj.session_uid, None
        try:
            _check_is_seen(obj, context.evaluated_depsgraph_get())
            wanted_land(obj, context.evaluated_depsgraph_get())
        except TerrainError as error:
            return self._failed(obj, str(error))
        self.looking = _views(obj, context.scene)
        self.work = running[self.uid] = Work()
        session.record_of(obj).status.error = ""
        self.timer = context.window_manager.event_timer_add(POLL_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if self.looking is not None and event.type == "ESC":
            self.work.stop()
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            return self._turn(context)
        except Exception:  # Blender takes it off without a word, and it would count as running for ever
            self.cancel(context)
            raise

    def _turn(self, context):
        live.redraw_panels()
        obj = next((item for item in session.all_terrains() if item.session_uid == self.uid), None)
        if obj is None:
            self.cancel(context)
            return {"CANCELLED"}
        if self.looking is not None:
            return self._look(context, obj)
        progress = self.work.poll()
        if not progress.done or warmup.preparing():  # what follows may update the mesh
            return {"PASS_THROUGH"}
        self._end(context)
        if self.work.job.cancelled:
            self.report({"INFO"}, str(progress.error))
            return {"CANCELLED"}
        if progress.error:
            return self._failed(obj, str(progress.error))
        derived_store.finish(self.land, self.wanted)
        return self._take(obj)

    def _look(self, context, obj):
        """Look at some more frames; after the last the child process begins."""
        end = time.monotonic() + TURN_S
        try:
            while time.monotonic() < end and not self.work.stopped:
                found = next(self.looking)
                if isinstance(found, list):
                    self.looking.close()
                    self.looking = None
                    self._start(obj, context.evaluated_depsgraph_get(), found)
                    break
                self.work.fraction = found
        except TerrainError as error:
            self._end(context)
            return self._failed(obj, str(error))
        except ReferenceError:  # Undo has put another scene in its place
            self.work.stop()
        if self.work.stopped:
            self._end(context)
            self.report({"INFO"}, "Shaping was cancelled before it began")
            return {"CANCELLED"}
        return {"PASS_THROUGH"}

    def _start(self, obj, depsgraph, views: list[View]) -> None:
        self.land = land = wanted_land(obj, depsgraph, views)
        derived_store.is_whole(land, session.open_field)  # removes one that is damaged
        self.work.job, self.wanted = derived_store.begin_shaping(land, session.open_field)
        derived_store.counts["stores"] += 1

    def execute(self, context):
        obj = context.object
        try:
            _check_is_seen(obj, context.evaluated_depsgraph_get())
            *_, views = _views(obj, context.scene)
            derived_store.raster_of("", wanted_land(obj, context.evaluated_depsgraph_get(), views), session.open_field)
        except TerrainError as error:
            return self._failed(obj, str(error))
        return self._take(obj)

    def cancel(self, context):
        """Another file is loaded, or Blender quits."""
        self.work.stop()
        self._end(context)

    def _end(self, context):
        if self.looking is not None:
            self.looking.close()  # the scene is at its frame again
        context.window_manager.event_timer_remove(self.timer)
        running.pop(self.uid, None)
        live.redraw_panels()

    def _failed(self, obj, message: str):
        session.record_of(obj).status.error = message
        self.report({"ERROR"}, message)
        return {"CANCELLED"}

    def _take(self, obj):
        """What is shown is decided by the settings: the next update finds the shaped store."""
        if obj.adaptive_terrain.live and not bpy.app.background:
            live.mark_dirty()
            return {"FINISHED"}
        try:
            session.update_object(obj)
        except TerrainError as error:
            self.report({"WARNING"}, str(error))
        return {"FINISHED"}


class CancelShaping(bpy.types.Operator):
    """Stop shaping; what was there stays, and what is done so far is not done again. What a view makes finer while it
    rests is left until the stack is another"""

    bl_idname = "adaptive_terrain.shape_cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.session_uid in running

    def execute(self, context):
        running[context.object.session_uid].stop()
        return {"FINISHED"}


class FinishShaping(bpy.types.Operator):
    """Be content with the levels that are done: coarser, but the whole"""

    bl_idname = "adaptive_terrain.shape_finish"
    bl_label = "Finish Early"

    @classmethod
    def poll(cls, context):
        work = running.get(context.object.session_uid) if context.object is not None else None
        return work is not None and work.job is not None

    def execute(self, context):
        running[context.object.session_uid].job.finish_early()
        return {"FINISHED"}


CLASSES = (ShapeLand, CancelShaping, FinishShaping)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    stop_all()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
