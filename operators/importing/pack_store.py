# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores beside their .blend file: packed there, with the shaped land and the baked maps that belong to them.

Packing copies, and then switches the path. The store that it copied from stays, because other files may name it: one in
the data folder serves every unsaved file with the same source and settings. On one file system the arrays of a copy
take no room.
"""

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.packing import PackingCancelled
from ...cbt_terrain.run.owned_files import real_path
from ..properties.scene_paths import absolute_path
from ..scene import land_jobs, session
from ..viewport import live
from .pack_plan import OnProgress, find_strays, plan, room_text

POLL_S, OFFER_S = 0.1, 0.2
_job: "PackJob | None" = None
_first_save = False


class PackJob:
    """Copies folders on a thread. `error`: why it ended, "" if it has not."""

    def __init__(self, copies: list[Callable[[OnProgress], None]]):
        self.copies, self.fraction, self.error = copies, 0.0, ""
        self.stopping = threading.Event()
        self.thread = threading.Thread(target=self.run, name="adaptive_terrain_pack", daemon=True)

    def run(self) -> None:
        try:
            for number, copy in enumerate(self.copies):
                copy(lambda done, number=number: self._progress(number, done))
        except TerrainError as error:
            self.error = str(error)

    def _progress(self, number: int, done: float) -> None:
        if self.stopping.is_set():
            raise PackingCancelled("Packing was cancelled; every store is where it was.")
        self.fraction = (number + done) / len(self.copies)


def progress() -> float | None:
    """Return how much of what is being packed is done (0 .. 1), or None."""
    return _job.fraction if _job is not None else None


class PackStore(bpy.types.Operator):
    """Copy every store that is elsewhere into the folder of the .blend file, with its shaped land and baked maps, and
    name it by a relative path: the folder can then be moved, and rendered elsewhere. The original stays where it was,
    since other files may use it"""

    bl_idname = "adaptive_terrain.pack_store"
    bl_label = "Pack Store Beside File"
    bl_options = {"REGISTER", "UNDO"}

    save_again: bpy.props.BoolProperty(options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def poll(cls, context):
        if not bpy.data.filepath:
            cls.poll_message_set("Save the file first")
            return False
        if not find_strays():
            cls.poll_message_set("Every store lies beside the file")
            return False
        if land_jobs.running:
            cls.poll_message_set("Land is being shaped, which packing copies: wait for it, or cancel that")
            return False
        return _job is None

    def _start(self) -> bool:
        global _job
        try:
            self.planned = plan(find_strays())
        except TerrainError as error:
            self.report({"ERROR"}, str(error))
            return False
        _job = PackJob(self.planned.copies())
        return True

    def execute(self, context):
        if not self._start():
            return {"CANCELLED"}
        _job.run()
        return self._finish()

    def invoke(self, context, event):
        if not self._start():
            return {"CANCELLED"}
        _job.thread.start()
        self.timer = context.window_manager.event_timer_add(POLL_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        live.redraw_panels()
        if _job.thread.is_alive():
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self.timer)
        return self._finish()

    def cancel(self, context):
        """Another file is loaded, or Blender quits."""
        global _job
        context.window_manager.event_timer_remove(self.timer)
        _job.stopping.set()
        _job.thread.join()
        _job = None

    def _finish(self):
        global _job
        job, _job = _job, None
        if job.error:
            self.report({"ERROR"}, job.error)
            return {"CANCELLED"}
        clean = not bpy.data.is_dirty
        self._show_copied_maps()
        targets = {uid: target for target, uids in self.planned.stores.values() for uid in uids}
        for obj in session.all_terrains():
            if obj.session_uid in targets:
                obj.adaptive_terrain.store = targets[obj.session_uid]
        names = ", ".join(target for target, _ in self.planned.stores.values())
        more = [f"{len(found)} {what}" for found, what in ((self.planned.lands, "of shaped land"),
                                                          (self.planned.maps, "of maps")) if found]  # fmt: skip
        self.report({"INFO"}, f"Beside the file now: {names}" + (f", with folders: {', '.join(more)}" if more else ""))
        if self.save_again and clean:
            bpy.ops.wm.save_mainfile()
        live.redraw_panels()
        return {"FINISHED"}

    def _show_copied_maps(self) -> None:
        """Let images of maps name the copies."""
        for image in bpy.data.images:
            path = real_path(absolute_path(image.filepath))
            if image.filepath and image.library is None and str(path.parent) in self.planned.maps:
                image.filepath = bpy.path.relpath(str(Path(self.planned.maps[str(path.parent)]) / path.name))


class CancelPack(bpy.types.Operator):
    """Stop packing; every store stays where it was"""

    bl_idname = "adaptive_terrain.cancel_pack"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context):
        return _job is not None

    def execute(self, context):
        _job.stopping.set()
        return {"FINISHED"}


class OfferPack(bpy.types.Operator):
    """Ask whether stores in the data folder are to be packed beside the file that was just saved"""

    bl_idname = "adaptive_terrain.offer_pack"
    bl_label = "Pack Terrain Beside File"

    def invoke(self, context, event):
        size = ""
        with suppress(TerrainError, OSError):  # packing says what is wrong
            size = f" ({room_text(plan(find_strays()))})"
        return context.window_manager.invoke_confirm(
            self,
            event,
            title="Pack the terrain beside the file?",
            message=f"It is in Blender's data folder. A copy beside the .blend file{size} can be moved with it.",
            confirm_text="Pack",
        )

    def execute(self, context):
        return bpy.ops.adaptive_terrain.pack_store("INVOKE_DEFAULT", save_again=True)


def _offer() -> None:
    windows = bpy.context.window_manager.windows
    if windows and find_strays():
        with bpy.context.temp_override(window=windows[0]):
            bpy.ops.adaptive_terrain.offer_pack("INVOKE_DEFAULT")


@persistent
def on_save_pre(_path, _unused=None) -> None:
    global _first_save
    _first_save = not bpy.data.filepath


@persistent
def on_save_post(_path, _unused=None) -> None:
    if _first_save and not bpy.app.background and bpy.data.filepath and find_strays():
        bpy.app.timers.register(_offer, first_interval=OFFER_S)


HANDLERS = {"save_pre": on_save_pre, "save_post": on_save_post}
CLASSES = (PackStore, CancelPack, OfferPack)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    for event, handler in HANDLERS.items():
        getattr(bpy.app.handlers, event).append(handler)


def unregister() -> None:
    for event, handler in HANDLERS.items():
        getattr(bpy.app.handlers, event).remove(handler)
    if _job is not None:
        _job.stopping.set()
        _job.thread.join()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
