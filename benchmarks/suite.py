# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark: its rows in order, their measurement, and the files that it writes."""

import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from ..cbt_terrain.errors import TerrainError
from ..operators.blender import need_bpy
from ..operators.text.machine import describe_machine
from .pages import goals, performance_page, report
from .rig import scenes
from .rig.baselines import RoamRebuild, build_roam_rebuild
from .rig.measure import BenchmarkRow
from .rows import (
    demand_row,
    effects_row,
    engine,
    files,
    fit_row,
    hidden_row,
    in_blender,
    in_program,
    land_rows,
    light_row,
    maps_row,
    query_row,
    same_picture,
    scatter_row,
    split_merge_row,
    start,
)

# Measures one row or several, anew on each call.
Measure = Callable[[], BenchmarkRow | Iterable[BenchmarkRow]]


def run(quick: bool, with_cycles: bool, blender: list[str] | None, json_file: Path | None, docs: Path | None) -> None:
    """Measure all rows, print a line for each, and write the requested files.

    Args:
        blender: the command that starts a Blender program.
        json_file: file for the rows.
        docs: folder for the pages on performance.

    Raises:
        TerrainError: a file cannot be written (before any measurement), or a row of a quick run is worse than goals.py
            allows (after all measurements).
    """
    pages = [docs / name for name in performance_page.documents([], {}, [])] if docs else []
    for path in ([json_file] if json_file else []) + pages:
        report.check_writable(path)
    notes: list[str] = []

    def note(text: str) -> None:
        notes.append(text)
        print(f"note: {text}", flush=True)

    description = describe_machine()
    if blender:
        description["Program"] = in_program.program_version(blender)
    for name, value in description.items():
        print(f"{name}: {value}")
    with scratch_folder(1 if quick else 4 if with_cycles else 3) as folder:
        roam = build_roam_rebuild(folder, note)
        try:
            measures = list_measures(folder, quick, with_cycles, blender, roam, note)
            rows = measure_rows(measures, goals.ATTEMPTS if quick else 1)
        finally:
            if roam:
                roam.close()
    if json_file is not None:
        report.write_json(rows, json_file)
    if docs is not None:
        for name, text in performance_page.documents(rows, description, notes).items():
            report.write_text(docs / name, text)
    if quick and (failed := goals.failures(rows)):
        failures = ", ".join(
            f"{row.name} at {row.size:,} (ratio {row.ratio:.3g}, at most {goals.max_ratio(row.name, row.size):.3g})"
            for row in failed
        )
        raise TerrainError(f"Rows were slower than allowed in each of {goals.ATTEMPTS} attempts: {failures}")


def measure_rows(measures: Iterable[Measure], attempts: int) -> list[BenchmarkRow]:
    """Measure all rows, print them, and measure those that fail again after the others.

    Another program may have disturbed the first attempt. The best attempt of a failed row counts.
    """
    rows: dict[tuple[str, int], BenchmarkRow] = {}
    for attempt in range(1, attempts + 1):
        failed = []
        for measure in measures:
            result = measure()
            for row in [result] if isinstance(result, BenchmarkRow) else result:
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


def list_measures(
    folder: Path,
    quick: bool,
    with_cycles: bool,
    program: list[str] | None,
    roam: RoamRebuild | None,
    note: Callable[[str], None],
) -> Iterator[Measure]:
    """Yield the measurement of every row in the order of the table; a quick run omits files, fits and small frames."""
    flat, rough = scenes.flat(), scenes.rough()
    for name, (_, sizes) in engine.REFINE_SIZES.items():
        for size in sizes:
            yield partial(engine.refine_row, name, flat, size, roam)
    for row in (engine.refine_error_row, engine.still_row, engine.surface_row):
        yield partial(row, rough, roam)
    yield partial(split_merge_row.split_merge_row, rough)
    yield partial(engine.budget_flight_row, rough)
    yield partial(engine.morph_flight_row, rough)
    yield partial(hidden_row.hidden_row, folder)
    yield effects_row.effects_flight_row
    yield light_row.light_preview_row
    yield from (land_rows.rivers_row, land_rows.scree_row, land_rows.water_row)
    yield partial(scatter_row.scatter_flight_row, rough)
    yield maps_row.maps_row
    yield query_row.query_heights_row
    store = in_blender.write_store(rough, folder / "rough")
    if not quick:
        yield partial(fit_row.fit_rows, note)
        yield partial(start.cold_start_row, rough, store)
        tiff = files.write_tiff(rough, folder / "rough.tif")
        yield partial(files.import_row, tiff, folder)
        yield partial(files.mosaic_row, rough, tiff, folder)
        yield partial(files.large_rows, tiff, folder, note)
    blender = _has_blender(note)
    if blender:
        yield partial(demand_row.demand_row, rough)
        for size in in_blender.FRAME_SIZES[-1:] if quick else in_blender.FRAME_SIZES:
            yield partial(in_blender.frame_row, rough, store, size)
    if program:
        yield partial(in_program.program_frame_row, program, store)
    else:
        note("The row program_frame is measured with --blender only.")
    if not with_cycles:
        note("The rows same_picture are measured with --with-cycles only.")
    elif blender:
        yield partial(same_picture.same_picture_rows, folder / "island")


@contextmanager
def scratch_folder(stores: int) -> Iterator[Path]:
    """Yield a folder that is removed at the end. Raises TerrainError without room for `stores` stores.

    Stores are written through mapped memory, where a full disk ends the process without a message.
    """
    try:
        folder = tempfile.TemporaryDirectory(prefix="adaptive-terrain-bench-", ignore_cleanup_errors=True)
    except OSError as reason:
        raise TerrainError(f"There is no folder for temporary files ({reason})", fix="let TMPDIR name one") from reason
    with folder as name:
        needed, free = stores * files.STORE_BYTES * scenes.SAMPLES**2, shutil.disk_usage(name).free
        if needed > free:
            raise TerrainError(
                f"A benchmark needs {needed / 1e9:.1f} GB in {Path(name).parent}, where {free / 1e9:.2g} GB are free",
                fix="let TMPDIR name a folder with more room",
            )
        yield Path(name)


def _has_blender(note: Callable[[str], None]) -> bool:
    try:
        need_bpy("The rows demand, frame and same_picture")
    except TerrainError as error:
        note(str(error))
        return False
    return True
