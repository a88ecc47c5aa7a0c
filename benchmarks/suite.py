# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark from its first row to its last: what is measured, in which order, and what becomes of it."""

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from ..cbt_terrain.errors import TerrainError
from ..operators.frame_sources import need_bpy
from . import cycles, engine, files, goals, in_blender, report, scale, scenes, start
from .baselines import build_roam_rebuild
from .machine import machine
from .measure import Row


def run(quick: bool, with_cycles: bool, json_file: Path | None, docs: Path | None) -> None:
    """Measure, print a line a row, and write what was asked for.

    Raises TerrainError at the end of a quick run if a row is worse than goals.py allows.
    """
    notes: list[str] = []

    def note(text: str) -> None:
        notes.append(text)
        print(f"note: {text}", flush=True)

    for name, value in machine().items():
        print(f"{name}: {value}")
    rows = []
    with tempfile.TemporaryDirectory(prefix="adaptive-terrain-bench-") as folder:
        for row in measured(Path(folder), quick, with_cycles, note):
            rows.append(row)
            print(report.line(row), flush=True)
    if json_file is not None:
        report.write_json(rows, json_file)
    if docs is not None:
        report.write_docs(rows, machine(), notes, docs)
    if quick and (failed := goals.failures(rows)):
        said = ", ".join(f"{row.name} at {row.size:,} ({row.ratio:.3g})" for row in failed)
        raise TerrainError(f"Slower than {goals.SLACK:g} times what is allowed: {said}.")


def measured(folder: Path, quick: bool, with_cycles: bool, note: Callable[[str], None]) -> Iterator[Row]:
    """Every row, in the order of the table; a quick run leaves out files, an empty cache and the largest sizes."""
    roam = build_roam_rebuild(folder, note)
    flat, rough = scenes.flat(), scenes.rough()
    try:
        yield from engine.refine_rows(flat, roam)
        yield engine.refine_error_row(rough, roam)
        yield engine.still_row(rough, roam)
        yield engine.surface_row(rough, roam)
        yield engine.meshlets_row(rough, roam)
    finally:
        if roam:
            roam.close()
    yield from engine.depth_rows(flat)
    store = in_blender.keep(rough, folder / "rough")
    yield start.warm_row(rough, store)
    if not quick:
        yield start.no_cache_row(rough, store)
        tiff = files.write_tiff(rough, folder / "rough.tif")
        yield from files.import_rows(tiff, folder)
        yield from files.large_rows(store, folder, note)
    blender = _has_blender(note)
    if blender:
        yield in_blender.ingest_row(rough)
        yield from in_blender.frame_rows(rough, store)
        yield in_blender.still_frame_row(rough, store)
    yield from scale.scale_rows(flat, rough, store if blender else None, scale.QUICK_SIZES if quick else scale.SIZES)
    if with_cycles and blender:
        yield from cycles.cycles_rows(store, tiff, folder)
    elif not with_cycles:
        note("The rows cycles are measured with --with-cycles only.")


def _has_blender(note: Callable[[str], None]) -> bool:
    try:
        need_bpy("The rows ingest, frame and cycles")
    except TerrainError as error:
        note(str(error))
        return False
    return True
