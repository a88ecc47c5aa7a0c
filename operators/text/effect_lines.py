# SPDX-License-Identifier: GPL-3.0-or-later
"""Texts about attributes: their declarations, their readers in a scene, and the cost of an evaluation."""

from collections.abc import Callable

from ...cbt_terrain.attributes.attribute import GEOMETRY, AttributeDeclaration
from .numbers import plain

BYTES = 4  # of a float32


def about(effect: AttributeDeclaration) -> dict:
    """Return an attribute's declaration as texts and numbers by name for the command line, which omits empty ones.

    "looks": how far around a vertex it reads. "adds to the bound": its part in the mesh's error.
    """
    return {
        "about": effect.about,
        "unit": effect.unit,
        "reads": ", ".join(effect.reads_with(())),  # with default parameters
        "parameters": {p.name: _parameter_text(p) for p in effect.parameters} or "",
        "looks": effect.halo,
        "adds to the bound": effect.bound,
        "cost": cost(effect),
    }


def cost(effect: AttributeDeclaration) -> str:
    """Return the memory and the time per vertex that an attribute's declaration states."""
    return f"{BYTES * effect.width} bytes and about {plain(effect.cost_ns)} ns a vertex"


def _parameter_text(parameter) -> str:
    """Format a parameter as `0.5 m (0 to 10): about`, or only its description if it is no number."""
    if not isinstance(parameter.default, int | float):
        return parameter.about
    unit = f" {parameter.unit}" if parameter.unit else ""
    return f"{parameter.default:g}{unit} ({parameter.min:g} to {parameter.max:g}): {parameter.about}"


def status_line(name: str, status) -> str:
    """Return `slope: read by material Rock, node Attribute.003; 12.1 ms, 0.4 MB`, or why it was skipped.

    name: the attribute's. status: its EffectStatus of the last update.
    """
    text = readers_text(status)
    text = text if status.note else text[0].lower() + text[1:]
    return f"{name}: {text}" if status.skipped else f"{name}: {text}; {cost_figures(status)}"


def readers_text(status, say: Callable[..., str] = str.format) -> str:
    """Return the readers of an effect after its note, or why it was skipped; `status` is None before an update.

    say: formats a template with values, in a panel also translated. An attribute from which geometry is made (GEOMETRY)
    is computed at one scale everywhere; others are filtered to the size of pixels. note: why values are 0.
    """
    if status is None:
        return say("No update yet")
    if status.skipped:
        return say("Skipped, {}", status.skipped)
    readers = status.readers[0]
    for reader in status.readers[1:]:
        readers = say("{} and {}", readers, reader)
    read = say("Read by {}, at one scale" if status.family == GEOMETRY else "Read by {}", readers)
    return f"{status.note}. {read}" if status.note else read


def cost_text(status, say: Callable[..., str]) -> str:
    """Return the cost of the last update: `12.1 ms, 0.4 MB, 1,203 new` (values that were not reused); "-" without one.

    say: formats a template with values, in a panel also translated.
    """
    return "-" if status is None or status.skipped else say("{}, {} new", cost_figures(status), f"{status.computed:,}")


def cost_figures(took) -> str:
    """Format time and memory as `12.1 ms, 0.4 MB`. took: has `ms` and `nbytes`, such as an EffectStatus."""
    return f"{plain(took.ms)} ms, {plain(took.nbytes / 1e6)} MB"
