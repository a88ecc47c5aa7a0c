# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels of the level of detail, in the viewport and in a render."""

from ...cbt_terrain.accuracy.cost_curve import CostCurve
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.view.criterion import requested_unit
from ...cbt_terrain.view.settings import CRITERIA, LIMITS, MODIFIERS, CriterionSetting
from ..session import session
from ..text.numbers import plain
from ..text.translations import phrase
from ..ui.panel_parts import TerrainSubpanel, draw_fixed_lines, draw_switched
from .request import criterion_from, within_time

ROUNDING = 1e-3  # fraction by which the finest error that fits may exceed its budget: it is a rounded number
BUDGET_LINES = 2


def draw_errors(column, settings) -> None:
    """Draw two rows: the screen error of the viewport and that of a render."""
    column.prop(settings.viewport, "error_px", text="Viewport Error")
    column.prop(settings.render, "error_px", text="Render Error")


def _draw_detail(column, detail) -> None:
    """Draw all settings of a criterion: errors, modifiers, limits and the time budget.

    detail: DetailSettings of the viewport or of the render.
    """
    for setting in CRITERIA:
        _draw_criterion(column, detail, setting)
    column.separator()
    for setting in MODIFIERS:
        column.prop(detail, setting.switch or setting.name, text=setting.row or setting.label)
    column.separator()
    for setting in LIMITS:
        draw_switched(column, detail, setting.switch, setting.name)
    draw_switched(column, detail, "limit_time", "max_ms")
    if detail.limit_time:
        draw_fixed_lines(column, _budget_text(detail), BUDGET_LINES)


def _draw_criterion(column, detail, setting: CriterionSetting) -> None:
    """Draw a switch and the number of one criterion, which is 0 while it is off."""
    row = column.row(heading=setting.row or setting.label, align=True)
    row.prop(detail, f"ask_{setting.name}", text="")
    if getattr(detail, setting.name) > 0.0:
        row.prop(detail, setting.name, text="")
    else:
        row.label(text="off")


def _budget_text(detail) -> str:
    """Return a sentence with the finest error that fits the time budget, or why none is known. detail: DetailSettings.

    curve.error: the measured errors, the largest first.
    """
    try:
        criterion, note = within_time(criterion_from(detail), detail)
    except TerrainError as error:  # every criterion is off
        return str(error)
    if note:
        return note
    unit, curve = requested_unit(criterion), CostCurve.from_json(detail.curve)
    error = getattr(criterion, f"error_{unit}")
    fits = curve.at(error)[1] <= detail.max_ms * (1 + ROUNDING)  # curve.at: triangles and milliseconds
    value = f"{plain(error, 4)} {unit}"
    text = phrase("Finest error that fits: {}", value) if fits else phrase("None fits; coarsest error: {}", value)
    is_measured = curve.error[-1] <= error <= curve.error[0]
    return text if is_measured else phrase("{}. Beyond the measured errors", text)


class ViewportPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_viewport"
    bl_label = "Detail in Viewport"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_advanced"

    def draw(self, context):
        """Draw the settings of the terrain's detail in viewports."""
        _draw_detail(self._columns(), session.shown_terrain(context).adaptive_terrain.viewport)


class RenderPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_render"
    bl_label = "Detail in Render"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_advanced"

    def draw(self, context):
        """Draw the settings of the terrain's detail in renders, and whether renders with stale frames are stopped."""
        column = self._columns()
        _draw_detail(column, session.shown_terrain(context).adaptive_terrain.render)
        column.separator()
        column.prop(context.scene.adaptive_terrain, "stop_stale_renders", text="Stop Stale Renders")
        if not context.scene.render.use_lock_interface:
            column.operator("adaptive_terrain.lock_interface", icon="UNLOCKED")


PANELS = (ViewportPanel, RenderPanel)
