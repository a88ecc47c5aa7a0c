# SPDX-License-Identifier: GPL-3.0-or-later
"""`adaptive-terrain accuracy`: what accuracy costs on the terrains of a store or a scene, measured and written down."""

from collections.abc import Callable
from pathlib import Path

from ...cbt_terrain.accuracy.sweep import sweep
from ...cbt_terrain.errors import TerrainError
from ..accuracy import page as accuracy_page
from ..accuracy import report as accuracy_report
from ..accuracy.subject import AccuracySubject
from ..blender import need_bpy
from ..text.console import Progress, print_line


def run(subjects: list[AccuracySubject], out: Path, show_progress: bool | None = None) -> None:
    """Measure the accuracy of every subject, then write the report into the folder `out`.

    Raises TerrainError if something cannot be written, and after writing if a measured error exceeds its bound.
    show_progress: whether there is a bar, None for one in a terminal only.
    """
    accuracy_report.prepare_folder(out)
    measure(subjects, show_progress)
    accuracy_report.write_report(subjects, out)
    print_line(f"{out / accuracy_report.PAGE} shows it")
    accuracy_report.check_bounds(subjects)


def measure(subjects: list[AccuracySubject], show_progress: bool | None = None) -> None:
    """Fill in the rows, crops and notes of every subject; print a line per row on stdout, a progress bar on stderr.

    show_progress: whether there is a bar, None for one in a terminal only.
    """
    write, note = mesh_writer()  # writes a surface into a Blender mesh; note: why that cannot be timed, else ""
    with Progress(len(subjects), "accuracy", show_progress) as bar:
        try:
            for done, subject in enumerate(subjects):
                subject.notes += [note] if note else []
                subject.rows = sweep(
                    subject.heights,
                    subject.settings,
                    subject.frames,
                    base=subject.base,
                    write=write,
                    effects=subject.effects,
                    on_row=lambda row, name=subject.name: bar.say(f"{name}, {accuracy_page.row_line(row)}"),
                    on_progress=lambda fraction, done=done: bar.to(done + fraction),
                )
                accuracy_report.draw_crops(subject)
        finally:
            accuracy_report.remove_scratch_meshes()


def mesh_writer() -> tuple[Callable | None, str]:
    """Return a function that times writing a surface into a Blender mesh, and "".

    Without Blender, return None and the reason, for the report's notes.
    """
    try:
        need_bpy("Writing a mesh")
    except TerrainError as reason:
        return None, f"Writing the mesh into Blender was not measured. {reason}"
    return accuracy_report.time_mesh_writing, ""
