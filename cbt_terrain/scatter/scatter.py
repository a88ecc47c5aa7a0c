# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scatter is: how many points, where, and what they look like. Hashable, so that it is part of keys."""

import math
from dataclasses import dataclass, replace

from ..effects.effect import GEOMETRY, Asked
from ..effects.splat import NAMES
from ..effects.splat_rules import Layer, check
from ..errors import TerrainError, check_number, check_seed
from ..plain_numbers import keep_plain_numbers
from .tile import POINTS

ANYWHERE = Layer("Anywhere")
LARGEST = 1e9
# Tiles in a raster's side, at most: what lies between two points then is still a lattice unit or more.
MOST_TILES = 1 << 20


@dataclass(frozen=True)
class Scatter:
    """Points that stand on a terrain.

    `spacing`: at full density there is one on `spacing` x `spacing` metres of the terrain's own space. `full_until`:
    metres of the world from the eye up to which density is full; further away it falls with the square of the distance,
    so that as many points a pixel are seen; 0: full everywhere. A quarter more points are there, which grow. `where`:
    density by rules, those of a splat layer. `layers`, `on`: splat layers of the terrain, and the number of the one
    whose part of the ground counts too, -1: none. `size`: of points that are full-grown; it varies by `variation` of
    itself either way. `align`: 0 upright, 1 along the normal. `margin_deg`, `margin_m`: how far outside the frame
    points still are, degrees and metres of the world: what stands there may reach or shine into it. `seed` gives other
    points.
    """

    spacing: float = 10.0
    full_until: float = 500.0
    where: Layer = ANYWHERE
    layers: tuple[Layer, ...] = ()
    on: int = -1
    size: float = 1.0
    variation: float = 0.2
    align: float = 0.0
    margin_deg: float = 5.0
    margin_m: float = 0.0
    seed: int = 0

    def __post_init__(self):
        keep_plain_numbers(self, "The scatter's")
        for name, low, high, unit in (
            ("spacing", 1e-4, LARGEST, "metres"),
            ("full_until", 0.0, LARGEST, "metres, 0 for full density everywhere"),
            ("size", 0.0, LARGEST, "times the size of what is scattered"),
            ("variation", 0.0, 1.0, "parts of the size"),
            ("align", 0.0, 1.0, "from upright to the ground's normal"),
            ("margin_deg", 0.0, 89.0, "degrees"),
            ("margin_m", 0.0, LARGEST, "metres"),
        ):
            check_number(f"The scatter's {name}", getattr(self, name), low, high, unit)
        check_seed("The scatter's seed", self.seed)
        if not -1 <= self.on < len(self.layers):
            raise TerrainError(
                f"The scatter stands on splat layer {self.on}, and there are {len(self.layers)}; choose one of them."
            )
        check(self._own_layers())
        if self.layers:
            check(self.layers)

    @property
    def tile_side(self) -> float:
        """Metres after which the pattern repeats."""
        return self.spacing * math.sqrt(POINTS)

    def reads(self) -> list[tuple[Asked, int]]:
        """Effects whose product is the density, each with the column of its values that counts; none for 1."""
        found = []
        if self.where.rules or self.where.strength != 1.0:
            found.append((_splat(0, self._own_layers()), 1))
        if self.on >= 0:
            found.append((_splat(self.on // 4, self.layers), self.on % 4))
        return found

    def _own_layers(self) -> tuple[Layer, ...]:
        """What lies on top of the rest takes just what its own rules give."""
        return ANYWHERE, replace(self.where, on_top=True)


def _splat(number: int, layers: tuple[Layer, ...]) -> Asked:
    return Asked(NAMES[number], ("a scatter",), GEOMETRY, (("layers", layers),))
