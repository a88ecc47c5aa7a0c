# SPDX-License-Identifier: GPL-3.0-or-later
"""Adaptation of a stack that was designed for land of some heights to land of other heights."""

from collections.abc import Mapping
from dataclasses import replace

from .mask import HEIGHT, GroundRule, HeightMask
from .stack import Entry, Stack

# Operators and names of parameters that are heights of the land, and of those that are in proportion to its relief.
HEIGHTS, RATES = {("snow", "line")}, {("rivers", "rise")}
MIN_RELIEF = 1.0  # metres


def fitted(stack: Stack, low: float, high: float) -> Stack:
    """Return a stack of height operators adapted to land from `low` to `high` metres.

    Heights (the snow line, limits of masks) keep their fraction of the relief above the foot, and uplift is scaled by
    the relief. The foot is `low`, but not below 0 m for land that rises above the sea. The result is designed for land
    from the foot to `high`. Without `stack.heights`, or for flat land, the stack stays as it is.
    """
    foot = max(low, 0.0) if high > 0.0 else low
    if stack.heights is None or high - foot < MIN_RELIEF:
        return stack
    designed_foot, designed_top = stack.heights
    ratio = (high - foot) / (designed_top - designed_foot)

    def move_height(metres: float) -> float:
        """Return the height in this land for a height in the stack's own land, metres."""
        return foot + (metres - designed_foot) * ratio

    def adapt_rule(rule: GroundRule) -> GroundRule:
        """Adapt the limits of a rule if they are heights."""
        if rule.of != HEIGHT:
            return rule
        return replace(rule, low=move_height(rule.low), high=move_height(rule.high), edge=rule.edge * ratio)

    def adapt_mask(mask: HeightMask | None) -> HeightMask | None:
        """Adapt the rules of a mask, if there is one."""
        return mask and replace(mask, rules=tuple(map(adapt_rule, mask.rules)))

    def adapt_parameters(entry: Entry) -> Mapping[str, float]:
        """Return the entry's parameters for the other land, within their ranges.

        Parameters of HEIGHTS are moved by `move_height`; those of RATES are multiplied by `ratio`, of both reliefs.
        """
        adapted = dict(entry.parameters)
        for parameter in entry.declaration.parameters:
            key = entry.effect, parameter.name
            if parameter.name in adapted and key in HEIGHTS | RATES:
                value = adapted[parameter.name]
                value = move_height(value) if key in HEIGHTS else value * ratio
                adapted[parameter.name] = min(max(value, parameter.min), parameter.max)
        return adapted

    entries = (replace(e, parameters=adapt_parameters(e), mask=adapt_mask(e.mask)) for e in stack.entries)
    return Stack(tuple(entries), (foot, high))
