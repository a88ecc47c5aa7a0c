# SPDX-License-Identifier: GPL-3.0-or-later
"""What is said of effects: of the catalogue, of what a scene reads, of what an evaluation took."""

from ...cbt_terrain.effects.catalogue import EFFECTS
from ...cbt_terrain.effects.effect import GEOMETRY, Effect
from .numbers import plain

BYTES = 4  # of a float32


def about(effect: Effect) -> dict:
    """A declaration, as fields for the command line; what is empty is left out there."""
    return {
        "about": effect.about,
        "unit": effect.unit,
        "reads": ", ".join(effect.reads_with(())),
        "parameters": {p.name: _parameter(p) for p in effect.parameters} or "",
        "looks": effect.halo,
        "adds to the bound": effect.bound,
        "cost": cost(effect),
    }


def cost(effect: Effect) -> str:
    """What one element of the effect takes, as its declaration says."""
    return f"{BYTES * effect.width} bytes and about {plain(effect.cost_ns)} ns a vertex"


def _parameter(parameter) -> str:
    """`0.5 m (0 to 10): what it does`; of one that is no number, only what it does."""
    if not isinstance(parameter.default, int | float):
        return parameter.about
    unit = f" {parameter.unit}" if parameter.unit else ""
    return f"{parameter.default:g}{unit} ({parameter.least:g} to {parameter.most:g}): {parameter.about}"


def status_line(name: str, status) -> str:
    """`slope: read by material Rock, node Attribute.003; 12.1 ms, 0.4 MB`, or why it was skipped."""
    said = readers_text(status)
    said = said if status.note else said[0].lower() + said[1:]
    return f"{name}: {said}" if status.skipped else f"{name}: {said}; {figures(status)}"


def readers_text(status) -> str:
    """Why it is nothing, where there is a note of that, and who reads an effect, or why it was skipped; `status`: an
    EffectStatus, None before the first update."""
    if status is None:
        return "No update yet"
    if status.skipped:
        return f"Skipped, {status.skipped}"
    scale = ", at one scale" if status.family == GEOMETRY else ""
    read = f"ead by {' and '.join(status.readers)}{scale}"
    return f"{status.note}; r{read}" if status.note else f"R{read}"


def cost_text(status) -> str:
    """`12.1 ms, 0.4 MB, 1,203 new`: what the last update took."""
    return f"{figures(status)}, {status.computed:,} new" if status is not None and not status.skipped else "-"


def figures(took) -> str:
    """Of a Ran or an EffectStatus."""
    return f"{plain(took.ms)} ms, {plain(took.nbytes / 1e6)} MB"


def unknown(name: str) -> str:
    """What is wrong with a name that is no effect's."""
    return f"{name!r} is no effect; expected some of {', '.join(EFFECTS)}"
