# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores beside their .blend file: packed there, and found again wherever the file is saved to.

Packing copies, and then switches the path. The store that it copied from stays, because other files may name it: one in
the user's folder serves every unsaved file with the same source and settings. On one file system a copy takes no room.
"""

import threading
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field import store as stores
from ...cbt_terrain.field.packing import PackingCancelled, copy_store
from ..request.imported import imported_of
from ..scene import session
from ..viewport import live
from .import_terrain import folder_beside

POLL_S, OFFER_S = 0.1, 0.2
RELATIVE = "//"
_job: "Job | None" = None
_first_save = False
_paths_before: dict[int, str] = {}  # by session_uid: what a save elsewhere has made relative to another folder


class Job:
    """Copies stores on a thread. `pairs`: folder and new folder of each. `error`: why it ended, "" if it has not."""

    def __init__(self, pairs: list[tuple[str, str]]):
        self.pairs, self.fraction, self.error = pairs, 0.0, ""
        self.stopping = threading.Event()
        self.thread = threading.Thread(target=self.run, name="adaptive_terrain_pack", daemon=True)

    def run(self) -> None:
        try:
            for number, (source, target) in enumerate(self.pairs):
                copy_store(source, target, lambda done, number=number: self._progress(number, done))
        except TerrainError as error:
            self.error = str(error)

    def _progress(self, number: int, done: float) -> None:
        if self.stopping.is_set():
            raise PackingCancelled("Packing was cancelled; every store is where it was.")
        self.fraction = (number + done) / len(self.pairs)


def progress() -> float | None:
    """How much of what is being packed is done (0 .. 1), or None."""
    return _job.fraction if _job is not None else None


def lies_beside(settings) -> bool:
    """Whether a terrain's store has a path relative to the .blend file and is in its folder."""
    if not bpy.data.filepath or not settings.store.startswith(RELATIVE):
        return False
    folder = Path(bpy.path.abspath(settings.store)).resolve()
    return folder.is_relative_to(Path(bpy.data.filepath).resolve().parent)


def _strays() -> list:
    """Terrains of a saved file with a store that is elsewhere."""
    if not bpy.data.filepath:
        return []
    with_store = [obj for obj in session.all_terrains() if obj.adaptive_terrain.store]
    return [obj for obj in with_store if not lies_beside(obj.adaptive_terrain)]


def plan(objects: list) -> dict[str, tuple[str, list[int]]]:
    """For each store's folder the new one, and the terrains (session_uid) that are to name it. Raises TerrainError."""
    planned: dict[str, tuple[str, list[int]]] = {}
    for obj in objects:
        folder = Path(bpy.path.abspath(obj.adaptive_terrain.store)).resolve()
        content = stores.read_json(folder)
        if str(folder) not in planned:
            taken = {target for target, _ in planned.values()}
            planned[str(folder)] = _target(obj, folder, content, taken), []
        planned[str(folder)][1].append(obj.session_uid)
    return planned


def _target(obj, folder: Path, content: dict, taken: set[str]) -> str:
    """Where the store in `folder` is to be: there, by a relative path, if it lies beside the file already."""
    if folder.is_relative_to(Path(bpy.data.filepath).resolve().parent):
        return bpy.path.relpath(str(folder))
    imported = imported_of(obj.adaptive_terrain)
    source = Path(imported.settings.get("source", "") if imported else "").stem
    return _free_folder(folder_beside(obj, source or "store"), content, taken)


def _free_folder(wanted: str, content: dict, taken: set[str]) -> str:
    """`wanted`, or with a number the next that holds no other store."""
    number = 1
    while True:
        folder = wanted if number == 1 else f"{wanted}_{number}"
        try:
            there = stores.read_json(Path(bpy.path.abspath(folder)))
            same = (there["key"], there["data"]) == (content["key"], content["data"])
        except TerrainError:
            same = not Path(bpy.path.abspath(folder), stores.JSON_NAME).exists()
        if same and folder not in taken:
            return folder
        number += 1


class PackStore(bpy.types.Operator):
    """Copy every store that is elsewhere into the folder of the .blend file, and name it by a relative path: the folder
    can then be moved, and rendered elsewhere. What is copied stays where it was, since other files may use it"""

    bl_idname = "adaptive_terrain.pack_store"
    bl_label = "Pack Store Beside File"
    bl_options = {"REGISTER", "UNDO"}

    save_again: bpy.props.BoolProperty(options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def poll(cls, context):
        if not bpy.data.filepath:
            cls.poll_message_set("Save the file first")
            return False
        if not _strays():
            cls.poll_message_set("Every store lies beside the file")
            return False
        return _job is None

    def _start(self) -> bool:
        global _job
        try:
            self.planned = plan(_strays())
        except TerrainError as error:
            self.report({"ERROR"}, str(error))
            return False
        _job = Job([(source, bpy.path.abspath(target)) for source, (target, _) in self.planned.items()])
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
        targets = {uid: target for target, uids in self.planned.values() for uid in uids}
        for obj in session.all_terrains():
            if obj.session_uid in targets:
                obj.adaptive_terrain.store = targets[obj.session_uid]
        self.report({"INFO"}, f"Beside the file now: {', '.join(target for target, _ in self.planned.values())}")
        if self.save_again and clean:
            bpy.ops.wm.save_mainfile()
        live.redraw_panels()
        return {"FINISHED"}


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
    """Ask whether stores in the user's folder are to be packed beside the file that was just saved"""

    bl_idname = "adaptive_terrain.offer_pack"
    bl_label = "Pack Terrain Beside File"

    def invoke(self, context, event):
        return context.window_manager.invoke_confirm(
            self,
            event,
            title="Pack the terrain beside the file?",
            message="It lies in the user folder of the extension. A copy beside the .blend file can be moved with it.",
            confirm_text="Pack",
        )

    def execute(self, context):
        return bpy.ops.adaptive_terrain.pack_store("INVOKE_DEFAULT", save_again=True)


def _offer() -> None:
    windows = bpy.context.window_manager.windows
    if windows and _strays():
        with bpy.context.temp_override(window=windows[0]):
            bpy.ops.adaptive_terrain.offer_pack("INVOKE_DEFAULT")


@persistent
def on_save_pre(path, _unused=None) -> None:
    """A relative path is written as it is from the folder that the file is saved to."""
    global _first_save
    before = bpy.data.filepath
    _first_save = not before
    _paths_before.clear()
    if not (before and path) or Path(before).parent == Path(path).parent:
        return
    for obj in session.all_terrains():
        settings = obj.adaptive_terrain
        if settings.store.startswith(RELATIVE):
            _paths_before[obj.session_uid] = settings.store
            folder = bpy.path.abspath(settings.store)
            try:
                settings.store = bpy.path.relpath(folder, start=str(Path(path).parent))
            except ValueError:  # another drive
                settings.store = folder


@persistent
def on_save_post(path, _unused=None) -> None:
    if not (bpy.data.filepath and path) or Path(bpy.data.filepath) != Path(path):
        _restore_paths()  # a copy was saved: the open file stays where it is
    _paths_before.clear()
    if _first_save and not bpy.app.background and bpy.data.filepath and _strays():
        bpy.app.timers.register(_offer, first_interval=OFFER_S)


@persistent
def on_save_failed(_path, _unused=None) -> None:
    _restore_paths()


def _restore_paths() -> None:
    for obj in session.all_terrains():
        if obj.session_uid in _paths_before:
            obj.adaptive_terrain.store = _paths_before[obj.session_uid]
    _paths_before.clear()


@persistent
def on_append(imported, _unused=None) -> None:
    """The path of a terrain that is appended goes from the folder of the file that it comes from; unless that is of a
    copy (Ctrl C), which Blender keeps elsewhere with paths as they were."""
    for item in imported.import_items:
        if (
            item.id_type != "OBJECT"
            or item.id is None
            or item.source_library is None
            or not session.is_terrain(item.id)
        ):
            continue
        settings = item.id.adaptive_terrain
        folder = bpy.path.abspath(settings.store, library=item.source_library)
        if settings.store.startswith(RELATIVE) and Path(folder).is_dir():
            try:
                settings.store = bpy.path.relpath(folder) if bpy.data.filepath else folder
            except ValueError:  # another drive
                settings.store = folder


HANDLERS = {"save_pre": on_save_pre, "save_post": on_save_post, "save_post_fail": on_save_failed}
if hasattr(bpy.app.handlers, "blend_import_post"):  # Blender 4.3
    HANDLERS["blend_import_post"] = on_append
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
