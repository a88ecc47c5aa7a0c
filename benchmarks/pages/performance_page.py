# SPDX-License-Identifier: GPL-3.0-or-later
"""The page docs/performance.md and its chart."""

from ...operators.text.numbers import number
from ..rig.measure import BLOCK_MS, BLOCKS, RUNS, SHORT_BLOCKS, SHORT_MS, BenchmarkRow
from .goals import ANY_SIZE, ATTEMPTS, ROWS, SLACK, excess, goal_of, known_ratio
from .plot import write_bars

PAGE = "performance.md"
BARS = "images/performance_frame.svg"
MOSAICS = (  # measured by hand: hours would be too long for the benchmark
    "A tenth of a mosaic of 100,352 x 100,352 samples was imported once, outside this run: "
    "[0.21 µs of processor time a sample](howto/large-mosaic.md#large-imports), estimated 35 min for all of it; on a "
    "busy machine, 16 of its files took 0.31 µs a sample. The "
    "[first picture](howto/first-picture.md#times) took 20-29 s."
)
# The six rows of the page.
HEADLINES = {
    ("frame", 1_000_000): "A frame: the camera moves, and Blender has the mesh",
    ("still", 1_000_000): "An update while the camera stands still",
    ("surface", 1_000_000): "An update without Blender, on all threads",
    ("refine_error", 1_000_000): "Its refinement alone, on one thread",
    ("same_picture", ANY_SIZE): "A picture in Cycles that is as good as its own dicing at 1 px, processor time",
    ("import", ANY_SIZE): "Import of a GeoTIFF; triangles: its samples",
}


def documents(rows: list[BenchmarkRow], machine: dict[str, str], notes: list[str]) -> dict[str, str]:
    """Return the text of every file by its name in the folder of pages."""
    return {BARS: write_bars(rows), PAGE: page(rows, machine, notes)}


def page(rows: list[BenchmarkRow], machine: dict[str, str], notes: list[str]) -> str:
    """Return the page: six rows, the chart of a frame, every missed goal, and the method."""
    parts = [
        "# Performance",
        'Written by `make bench BENCH="--with-cycles --docs docs --blender COMMAND"`; do not edit it by hand. Times '
        "are of one machine on one day. Compare the ratios: ours and the baselines alternated in one run.",
        ", ".join(f"{name} {value}" for name, value in machine.items()) + ".",
        "## Six rows",
        headlines(rows),
        f"The run measured {len(rows)} rows. `adaptive-terrain bench --json FILE` writes them all, with their steps. "
        f"{MOSAICS}",
        "## Time of a frame by step",
        f"![Milliseconds of each step of a frame]({BARS})",
        "## Missed goals",
        misses(rows),
        "## Method",
        f"A time is the median of {BLOCKS * RUNS} runs; ours and the baseline alternate in blocks of {RUNS} runs, or "
        f"of fewer that take {BLOCK_MS / 1e3:g} s together. It is the median of {SHORT_BLOCKS * RUNS} runs where one "
        f"takes less than {SHORT_MS:g} ms, and of nine where each is a process or a render. The ratio is our time (or "
        "memory, or triangles) divided by the baseline's.",
        "`roam_rebuild` is a serial C bintree (`benchmarks/rig/roam_rebuild.c`, `-O3 -march=native`) that rebuilds the "
        "whole refinement from its roots on one thread. `plain_ingest` gives Blender the same arrays as attributes "
        "with `foreach_set`, computes edges with `update(calc_edges=True)`, and evaluates the mesh.",
        f"`bench --quick` fails if a ratio is more than {SLACK:g} times its goal, or {SLACK:g} times the known ratio "
        f"(`benchmarks/pages/goals.py`) of a row that misses it, in each of {ATTEMPTS} attempts.",
    ]
    if notes:
        parts += ["## Left out", "\n".join(f"* {note}" for note in notes)]
    return "\n\n".join(parts) + "\n"


def headlines(rows: list[BenchmarkRow]) -> str:
    """Return the table of the six rows, as far as they were measured."""
    lines = ["| | triangles | ms | baseline | ms | ratio | goal |", "| --- | ---: | ---: | --- | ---: | ---: | ---: |"]
    for (name, size), title in HEADLINES.items():
        row = next((row for row in rows if row.name == name and size in (row.size, ANY_SIZE)), None)
        if row is not None:
            lines.append(f"| {title} | {row.size:,} | {' | '.join(_cells(row))} |")
    return "\n".join(lines)


def _cells(row: BenchmarkRow) -> list[str]:
    """Return time, baseline and its time, ratio and goal."""
    goal = goal_of(row.name, row.size)
    known = row.ratio is not None
    ratio, goal_text = f"{row.ratio:.3g}" if known else "", "" if goal is None else f"{goal:g}"
    return [number(row.ms), (row.baseline or "") if known else "", number(row.baseline_ms), ratio, goal_text]


def misses(rows: list[BenchmarkRow]) -> str:
    """Return the table of rows that miss their goals, with the known ratio of those that miss them by far."""
    lines = ["| row | size | ratio | goal | known ratio |", "| --- | ---: | ---: | ---: | ---: |"]
    missed = [row for row in rows if excess(row) is not None]
    for row in missed:
        known = known_ratio(row.name, row.size)
        cells = [row.name, f"{row.size:,}", f"{row.ratio:.3g}", f"{goal_of(row.name, row.size):g}"]
        lines.append(f"| {' | '.join([*cells, '' if known is None else f'{known:g}'])} |")
    sentences = [f"* `{name}`: {ROWS[name].sentence}" for name in dict.fromkeys(row.name for row in missed)]
    return "\n".join([*lines, "", *sentences]) if missed else "None."
