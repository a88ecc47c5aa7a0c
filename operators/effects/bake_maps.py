# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake maps of a terrain, on a thread beside the window: the frames of a shot are looked at a few at a time."""

import threading
import time
import traceback

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.land.derived_store import raster_of
from ...cbt_terrain.maps.bake import Baked
from ...cbt_terrain.maps.folder import files_of
from ...cbt_terrain.run import warmup
from ..scene import session
from ..scene.polls import on_terrain
from ..viewport import live
from . import map_images
from .map_baking import MapRequest, carry_out, summary
from .map_request import gathered

POLL_S = 0.1
TURN_S = 0.05  # so long frames are looked at before the window has its turn
STOPPED = "Baking was stopped; the maps are as they were"
_job: "Job | None" = None


class Stopped(Exception):
    """The bake was stopped."""


class Job:
    """One bake on a thread. `uid`: session_uid of the terrain. `baked`: when it has ended well; else `error` says why
    not, "" if it was merely stopped."""

    def __init__(self, uid: int):
        self.uid, self.fraction, self.message = uid, 0.0, "Looking at frames"
        self.baked: Baked | None = None
        self.error = ""
        self.stopping = threading.Event()
        self.thread: threading.Thread | None = None

    def start(self, request: MapRequest) -> None:
        self.fraction, self.message = 0.0, "Baking maps"
        self.thread = threading.Thread(target=self.run, args=(request,), name="adaptive_terrain_maps", daemon=True)
        self.thread.start()

    def run(self, request: MapRequest) -> None:
        try:
            warmup.wait()
            with session.engine_lock:
                field = raster_of(request.store, request.land, session.open_field, verified=True)
            self.baked = carry_out(request, field, self._progress, session.engine_lock)
        except Stopped:
            pass
        except TerrainError as error:
            self.error = str(error)
        except Exception as error:
            traceback.print_exc()
            self.error = f"Baking failed unexpectedly ({type(error).__name__}: {error}); the maps are as they were."

    def _progress(self, fraction: float) -> None:
        if self.stopping.is_set():
            raise Stopped
        self.fraction = fraction


def progress() -> tuple[float, str] | None:
    """How far a bake is (0 .. 1), and what it does; None where none is under way."""
    return (_job.fraction, _job.message) if _job is not None else None


class BakeMaps(bpy.types.Operator):
    """Bake effects into images, from the height map itself: shading then does not depend on the triangles. Only images
    that are not there yet, or that something has changed for, are made"""

    bl_idname = "adaptive_terrain.bake_maps"
    bl_label = "Bake Maps"
    bl_options = {"REGISTER", "UNDO"}  # else the next Undo takes the folder from the terrain, too

    @classmethod
    def poll(cls, context):
        if _job is not None:
            cls.poll_message_set("Maps are being baked")
            return False
        return on_terrain(cls, context)

    def execute(self, context):
        obj, job = context.object, Job(context.object.session_uid)
        try:
            *_, request = gathered(obj, context.scene)
        except TerrainError as error:
            job.error = str(error)
        else:
            job.run(request)
        return self._finish(obj, job)

    def invoke(self, context, event):
        global _job
        obj = context.object
        self.job = _job = Job(obj.session_uid)
        self.gathering = gathered(obj, context.scene)
        session.record_of(obj).status.error = ""
        self.timer = context.window_manager.event_timer_add(POLL_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC" and event.value == "PRESS":
            self.job.stopping.set()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        live.redraw_panels()
        if self.job.thread is None:
            self._look()
        if self.job.thread is not None and self.job.thread.is_alive():
            return {"PASS_THROUGH"}
        if self.job.thread is None and not (self.job.error or self.job.stopping.is_set()):
            return {"PASS_THROUGH"}
        self._end(context)
        obj = next((item for item in session.all_terrains() if item.session_uid == self.job.uid), None)
        return {"CANCELLED"} if obj is None else self._finish(obj, self.job)

    def cancel(self, context):
        """Another file is loaded, or Blender quits."""
        self.job.stopping.set()
        if self.job.thread is not None:
            self.job.thread.join()
        self._end(context)

    def _look(self) -> None:
        """Look at some more of the frames; after the last the bake begins."""
        end = time.monotonic() + TURN_S
        try:
            while time.monotonic() < end and not self.job.stopping.is_set():
                found = next(self.gathering)
                if isinstance(found, MapRequest):
                    self.job.start(found)
                    return
                self.job.fraction = found
        except TerrainError as error:
            self.job.error = str(error)
        except ReferenceError:  # the terrain or its scene is gone
            self.job.stopping.set()

    def _end(self, context) -> None:
        global _job
        self.gathering.close()  # the scene is at its frame again
        context.window_manager.event_timer_remove(self.timer)
        _job = None
        live.redraw_panels()

    def _finish(self, obj, job: Job):
        if job.baked is not None:
            map_images.own_folder(obj)  # after an Undo meanwhile
            map_images.reload(map_images.map_folder(obj), _image_files(job.baked))
            self.report({"INFO"}, summary(job.baked, obj.name))
            return {"FINISHED"}
        session.record_of(obj).status.error = job.error
        self.report({"ERROR"} if job.error else {"INFO"}, job.error or STOPPED)
        return {"CANCELLED"}


def _image_files(baked: Baked) -> set[str]:
    """What images of Blender may name: single files, and tiles as a whole."""
    return files_of(baked.index) | {entry["file"] for entry in baked.index["maps"].values()}


class CancelMaps(bpy.types.Operator):
    """Stop baking; the maps stay as they were"""

    bl_idname = "adaptive_terrain.cancel_maps"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context):
        return _job is not None

    def execute(self, context):
        _job.stopping.set()
        return {"FINISHED"}


def register() -> None:
    bpy.utils.register_class(BakeMaps)
    bpy.utils.register_class(CancelMaps)


def unregister() -> None:
    global _job
    if _job is not None:
        _job.stopping.set()
        if _job.thread is not None:
            _job.thread.join()
        _job = None
    bpy.utils.unregister_class(CancelMaps)
    bpy.utils.unregister_class(BakeMaps)
