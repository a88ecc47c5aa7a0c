# SPDX-License-Identifier: GPL-3.0-or-later
"""Plots of a report about accuracy: error against time and against triangles, and which settings nothing beats.

A row is one measured setting. It is fitted if its vertices were moved off the surface to save triangles; such a fit is
made once, not for each frame, so it has no time that compares with others. It is plain if only its error limits the
mesh: no meshlets, limit of depth, fitted vertices or geomorph. `cost` is "ms" or "triangles".
"""

import math
from operator import attrgetter
from typing import TYPE_CHECKING

from ...cbt_terrain.accuracy.sweep_settings import Setting
from ...cbt_terrain.field.heightfield import INTERPOLATIONS
from ...cbt_terrain.view.criterion import LARGEST
from ..text.log_plot import CROSS, RING, Curve, draw
from ..text.page_blocks import Plot
from ..text.svg import BLUE, GOLD, GREEN, INK, PURPLE, RED, SOFT, TEAL

if TYPE_CHECKING:
    from ...cbt_terrain.accuracy.rows import Row

SPREAD = " Processor time of all threads. Pale bars: from the fastest to the slowest run."
UNIT_NAMES = {"px": "pixels on screen", "m": "metres of height"}


def error_plots(subject, unit: str, current: "Row | None") -> list[Plot]:
    """Return plots of error against time, unless times are not steady, and against triangles.

    subject: an AccuracySubject. unit: "px" or "m". current: row of the scene's own setting. Fitted rows are in no plot
    of times.
    """
    from ...cbt_terrain.accuracy.rows import unsteady_row

    rows = [row for row in subject.rows if row.setting.unit == unit]
    found = []
    for cost, axis in (("ms", "ms of CPU to the finished mesh"), ("triangles", "triangles")):
        if cost == "ms" and unsteady_row(rows) is not None:
            continue
        shown = [row for row in rows if cost == "triangles" or not row.setting.fitted]
        drawing = draw(plot_curves(shown, cost, current), axis, f"error, {unit}")
        caption = f"{subject.title}: error in {UNIT_NAMES[unit]} against {axis}, both logarithmic."
        caption += SPREAD if cost == "ms" else ""
        found.append(Plot(f"{subject.name}_{unit}_{cost}.svg", caption, drawing))
    return found


def plot_curves(rows: "list[Row]", cost: str, current: "Row | None") -> list[Curve]:
    """Return the curves of a plot of rows of one unit, one row at least; `cost` is "ms" or "triangles".

    The first row must have the interpolation of the terrain; plain rows of the other interpolation get one curve.
    Curves without points are in the result: `draw` leaves them out. current: row to mark if it is in `rows`, or None.
    """

    def points(candidates: "list[Row]", error) -> list[tuple[float, float]]:
        """Return (cost, error) of rows for a curve, the coarsest first. error: function of a row."""
        coarse_first = sorted(candidates, key=lambda row: -row.setting.error)
        return [(cost_of(row, cost), error(row)) for row in coarse_first]

    def bound(row: "Row") -> float:
        """Return the bound of a row, infinity if it has none."""
        return row.bound if row.bound < LARGEST else math.inf  # not drawn

    measured, interpolation = attrgetter("error"), rows[0].setting.interpolation
    all_plain = [row for row in rows if row.setting.is_plain]
    plain = [row for row in all_plain if row.setting.interpolation == interpolation]
    other = [row for row in all_plain if row.setting.interpolation != interpolation]
    fitted = [row for row in rows if row.setting.fitted]
    other_name = other[0].setting.interpolation if other else ""
    front = pareto_rows(rows, cost)
    # spans: from the fastest to the slowest run of each point, drawn beside it.
    found = [
        Curve("requested", SOFT, points(plain, lambda row: row.setting.error), dash="2 4"),
        Curve("bound", TEAL, points(plain, bound)),
        Curve("measured", RED, points(plain, measured), spans=time_spreads(plain, cost)),
        Curve(f"{other_name}, measured", PURPLE, points(other, measured)),
        Curve("fitted, bound", BLUE, points(fitted, bound), dash="7 4"),
        Curve("fitted, measured", GREEN, points(fitted, measured)),
        Curve("meshlets, measured", BLUE, points([r for r in rows if r.setting.meshlet], measured), joined=False),
        Curve("less depth, measured", GOLD, points([r for r in rows if r.setting.max_depth], measured), joined=False),
        Curve("Pareto front", INK, [(cost_of(r, cost), r.error) for r in front], joined=False, marker=RING),
    ]
    if current in rows:
        found.append(
            Curve(
                f"current, {setting_label(current.setting)}",
                INK,
                points([current], measured),
                joined=False,
                marker=CROSS,
            )
        )
    return found


def time_spreads(rows: "list[Row]", cost: str) -> list[tuple[float, float]]:
    """Return the fastest and the slowest time of each row in the order of its curve; [] for triangles.

    A row without a spread has its time twice.
    """
    coarse_first = sorted(rows, key=lambda row: -row.setting.error)
    return [row.spread_ms or (row.cost_ms, row.cost_ms) for row in coarse_first] if cost == "ms" else []


def pareto_rows(rows: "list[Row]", cost: str) -> "list[Row]":
    """Return the rows that no other row of the same interpolation beats in both error and cost.

    rows: of one unit. cost: "ms" or "triangles". Interpolations are different surfaces, whose errors do not
    compare. Fitted rows have no time. Rows that switch geomorph on or off (`morph` is not None) are left out, because
    its purpose is not a smaller error.
    """
    from ...cbt_terrain.accuracy.rows import pareto

    found, rows = [], [row for row in rows if row.setting.morph is None]
    for name in dict.fromkeys(row.setting.interpolation for row in rows):
        candidates = [r for r in rows if r.setting.interpolation == name]
        candidates = [r for r in candidates if cost == "triangles" or not r.setting.fitted]
        found += [candidates[i] for i in pareto([(row.error, cost_of(row, cost)) for row in candidates])]
    return found


def cost_of(row: "Row", cost: str) -> float:
    """Return the cost of a row. cost: "ms" or "triangles"."""
    return row.cost_ms if cost == "ms" else float(row.triangles)


def setting_label(setting: Setting) -> str:
    """Return a setting as text, such as `1 px, depth 15` or `4 m, fitted`.

    Its `morph` is above 1 with geomorph, 1 without, and None if it is as in the rest of the sweep.
    """
    parts = [f"{setting.error:g} {setting.unit}"]
    parts += [f"depth {setting.max_depth}"] if setting.max_depth else []
    parts += [f"meshlet {setting.meshlet}"] if setting.meshlet else []
    parts += ["smooth" if setting.morph > 1 else "not smooth"] if setting.morph is not None else []
    parts += [setting.interpolation] if setting.interpolation != INTERPOLATIONS[0] else []
    return ", ".join([*parts, "fitted"] if setting.fitted else parts)
