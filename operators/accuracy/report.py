# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks that a report about accuracy can be written, writes it, and checks that every bound in it holds."""

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from ...cbt_terrain.errors import TerrainError
from ..export.exporting import check_disk_space, check_target, make_folder, write_files
from ..text.machine import describe_machine
from .plots import setting_label
from .subject import AccuracySubject

PAGE = "index.html"
FILES = ("accuracy.csv", "accuracy.json", "accuracy.md", PAGE)
REPORT_BYTES = 1 << 21  # more than it is
SCRATCH = "adaptive_terrain_scratch"  # property of the mesh that is written into


def prepare_folder(out: Path) -> None:
    """Create the folder of a report. Raises TerrainError if it cannot be written, before the long measurement."""
    make_folder(out)
    for name in FILES:
        check_target(out / name)
    check_disk_space(out / PAGE, REPORT_BYTES)


def write_report(subjects: Sequence[AccuracySubject], out: Path) -> None:
    """Write all files of a report into the folder `out`, all or none. Raises TerrainError."""
    from . import page as accuracy_page

    make_folder(out)  # which may be gone since `prepare_folder`
    write_files(out, accuracy_page.report_files(subjects, describe_machine()))


def draw_crops(subject: AccuracySubject) -> None:
    """Set `subject.crops`: pictures of one part of the first frame at the errors of `strip_rows`, for the page.

    `strip_rows`: the rows of the errors that the page's strip of pictures compares. `crops` is [] without such rows,
    without a view and for a panorama.
    """
    from ...cbt_terrain.accuracy.crops import crops
    from ...cbt_terrain.terrain import Terrain
    from . import page as accuracy_page

    errors = [row.setting.error for row in accuracy_page.strip_rows(subject)]
    subject.crops = crops(Terrain(subject.heights), subject.frames[0], errors, subject.base)


def check_bounds(subjects: Sequence[AccuracySubject]) -> None:
    """Raise TerrainError if a measured error exceeds its bound."""
    # `not <=`: an error that is not a number holds no bound.
    if broken := [(subject, row) for subject in subjects for row in subject.rows if not row.error <= row.bound]:
        subject, row = broken[0]
        raise TerrainError(
            f"The bound does not hold in {len(broken)} row{'s' * (len(broken) > 1)}, first of {subject.name} at "
            f"{setting_label(row.setting)}: bounded by {row.bound:.9g} {row.setting.unit}, measured {row.error:.9g}",
            fix="report it with accuracy.json",
        )


def time_mesh_writing(surface) -> float:
    """Write a surface into a Blender mesh, on the main thread, and return the milliseconds that it took.

    The same mesh is used until `remove_scratch_meshes`, so that it has memory already, as a terrain's mesh has. A
    million triangles take twice as long in a new mesh.
    """
    import bpy

    from ..bridge.writer import write_mesh

    mesh = next(_scratch_meshes(), None)
    if mesh is None:
        mesh = bpy.data.meshes.new("accuracy")
        mesh[SCRATCH] = True
    start = time.perf_counter()
    write_mesh(mesh, surface)
    return (time.perf_counter() - start) * 1e3


def remove_scratch_meshes() -> None:
    """Remove the meshes that `time_mesh_writing` wrote, also those that an undo has restored."""
    bpy = sys.modules.get("bpy")
    if bpy is not None:
        for mesh in list(_scratch_meshes()):
            bpy.data.meshes.remove(mesh)


def _scratch_meshes():
    """Yield the meshes that `time_mesh_writing` wrote. An undo replaces them, so they are looked up each time."""
    import bpy

    return (mesh for mesh in bpy.data.meshes if mesh.users == 0 and SCRATCH in mesh)
