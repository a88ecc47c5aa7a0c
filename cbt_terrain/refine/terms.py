# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bound is made of, and how far rounding to float32 can take a mesh from where it was computed."""

from dataclasses import dataclass

import numpy as np

from ..field.heightfield import HeightField

# Significant bits of float32: whole multiples of a power of two up to 2^24 times that power are exact.
SINGLE_BITS = 24
# Displacement rounds about ten times in float64, each time by 2^-53 of its largest number at most.
DISPLACEMENT_ERROR = 2.0**-48


@dataclass(frozen=True)
class Terms:
    """The parts of a bound at the leaf that decides it, in the bound's own unit; they add up to it.

    `geometric`: interpolation by triangles; of a leaf that is drawn as a meshlet, by those that are drawn.
    `resampling`: what importing moved the raster's own samples there. `precision`: float32 positions. `source`: the
    source's own rounding of its heights.
    """

    geometric: float
    resampling: float
    precision: float
    source: float

    @classmethod
    def shares(cls, bound: float, *parts: float) -> "Terms":
        """A bound divided in proportion to its four parts in metres, in the order above."""
        total = sum(parts)
        part = bound / total if total > 0.0 else 0.0
        return cls(*(p * part for p in parts))


def left_of(error_m: float, source: float) -> float:
    """Metres of an error of height that are left to all but the source's rounding: what that does not take, but where
    it takes more than half, so that little would be gained for many triangles, four fifths."""
    return error_m - source if source <= 0.5 * error_m else 0.8 * error_m


def rounding(field: HeightField, depth: int, vertical_scale: float, vertical_offset: float) -> float:
    """Metres of height by which float32 positions of leaves at `depth` or above can move a mesh, at most.

    A height is rounded by half a step of float32 at the highest. A plane coordinate that is rounded moves the mesh
    sideways, hence up or down by that times its facets' slope; coordinates that float32 holds exactly do not count.
    A facet between a ridge and a valley leans along both: no more than the surface does along x and y together.
    """
    lattice = field.lattice
    lean = field.steepest_x * lattice.step_x + field.steepest_y * lattice.step_y  # metres a cell
    x, y, z = position_rounding(field, depth, vertical_scale, vertical_offset)
    return (z + (x / lattice.step_x + y / lattice.step_y) * lean * abs(vertical_scale)) * (1 + 1e-6)


def position_rounding(
    field: HeightField, depth: int, vertical_scale: float, vertical_offset: float
) -> tuple[float, float, float]:
    """Metres by which float32 positions of leaves at `depth` or above are off along x, y and z, at most."""
    lattice, plane = field.lattice, []
    sides = (lattice.cells_x, lattice.span[0], lattice.step_x), (lattice.cells_y, lattice.span[1], lattice.step_y)
    for cells, span, step in sides:
        spacing = step * 2.0 ** (lattice.levels - depth // 2)
        largest = (span - 0.5 * cells) * step
        plane.append(0.0 if _is_exact(largest, spacing) else _half_step(largest))
    heights = max(abs(field.min_height), abs(field.max_height)) * abs(vertical_scale)
    highest = max(abs(h * vertical_scale + vertical_offset) for h in (field.min_height, field.max_height))
    # A bicubic height is a sum of sixteen, which rounds about twice as much.
    part = DISPLACEMENT_ERROR * (2 if field.interpolation == "bicubic" else 1)
    return *plane, _half_step(highest) + part * (heights + abs(vertical_offset))


def _half_step(largest: float) -> float:
    """Half the distance between neighbouring float32 near a number."""
    return 0.5 * float(np.spacing(np.float32(largest))) if largest else 0.0


def _is_exact(largest: float, spacing: float) -> bool:
    """Whether float32 holds every number from -largest to largest in steps of `spacing`."""
    quantum = min(_power_of_two(largest), _power_of_two(spacing))
    return largest <= quantum * 2.0**SINGLE_BITS


def _power_of_two(number: float) -> float:
    """The largest power of two of which a positive number is a multiple."""
    numerator, denominator = number.as_integer_ratio()
    return (numerator & -numerator) / denominator
