# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the job of a scene for a render farm."""

from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError, unwritable
from ...cbt_terrain.run import stopping
from .. import jobs
from ..bridge.scene_paths import absolute_path
from ..export.formats import parse_frames
from ..job_operator import DialogJobOperator
from ..session import session
from ..terrain.properties import PATH_OPTIONS


class SubmitToFarm(DialogJobOperator, bpy.types.Operator):
    """Write a folder for a render farm: the saved file, the stores of its terrains, and a job for Deadline Cloud (Open
    Job Description) and Flamenco"""

    bl_idname = "adaptive_terrain.submit"
    bl_label = "Submit to Farm"

    kind = jobs.SUBMIT

    folder: bpy.props.StringProperty(
        name="Folder",
        description="Folder of the job; the rendered frames go to its subfolder frames",
        subtype="DIR_PATH",
        default="//farm/",
        options=PATH_OPTIONS,
    )
    frames: bpy.props.StringProperty(
        name="Frames",
        description="Frames to render, such as 1-24, 1-24:2 for every second, or 1-3,8. Empty: those of the scene",
        options={"SKIP_SAVE"},
    )
    chunk: bpy.props.IntProperty(
        name="Frames per Task",
        description="Frames that one computer makes in a row: more start Blender less often, fewer use more computers",
        default=4, min=1, soft_max=100,
    )  # fmt: skip
    render: bpy.props.BoolProperty(
        name="Render", description="Render pictures; otherwise write meshes as .npz files", default=True
    )
    bring: bpy.props.BoolProperty(
        name="Bring Extension",
        description="Send this extension (200 MB) with the job. The farm's computers need the same system as this one; "
        "switch it off if they have the extension",
        default=True,
    )
    allow_outside: bpy.props.BoolProperty(
        name="Allow Outside",
        description="Also send files from outside the folder of this file that are not images, height maps or stores",
        default=False,
        options={"SKIP_SAVE"},
    )

    shared_disk: bpy.props.BoolProperty(
        name="Shared Disk",
        description="The farm's computers see stores and height maps under the same paths, and share the import of a "
        "large missing store. Switch it off for farms that copy files, such as Deadline Cloud",
        default=True,
    )

    @classmethod
    def poll(cls, context):
        """Return whether the file is saved and its scene has a terrain; otherwise set the reason that Blender shows."""
        if not bpy.data.filepath:
            cls.poll_message_set("Save the file first")
            return False
        cls.poll_message_set("The scene has no terrain; add one")
        if not session.terrains_of(context.scene):
            return False
        cls.poll_message_set("A job is being written: wait for it, or cancel it beside its progress bar")
        return jobs.find(jobs.SUBMIT) is None

    def subject(self, _context) -> None:
        """Return None: a farm's job is of the scene, not of one terrain."""

    def ask(self, context, _event):
        """Refuse unsaved changes, and show the options in a dialog."""
        _check_is_saved()
        if not self.properties.is_property_set("frames"):
            scene = context.scene
            step = f":{scene.frame_step}" if scene.frame_step > 1 else ""
            self.frames = f"{scene.frame_start}-{scene.frame_end}{step}"
        return context.window_manager.invoke_props_dialog(self, width=400, confirm_text="Write Job")

    def steps(self, context, job: jobs.BackgroundJob) -> jobs.Steps:
        """Count the tiles of missing stores on a thread, then write the job; return its lines and notes."""
        from ..importing.shot_import import tiles_to_share
        from .submit import INSTALLED, missing_imports, submit

        _check_is_saved()
        if not self.folder.strip():
            raise TerrainError("The job has no folder", expected="one, such as //farm/")
        frames, out, scene = self._frames(), Path(absolute_path(self.folder)), context.scene
        imports = missing_imports(session.terrains_of(scene)) if self.shared_disk else {}

        def count() -> dict[int, int]:
            """Return the numbers of tiles by session_uid, from the headers of the files."""
            with stopping.checking(job.raise_if_stopped):
                return {uid: tiles_to_share(settings) for uid, settings in imports.items()}

        counts = yield from jobs.run_on_thread(job, count)
        job.raise_if_stopped()
        _check_is_saved()  # the user may have gone on
        try:
            return submit(
                scene,
                session.terrains_of(scene),
                out,
                frames=frames,
                chunk=self.chunk,
                formats=() if self.render else ("npz",),
                extension=INSTALLED if self.bring else None,
                allow_outside=self.allow_outside,
                shared_disk=self.shared_disk,
                count_tiles=lambda obj: counts.get(obj.session_uid, 0),
            )
        except ReferenceError:  # undo has replaced the scene, or it is gone
            raise jobs.JobStopped from None
        except OSError as reason:
            raise unwritable(f"The job {out}", reason) from reason

    def finish(self, _context, _obj, result: tuple[list[str], list[str]]) -> None:
        """Report the job's commands and notes."""
        lines, notes = result
        for kind, texts in (("INFO", lines), ("WARNING", notes)):
            for text in texts:
                self.report({kind}, text)

    def _frames(self) -> tuple[int, ...] | None:
        """Return the frames of the option, None for those of the scene."""
        return parse_frames(self.frames) if self.frames.strip() else None


def _check_is_saved() -> None:
    """Raise TerrainError for unsaved changes: a farm renders the file on disk."""
    if bpy.data.is_dirty and not bpy.app.background:  # `is_dirty` is always set in the background
        raise TerrainError("The file has unsaved changes, and a farm renders the saved file", fix="save it first")
