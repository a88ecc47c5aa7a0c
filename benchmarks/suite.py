# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark from its first row to its last: what is measured, in which order, and what becomes of it."""

import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from ..cbt_terrain.errors import TerrainError
from ..operators.blender import need_bpy
from ..operators.text.machine import machine
from .pages import goals, performance_page, report
from .rig import scenes
from .rig.baselines import RoamRebuild, build_roam_rebuild
from .rig.measure import Row
from .rows import (
    cycles,
    cycles_likeness,
    demand_rows,
    detail_rows,
    effects,
    engine,
    files,
    fit_row,
    hidden_row,
    in_blender,
    in_program,
    land_rows,
    layer_rows,
    light_rows,
    maps_rows,
    morph_rows,
    query_rows,
    scale,
    scatter_rows,
    scree_rows,
    shading_row,
    start,
    water_rows,
)

# Measures one row or several, and measures them anew whenever it is called.
Measure = Callable[[], Row | Iterable[Row]]


def run(quick: bool, with_cycles: bool, blender: list[str] | None, json_file: Path | None, docs: Path | None) -> None:
    """Measure, print a line a row, and write what was asked for. `blender`: a command that starts the program.

    Raises TerrainError at once if that cannot be written, and at the end of a quick run if a row is worse than goals.py
    allows.
    """
    documents = [docs / name for name in performance_page.documents([], {}, [])] if docs else []
    for path in ([json_file] if json_file else []) + documents:
        report.check_writable(path)
    notes: list[str] = []

    def note(text: str) -> None:
        notes.append(text)
        print(f"note: {text}", flush=True)

    described = machine()
    if blender:
        described["Program"] = in_program.program_version(blender)
    for name, value in described.items():
        print(f"{name}: {value}")
    with scratch_folder(1 if quick else 3 if with_cycles else 2) as folder:
        roam = build_roam_rebuild(folder, note)
        try:
            measures = everything(folder, quick, with_cycles, blender, roam, note)
            rows = measured(measures, goals.ATTEMPTS if quick else 1)
        finally:
            if roam:
                roam.close()
    if json_file is not None:
        report.write_json(rows, json_file)
    if docs is not None:
        for name, text in performance_page.documents(rows, described, notes).items():
            report.write_text(docs / name, text)
    if quick and (failed := goals.failures(rows)):
        said = ", ".join(
            f"{row.name} at {row.size:,} (ratio {row.ratio:.3g}, at most {goals.most_allowed(row.name, row.size):.3g})"
            for row in failed
        )
        raise TerrainError(f"Slower than allowed in each of {goals.ATTEMPTS} attempts: {said}.")


def measured(measures: Iterable[Measure], attempts: int) -> list[Row]:
    """The rows of all measures, printed as they come; one that fails is measured again after all others.

    What disturbed it may then be over. It fails only if every attempt does; of its attempts the best is kept.
    """
    rows: dict[tuple[str, int], Row] = {}
    for attempt in range(1, attempts + 1):
        failed = []
        for measure in measures:
            found = measure()
            for row in [found] if isinstance(found, Row) else found:
                row.attempts = attempt
                print(report.line(row), flush=True)
                best = rows.setdefault((row.name, row.size), row)
                if goals.failures([best]):
                    if row.ratio < best.ratio:
                        rows[row.name, row.size] = best = row
                    best.attempts = attempt
                if goals.failures([best]) and measure not in failed:
                    failed.append(measure)
        if not failed:
            break
        measures = failed
    return list(rows.values())


def everything(
    folder: Path,
    quick: bool,
    with_cycles: bool,
    program: list[str] | None,
    roam: RoamRebuild | None,
    note: Callable[[str], None],
) -> Iterator[Measure]:
    """Every row, in the order of the table; a quick run leaves out what has no goal, files and the largest sizes."""
    flat, rough = scenes.flat(), scenes.rough()
    for threads, sizes in engine.REFINE_SIZES.items():
        for size in sizes:
            yield partial(engine.refine_row, flat, size, threads, roam)
    for row in (engine.refine_error_row, engine.still_row, engine.surface_row, engine.meshlets_row):
        yield partial(row, rough, roam)
    yield effects.fused_row
    yield effects.frames_rows
    yield partial(engine.depth_row, flat)
    if not quick:
        yield partial(engine.depth_reached_row, flat)
    yield partial(engine.budget_rows, rough)
    yield partial(engine.budget_level_row, flat)
    yield partial(layer_rows.layer_rows, rough)
    yield partial(light_rows.light_rows)
    yield from (land_rows.relief_row, land_rows.river_rows, land_rows.demanded_row)
    yield partial(scree_rows.scree_rows)
    yield water_rows.water_rows
    yield partial(scatter_rows.scatter_rows, rough)
    yield partial(hidden_row.hidden_row, folder)
    yield partial(morph_rows.morph_rows, rough)
    yield partial(maps_rows.maps_row)
    yield from (detail_rows.from_air_row, detail_rows.from_ground_row, detail_rows.displacement_row)
    yield query_rows.query_rows
    store = in_blender.keep(rough, folder / "rough")
    if not quick:
        yield partial(start.warm_row, rough, store)
        yield partial(shading_row.shading_rows, folder)
        yield partial(land_rows.stack_rows)
        yield partial(fit_row.fit_rows, note)
        yield partial(start.no_cache_row, rough, store)
        tiff = files.write_tiff(rough, folder / "rough.tif")
        yield partial(files.import_rows, tiff, folder)
        yield partial(files.large_rows, store, folder, note)
    blender = _has_blender(note)
    if blender:
        yield partial(in_blender.ingest_row, rough)
        for size in [in_blender.MILLION] if quick else in_blender.FRAME_SIZES:
            yield partial(in_blender.frame_row, rough, store, size)
        if not quick:
            yield partial(in_blender.frame_row, rough, store, in_blender.MILLION, engine.MESHLET)
            yield partial(in_blender.still_frame_row, rough, store)
        yield partial(demand_rows.demand_rows, rough)
        yield effects.ingest_row
    if program:
        yield partial(in_program.program_rows, program, store)
    else:
        note("The rows program_ are measured with --blender only.")
    sizes = scale.QUICK_SIZES if quick else scale.SIZES
    yield partial(scale.refine_row, flat, sizes)
    yield partial(scale.surface_row, rough, sizes)
    if blender:
        yield partial(scale.ingest_row, rough, sizes)
        yield partial(scale.frame_row, rough, store, sizes)
    if with_cycles and blender:
        yield partial(cycles.cycles_rows, store, tiff, folder)
        yield partial(cycles_likeness.same_picture_rows, folder / "island")
    elif not with_cycles:
        note("The rows cycles are measured with --with-cycles only.")


@contextmanager
def scratch_folder(stores: int) -> Iterator[Path]:
    """A folder that is removed in the end. Raises TerrainError unless there is room for so many stores.

    They are written through mapped memory, where a full disk ends the process without a word.
    """
    try:
        folder = tempfile.TemporaryDirectory(prefix="adaptive-terrain-bench-", ignore_cleanup_errors=True)
    except OSError as reason:
        raise TerrainError(f"There is no folder for temporary files ({reason}); let TMPDIR name one.") from reason
    with folder as name:
        needed, free = stores * files.STORE_BYTES * scenes.SAMPLES**2, shutil.disk_usage(name).free
        if needed > free:
            raise TerrainError(
                f"A benchmark needs {needed / 1e9:.1f} GB in {Path(name).parent}, where {free / 1e9:.2g} GB are free; "
                "let TMPDIR name a folder with more room."
            )
        yield Path(name)


def _has_blender(note: Callable[[str], None]) -> bool:
    try:
        need_bpy("The rows ingest, frame and cycles")
    except TerrainError as error:
        note(str(error))
        return False
    return True
