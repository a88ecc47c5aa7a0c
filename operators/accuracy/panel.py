# SPDX-License-Identifier: GPL-3.0-or-later
"""Result and cost of the last update, its measured errors, and the cost of other errors.

`status` describes the last update of the terrain: its mode (VIEWPORT or RENDER, "" before the first update), its
request, the bounds of the mesh, the triangles, and the milliseconds of each step.
"""

import os

from ...cbt_terrain.accuracy.cost_curve import CostCurve
from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.view.criterion import LARGEST, requested_unit
from ...cbt_terrain.view.settings import BOUNDS
from .. import jobs
from ..session import session
from ..text.numbers import SMALLEST, plain
from ..text.shown_bounds import NO_BOUND, bound_text, limit_text
from ..text.translations import phrase
from ..ui.panel_parts import TerrainSubpanel, draw_figures, draw_message, error_lines
from . import measure as measure_accuracy
from . import sweep as sweep_accuracy
from .report import PAGE

TERMS = {
    "geometric": "by triangles",
    "precision": "by precision",
    "source": "by the source",
}
STEPS = {"total": "Engine in all", "mesh": "Into Blender"}


class StatisticsPanel(TerrainSubpanel):
    """Grows and shrinks with what there is to tell, so it is the last panel, and closed until someone asks."""

    bl_idname = "ADAPTIVE_TERRAIN_PT_statistics"
    bl_label = "Accuracy of Last Update"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_advanced"

    def draw(self, context):
        """Draw errors and figures of the last update, measured errors and predicted costs."""
        column = self._columns()
        obj = session.shown_terrain(context)
        status = session.record_of(obj).status
        for text, icon in error_lines(status):
            draw_message(column, text, icon)
        if status.mode and status.request.note:
            draw_message(column, status.request.note, "INFO")
        draw_figures(column, statistics_lines(status))
        if status.mode:
            detail = getattr(obj.adaptive_terrain, measure_accuracy.DETAIL[status.mode])
            self._draw_measured_and_predicted(column, status, detail)
        _draw_measuring(column, "adaptive_terrain.measure_accuracy", "DRIVER_DISTANCE")

    def _draw_measured_and_predicted(self, column, status, detail):
        """Draw the measured errors if they belong to this mesh, and what other errors would cost by the measured curve.

        detail: DetailSettings with the results.
        """
        measured = measure_accuracy.read_measured(detail)
        lines = measured_lines(measured) if measured.get("digest") == status.digest else []
        if lines:
            column.separator()
            draw_figures(column, lines)
        try:
            curve = CostCurve.from_json(detail.curve) if detail.curve else None
        except TerrainError as damaged:
            draw_message(column, str(damaged), "INFO")
            return
        if detail.no_curve:
            draw_message(column, shown(detail.no_curve, 400), "INFO")
        predicted = prediction_lines(status, curve, exact=bool(lines)) if curve else []
        if predicted:
            column.separator()
        for line in predicted:
            column.label(text=line)


class AccuracyReportPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_accuracy_report"
    bl_label = "Accuracy Report"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_statistics"

    def draw(self, context):
        """Draw the folder of reports, the button that writes one, and one that opens it, or why there is no path."""
        column = self._columns()
        obj = session.shown_terrain(context)
        column.prop(obj.adaptive_terrain, "reports")
        _draw_measuring(column, "adaptive_terrain.sweep_accuracy", "GRAPH")
        try:
            page = sweep_accuracy.report_folder(obj) / PAGE
        except TerrainError as error:
            draw_message(column, str(error), "INFO")
            return
        if os.path.isfile(page):  # never raises
            column.operator("wm.path_open", text="Open Report", icon="URL").filepath = str(page)


def _draw_measuring(column, operator: str, icon: str) -> None:
    """Draw the button of a measurement, or the progress of the one that runs. operator: the measurement's bl_idname."""
    job = jobs.find(jobs.MEASURE)
    if job is None:
        column.operator(operator, icon=icon)
    else:
        jobs.draw_progress(column, job)


def _list_bounds(status) -> list[tuple[str, float, str, object]]:
    """Return label, value, unit and terms of every bound of the last update, in the order of BOUNDS.

    Terms are the parts of an error's bound by their cause; None for a bound of edges or areas. Bounds that the update
    does not have are left out.
    """
    bounds = []
    for name, (label, unit) in BOUNDS.items():
        if (value := getattr(status.bounds, name)) is not None:
            terms = getattr(status.bounds, name.replace("bound", "terms"), None)  # terms_px of bound_px
            bounds.append((label, value, unit, terms))
    return bounds


def _bound_label(value: float, unit: str, digits: int) -> str:
    """Return a bound as text, rounded up to a number of digits, or NO_BOUND. value: 0 if nothing is in view."""
    shown = max(value, SMALLEST) if value else 0.0
    return f"≤ {bound_text(shown, unit, digits)}" if value < LARGEST else NO_BOUND


def summary_lines(status, sees_nothing: bool = False, is_behind: bool = False) -> list[tuple[str, str]]:
    """Return the three lines at the panel's top, also before the first update: triangles, a bound, and the time.

    The bound is the first one of BOUNDS that the update has; the time is that of engine, overlay and mesh.

    sees_nothing: whether the camera has no view of the terrain, so that its bound in pixels means nothing. is_behind:
    whether an update is under way, so that the last one may be of a camera without a view.
    """
    if not status.mode:
        return [("Triangles", "-"), ("Error bound", "-"), ("Update", "-")]
    name, value, unit, _ = (_list_bounds(status) or [("Error bound", None, "", None)])[0]
    bound = "-" if value is None else _bound_label(value, unit, digits=3)
    if unit.startswith("px") and value == 0.0 and (sees_nothing or is_behind):
        bound = "no view" if sees_nothing else "updating"
    ms = sum(status.ms.get(step, 0.0) for step in ("total", "overlay", "mesh"))
    return [("Triangles", f"{status.triangles_left:,}"), (name, bound), ("Update", f"{plain(ms)} ms")]


def statistics_lines(status) -> list[tuple[str, str]]:
    """Return names and figures of the last update, each with its unit: errors, counts, and a time for each step."""
    if not status.mode:
        return [("No update yet", "")]
    unit = requested_unit(status.request.criterion)
    lines = [("Asked", f"{plain(getattr(status.request.criterion, f'error_{unit}'), 4)} {unit}")] if unit else []
    # terms: the parts of an error's bound by their cause, such as the rounding of the source; None for other bounds.
    for name, value, unit, terms in _list_bounds(status):
        lines.append((name, _bound_label(value, unit, digits=4)))
        parts = {label: getattr(terms, term) for term, label in TERMS.items()} if terms and value < LARGEST else {}
        lines += [(f"    {phrase(label)}", f"{plain(part)} {unit}") for label, part in parts.items() if part]
    if status.bounds.limited:
        lines.append(("Held back by", limit_text(status.bounds.limited)))
    if status.bounds.relaxed != 1.0:
        lines.append(("Coarser than asked", phrase("{} times", plain(status.bounds.relaxed))))
    lines += [("Leaves", f"{status.leaves:,}"), ("Triangles", f"{status.triangles:,}")]
    if status.triangles_left != status.triangles:
        lines.append(("Left by clean-up", f"{status.triangles_left:,}"))
    return lines + [(STEPS.get(step, step.capitalize()), f"{ms:.2f} ms") for step, ms in status.ms.items()]


def measured_lines(measured: dict) -> list[tuple[str, str, str]]:
    """Return a line of headings and one for each measured error: name and unit, the largest, the 95th percentile.

    The largest error of height is that of the whole surface; the others, and all percentiles, are of sampled points.
    measured: result of `read_measured`, not {}. Errors without a sample have no line.
    """
    distributions = [
        ("Screen (px)", "screen_px"),
        ("Hidden (px)", "hidden_px"),
        ("Silhouette (px)", "silhouette_px"),
        ("Vertical (m)", "vertical_m"),
        ("Facet normal (°)", "facet_deg"),
        ("Shading normal (°)", "shading_deg"),
    ]
    lines = [("Measured", phrase("largest"), "95 %")]
    for name, key in distributions:
        errors = measured[key]
        if errors and errors["count"]:
            largest = measured["vertical_max_m"] if key == "vertical_m" else errors["max"]
            lines.append((name, plain(largest), plain(errors["p95"])))
    return [*lines, ("Rounding (m)", plain(measured["rounding_m"]), "")]


def prediction_lines(status, curve: CostCurve, exact: bool) -> list[str]:
    """Return lines on what half and twice the error of the last update would cost, by the measured curve.

    The update's error is the requested one times `relaxed`, by which a limit of triangles made it larger. exact: the
    update's mesh is the measured one; otherwise the curve is scaled to go through the update's own cost. The result is
    [] if the update has no error in the curve's unit.
    """
    error = getattr(status.request.criterion, f"error_{curve.unit}") * status.bounds.relaxed
    if not error:
        return []
    triangles, ms = curve.at(error)
    triangle_factor, time_factor = 1.0, 1.0
    if not exact:
        triangle_factor = status.triangles / triangles
        if status.changed and "total" in status.ms:  # the time of a mesh that stayed says nothing
            time_factor = status.ms["total"] / ms
    lines = []
    for other in (error / 2, error * 2):
        triangles, ms = curve.at(other)
        cost = phrase("~{} triangles, ~{} ms", _two_digits(triangles * triangle_factor), _two_digits(ms * time_factor))
        lines.append(f"{plain(other)} {curve.unit}: {cost}")
    return lines


def _two_digits(value: float) -> str:
    """Format a number with two digits: a prediction is no better."""
    return plain(float(f"{value:.2g}"))


PANELS = (StatisticsPanel, AccuracyReportPanel)
