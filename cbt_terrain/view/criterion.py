# SPDX-License-Identifier: GPL-3.0-or-later
"""The criterion of a refinement.

Every criterion is a ratio, squared: how many times too coarse a diamond is; 1 is exactly as fine as requested. Criteria
combine by maximum. Each ratio is nested: an error saturated from the bottom up over a distance to a box that contains
the children's boxes (Lindstrom and Pascucci 2002, sections 3 and 4), so a plain walk from the roots gives a conforming
mesh.
"""

from dataclasses import dataclass

from ..errors import TerrainError
from ..plain_numbers import keep_plain_numbers
from .settings import CRITERIA, SETTINGS

# Requested errors, edges and areas are clamped to this range: the finest and the coarsest mesh that there can be.
SMALLEST, LARGEST = 1e-30, 1e30


@dataclass(frozen=True)
class Criterion:
    """Requested errors, edges and areas, of which 0 switches one off and all others hold together; and limits.

    Ranges, labels and options are in settings.py.

    Attributes:
        error_px: screen-space geometric error, pixels.
        edge_px: longest edge, pixels.
        area_px: triangle area, square pixels.
        error_m: vertical error, metres, independent of any view.
        guard_deg: guard band around the frame with full detail, degrees, for a field of view of 50 degrees; narrower
            in proportion for a narrower one.
        off_screen_factor: how many times coarser the rest may be, for a field of view of 50 degrees; coarser in
            proportion for a narrower one. 1 switches culling off.
        hidden_factor: how many times coarser ground may be that nearer ground hides. It needs an error, an eye (an
            orthographic view has none) and ground without holes. Mirrors, shadows and wide apertures see more.
        shading_floor: smallest fraction of an error of height that counts, 0 .. 1. From above such errors move no
            pixel, but show in shading and shadows.
        max_depth: bisections of a root square; None: down to the precision of float32.
        max_triangles: None is no limit.
        meshlet: each leaf becomes 4**meshlet triangles, 0 .. 4.
        morph: ratio at which vertices are at their final heights, see morph.py. 1 is off; 1.5 takes a quarter to a
            half more triangles for the same bound.
    """

    error_px: float = 1.0
    edge_px: float = 0.0
    area_px: float = 0.0
    error_m: float = 0.0
    guard_deg: float = 2.5
    off_screen_factor: float = 16.0
    hidden_factor: float = 1.0
    shading_floor: float = 0.5
    max_depth: int | None = None
    max_triangles: int | None = None
    meshlet: int = 0
    morph: float = 1.0

    def __post_init__(self) -> None:
        """Check every number and clamp the requests to SMALLEST .. LARGEST. Raises TerrainError."""
        keep_plain_numbers(self, "The criterion's")
        for setting in SETTINGS:
            setting.check(getattr(self, setting.name))
        requested = {setting.name: getattr(self, setting.name) for setting in CRITERIA}
        requested = {name: value for name, value in requested.items() if value}
        if not requested:
            raise TerrainError("Every criterion is 0", fix="ask for an error, an edge length or an area")
        for name, value in requested.items():  # squares of larger and smaller numbers overflow
            object.__setattr__(self, name, min(max(value, SMALLEST), LARGEST))

    @property
    def hides(self) -> bool:
        """Tell whether hidden ground may be coarser.

        It needs a limit of the error: without one, the height of the ground in front of it is unknown.
        """
        return self.hidden_factor > 1 and bool(self.error_px or self.error_m)

    @property
    def morph_until(self) -> float:
        """Return the ratio of error to criterion at which vertices are at their final heights.

        It is 1 if none moves, as without a view.
        """
        return self.morph if self.needs_view else 1.0

    @property
    def measures_edges(self) -> bool:
        """Return whether lengths of edges or areas of triangles on screen are limited."""
        return bool(self.edge_px or self.area_px)

    @property
    def needs_view(self) -> bool:
        """Return whether a limit on screen is requested."""
        return bool(self.error_px or self.edge_px or self.area_px)


def requested_unit(criterion: Criterion) -> str:
    """Return the unit of the error that reports compare and budgets limit: px with a screen error, else m, else ""."""
    return "px" if criterion.error_px else "m" if criterion.error_m else ""
