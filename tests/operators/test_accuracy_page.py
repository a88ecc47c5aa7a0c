# SPDX-License-Identifier: GPL-3.0-or-later
"""What a report's tables and plots show of known rows."""

import dataclasses
import math
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from accuracy_rows import known_rows
from adaptive_terrain.cbt_terrain.accuracy.sweep_settings import Setting
from adaptive_terrain.cbt_terrain.ask.criterion import LARGEST
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.refine.terms import Terms
from adaptive_terrain.operators.report import accuracy_page, accuracy_plots
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
    assert curves[f"current, {accuracy_plots.label(rows[0].setting)}"].points[0][1] == rows[0].error
    assert "bicubic, measured" not in curves or curves["bicubic, measured"].points == []
    smooth = dataclasses.replace(rows[0], setting=dataclasses.replace(rows[0].setting, interpolation="bicubic"))
    curves = {curve.label: curve for curve in accuracy_plots.plot_curves([*rows, smooth], cost, rows[0])}
    assert [y for _, y in curves["bicubic, measured"].points] == [smooth.error]
    assert accuracy_plots.label(smooth.setting).endswith(", bicubic")
    plain = curves["measured"].points
    assert [y for _, y in plain] == [row.error for row in rows if row.setting.plain]
    assert [x for x, _ in curves["asked"].points] == [x for x, _ in plain]


def test_each_interpolation_has_a_pareto_front_of_its_own():
    """Errors against another surface do not compare, however small."""
    rows = [row for row in known_rows() if row.setting.unit == "px"]
    smooth = dataclasses.replace(rows[0].setting, interpolation="bicubic")
    better = dataclasses.replace(rows[0], setting=smooth, triangles=1, ms={"total": 0.1})
    front = accuracy_plots.pareto_rows([*rows, better], "triangles")
    assert front == [*accuracy_plots.pareto_rows(rows, "triangles"), better]


def test_the_table_says_which_rows_are_on_the_pareto_fronts():
    table = accuracy_page.overview(known_rows(), Setting("px", 2.0))
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


def test_a_mesh_that_may_reach_the_eye_has_no_bound_in_tables_nor_a_point_in_the_plot():
    known = [row for row in known_rows() if row.setting.unit == "px"]
    terms = Terms(0.75 * LARGEST, 0.25 * LARGEST, 0.0, 0.0)
    rows = [dataclasses.replace(known[0], bound_px=LARGEST, terms=terms), *known[1:]]
    assert accuracy_page.overview(rows, None).rows[0][1] == NO_BOUND
    assert accuracy_page.bound_table(rows).rows[0] == ["4 px", NO_BOUND, "", "", "", "", ""]
    assert f"bound {NO_BOUND}, measured 3 px" in accuracy_page.row_line(rows[0])
    bound = next(curve for curve in accuracy_plots.plot_curves(rows, "ms", None) if curve.label == "bound")
    assert [y for _, y in bound.points] == [math.inf, 2.0, 1.0], "infinity is what `draw` leaves out"


def test_the_page_says_what_the_source_has_rounded():
    heights = np.random.default_rng(0).standard_normal((20, 31))
    said = accuracy_page.imported_text(from_array(heights, source_max=0.5))
    assert said.endswith(" may have moved the surface by up to 0.5 m.")
    assert accuracy_page.imported_text(from_array(heights)) == ""


def test_curves_without_a_place_on_logarithmic_axes_are_left_out():
    assert ElementTree.fromstring(draw([Curve("none", "#000", [(0.0, 1.0), (1.0, -1.0)])], "x", "y")).findall("*") == []
    points = [(1.0, 0.0), (10.0, 2.0), (100.0, math.inf), (1000.0, 20.0)]
    plot = ElementTree.fromstring(draw([Curve("a < b", "#000", points)], "x", "y"))
    line = plot.find(f"{SVG}polyline").get("points").split()
    tiny = ElementTree.fromstring(draw([Curve("tiny", "#000", [*points, (5.0, 1e-89)])], "x", "y"))
    assert tiny.find(f"{SVG}polyline").get("points").split() == line
    assert len(line) == 2 and len(plot.findall(f"{SVG}circle")) == 2
    assert {"a < b", "x", "y", "1,000", "10"} <= {text.text for text in plot.iter(f"{SVG}text")}
