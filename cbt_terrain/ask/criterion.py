# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked of a refinement.

Every criterion is a ratio, squared: how much too coarse a diamond is, 1 being exactly what was asked. Criteria combine
by max. Each ratio is nested: an error saturated from the bottom up over a distance to a box that contains the
children's boxes (Lindstrom and Pascucci 2002, sections 3 and 4), so a plain walk from the roots gives a conforming
mesh.
"""

import math
from dataclasses import dataclass

from ..errors import TerrainError
from ..plain_numbers import keep_plain_numbers
from .morph import MOST

# What is asked is kept between these: the finest and the coarsest mesh that there can be.
SMALLEST, LARGEST = 1e-30, 1e30
# As if seen 30 degrees off.
SHADING_FLOOR = 0.5


@dataclass(frozen=True)
class Criterion:
    """What is asked; 0 switches a criterion off, and those that are on hold together.

    `error_px`: screen-space geometric error, pixels. `edge_px`: longest edge, pixels. `area_px`: triangle area, square
    pixels. `error_m`: vertical error, metres, independent of any view. `guard_deg`: how far outside the frame still
    counts as seen, degrees. `off_screen_factor`: how much coarser the rest may be; 1 switches culling off. Both are
    those of a field of view of 50 degrees: of a narrower one the band is narrower and the rest coarser in proportion.
    `hidden_factor`: the same of ground in the frame that nearer ground hides. It needs an error, an eye (an
    orthographic view has none) and ground without holes; mirrors, shadows and lenses wider than a point see more.
    `shading_floor`: from above, errors of height move no pixel but show in shading and shadows; an error counts as if
    seen from so far beside it that this part of it shows, 0 .. 1.
    `max_depth`: bisections of a root square (None: to what float32 holds). `max_triangles`: None is no limit.
    `meshlet`: each leaf becomes 4**meshlet triangles, 0 .. 4.
    `morph`: points rise to their places by the view alone, so that nothing pops: see morph.py. 1 is off, 1.5 takes a
    quarter to a half more triangles for the same bound; 4 at most.
    """

    error_px: float = 1.0
    edge_px: float = 0.0
    area_px: float = 0.0
    error_m: float = 0.0
    guard_deg: float = 2.5
    off_screen_factor: float = 16.0
    hidden_factor: float = 1.0
    shading_floor: float = SHADING_FLOOR
    max_depth: int | None = None
    max_triangles: int | None = None
    meshlet: int = 0
    morph: float = 1.0

    def __post_init__(self):
        keep_plain_numbers(self, "The criterion's")
        for name in ("error_px", "edge_px", "area_px", "error_m", "guard_deg"):
            value = getattr(self, name)
            if not (0 <= value < math.inf):
                raise TerrainError(f"The criterion's {name} is {value}; expected a finite number, 0 or more.")
        for name in ("error_px", "edge_px", "area_px", "error_m"):
            if value := getattr(self, name):  # squares of what lies outside are no numbers any more
                object.__setattr__(self, name, min(max(value, SMALLEST), LARGEST))
        for name, label in (("off_screen_factor", "off-screen factor"), ("hidden_factor", "hidden factor")):
            if not getattr(self, name) >= 1:
                raise TerrainError(f"The {label} is {getattr(self, name)}; expected 1 (no culling) or more.")
        if not 0 <= self.shading_floor <= 1:
            raise TerrainError(f"The shading floor is {self.shading_floor}; expected a number from 0 to 1.")
        if self.meshlet not in range(5):
            raise TerrainError(f"The meshlet level is {self.meshlet}; expected a whole number from 0 to 4.")
        if self.max_depth is not None and self.max_depth < 1:
            raise TerrainError(f"The depth limit is {self.max_depth}; expected 1 or more.")
        if self.max_triangles is not None and self.max_triangles < 0:
            raise TerrainError(f"The triangle limit is {self.max_triangles}; expected 0 or more.")
        if not 1 <= self.morph <= MOST:
            raise TerrainError(f"The morph is {self.morph}; expected a number from 1 (off) to {MOST:g}.")
        if not (self.error_px or self.edge_px or self.area_px or self.error_m):
            raise TerrainError("Every criterion is 0; ask for an error, an edge length or an area.")

    @property
    def hides(self) -> bool:
        """Whether hidden ground may be coarser; without an error asked, nothing says how low the ground in front is."""
        return self.hidden_factor > 1 and bool(self.error_px or self.error_m)

    @property
    def rises_until(self) -> float:
        """The ratio at which points are in their places; 1: all are. Without a view nothing moves."""
        return self.morph if self.needs_view else 1.0

    @property
    def measures_edges(self) -> bool:
        return bool(self.edge_px or self.area_px)

    @property
    def needs_view(self) -> bool:
        return bool(self.error_px or self.edge_px or self.area_px)


def unit_asked(criterion: Criterion) -> str:
    """The unit of the error that is swept and budgeted: px where a screen error is asked for, else m, else ""."""
    return "px" if criterion.error_px else "m" if criterion.error_m else ""
