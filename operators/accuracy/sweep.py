# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure the terrain with a sweep of settings, and write the report that `adaptive-terrain accuracy` writes."""

import os
from contextlib import contextmanager
from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.view.criterion import Criterion
from ..bridge.scene_paths import absolute_path
from ..export.blend_files import file_name
from ..jobs import BackgroundJob
from ..session import session
from ..session.pauses import handlers_paused
from ..terrain.request import RENDER, gather
from . import report as accuracy_report
from .measuring import MeasuringOperator
from .plots import setting_label
from .subject import AccuracySubject, Look, gather_views

BESIDE = "//accuracy/"
NOT_FOLLOWED = (
    "the scene by a driver that looks at the scene itself; then popping here is that of a next frame in which that "
    "stands still. The command measures it."
)


def report_folder(obj) -> Path:
    """Return the folder of a terrain's report, inside the one of its settings, as an absolute path; it need not exist.

    Raises TerrainError for a path relative to a file that is not saved, and for one that is not absolute.
    """
    folder = obj.adaptive_terrain.reports
    if folder.startswith("//") and not bpy.data.filepath:
        raise TerrainError(
            f"Reports go into {folder!r}, relative to the .blend file, which is not saved yet",
            fix="save the file, or choose another folder",
        )
    path = Path(os.path.expanduser(absolute_path(folder)))
    if not path.is_absolute():
        raise TerrainError(
            f"Reports go into {folder!r}, which is not a whole path", fix=f"choose a folder, or {BESIDE!r}"
        )
    return path / file_name(obj)


def check_report_name(obj) -> None:
    """Raise TerrainError if another terrain has the same report folder, upper and lower case being equal in names."""
    place = obj.adaptive_terrain.reports, file_name(obj).casefold()
    for other in session.all_terrains():
        if other != obj and (other.adaptive_terrain.reports, file_name(other).casefold()) == place:
            raise TerrainError(
                f"The reports of {obj.name!r} and {other.name!r} would both be written to {file_name(obj)!r}",
                fix="rename one of the terrains, or choose another folder",
            )


@contextmanager
def copied_scene(scene, view_layer):
    """Yield a copy of the scene and its view layer, for a `with` block that visits other frames.

    The scene itself stays at its frame, with changes that have no keyframe. The copy is removed after the block.
    """
    copy = scene.copy()
    try:
        yield copy, copy.view_layers[view_layer.name]
    finally:
        # Return to the frame: both scenes share objects, which handlers of other extensions may have moved.
        with handlers_paused():
            copy.frame_set(scene.frame_current, subframe=scene.frame_subframe)
        bpy.data.scenes.remove(copy)


def readers_of(scene) -> list[str]:
    """Return the names of data-blocks that read the scene itself, as some drivers do.

    In a copy of the scene they see the original's frame, which the report has to mention.
    """
    users = bpy.data.user_map(subset=[scene])[scene]
    return sorted(user.name for user in users if user.id_type not in ("WINDOWMANAGER", "SCREEN", "WORKSPACE"))


def measure_look(look: Look, through: str, job: BackgroundJob) -> AccuracySubject:
    """Measure every setting of a sweep on the job's thread; return the subject with its rows and crops.

    Only writing meshes is done on the main thread. look: the terrain with its views in the frames to measure. through:
    the camera, as a phrase after "through".
    """
    from ...cbt_terrain.accuracy.sweep import sweep

    with session.engine_lock:
        subject = look.subject(through)
    settings = subject.settings

    def on_progress(fraction: float) -> None:
        """Show the setting that is being measured, from the fraction that is done."""
        number = min(int(fraction * len(settings)), len(settings) - 1)
        job.progress(fraction, f"Report: {setting_label(settings[number])}")

    subject.rows = sweep(
        subject.heights,
        settings,
        subject.frames,
        base=subject.base,  # the criterion whose other limits, such as culling, all settings have
        effects=subject.effects,  # the attributes that the scene reads
        write=lambda surface: job.call_on_main(lambda: accuracy_report.time_mesh_writing(surface)),
        on_progress=on_progress,
    )
    accuracy_report.draw_crops(subject)
    return subject


class SweepAccuracy(MeasuringOperator, bpy.types.Operator):
    """Measure this terrain with many settings, and write a page with plots and tables and the same as CSV. It takes a
    minute or more; Open Report shows the page"""

    bl_idname = "adaptive_terrain.sweep_accuracy"
    bl_label = "Write Accuracy Report"
    bl_options = {"REGISTER"}

    def prepare(self, context):
        """Check the folder, return the function that measures and writes.

        A copy of the scene visits the current frame and the next one, for measuring popping.
        """
        obj, scene = context.object, context.scene
        folder = report_folder(obj)
        check_report_name(obj)
        # Raises errors that name this scene, not its copy.
        gather(obj, context.evaluated_depsgraph_get(), RENDER, criterion=Criterion())
        with copied_scene(scene, context.view_layer) as (copy, view_layer):
            [look] = gather_views(copy, view_layer, [obj], [scene.frame_current])
        accuracy_report.prepare_folder(folder)
        readers = readers_of(scene)  # data-blocks that see the frame of this scene, not that of its copy
        through = f"the camera of {Path(bpy.data.filepath).name or 'the scene'}"

        def measure_and_write(job: BackgroundJob) -> tuple[Path, AccuracySubject]:
            """Measure and write the report; return its folder and the subject.

            Raises TerrainError if it cannot be written, and after writing if a bound does not hold.
            """
            subject = measure_look(look, through, job)
            if readers:
                subject.notes.append(f"{' and '.join(readers)} may follow {NOT_FOLLOWED}")
            job.progress(1.0, "Report: writing")
            accuracy_report.write_report([subject], folder)
            accuracy_report.check_bounds([subject])
            return folder, subject

        return measure_and_write

    def clean_up(self):
        """Remove the meshes that were written to time Blender."""
        accuracy_report.remove_scratch_meshes()

    def finish(self, _context, _obj, result: tuple[Path, AccuracySubject]) -> None:
        """Report where the report is."""
        folder, subject = result
        self.report({"INFO"}, f"{folder / accuracy_report.PAGE}: {len(subject.rows)} settings measured")
