# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/performance.md, which fits on one page, its appendix with every row, and the same as data."""

import json

from ...operators.text.numbers import number
from ..rig.measure import BLOCK_MS, BLOCKS, RUNS, SHORT_BLOCKS, SHORT_MS, Row
from . import profiles
from .goals import ANY_SIZE, ATTEMPTS, SLACK, goal_of, missed_by, recorded_of
from .plot import write_bars, write_plot
from .report import MEANING, as_json

PAGE, TABLE, DATA = "performance.md", "performance_table.md", "performance.json"
PLOT, BARS = "images/performance.svg", "images/performance_frame.svg"
# The six rows of the page: what a user waits for.
HEADLINES = {
    ("frame", 1_000_000): "A frame: the camera moves, and Blender has the mesh",
    ("still", 1_000_000): "The camera stands still: to know it",
    ("surface", 1_000_000): "A frame's update without Blender, on all threads",
    ("refine_error", 1_000_000): "Its refinement alone, on one thread",
    ("same_picture", ANY_SIZE): "A picture in Cycles that is as good as its own dicing at 1 px, processor time",
    ("import", ANY_SIZE): "Import of a GeoTIFF; triangles: its samples",
}


def documents(rows: list[Row], machine: dict[str, str], notes: list[str]) -> dict[str, str]:
    """Every file by its name in the folder of documents."""
    content = {"machine": machine, "notes": notes, "rows": [as_json(row) for row in rows]}
    return {
        PLOT: write_plot(rows),
        BARS: write_bars(rows),
        PAGE: page(rows, machine),
        TABLE: appendix(rows, machine, notes),
        DATA: json.dumps(content, indent=1, allow_nan=False) + "\n",
    }


def page(rows: list[Row], machine: dict[str, str]) -> str:
    slopes = {row.name.removeprefix("scale_"): row.ratio for row in rows if row.name.startswith("scale_")}
    said = ", ".join(f"{name} {slope:.2f}" for name, slope in slopes.items())
    parts = [
        "# Performance",
        'Written by `make bench BENCH="--with-cycles --docs docs --blender COMMAND"`; do not edit it by hand. Times '
        "are of one machine on one day. What counts are the ratios: the baselines took turns with ours in one run.",
        machine_line(machine),
        "## Six rows",
        headlines(rows),
        f"[Every row]({TABLE}) says what each baseline is, and has {len(rows)} of them; [{DATA}]({DATA}) is the same "
        "as data.",
        "## Time against triangles",
        f"![Milliseconds against triangles, both logarithmic]({PLOT})",
        f"Slopes (1: proportional): {said}.",
        "## Where a frame's time goes",
        f"![Milliseconds of each step of a frame]({BARS})",
        "## What is missed",
        misses(rows),
    ]
    return "\n\n".join(parts) + "\n"


def appendix(rows: list[Row], machine: dict[str, str], notes: list[str]) -> str:
    parts = [
        "# Performance: every row",
        f"The appendix of [Performance]({PAGE}), written by the same run; do not edit it by hand.",
        machine_line(machine),
        "## How it is measured",
        f"A time is the median of {BLOCKS * RUNS} runs, ours and the baseline in turns of {RUNS}, or of as many as "
        f"take {BLOCK_MS / 1e3:g} s where they take more than {BLOCK_MS / RUNS:g} ms; of "
        f"{SHORT_BLOCKS * RUNS} where a run takes less than {SHORT_MS:g} ms; of nine where each is a process or a "
        "render of its own. *First* is the first run, which finds cold memory; it is in no median. Ratio is ours to "
        "the baseline; for `scale_` it is the slope, for memory the ratio of memory.",
        "`roam_rebuild` is a serial C bintree (`benchmarks/rig/roam_rebuild.c`, `-O3 -march=native`) that rebuilds the "
        "whole refinement from its roots on one thread. `plain_ingest` gives Blender the same arrays as attributes "
        "with `foreach_set`, lets it find the edges with `update(calc_edges=True)`, and has the mesh evaluated.",
        "## Results",
        table(rows),
        f"`bench --quick` fails when a ratio is more than {SLACK:g} times its goal. A row that is known to be beyond "
        f"that (`RECORDED` in `benchmarks/pages/goals.py`) may not be worse than {SLACK:g} times the ratio recorded "
        f"for it. A row that fails is measured again after all others; {ATTEMPTS} failures in a row fail the run.",
        "## Where the time goes",
        "Milliseconds a frame, medians of each step. Of the refinement rows `whole` is all but the surface, with what "
        "Python does around the kernels.",
        pairs_table(rows, "steps", "steps, ms"),
        *profiles.section(profiles.FILE),
        "## Other figures",
        pairs_table(rows, "figures", ""),
        "## What the rows are",
        "\n".join(f"* `{name}`: {MEANING[name]}" for name in dict.fromkeys(row.name for row in rows)),
    ]
    if notes:
        parts += ["## Left out", "\n".join(f"* {note}" for note in notes)]
    return "\n\n".join(parts) + "\n"


def machine_line(machine: dict[str, str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in machine.items()) + "."


def headlines(rows: list[Row]) -> str:
    lines = ["| | triangles | ms | beside | ms | ratio | goal |", "| --- | ---: | ---: | --- | ---: | ---: | ---: |"]
    for (name, size), what in HEADLINES.items():
        row = next((row for row in rows if row.name == name and size in (row.size, ANY_SIZE)), None)
        if row is not None:
            lines.append(f"| {what} | {row.size:,} | {' | '.join(_cells(row))} |")
    return "\n".join(lines)


def _cells(row: Row) -> list[str]:
    """A row's time, its baseline with its time, the ratio, and the goal."""
    goal = goal_of(row.name, row.size)
    known = row.ratio is not None
    ratio, goal_text = f"{row.ratio:.3g}" if known else "", "" if goal is None else f"{goal:g}"
    return [number(row.ms), (row.baseline or "") if known else "", number(row.baseline_ms), ratio, goal_text]


def table(rows: list[Row]) -> str:
    lines = [
        "| row | size | first | ms | baseline | ms | ratio | goal | |",
        "| --- | ---: | ---: | ---: | --- | ---: | ---: | ---: | --- |",
    ]
    for row in rows:
        goal, missed = goal_of(row.name, row.size), missed_by(row)
        verdict = "" if goal is None or row.ratio is None else "met" if missed is None else f"missed by {missed:.0%}"
        cells = [row.name, f"{row.size:,}", number(row.first_ms), *_cells(row), verdict]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def misses(rows: list[Row]) -> str:
    """Each row over its goal with what holds it, as far as that is known."""
    lines = []
    for row in rows:
        part = missed_by(row)
        if part is not None:
            known, goal = recorded_of(row.name, row.size), goal_of(row.name, row.size)
            why = f"Known ({known[0]:g}): {known[1]}" if known else "Not known before this run."
            lines.append(f"* `{row.name}` at {row.size:,}: {row.ratio:.3g} for {goal:g}, {part:.0%} over. {why}")
    return "\n".join(lines) or "Nothing."


def pairs_table(rows: list[Row], attribute: str, head: str) -> str:
    """What rows have under names, in a line each."""
    lines = [f"| row | size | {head} |", "| --- | ---: | --- |"]
    for row in rows:
        if pairs := getattr(row, attribute):
            said = ", ".join(f"{name} {number(value)}" for name, value in pairs.items())
            lines.append(f"| {row.name} | {row.size:,} | {said} |")
    return "\n".join(lines)
