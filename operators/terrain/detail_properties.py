# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of the level of detail: `object.adaptive_terrain.viewport` and `.render`.

Those of a criterion are made from the table in cbt_terrain/view/settings.py.
"""

import bpy
from bpy.props import BoolProperty, FloatProperty, IntProperty, StringProperty

from ...cbt_terrain.view.settings import CRITERIA, RENDER, SETTINGS, VIEWPORT, CriterionSetting

MAX_INT, MAX_FLOAT = 2**31 - 1, 3.4028234663852886e38  # of Blender's properties
UNITS = {"px": {"subtype": "PIXEL"}, "m": {"unit": "LENGTH"}, "fraction": {"subtype": "FACTOR"}}


def changed(self, _context) -> None:
    """Tag the object: where a script sets a property, its evaluated copy would keep the old value."""
    self.id_data.update_tag()


def value_of(detail, setting: CriterionSetting) -> float | None:
    """Return the value of a criterion's setting in a DetailSettings; if its switch is off, the setting's default.

    The default limits nothing. A flag has a switch only: on stands for the usual value.
    """
    if setting.switch and not getattr(detail, setting.switch):
        return setting.default
    return setting.usual if setting.is_flag else getattr(detail, setting.name)


def _number_property(setting: CriterionSetting, default: float):
    """Return the Blender property that holds a setting's number, with its label, unit and range."""
    kind, largest = (int, MAX_INT) if setting.whole else (float, MAX_FLOAT)
    options = {"name": setting.label, "description": setting.tooltip, "update": changed}
    limits = {"min": setting.min, "max": min(setting.max, largest), "soft_max": min(setting.soft_max, largest)}
    numbers = {name: kind(value) for name, value in {"default": default, **limits}.items()}
    if setting.whole:
        return IntProperty(**options, **numbers)
    return FloatProperty(**options, **numbers, precision=setting.digits, **UNITS.get(setting.unit, {}))


def _switch_property(setting: CriterionSetting, mode: str):
    """Return the Blender property of the check box for a limit or a flag.

    mode: VIEWPORT or RENDER, which differ in defaults.
    """
    return BoolProperty(
        name=setting.switch_label or setting.label,
        description=setting.switch_tooltip or setting.tooltip,
        default=setting.default_in(mode) != setting.default,  # the latter limits nothing
        update=changed,
    )


def _criterion_switch(setting: CriterionSetting):
    """Return the check box of a criterion, which stores nothing: it sets the number to 0 or to its usual value."""

    def set_switch(self, on: bool) -> None:
        """Set the number to its usual value if it is switched `on` and was 0, or to 0."""
        if on != (getattr(self, setting.name) > 0.0):
            setattr(self, setting.name, setting.usual if on else 0.0)

    return BoolProperty(
        name=setting.label,
        description="Use this limit. Of all limits that are on, the strictest decides",
        get=lambda self: getattr(self, setting.name) > 0.0,
        set=set_switch,
        options=set(),
    )


def _make_properties(mode: str) -> dict:
    """Return the Blender properties of every setting of a criterion by their identifiers.

    mode: VIEWPORT or RENDER, which differ in defaults.
    """
    found = {f"ask_{setting.name}": _criterion_switch(setting) for setting in CRITERIA}
    for setting in SETTINGS:
        if setting.switch:
            found[setting.switch] = _switch_property(setting, mode)
        if not setting.is_flag:
            default = setting.default_in(mode)  # None: no limit, and its switch is off
            found[setting.name] = _number_property(setting, setting.usual if default is None else default)
    return found


class DetailSettings:
    """Time budget and measured accuracy, the same in the viewport and in a render."""

    limit_time: BoolProperty(
        name="Time Budget",
        description="Choose the finest error that can be computed within Max Time, instead of the error above; press "
        "Measure Accuracy first. The viewport also learns from its own times; renders are the same on every computer",
        update=changed,
    )  # fmt: skip
    max_ms: FloatProperty(
        name="Max Time (ms)",
        description="Time to compute the mesh of a new view, in milliseconds; the transfer to Blender takes some more",
        default=50.0, min=0.01, soft_max=1000.0, precision=1, update=changed,
    )  # fmt: skip
    curve: StringProperty(
        name="Cost Curve",
        description="Time and triangles for each error, measured by Measure Accuracy; JSON",
        update=changed,
    )
    no_curve: StringProperty(
        name="No Cost Curve", description="Why the last Measure Accuracy gave no curve; empty if it did"
    )
    measured: StringProperty(
        name="Measured Accuracy", description="Errors of one mesh, as Measure Accuracy has measured them; JSON"
    )


class ViewportDetail(DetailSettings, bpy.types.PropertyGroup):
    """Level of detail in the viewport."""

    __annotations__ = _make_properties(VIEWPORT)


class RenderDetail(DetailSettings, bpy.types.PropertyGroup):
    """Level of detail in a render, a bake or an export."""

    __annotations__ = _make_properties(RENDER)
