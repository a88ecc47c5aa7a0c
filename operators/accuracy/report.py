# SPDX-License-Identifier: GPL-3.0-or-later
"""A report about accuracy: whether it can be written, the files that it is, and whether every bound in it holds."""

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from ...cbt_terrain.accuracy.crops import crops
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.terrain import Terrain
from ..export.exporting import check_room, check_target, make_folder, write_files
from ..text.machine import machine
from . import page as accuracy_page
from .plots import label
from .subject import AccuracySubject

PAGE = "index.html"
FILES = ("accuracy.csv", "accuracy.json", "accuracy.md", PAGE)
REPORT_BYTES = 1 << 21  # more than it is
SCRATCH = "adaptive_terrain_scratch"  # property of the mesh that is written into


def prepare(out: Path) -> None:
    """Make the folder; raises TerrainError where a report cannot be written: better now than after measuring."""
    make_folder(out)
    for name in FILES:
        check_target(out / name)
    check_room(out / PAGE, REPORT_BYTES)


def write(subjects: Sequence[AccuracySubject], out: Path) -> None:
    """Write FILES and the plots of measured subjects into the folder `out`, all or none; raises TerrainError."""
    make_folder(out)  # which may be gone since `prepare`
    write_files(out, accuracy_page.files(subjects, machine()))


def draw(subject: AccuracySubject) -> None:
    """Draw the pictures of errors that a page shows side by side."""
    errors = [row.setting.error for row in accuracy_page.strip_rows(subject)]
    subject.crops = crops(Terrain(subject.heights), subject.frames[0], errors, subject.base)


def check_bounds(subjects: Sequence[AccuracySubject]) -> None:
    """Raise TerrainError where a measured error passes its bound."""
    if broken := [(subject, row) for subject in subjects for row in subject.rows if not row.error <= row.bound]:
        subject, row = broken[0]
        raise TerrainError(
            f"The bound does not hold in {len(broken)} row{'s' * (len(broken) > 1)}, first of {subject.name} at "
            f"{label(row.setting)}: bounded by {row.bound:.9g} {row.setting.unit}, measured {row.error:.9g}",
            fix="report it with accuracy.json",
        )


def ingest_ms(surface) -> float:
    """Measure the milliseconds that writing a surface into a Blender mesh takes.

    The same mesh is written until `ingest_end`, so it has memory already, as a terrain's mesh has. A million triangles
    take twice as long in a new mesh.
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


def ingest_end() -> None:
    """Remove the meshes that were written, also those that an undo has restored."""
    bpy = sys.modules.get("bpy")
    if bpy is not None:
        for mesh in list(_scratch_meshes()):
            bpy.data.meshes.remove(mesh)


def _scratch_meshes():
    """Yield the meshes that this module made. They are looked up each time, as an undo replaces them."""
    import bpy

    return (mesh for mesh in bpy.data.meshes if mesh.users == 0 and SCRATCH in mesh)
