# SPDX-License-Identifier: GPL-3.0-or-later
"""A stack that is meant for land of some height, for land of another: snow lines and the like move with it."""

from collections.abc import Mapping
from dataclasses import replace

from .mask import HEIGHT, Mask
from .stack import Entry, Stack

# Parameters that are heights of the land, and those that are in proportion to its relief.
LEVELS, RATES = {("snow", "line")}, {("rivers", "rise")}
LEAST_RELIEF = 1.0  # metres; flatter land says nothing


def fitted(stack: Stack, low: float, high: float) -> Stack:
    """The stack for land from `low` to `high` metres; as it is where it does not say for which land it was made.

    Heights (the snow line, limits of masks by height) stand as high over the land's foot, in parts of its relief, and
    uplift goes by the relief. The foot of land in the sea is the sea.
    """
    foot = max(low, 0.0) if high > 0.0 else low
    if stack.heights is None or high - foot < LEAST_RELIEF:
        return stack
    ratio = (high - foot) / (stack.heights[1] - stack.heights[0])

    def level(metres: float) -> float:
        return foot + (metres - stack.heights[0]) * ratio

    def mask(given: Mask | None) -> Mask | None:
        if given is None:
            return None
        rules = (
            replace(rule, low=level(rule.low), high=level(rule.high), edge=rule.edge * ratio)
            if rule.of == HEIGHT
            else rule
            for rule in given.rules
        )
        return replace(given, rules=tuple(rules))

    def parameters(entry: Entry) -> Mapping[str, float]:
        found = dict(entry.parameters)
        for parameter in entry.declaration.parameters:
            key = entry.effect, parameter.name
            if parameter.name in found and key in LEVELS | RATES:
                value = found[parameter.name]
                value = level(value) if key in LEVELS else value * ratio
                found[parameter.name] = min(max(value, parameter.least), parameter.most)
        return found

    entries = (replace(e, parameters=parameters(e), mask=mask(e.mask)) for e in stack.entries)
    return Stack(tuple(entries), (foot, high))
