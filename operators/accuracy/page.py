# SPDX-License-Identifier: GPL-3.0-or-later
"""What `accuracy` writes: one table as CSV and JSON, and the same pages as HTML and Markdown, with their plots.

A subject is one terrain with its measured rows. A row is one setting, such as an error of 1 pixel, with the bound that
it guarantees, the measured errors, and the cost in triangles, time and memory.
"""

import csv
import io
import json

from ...cbt_terrain.accuracy.rows import STEPS, TERMS, Row, curve_of, curve_rows, unsteady_row, unsteady_text
from ...cbt_terrain.accuracy.sweep_settings import Setting
from ...cbt_terrain.field.heightfield import INTERPOLATIONS
from ...cbt_terrain.view.criterion import LARGEST
from ..text.numbers import number
from ..text.page_blocks import (
    Figures,
    Heading,
    Lead,
    PagePicture,
    PictureStrip,
    Plot,
    Table,
    Text,
    Words,
    as_html,
    as_markdown,
)
from ..text.png import png
from ..text.shown_bounds import bound_text, limit_text
from .land_section import land_section
from .plots import error_plots, pareto_rows, setting_label
from .subject import AccuracySubject
from .transitions_section import transitions_section
from .words import WORDS

TITLE = "What accuracy costs"
# Part of a time within which two measurements of the same differ.
NOISE = 0.05
# Errors in pixels that the strip shows, where they were measured.
STRIP_PX = (4.0, 2.0, 1.0, 0.5)


def report_files(subjects, machine: dict[str, str]) -> dict[str, str | bytes]:
    """Return the content of every file of a report by its name: text, or the bytes of a PNG.

    subjects: measured AccuracySubjects, each with a row at least. machine: texts about the computer by name.
    """
    title, blocks = title_of(subjects), build_page(subjects, machine)
    return pictures(blocks) | {
        "accuracy.csv": as_csv(subjects),
        "accuracy.json": as_json(subjects, machine),
        "accuracy.md": as_markdown(title, blocks),
        "index.html": as_html(title, blocks),
    }


def pictures(blocks: list) -> dict[str, str | bytes]:
    """Return the files that a page's Markdown links to, by name: plots as SVG text, pictures as PNG bytes."""
    drawn = {block.name: block.svg for block in blocks if isinstance(block, Plot)}
    return drawn | {p.name: p.png for block in blocks if isinstance(block, PictureStrip) for p in block.pictures}


def title_of(subjects) -> str:
    """Return the title of a report: the names of its terrains."""
    return " and ".join(subject.title for subject in subjects)


def as_csv(subjects) -> str:
    """Return a CSV with a head and a line for each measured row, one at least; figures that are None are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    lines = [{"terrain": subject.name} | row.figures() for subject in subjects for row in subject.rows]
    writer.writerow(lines[0])
    writer.writerows(line.values() for line in lines)
    return text.getvalue()


def as_json(subjects, machine: dict[str, str]) -> str:
    """Return the report as JSON, with the cost curves and all figures of each row.

    subjects: measured terrains. machine: texts about the computer by name.
    """
    terrains = [
        {
            "name": s.name,
            "height_field": str(s.heights.key),
            "seen": s.seen,
            "frames": s.frame_numbers,
            "current": None if s.current is None else setting_label(s.current),
            "notes": s.notes + timing_notes(s),
            "curves": [json.loads(curve.to_json()) for curve in cost_curves(s)],
            "rows": [row.figures() for row in s.rows],
        }
        for s in subjects
    ]
    content = {"generator": "Adaptive Terrain", "machine": machine, "terrains": terrains}
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def build_page(subjects, machine: dict[str, str]) -> list:
    """Return the page as blocks: figures and plots of all terrains first, then their tables, definitions last.

    subjects: measured terrains. machine: texts about the computer by name.
    """
    several, blocks = len(subjects) > 1, []
    for subject in subjects:
        blocks += [Heading(subject.title)] if several else []
        blocks += front_blocks(subject)
    for subject in subjects:
        blocks += table_blocks(subject, f" of {subject.title}" if several else "")
    return [*blocks, Heading("What the words mean"), Words(WORDS), measured_on(machine)]


def measured_on(machine: dict[str, str]) -> Text:
    """Return the machine and the versions of programs in one sentence."""
    return Text("Measured on: " + ", ".join(f"{name} {value}" for name, value in machine.items()) + ".")


def front_blocks(subject: AccuracySubject) -> list:
    """Return the first part of one terrain's page: five figures, pictures, sentences on costs, plots and notes.

    The figures are those of the current setting if it was measured, or else of the first setting that is an error only
    (`is_plain`), or else of the first row.
    """
    rows = subject.rows
    current = next((row for row in rows if row.setting == subject.current), None)
    shown = current or next((row for row in rows if row.setting.is_plain), rows[0])
    numbers = subject.frame_numbers
    frames = f", frame{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"
    lattice = subject.heights.lattice
    across, up = (lattice.width - 1) * lattice.step_x, (lattice.height - 1) * lattice.step_y
    blocks = [
        Lead(
            f"{across:,.0f} x {up:,.0f} m of ground from {lattice.width:,} x {lattice.height:,} samples, seen "
            f"{subject.seen}{frames if numbers else ''}."
        ),
        Figures(main_figures(shown)),
        *picture_strip(subject),
        *(Text(sentence) for sentence in cost_sentences(subject)),
    ]
    for unit in by_unit(rows):
        blocks += error_plots(subject, unit, current)
    return blocks + [Text(note) for note in subject.notes + timing_notes(subject)]


def main_figures(row: Row) -> list[tuple[str, str]]:
    """Return (value, meaning) of the five main figures of one setting."""
    unit = row.setting.unit
    return [
        (f"{row.triangles:,}", "triangles"),
        (f"{row.whole_ms:.3g} ms", "a frame, from the camera to the finished mesh"),
        (bound_text(row.bound, unit), f"the bound, for {setting_label(row.setting)} requested"),
        (f"{row.error:.3g} {unit}", "the largest error that was measured"),
        (f"{row.surface_mb:.3g} MB", "the mesh in memory"),
    ]


def picture_strip(subject: AccuracySubject) -> list[PictureStrip | Text]:
    """Return pictures of the same part of the view at several errors, with the cost of each; [] if none were drawn.

    The pictures are `subject.crops`, whose errors are those of `strip_rows`.
    """
    costs = {row.setting.error: row for row in strip_rows(subject)}
    shown = [
        PagePicture(
            f"{subject.name}_{crop.error_px:g}px.png",
            f"{costs[crop.error_px].triangles:,} triangles, {costs[crop.error_px].whole_ms:.3g} ms a frame",
            f"{crop.error_px:g} px",
            png(crop.pixels),
        )
        for crop in subject.crops
    ]
    numbers = subject.frame_numbers
    where = f"frame {numbers[0]}" if numbers else "the picture"
    text = (
        f"The part of {where} in which these errors differ most, pixel by pixel. The edges of the triangles are drawn "
        f"in its lower left half.{' Triangles and times are medians of all frames.' if numbers[1:] else ''}"
    )
    return [PictureStrip(shown), Text(text)] if shown else []


def strip_rows(subject: AccuracySubject) -> list[Row]:
    """Return the rows that the strip shows in pictures, the coarsest first."""
    plain = {row.setting: row for row in subject.rows if row.setting.is_plain}
    settings = [Setting("px", error, interpolation=subject.heights.interpolation) for error in STRIP_PX]
    return [plain[setting] for setting in settings if setting in plain]


def table_blocks(subject: AccuracySubject, of: str) -> list:
    """Return the second part of one terrain's page: all figures as tables.

    of: " of NAME" for headings if the page has several terrains, else "".
    """
    from ...cbt_terrain.accuracy.interpolation import interpolation

    heights, rows = subject.heights, subject.rows
    relief = heights.max_height - heights.min_height
    origin = heights.provenance
    source = f" (from {origin['format']}, {origin['stored']})" if {"format", "stored"} <= set(origin) else ""
    several = (
        " Of several frames errors are the largest, triangles and times the median."
        if subject.frame_numbers[1:]
        else ""
    )
    between = interpolation(heights)  # statistics of the distances between the two interpolated surfaces, metres
    return [
        Heading(f"Every row{of}"),
        Text(f"{relief:,.5g} m from the lowest to the highest{source}.{several}"),
        Text(
            f"Errors are those against the {heights.interpolation} surface through the samples, of rows marked "
            f"{other_interpolation(heights)} against that one; between samples the two are up to {between.max:.3g} m "
            f"apart (95 % of places within {between.p95:.3g} m)." + source_rounding_text(heights)
        ),
        overview_table(rows, subject.current),  # current: the terrain's own setting, which the table marks, or None
        Heading(f"What the errors{of} are made of"),
        *error_tables(rows),
        Heading(f"Where the time{of} goes"),
        steps_table(rows),
        *transitions_section(rows, of, f"{subject.name}_popping.svg"),
        *land_section(heights, of),
    ]


def other_interpolation(heights) -> str:
    """Return the interpolation that only some rows of a sweep use: the one that the terrain does not."""
    return next(name for name in INTERPOLATIONS if name != heights.interpolation)


def source_rounding_text(heights) -> str:
    """Describe the rounding of the source, "" if there is none."""
    if not heights.source_max:
        return ""
    return f" The source's own rounding may have moved the surface by up to {heights.source_max:.2g} m."


def cost_curves(subject: AccuracySubject) -> list:
    """Return the cost curve of each unit that has two errors or more in its `curve_rows`, and steady times."""
    steady = [rows for rows in by_unit(subject.rows).values() if unsteady_row(rows) is None]
    return [curve_of(rows) for rows in steady if len({row.setting.error for row in curve_rows(rows)}) > 1]


def by_unit(rows: list[Row]) -> dict[str, list[Row]]:
    """Return the rows of a sweep by the unit of their error, "px" or "m"."""
    units = dict.fromkeys(row.setting.unit for row in rows)
    return {unit: [row for row in rows if row.setting.unit == unit] for unit in units}


def timing_notes(subject: AccuracySubject) -> list[str]:
    """Return a sentence for each unit whose cost curve is left out because its times were not steady."""
    notes = []
    for unit, rows in by_unit(subject.rows).items():
        if (row := unsteady_row(rows)) is not None:
            reason = unsteady_text(setting_label(row.setting), row.spread_ms)
            notes.append(f"The curve of errors in {unit} against time is left out: {reason}")
    return notes


def cost_sentences(subject: AccuracySubject) -> list[str]:
    """Return a text for each cost curve: the cost of half the error, and what twice the error saves.

    The error is the current setting's if that has the curve's unit, or else the one in the middle of the sweep.
    """
    text = []
    for curve in cost_curves(subject):  # whose errors fall
        unit, error = curve.unit, curve.error[len(curve.error) // 2]
        if subject.current is not None and subject.current.unit == unit:
            error = subject.current.error
        (coarse, coarse_ms), (triangles, ms), (fine, fine_ms) = (curve.at(error * factor) for factor in (2, 1, 0.5))
        text.append(
            f"Halving the error from {error:g} {unit} to {error / 2:g} {unit} costs "
            f"{difference_text(fine_ms - ms, ms)} and {fine - triangles:,.0f} triangles; doubling it "
            f"to {error * 2:g} {unit} saves {difference_text(ms - coarse_ms, ms)} and "
            f"{triangles - coarse:,.0f} triangles."
        )
        if not curve.error[-1] <= error / 2 < error * 2 <= curve.error[0]:
            text[-1] += " Part of that is extrapolated: it lies beyond what was measured."
    return text


def difference_text(difference_ms: float, whole_ms: float) -> str:
    """Describe a difference of times; one within the noise of a measurement gets no number.

    difference_ms: below 0 if the finer error was measured to be faster, which is noise, too. whole_ms: the measured
    time, of which NOISE is the noise.
    """
    return f"{difference_ms:.3g} ms of CPU" if difference_ms > NOISE * whole_ms else "no measurable time"


def overview_table(rows: list[Row], current: Setting | None) -> Table:
    """Return the table of all settings: bound, measured error, cost, and which Pareto fronts each is on.

    Each unit has a front of triangles, and one of times if these are steady. current: the setting to mark, or None.
    """
    fronts = {}
    for of_unit in by_unit(rows).values():
        for cost in ("triangles",) if unsteady_row(of_unit) else ("ms", "triangles"):
            front = pareto_rows(of_unit, cost)
            fronts[cost] = fronts.get(cost, []) + [row.setting for row in front]
    head = ["setting", "bound", "measured", "measured / requested", "triangles", "ms", "mesh, MB", "buffers, MB"]
    lines = []
    for row in rows:
        unit, name = row.setting.unit, setting_label(row.setting) + (" (current)" if row.setting == current else "")
        fronts_text = ", ".join(cost for cost, settings in fronts.items() if row.setting in settings)
        numbers = [bound_text(row.bound, unit), f"{number(row.error)} {unit}", f"{row.error / row.setting.error:.2f}"]
        numbers += [f"{row.triangles:,}", number(row.whole_ms), number(row.surface_mb), number(row.buffers_mb)]
        # row.limited: names of the limits, such as max_triangles, that made the bound exceed the requested error.
        lines.append([name, *numbers, limit_text(*row.limited), fronts_text])
    return Table([*head, "held back by", "Pareto front"], lines)


def error_tables(rows: list[Row]) -> list[Table]:
    """Return tables of the terms of the bound and of all measured errors.

    These are height, screen, silhouette, popping, normals and rounding. Errors on screen have a table, of the rows with
    a view, only if there are such rows.
    """
    blocks = [bound_table(rows)]
    on_screen = [row for row in rows if row.measured.screen_px is not None]
    if on_screen:
        names = ("screen_px", "hidden_px", "silhouette_px", "popping_px")
        head = ["pixels", "visible: max", "p95", "mean", "hidden: max", "silhouette: max", "p95", "popping: max", "p95"]
        lines = []
        for row in on_screen:
            seen, hidden, outline, popped = (getattr(row if n == "popping_px" else row.measured, n) for n in names)
            # The last three are None where they were not measured.
            cells = [seen.max, seen.p95, seen.mean, *(part and part.max for part in (hidden, outline))]
            cells += [outline and outline.p95, popped and popped.max, popped and popped.p95]
            lines.append([setting_label(row.setting), *map(number, cells)])
        blocks.append(Table(head, lines))
    head = ["metres, degrees", "height: max", "p95", "rms", "rounding: max", "faces: p95", "max", "shading: p95", "max"]
    lines = []
    for row in rows:
        m = row.measured
        cells = [m.vertical_max_m, m.vertical_m.p95, m.vertical_m.rms, m.rounding_m]
        cells += [m.facet_deg.p95, m.facet_deg.max, m.shading_deg.p95, m.shading_deg.max]
        lines.append([setting_label(row.setting), *map(number, cells)])
    return [*blocks, Table(head, lines)]


def bound_table(rows: list[Row]) -> Table:
    """Return the table of the terms of each bound, at the leaf with the largest one; empty cells without a bound."""
    head = ["parts of the bound", "in all", *TERMS, "measured, of the bound"]
    lines = []
    for row in rows:
        bounded = row.bound < LARGEST
        parts = [getattr(row.terms, part, None) if bounded else None for part in TERMS]
        used = f"{row.error / row.bound:.0%}" if row.bound and bounded else ""
        lines.append([setting_label(row.setting), bound_text(row.bound, row.setting.unit), *map(number, parts), used])
    return Table(head, lines)


def steps_table(rows: list[Row]) -> Table:
    """Return the table of milliseconds: processor time, time to the finished mesh, that of the engine, and by step.

    A step that no row took has no column.
    """
    steps = [step for step in STEPS if any(row.ms.get(step) for row in rows)]
    lines = []
    for row in rows:
        times = [row.cpu_ms, row.whole_ms, row.ms["total"], *(row.ms.get(step) for step in steps)]
        lines.append([setting_label(row.setting), *map(number, times)])
    return Table(["ms", "CPU", "finished mesh", "engine", *steps], lines)


def row_line(row: Row) -> str:
    """Describe one row in a line for the terminal."""
    unit = row.setting.unit
    return (
        f"{setting_label(row.setting)}: bound {bound_text(row.bound, unit)}, measured {row.error:.3g} {unit}, "
        f"{row.triangles:,} triangles, {row.whole_ms:.3g} ms"
    )
