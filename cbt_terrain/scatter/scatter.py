# SPDX-License-Identifier: GPL-3.0-or-later
"""The declaration of a scatter: density, rules and style of its points. It is hashable and part of keys."""

import math
from dataclasses import dataclass, replace

from ..attributes.attribute import GEOMETRY, AttributeRequest
from ..attributes.splat import NAMES
from ..attributes.splat_rules import Layer, check_layers
from ..errors import TerrainError, check_kind, check_number, check_seed
from ..plain_numbers import keep_plain_numbers, plain_sequence

ANYWHERE = Layer("Anywhere")
LARGEST = 1e9
# Limit of tiles along a raster's side, which keeps points at least a lattice unit apart.
MAX_TILES = 1 << 20


@dataclass(frozen=True)
class Scatter:
    """Points on a terrain.

    Attributes:
        spacing: full density is one point on `spacing` x `spacing` metres in the terrain's space.
        full_until: distance from the eye in metres of the world up to which density is full; beyond, it falls with the
            square of the distance, for a constant number of points in a pixel. 0 for full density everywhere. A quarter
            more points are there with sizes from 0 on.
        where: density by the rules of a splat layer.
        layers, on: splat layers of the terrain, and the index of the one whose weight multiplies the density, or -1.
        size, variation: full size, and its variation as a fraction in both directions.
        align: 0 for upright, 1 for along the normal.
        margin_deg, margin_m: margin around the frame in degrees and metres of the world, for objects that reach or cast
            light into it.
        seed: selects other points.
        corner: CRS coordinates (x, y) from which points are counted, those of the raster's south-western corner at
            first; None for its present one. So points stay if the raster grows.
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
    corner: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Convert numbers to plain ones. Raise TerrainError for a value out of range."""
        keep_plain_numbers(self, "The scatter's")
        check_kind(self.where, Layer, "The scatter's where", "a Layer")
        object.__setattr__(self, "layers", plain_sequence(self.layers, Layer, "The scatter's layers", "Layer objects"))
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
            problem = f"The scatter stands on splat layer {self.on}, and there are {len(self.layers)}"
            raise TerrainError(problem, fix="choose one of them")
        check_layers(self._density_layers())
        if self.layers:
            check_layers(self.layers)

    @property
    def tile_side(self) -> float:
        """Return the side of a tile of the pattern in metres."""
        from .tile import POINTS

        return self.spacing * math.sqrt(POINTS)

    def reads(self) -> list[tuple[AttributeRequest, int]]:
        """Return the attributes whose product is the density, each with the column of its values; [] if it is 1."""
        requests = []
        if self.where.rules or self.where.strength != 1.0:
            requests.append((_splat(0, self._density_layers()), 1))  # the second of these layers is the density
        if self.on >= 0:  # a splat attribute has the weights of 4 layers
            requests.append((_splat(self.on // 4, self.layers), self.on % 4))
        return requests

    def _density_layers(self) -> tuple[Layer, ...]:
        """Return two layers, one everywhere and over it one whose weight, from its rules, is the density."""
        return ANYWHERE, replace(self.where, on_top=True)


def _splat(number: int, layers: tuple[Layer, ...]) -> AttributeRequest:
    """Return the request for the splat attribute `number` of these layers, 0 for splat_1."""
    return AttributeRequest(NAMES[number], ("a scatter",), GEOMETRY, (("layers", layers),))
