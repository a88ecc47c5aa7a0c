# SPDX-License-Identifier: GPL-3.0-or-later
"""The page docs/performance.md, its appendix with every row, its chart, and the rows as JSON."""

import json

from ...operators.text.numbers import number
from ..rig.measure import BLOCK_MS, BLOCKS, RUNS, SHORT_BLOCKS, SHORT_MS, BenchmarkRow
from .goals import ANY_SIZE, ATTEMPTS, ROWS, SLACK, excess, goal_of, known_ratio
from .plot import write_bars
from .report import as_json

PAGE, TABLE, DATA = "performance.md", "performance_table.md", "performance.json"
BARS = "images/performance_frame.svg"
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
    content = {"machine": machine, "notes": notes, "rows": [as_json(row) for row in rows]}
    return {
        BARS: write_bars(rows),
        PAGE: page(rows, machine),
        TABLE: appendix(rows, machine, notes),
        DATA: json.dumps(content, indent=1, allow_nan=False) + "\n",
    }


def page(rows: list[BenchmarkRow], machine: dict[str, str]) -> str:
    """Return the page: six rows, the chart of a frame, and every missed goal."""
    parts = [
        "# Performance",
        'Written by `make bench BENCH="--with-cycles --docs docs --blender COMMAND"`; do not edit it by hand. Times '
        "are of one machine on one day. Compare the ratios: ours and the baselines alternated in one run.",
        machine_line(machine),
        "## Six rows",
        headlines(rows),
        f"[Every row]({TABLE}) explains the baselines and lists all {len(rows)} measurements; [{DATA}]({DATA}) holds "
        "them as data.",
        "## Time of a frame by step",
        f"![Milliseconds of each step of a frame]({BARS})",
        "## Missed goals",
        misses(rows),
    ]
    return "\n\n".join(parts) + "\n"


def appendix(rows: list[BenchmarkRow], machine: dict[str, str], notes: list[str]) -> str:
    """Return the appendix: the method, and every row with its goal, its steps and its other figures."""
    parts = [
        "# Performance: every row",
        f"Appendix of [Performance]({PAGE}), written by the same run; do not edit it by hand.",
        machine_line(machine),
        "## Method",
        f"A time is the median of {BLOCKS * RUNS} runs; ours and the baseline alternate in blocks of {RUNS} runs, or "
        f"of fewer that take {BLOCK_MS / 1e3:g} s together. It is the median of {SHORT_BLOCKS * RUNS} runs where one "
        f"takes less than {SHORT_MS:g} ms, and of nine where each is a process or a render. *First* is the first run, "
        "which finds cold memory and is in no median. The ratio is our time (or memory, or triangles) divided by the "
        "baseline's.",
        "`roam_rebuild` is a serial C bintree (`benchmarks/rig/roam_rebuild.c`, `-O3 -march=native`) that rebuilds the "
        "whole refinement from its roots on one thread. `plain_ingest` gives Blender the same arrays as attributes "
        "with `foreach_set`, computes edges with `update(calc_edges=True)`, and evaluates the mesh.",
        "## Rows",
        "\n".join(f"* `{name}`: {ROWS[name].sentence}" for name in dict.fromkeys(row.name for row in rows)),
        "## Results",
        table(rows),
        f"`bench --quick` fails if a ratio is more than {SLACK:g} times its goal, or {SLACK:g} times the known ratio "
        f"(`benchmarks/pages/goals.py`) of a row that misses it, in each of {ATTEMPTS} attempts.",
        "## Steps",
        "Milliseconds of a frame, medians of each step.",
        pairs_table(rows, "steps", "steps, ms"),
        "## Other figures",
        pairs_table(rows, "figures", ""),
    ]
    if notes:
        parts += ["## Left out", "\n".join(f"* {note}" for note in notes)]
    return "\n\n".join(parts) + "\n"


def machine_line(machine: dict[str, str]) -> str:
    """Return the machine and the versions of programs in one line."""
    return ", ".join(f"{name} {value}" for name, value in machine.items()) + "."


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


def table(rows: list[BenchmarkRow]) -> str:
    """Return the table of all rows."""
    lines = [
        "| row | size | first | ms | baseline | ms | ratio | goal | |",
        "| --- | ---: | ---: | ---: | --- | ---: | ---: | ---: | --- |",
    ]
    for row in rows:
        missed = excess(row)
        verdict = "" if row.ratio is None else "met" if missed is None else f"missed by {missed:.0%}"
        cells = [row.name, f"{row.size:,}", number(row.first_ms), *_cells(row), verdict]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def misses(rows: list[BenchmarkRow]) -> str:
    """Return the table of rows that miss their goals, with the known ratio of those that miss them by far."""
    lines = ["| row | size | ratio | goal | known ratio |", "| --- | ---: | ---: | ---: | ---: |"]
    for row in rows:
        if excess(row) is not None:
            known = known_ratio(row.name, row.size)
            cells = [row.name, f"{row.size:,}", f"{row.ratio:.3g}", f"{goal_of(row.name, row.size):g}"]
            lines.append(f"| {' | '.join([*cells, '' if known is None else f'{known:g}'])} |")
    return "\n".join(lines) if len(lines) > 2 else "None."


def pairs_table(rows: list[BenchmarkRow], attribute: str, head: str) -> str:
    """Return a table of named numbers, a line for each row."""
    lines = [f"| row | size | {head} |", "| --- | ---: | --- |"]
    for row in rows:
        if pairs := getattr(row, attribute):
            numbers = ", ".join(f"{name} {number(value)}" for name, value in pairs.items())
            lines.append(f"| {row.name} | {row.size:,} | {numbers} |")
    return "\n".join(lines)
