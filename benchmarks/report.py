# SPDX-License-Identifier: GPL-3.0-or-later
"""How results are shown: a line each, JSON, and the page docs/performance.md with its plot."""

import json
import os
import tempfile
from pathlib import Path

from ..cbt_terrain.errors import TerrainError
from . import profiles
from .goals import ATTEMPTS, SLACK, goal_of, missed_by, recorded_of
from .measure import BLOCKS, RUNS, SHORT_BLOCKS, SHORT_MS, Row
from .plot import write_plot

PAGE, PLOT = "performance.md", "images/performance.svg"
# What a reader of the page should know of each row.
MEANING = {
    "refine_1t": "The walk of the tree, tree marked, counters up to date; the camera moves by 0.1 % of the side a "
    "frame, all round over a flat 4097² field, edges of one length on screen, depth 27; one thread.",
    "refine_2t": "The same on two threads.",
    "refine_error": "Error on screen over a rough 4097² field, frustum and guard band on; one thread.",
    "still": "The same camera again: to know that nothing changed. No mesh is written.",
    "surface": "The whole update of the rough field: refine, weld, displace, normals, uv; all threads.",
    "meshlets": "As many triangles, 4⁴ for each leaf.",
    "ingest": "The arrays to an evaluated Blender mesh, with normals and two attributes.",
    "frame": "Camera moves to evaluated mesh, all that Blender does in between.",
    "frame_meshlets": "The same with 4⁴ triangles for each leaf.",
    "still_frame": "A frame change in Blender while the camera stands still; no mesh is written.",
    "program_ingest": "ingest inside the Blender program that is named above, without a window. Before 4.5 Blender "
    "takes normals by corner only, and encodes them one by one: a million triangles took 608 ms in 4.3.2, 2.1 times "
    "the plain ingest, and a frame 638 ms.",
    "program_frame": "frame inside of it.",
    "program_frame_meshlets": "frame_meshlets inside of it.",
    "program_still_frame": "still_frame inside of it.",
    "depth": "refine_1t of the same leaves in trees of depth 20, 24, 28, 32: slowest beside fastest.",
    "depth_reached": "The same, each camera so low that its finest leaves reach that depth: other leaves, as many.",
    "budget_first": "An error 30 times too fine for a triangle limit: search and refinement of a first update, beside "
    "a refinement of the same leaves without a limit; rough 4097² field, one thread.",
    "budget_flight": "The same in a flight, beside one for the error that fits in its first frame; both take leaves "
    "from the last frame.",
    "budget_level": "As budget_first, of edges 30 times too short, all round over a flat 4097² field.",
    "fit_rough": "A static mesh for one vertical error (asked_m) whose vertices may leave the surface, `bake --fit`: "
    "513² samples of the rough field; beside greedy Delaunay insertion for the same error at the samples.",
    "fit_jacksboro": "The same of a real DEM, 321 x 385 samples 90 m apart.",
    "cold_start": "Python's start to the first mesh of a store, kernels compiled before.",
    "cold_start_no_cache": "The same with an empty kernel cache: everything is compiled.",
    "import": "A 4097² float32 GeoTIFF to a store with its error hierarchy, in the import's own process.",
    "import_reopen": "That store opened again; the goal is 50 ms.",
    "large_open": "A generated store of 16385² samples opened.",
    "large_frame": "Frames of it, beside the same number of triangles of 4097² samples; first: not in the file cache.",
    "large_memory": "Memory that stays resident after these frames, beside the same of 4097² samples.",
    "scale_refine": "Slope of time over triangles, logarithms of both; the time is of the largest size.",
    "scale_surface": "The same of surface.",
    "scale_ingest": "The same of ingest.",
    "scale_frame": "The same of frame.",
    "cycles_edge": "A whole Cycles render, 960 x 540, 1 sample: our edges at 1 px beside Cycles' dicing at 1 px; "
    "size counts our triangles. Ours bounds the longest edge of each triangle, so it has several times as many.",
    "cycles_edge_memory": "Peak memory of the two processes.",
    "cycles_error": "The same with our error at 1 px. ssim: how like the picture is to that of the whole grid; "
    "cpu_s: processor seconds a frame.",
    "cycles_error_memory": "Peak memory of the two processes.",
}


def line(row: Row) -> str:
    """One row as the terminal shows it."""
    parts = [f"{row.name:20} {row.size:>11,}", f"{number(row.ms):>9} ms" if row.ms is not None else " " * 12]
    if row.ratio is not None:
        base = "" if row.baseline_ms is None else f"{number(row.baseline_ms)} ms"
        parts.append(f"{row.baseline:>14} {base:>11}  ratio {row.ratio:7.4f}")
    goal, missed = goal_of(row.name, row.size), missed_by(row)
    if goal is not None and row.ratio is not None:
        parts.append(f"goal {goal:g}: {'met' if missed is None else f'missed by {missed:.0%}'}")
    parts += [f"{name} {number(value)}" for name, value in row.figures.items()]
    if row.attempts > 1:
        parts.append(f"attempt {row.attempts}")
    return "  ".join(parts).rstrip()


def number(value: float | None) -> str:
    """Three digits that count, and none beyond the point from 100 on."""
    if value is None:
        return ""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def as_json(row: Row) -> dict:
    """The six keys of a result, its goal, and what else was measured."""
    content = {name: getattr(row, name) for name in ("name", "size", "ms", "baseline", "baseline_ms", "ratio")}
    content["goal"] = goal_of(row.name, row.size)
    extras = {"first_ms": row.first_ms, "steps": row.steps, "figures": row.figures}
    if row.attempts > 1:
        extras["attempts"] = row.attempts
    return content | {name: value for name, value in extras.items() if value}


def write_json(rows: list[Row], path: Path) -> None:
    text = json.dumps([as_json(row) for row in rows], indent=1, allow_nan=False)
    write_text(path, text + "\n")


def write_docs(rows: list[Row], machine: dict[str, str], notes: list[str], folder: Path) -> None:
    """The page and its plot into a folder of documents."""
    slopes = {row.name.removeprefix("scale_"): row.ratio for row in rows if row.name.startswith("scale_")}
    write_text(folder / PLOT, write_plot(rows))
    write_text(folder / PAGE, page(rows, machine, notes, slopes))


def page(rows: list[Row], machine: dict[str, str], notes: list[str], slopes: dict[str, float]) -> str:
    """docs/performance.md as text."""
    parts = [
        "# Performance",
        'Written by `make bench BENCH="--with-cycles --docs docs --blender COMMAND"`; do not edit it by hand. Absolute '
        "times are of one machine on one day: what counts are the ratios to baselines that took turns with ours in the "
        "same run.",
        ", ".join(f"{name} {value}" for name, value in machine.items()) + ".",
        "## How it is measured",
        f"A time is the median of {BLOCKS * RUNS} runs, ours and the baseline in turns of {RUNS}; of "
        f"{SHORT_BLOCKS * RUNS} where a run takes less than {SHORT_MS:g} ms; of nine where each is a process or a "
        "render of its own. *First* is the first run, which finds cold memory; it is in no "
        "median. Ratio is ours to the baseline; for `scale_` it is the slope, for memory the ratio of memory.",
        "`roam_rebuild` is a serial C bintree (`benchmarks/roam_rebuild.c`, `-O3 -march=native`) that rebuilds the "
        "whole refinement from its roots on one thread. `plain_ingest` gives Blender the same arrays as attributes "
        "with `foreach_set`, lets it find the edges with `update(calc_edges=True)`, and has the mesh evaluated.",
        "## Results",
        table(rows),
        "## Where goals are missed",
        misses(rows),
        "## Time against triangles",
        f"![Time against triangles, both logarithmic]({PLOT})",
        "Slopes (1: proportional): " + ", ".join(f"{name} {slope:.2f}" for name, slope in slopes.items()) + ".",
        "## Where the time goes",
        "Milliseconds a frame, medians of each step. Of the refinement rows `whole` is all but the surface, with what "
        "Python does around the kernels.",
        steps_table(rows),
        *profiles.section(profiles.FILE),
        "## Other figures",
        figures_table(rows),
        "## What the rows are",
        "\n".join(f"* `{name}`: {MEANING[name]}" for name in dict.fromkeys(row.name for row in rows)),
    ]
    if notes:
        parts += ["## Left out", "\n".join(f"* {note}" for note in notes)]
    return "\n\n".join(parts) + "\n"


def table(rows: list[Row]) -> str:
    lines = [
        "| row | size | ms | first | baseline | ms | ratio | goal | |",
        "| --- " + "| ---: " * 3 + "| --- " + "| ---: " * 3 + "| --- |",
    ]
    for row in rows:
        goal, missed = goal_of(row.name, row.size), missed_by(row)
        verdict = "" if goal is None or row.ratio is None else "met" if missed is None else f"missed by {missed:.0%}"
        cells = [
            row.name,
            f"{row.size:,}",
            number(row.ms),
            number(row.first_ms),
            "" if row.ratio is None else row.baseline or "",
            number(row.baseline_ms),
            "" if row.ratio is None else f"{row.ratio:.3g}",
            "" if goal is None else f"{goal:g}",
            verdict,
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def misses(rows: list[Row]) -> str:
    """Each row over its goal with what holds it, as far as that is known."""
    over = [(row, missed_by(row)) for row in rows if missed_by(row) is not None]
    if not over:
        return "Nowhere."
    lines = []
    for row, part in over:
        known, goal = recorded_of(row.name, row.size), goal_of(row.name, row.size)
        why = f"Known ({known[0]:g}): {known[1]}" if known else "Not known before this run."
        lines.append(f"* `{row.name}` at {row.size:,}: {row.ratio:.3g} for {goal:g}, {part:.0%} over. {why}")
    rule = (
        f"`bench --quick` fails when a ratio is more than {SLACK:g} times its goal; a row that is known to be beyond "
        f"that (`RECORDED` in `benchmarks/goals.py`) may not be worse than {SLACK:g} times the ratio recorded for it. "
        f"A row that fails is measured again after all others; {ATTEMPTS} failures in a row fail the run."
    )
    return rule + "\n\n" + "\n".join(lines)


def steps_table(rows: list[Row]) -> str:
    lines = [
        f"| {row.name} | {row.size:,} | {', '.join(f'{step} {number(ms)}' for step, ms in row.steps.items())} |"
        for row in rows
        if row.steps
    ]
    return "\n".join(["| row | size | steps, ms |", "| --- | ---: | --- |", *lines])


def figures_table(rows: list[Row]) -> str:
    lines = [
        f"| {row.name} | {row.size:,} | {', '.join(f'{name} {number(value)}' for name, value in row.figures.items())} |"
        for row in rows
        if row.figures
    ]
    return "\n".join(["| row | size | |", "| --- | ---: | --- |", *lines])


def check_writable(path: Path) -> None:
    """Whether a file of that name can be written, folders above it included; raises TerrainError, leaves nothing."""
    existing = next(folder for folder in path.absolute().parents if folder.exists())
    try:
        if path.is_dir():
            raise IsADirectoryError(None, "it is a folder")
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as reason:
        raise _unwritable(path, reason) from reason


def write_text(path: Path, text: str) -> None:
    """All of the file or none of it; what is no plain file, like a pipe, is written into."""
    whole = path.is_file() or not path.exists()
    target = path.resolve() if whole else path
    part = target.with_name(f".{target.name}.{os.getpid()}") if whole else path
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.write_text(text, encoding="utf-8")
            if whole:
                part.replace(target)
        finally:
            if whole:
                part.unlink(missing_ok=True)
    except OSError as reason:
        raise _unwritable(path, reason) from reason


def _unwritable(path: Path, reason: OSError) -> TerrainError:
    return TerrainError(f"{path} cannot be written ({reason.strerror}); choose another name.")
