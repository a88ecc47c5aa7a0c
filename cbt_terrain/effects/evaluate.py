# SPDX-License-Identifier: GPL-3.0-or-later
"""Running a plan on a surface: each effect once, nothing that is not in the plan, nothing again that is known."""

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..ask.view import View
from ..field.heightfield import HeightField
from ..mesh.attributes import POINT as POINTS
from ..mesh.attributes import Attribute
from ..mesh.surface import Surface
from .catalogue import EFFECTS
from .effect import GEOMETRY, MAP, Asked, Places
from .plan import Plan
from .scale import fixed_level, footprint_levels


@dataclass(frozen=True)
class Ran:
    """What one effect of a plan took: milliseconds (shared evenly by those that were made together), bytes that it
    holds, and for how many elements it was computed; 0 where all were known."""

    ms: float
    nbytes: int
    computed: int


@dataclass
class Evaluator:
    """Evaluates effects for one terrain's surfaces; keeps what the next frame may take over.

    `runs`: how often each effect was computed, ever: what is not asked for is not in it.
    """

    threads: int = 1
    runs: Counter = field(default_factory=Counter)
    ran: dict[str, Ran] = field(default_factory=dict)

    def attributes(
        self,
        plan: Plan,
        heights: HeightField,
        surface: Surface,
        views: Sequence[View] = (),
        placement: np.ndarray | None = None,
        vertical_scale: float = 1.0,
        vertical_offset: float = 0.0,
    ) -> dict[str, Attribute]:
        """The attributes of the plan for this surface, by name; in arrays of their own.

        Arguments as of `Terrain.update`. With no views what pictures show is at the raster's own scale.
        """
        self.ran = {}
        if not plan.steps:
            return {}
        scale = vertical_scale, vertical_offset
        levels = {
            family: fixed_level(surface) if family == GEOMETRY else footprint_levels(heights, surface, views, placement)
            for family in {step.family for step in plan.steps}
        }
        places = {
            family: Places(heights, surface.positions, level, *scale, self.threads) for family, level in levels.items()
        }
        values: dict[str, np.ndarray] = {}
        for together in _made_together(plan):
            first = together[0]
            start = time.perf_counter()
            wanted = {step.name: EFFECTS[step.name].defaults() | dict(step.parameters) for step in together}
            made = EFFECTS[first.name].make(places[first.family], wanted, values)
            ms = (time.perf_counter() - start) * 1e3 / len(together)
            for step in together:
                values[step.name] = made[step.name]
                self.runs[step.name] += 1
                self.ran[step.name] = Ran(ms, made[step.name].nbytes, len(made[step.name]))
        return {
            name: Attribute(values[name], POINTS, EFFECTS[name].unit)
            for name in plan.attributes
            if EFFECTS[name].domain != MAP
        }


def _made_together(plan: Plan) -> list[list[Asked]]:
    """Steps with the same function and family in one call, where nothing between them is read."""
    groups: list[list[Asked]] = []
    for step in plan.steps:
        effect = EFFECTS[step.name]
        for group in reversed(groups):
            if EFFECTS[group[0].name].make is effect.make and group[0].family == step.family:
                group.append(step)
                break
            if any(other.name in effect.reads for other in group):
                groups.append([step])
                break
        else:
            groups.append([step])
    return groups
