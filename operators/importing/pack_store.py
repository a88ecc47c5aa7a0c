# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores beside their .blend file: packed there, with the shaped land and the baked maps that belong to them.

Packing copies, and then switches the path. The store that it copied from stays, because other files may name it: one in
the data folder serves every unsaved file with the same source and settings. On one file system the arrays of a copy
take no room.
"""

from contextlib import suppress
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run.owned_files import real_path
from .. import jobs
from ..bridge.scene_paths import absolute_path
from ..bridge.writing import allow_writing
from ..job_operator import JobOperator
from ..session import session
from .imported import loaded_text
from .pack_plan import PackPlan, plan_packing, room_text, terrains_to_pack
from .store_location import after_save

OFFER_S = 0.2
_first_save = False


class PackStore(JobOperator, bpy.types.Operator):
    """Copy the imported heights, the shaped land and the baked maps into the folder of the .blend file, so that you can
    move the folder to another computer. The originals stay"""

    bl_idname = "adaptive_terrain.pack_store"
    bl_label = "Pack Store Beside File"
    bl_options = {"REGISTER", "UNDO"}

    kind = jobs.PACK

    save_again: bpy.props.BoolProperty(options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def poll(cls, context):
        """Return whether there are stores to pack and no job uses them.

        Otherwise set the reason that Blender shows; a job that packs is shown in a row.
        """
        if not bpy.data.filepath:
            cls.poll_message_set("Save the file first")
            return False
        if not terrains_to_pack():
            cls.poll_message_set("Every store lies beside the file")
            return False
        if jobs.find(jobs.SHAPE):
            cls.poll_message_set("Land is being shaped, which packing copies: wait for it, or cancel that")
            return False
        return jobs.find(jobs.PACK) is None

    def subject(self, _context):
        """Return None: the job belongs to the whole file, not to one terrain."""
        return None

    def steps(self, _context, job: jobs.BackgroundJob) -> jobs.Steps:
        """Copy the stores and what belongs to them on a thread; return the PackPlan. Raises TerrainError."""
        planned = plan_packing(terrains_to_pack())
        copies = planned.copies()

        def copy_all() -> PackPlan:
            """Copy all stores, on a thread, and report progress."""
            for number, copy in enumerate(copies):
                copy(lambda done, number=number: job.progress((number + done) / len(copies)))
            return planned

        return (yield from jobs.run_on_thread(job, copy_all))

    def finish(self, _context, _obj, planned: PackPlan) -> None:
        """Let the terrains and the images of their maps use the copies; with `save_again` save the file.

        It is not saved if the user has changed anything meanwhile. planned: by original folder, `stores` has the path
        of a copy and the uids of its terrains; `lands` and `maps` have the folders of copies.
        """
        is_saved = not bpy.data.is_dirty  # saving again then saves nothing but the new paths
        self._show_copied_maps(planned)
        file = self.job.file  # the copies are beside it, also if it was saved elsewhere meanwhile
        targets = {uid: after_save(target, file) for target, uids in planned.stores.values() for uid in uids}
        for obj in session.all_terrains():
            if obj.session_uid in targets:
                obj.adaptive_terrain.store = targets[obj.session_uid]
        names = ", ".join(target for target, _ in planned.stores.values())
        more = [f"{len(found)} {what}" for found, what in ((planned.lands, "of shaped land"),
                                                          (planned.maps, "of maps")) if found]  # fmt: skip
        self.report({"INFO"}, f"Beside the file now: {names}" + (f", with folders: {', '.join(more)}" if more else ""))
        if self.save_again and is_saved:
            bpy.ops.wm.save_mainfile()

    def _show_copied_maps(self, planned: PackPlan) -> None:
        """Change the paths of images that show baked maps to the copies, relative to the .blend file."""
        for image in bpy.data.images:
            path = real_path(absolute_path(image.filepath))
            if image.filepath and image.library is None and str(path.parent) in planned.maps:
                image.filepath = bpy.path.relpath(str(Path(planned.maps[str(path.parent)]) / path.name))


class OfferPack(bpy.types.Operator):
    """Offer to copy imported heights from the data folder to the folder of the file that was just saved"""

    bl_idname = "adaptive_terrain.offer_pack"
    bl_label = "Pack Terrain Beside File"

    def invoke(self, context, event):
        """Ask the user, with the size of the copies."""
        size = ""
        with suppress(TerrainError, OSError):  # packing reports the error
            size = f" ({room_text(plan_packing(terrains_to_pack()))})"
        return context.window_manager.invoke_confirm(
            self,
            event,
            title="Pack the terrain beside the file?",
            message=f"It is in Blender's data folder. A copy beside the .blend file{size} can be moved with it.",
            confirm_text="Pack",
        )

    def execute(self, context):
        """Pack the stores after the user has agreed."""
        return bpy.ops.adaptive_terrain.pack_store("INVOKE_DEFAULT", save_again=True)


@allow_writing
def _ask_to_pack() -> None:
    """Open the question whether to pack, unless there is nothing to pack or an incomplete store is among it.

    A timer calls it once, a moment after the first save of a file.
    """
    windows = bpy.context.window_manager.windows
    terrains = terrains_to_pack()
    if windows and terrains and not any(loaded_text(obj.adaptive_terrain) for obj in terrains):
        with bpy.context.temp_override(window=windows[0]):
            bpy.ops.adaptive_terrain.offer_pack("INVOKE_DEFAULT")


@persistent
def on_save_pre(_path, _unused=None) -> None:
    """Remember whether this is the first save of the file."""
    global _first_save
    _first_save = not bpy.data.filepath


@persistent
def on_save_post(_path, _unused=None) -> None:
    """Offer to pack after the first save, if a store is outside the file's folder."""
    if _first_save and not bpy.app.background and bpy.data.filepath and terrains_to_pack():
        bpy.app.timers.register(_ask_to_pack, first_interval=OFFER_S)
