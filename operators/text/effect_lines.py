# SPDX-License-Identifier: GPL-3.0-or-later
"""What is said of effects: of the catalogue, of a plan, of what an evaluation took."""

from collections.abc import Mapping

from ...cbt_terrain.effects.catalogue import EFFECTS
from ...cbt_terrain.effects.effect import GEOMETRY, MAP, Effect
from ...cbt_terrain.effects.evaluate import Ran
from ...cbt_terrain.effects.plan import Plan
from .numbers import plain

BYTES = 4  # of a float32


def about(effect: Effect) -> dict:
    """A declaration, as fields for the command line; what is empty is left out there."""
    return {
        "about": effect.about,
        "unit": effect.unit,
        "reads": ", ".join(effect.reads),
        "parameters": {p.name: _parameter(p) for p in effect.parameters} or "",
        "looks": effect.halo,
        "adds to the bound": effect.bound,
        "cost": cost(effect),
    }


def cost(effect: Effect) -> str:
    """What one element of the effect takes, as its declaration says."""
    element = "a sample of the whole raster" if effect.domain == MAP else "a vertex"
    return f"{BYTES * effect.width} bytes and about {plain(effect.cost_ns)} ns {element}"


def _parameter(parameter) -> str:
    """`0.5 m (0 to 10): what it does`; of one that is no number, only what it does."""
    if not isinstance(parameter.default, int | float):
        return parameter.about
    unit = f" {parameter.unit}" if parameter.unit else ""
    return f"{parameter.default:g}{unit} ({parameter.least:g} to {parameter.most:g}): {parameter.about}"


def plan_lines(plan: Plan, ran: Mapping[str, Ran]) -> list[str]:
    """A line for each effect: who reads it and what it took, or why it was skipped."""
    lines = [f"{step.name}: {readers(step)}{took(ran.get(step.name))}" for step in plan.steps]
    return lines + [f"{name}: skipped, {why}" for name, why in plan.skipped.items()]


def readers(step) -> str:
    """`read by material Rock, node Attribute.003`; geometry is told apart, because its scale is another."""
    scale = ", at one scale" if step.family == GEOMETRY else ""
    return f"read by {' and '.join(step.readers)}{scale}"


def took(ran: Ran | None) -> str:
    """`; 12.1 ms, 0.4 MB`."""
    return f"; {figures(ran)}" if ran else ""


def figures(ran: Ran) -> str:
    return f"{plain(ran.ms)} ms, {plain(ran.nbytes / 1e6)} MB"


def unknown(name: str) -> str:
    """What is wrong with a name that is no effect's."""
    return f"{name!r} is no effect; expected some of {', '.join(EFFECTS)}"
