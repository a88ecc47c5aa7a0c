# SPDX-License-Identifier: GPL-3.0-or-later
"""What a report's tables and plots show of known rows."""

import dataclasses
import math
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from accuracy_rows import known_rows
from adaptive_terrain.cbt_terrain.accuracy import rows as rows_of_sweep
from adaptive_terrain.cbt_terrain.accuracy.mesh import Errors
from adaptive_terrain.cbt_terrain.accuracy.sweep_settings import Setting
from adaptive_terrain.cbt_terrain.accuracy.timed_runs import TimedFrame
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.refine.terms import Terms
from adaptive_terrain.cbt_terrain.view.criterion import LARGEST
from adaptive_terrain.operators.accuracy import page as accuracy_page
from adaptive_terrain.operators.accuracy import plots as accuracy_plots
from adaptive_terrain.operators.accuracy.subject import AccuracySubject
from adaptive_terrain.operators.accuracy.transitions_section import transitions_section
from adaptive_terrain.operators.text.log_plot import Curve, draw
from adaptive_terrain.operators.text.shown_bounds import NO_BOUND

SVG = "{http://www.w3.org/2000/svg}"


@pytest.mark.parametrize(
    ("unit", "cost", "front"),
    [
        ("px", "ms", [(1.0, 3.0), (2.0, 1.5), (3.0, 0.5)]),
        ("px", "triangles", [(100, 3.0), (400, 1.5), (1600, 0.9), (9000, 0.5)]),
        ("m", "triangles", [(20, 7.5), (50, 7.0)]),
    ],
)
def test_the_plot_rings_the_pareto_front_and_crosses_the_current(unit, cost, front):
    rows = [row for row in known_rows() if row.setting.unit == unit]
    curves = {curve.label: curve for curve in accuracy_plots.plot_curves(rows, cost, rows[0])}
    assert curves["Pareto front"].points == front
    assert curves[f"current, {accuracy_plots.setting_label(rows[0].setting)}"].points[0][1] == rows[0].error
    assert "bicubic, measured" not in curves or curves["bicubic, measured"].points == []
    smooth = dataclasses.replace(rows[0], setting=dataclasses.replace(rows[0].setting, interpolation="bicubic"))
    curves = {curve.label: curve for curve in accuracy_plots.plot_curves([*rows, smooth], cost, rows[0])}
    assert [y for _, y in curves["bicubic, measured"].points] == [smooth.error]
    assert accuracy_plots.setting_label(smooth.setting).endswith(", bicubic")
    plain = curves["measured"].points
    assert [y for _, y in plain] == [row.error for row in rows if row.setting.is_plain]
    assert [x for x, _ in curves["requested"].points] == [x for x, _ in plain]


def test_each_interpolation_has_a_pareto_front_of_its_own():
    """Errors against another surface do not compare, however small."""
    rows = [row for row in known_rows() if row.setting.unit == "px"]
    smooth = dataclasses.replace(rows[0].setting, interpolation="bicubic")
    better = dataclasses.replace(rows[0], setting=smooth, triangles=1, ms={"total": 0.1})
    front = accuracy_plots.pareto_rows([*rows, better], "triangles")
    assert front == [*accuracy_plots.pareto_rows(rows, "triangles"), better]


@pytest.mark.parametrize(("morph", "name"), [(1.5, "smooth"), (1.0, "not smooth")])
def test_a_section_compares_popping_with_and_without_geomorph(morph, name):
    """Whichever way the other rows are; errors of the pair are not mixed up, and it has no part in the fronts."""
    own = dataclasses.replace(known_rows()[0], popping_px=Errors(9, 4.0, 0.0, 3.0, 0.1, 0.2))
    own = dataclasses.replace(own, shading_change=Errors(9, 30.0, 0.0, 3.0, 0.1, 0.2))
    setting = dataclasses.replace(own.setting, morph=morph)
    jumps = Errors(9, 0.04, 0.01, 0.02, 0.01, 0.01)
    other = dataclasses.replace(own, setting=setting, popping_px=jumps, triangles=125, ms={"total": 0.5})
    other = dataclasses.replace(other, shading_change=Errors(9, 2.0, 0.0, 1.0, 0.1, 0.2))
    heading, _, table, plot = transitions_section([own, other, *known_rows()[1:]], " of hills", "a_popping.svg")
    assert heading.text == "What Geomorph of hills saves and costs"
    ratios, jumped = (["1.25", "0.50"], ["4", "0.04"]) if morph > 1 else (["0.80", "2.00"], ["0.04", "4"])
    shaded = ["30", "2"] if morph > 1 else ["2", "30"]
    [line] = table.rows
    assert line[0] == "4 px" and line[1:3] == jumped and line[5:7] == shaded and line[-2:] == ratios
    curves = ElementTree.fromstring(plot.svg).findall(f".//{SVG}text")
    assert {"without, largest", "smooth, 99.9 %"} <= {text.text for text in curves}
    assert accuracy_plots.setting_label(setting) == f"4 px, {name}"
    assert other not in accuracy_plots.pareto_rows([own, other], "ms")
    assert transitions_section(known_rows(), "", "a_popping.svg") == []


def test_the_table_says_which_rows_are_on_the_pareto_fronts():
    table = accuracy_page.overview_table(known_rows(), Setting("px", 2.0))
    least = {line[0]: line[-1] for line in table.rows}
    assert least == {
        "4 px": "ms, triangles",
        "2 px (current)": "ms, triangles",
        "1 px": "triangles",
        "1 px, meshlet 2": "ms, triangles",
        "1 px, depth 9": "",
        "8 m": "ms, triangles",
        "8 m, fitted": "triangles",
    }
    assert table.rows[0][1:6] == ["4 px", "3 px", "0.75", "100", "1"]


def test_an_infinite_bound_is_in_no_table_and_no_plot():
    known = [row for row in known_rows() if row.setting.unit == "px"]
    terms = Terms(0.75 * LARGEST, 0.25 * LARGEST, 0.0)
    rows = [dataclasses.replace(known[0], bound=LARGEST, terms=terms), *known[1:]]
    assert accuracy_page.overview_table(rows, None).rows[0][1] == NO_BOUND
    assert accuracy_page.bound_table(rows).rows[0] == ["4 px", NO_BOUND, "", "", "", ""]
    assert f"bound {NO_BOUND}, measured 3 px" in accuracy_page.row_line(rows[0])
    bound = next(curve for curve in accuracy_plots.plot_curves(rows, "ms", None) if curve.label == "bound")
    assert [y for _, y in bound.points] == [math.inf, 2.0, 1.0], "infinity is what `draw` leaves out"


def test_the_page_says_what_the_source_has_rounded():
    heights = np.random.default_rng(0).standard_normal((20, 31))
    said = accuracy_page.source_rounding_text(from_array(heights, source_max=0.5))
    assert said.endswith(" may have moved the surface by up to 0.5 m.")
    assert accuracy_page.source_rounding_text(from_array(heights)) == ""


def curve_of(plot) -> list[str]:
    """Return the points of the plot's first curve."""
    lines = (line for line in plot.iter(f"{SVG}polyline") if line.get("stroke") == "#000")
    return next(line.get("points") for line in lines if not line.get("stroke-opacity")).split()


def test_a_plot_draws_from_the_fastest_to_the_slowest_run():
    points, spans = [(10.0, 4.0), (100.0, 0.0), (100.0, 1.0)], [(8.0, 14.0), (1.0, 2.0), (80.0, 300.0)]
    plot = ElementTree.fromstring(draw([Curve("ms", "#000", points, spans=spans)], "x", "y"))
    bars = [line.get("points") for line in plot.iter(f"{SVG}polyline") if line.get("stroke-opacity")]
    ends = [[float(place.split(",")[0]) for place in bar.split()] for bar in bars]
    (first, _), (second, _) = ([float(n) for n in place.split(",")] for place in curve_of(plot)[-2:])
    assert len(ends) == 2, "a point without a place has no bar"
    assert ends[0][0] < first < ends[0][1] < ends[1][0] < second < ends[1][1]
    rows = [row for row in known_rows() if row.setting.unit == "px"]
    known = [dataclasses.replace(rows[0], spread_ms=(0.5, 3.0)), *rows[1:]]
    measured = {unit: accuracy_plots.plot_curves(known, unit, None) for unit in ("ms", "triangles")}
    spans = {unit: next(c.spans for c in curves if c.label == "measured") for unit, curves in measured.items()}
    assert spans == {"ms": [(0.5, 3.0), (2.0, 2.0), (5.0, 5.0)], "triangles": []}


def test_the_times_of_a_row_have_their_extremes():
    assert rows_of_sweep.spread_of([3.0, 1.0, 2.0]) == (1.0, 3.0) and rows_of_sweep.spread_of([3.0]) is None


def test_curves_without_a_place_on_logarithmic_axes_are_left_out():
    empty = ElementTree.fromstring(draw([Curve("none", "#000", [(0.0, 1.0), (1.0, -1.0)])], "x", "y"))
    assert not [part for part in empty.iter() if part.tag in (f"{SVG}polyline", f"{SVG}circle", f"{SVG}text")]
    points = [(1.0, 0.0), (10.0, 2.0), (100.0, math.inf), (1000.0, 20.0)]
    plot = ElementTree.fromstring(draw([Curve("a < b", "#000", points)], "x", "y"))
    line = curve_of(plot)
    tiny = ElementTree.fromstring(draw([Curve("tiny", "#000", [*points, (5.0, 1e-89)])], "x", "y"))
    assert curve_of(tiny) == line
    assert len(line) == 2 and len(plot.findall(f"{SVG}circle")) == 2
    assert {"a < b", "x", "y", "1,000", "10"} <= {text.text for text in plot.iter(f"{SVG}text")}


def test_a_time_curve_of_runs_that_disagree_is_left_out():
    rows = [row for row in known_rows() if row.setting.is_plain]
    field = from_array(np.zeros((5, 5), np.float32))
    torn = [dataclasses.replace(rows[0], spread_ms=(10.0, 25.0), cpu_ms=10.0), *rows[1:]]
    subject = AccuracySubject("rough", field, [TimedFrame()], [], "as a whole", None, rows=torn)
    assert accuracy_page.cost_curves(subject) == [] and accuracy_page.cost_sentences(subject) == []
    assert [plot.name for plot in accuracy_plots.error_plots(subject, "px", None)] == ["rough_px_triangles.svg"]
    reason = f"at {accuracy_plots.setting_label(rows[0].setting)} runs of the same update took 10 to 25 ms of CPU"
    files = accuracy_page.report_files([subject], {})
    assert reason in files["accuracy.md"] and reason in files["accuracy.json"] and reason in files["index.html"]
    subject.rows = [dataclasses.replace(rows[0], spread_ms=(10.0, 20.0)), *rows[1:]]
    assert [curve.unit for curve in accuracy_page.cost_curves(subject)] == ["px"]
    assert accuracy_page.timing_notes(subject) == [] and len(accuracy_plots.error_plots(subject, "px", None)) == 2


def test_a_difference_within_the_noise_is_a_plain_sentence():
    assert (
        accuracy_page.difference_text(0.001, 10.0) == accuracy_page.difference_text(-1.0, 10.0) == "no measurable time"
    )
    assert accuracy_page.difference_text(5.0, 10.0) == "5 ms of CPU"


def test_there_is_no_curve_if_the_limit_stopped_all_rows():
    """A sweep in metres of a rough raster of 4097 x 4097 samples: its measurements are written all the same."""
    rows = [row for row in known_rows() if row.setting.is_plain]
    held = [dataclasses.replace(row, limited=("max_triangles",)) for row in rows]
    field = from_array(np.zeros((5, 5), np.float32))
    subject = AccuracySubject("rough", field, [TimedFrame()], [], "as a whole", None, rows=[rows[0], *held[1:]])
    assert accuracy_page.cost_curves(subject) == [] and accuracy_page.cost_sentences(subject) == []
    assert "the triangle limit" in accuracy_page.report_files([subject], {})["accuracy.md"]
    subject.rows = rows
    assert [curve.unit for curve in accuracy_page.cost_curves(subject)] == ["px"]
