# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the job of a scene for a render farm."""

from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError
from ..bridge.scene_paths import absolute_path
from ..export.formats import parse_frames
from ..session import session
from ..session.polls import cancelled_by_errors
from ..terrain.properties import PATH_OPTIONS


class SubmitToFarm(bpy.types.Operator):
    """Write a folder for a render farm: the saved file, the stores of its terrains, and a job for Deadline Cloud (Open
    Job Description) and Flamenco"""

    bl_idname = "adaptive_terrain.submit"
    bl_label = "Submit to Farm"

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
        return bool(session.terrains_of(context.scene))

    def invoke(self, context, event):
        """Refuse unsaved changes, and show the options in a dialog."""
        try:
            _check_is_saved()
        except TerrainError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not self.properties.is_property_set("frames"):
            scene = context.scene
            self.frames = f"{scene.frame_start}-{scene.frame_end}"
        return context.window_manager.invoke_props_dialog(self, width=400, confirm_text="Write Job")

    @cancelled_by_errors
    def execute(self, context):
        """Write the job of the saved file into the chosen folder, and report its commands and notes."""
        from .submit import INSTALLED, submit

        _check_is_saved()
        if not self.folder.strip():
            raise TerrainError("The job has no folder", expected="one, such as //farm/")
        lines, notes = submit(
            context.scene,
            session.terrains_of(context.scene),
            Path(absolute_path(self.folder)),
            frames=self._frames(),
            chunk=self.chunk,
            formats=() if self.render else ("npz",),
            extension=INSTALLED if self.bring else None,
            allow_outside=self.allow_outside,
            shared_disk=self.shared_disk,
        )
        for kind, texts in (("INFO", lines), ("WARNING", notes)):
            for text in texts:
                self.report({kind}, text)
        return {"FINISHED"}

    def _frames(self) -> tuple[int, ...] | None:
        """Return the frames of the option, None for those of the scene."""
        return parse_frames(self.frames) if self.frames.strip() else None


def _check_is_saved() -> None:
    """Raise TerrainError for unsaved changes: a farm renders the file on disk."""
    if bpy.data.is_dirty and not bpy.app.background:  # `is_dirty` is always set in the background
        raise TerrainError("The file has unsaved changes, and a farm renders the saved file", fix="save it first")
