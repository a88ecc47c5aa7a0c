# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bound is made of, and how far rounding to float32 can take a mesh from where it was computed."""

from dataclasses import dataclass

import numpy as np

from ..field.detail_bounds import steepest
from ..field.heightfield import HeightField
from ..view.linear import add_up

# Significant bits of float32: whole multiples of a power of two up to 2^24 times that power are exact.
SINGLE_BITS = 24
# Displacement rounds about ten times in float64, each time by 2^-53 of its largest number at most.
DISPLACEMENT_ERROR = 2.0**-48
# Inside a bicubic patch slopes are means of three times the differences of control heights, and a facet may lean along
# each axis by as much as the surface does along both.
BICUBIC_LEAN = 6.0
# Relative; above what rounding does to the sums below.
OUTWARD = 1 + 1e-6
MARGIN = 1e-12  # ... of a few metres


@dataclass(frozen=True)
class Terms:
    """The parts of a bound, in its own unit; they add up to it.

    `geometric`: what is given to the triangles; of a leaf that is drawn as a meshlet, to those that are drawn.
    `precision`: what float32 positions take. `source`: what the source's own rounding of its heights takes.
    """

    geometric: float
    precision: float
    source: float

    @classmethod
    def shares(cls, bound: float, *parts: float) -> "Terms":
        """A bound divided in proportion to its three parts in metres, in the order above."""
        total = add_up(parts)
        part = bound / total if total > 0.0 else 0.0
        return cls(*(p * part for p in parts))


@dataclass(frozen=True)
class Rounding:
    """Metres of height by which float32 positions can move a mesh.

    `height`: the heights' own rounding. Plane coordinates that are rounded move a facet sideways, hence up or down by
    that times its slope: `lean` metres a metre of the range of heights in its diamond's box, and `most_lean` at most.
    """

    height: float = 0.0
    lean: float = 0.0
    max_lean: float = 0.0

    @property
    def most(self) -> float:
        return self.height + self.max_lean


def left_of(error_m: float, source: float) -> float:
    """Metres of an error of height that are left to all but the source's rounding: what that does not take, but where
    it takes more than half, so that little would be gained for many triangles, four fifths."""
    return error_m - source if source <= 0.5 * error_m else 0.8 * error_m


def weighed_as(error_m: float, source: float, mean: float = 1.0) -> float:
    """Metres that the criterion (`metres2_of` in kernels/refine/diamond.py) weighs an error as, so that all of it
    holds; `mean`: of a ramp (`mean_ramp`), which adds mean - 1 times as much to what the finest mesh is off."""
    left = left_of(error_m, source)
    return min((left + source) / mean, left * (1.25 / (1.25 * mean - 0.25)))


def rounding(field: HeightField, depth: int, vertical_scale: float, vertical_offset: float) -> Rounding:
    """What float32 positions of leaves at `depth` or above do.

    A height is rounded by half a step of float32 at the highest. Coordinates that float32 holds exactly do not count.
    Of heights that differ by R in all, no facet climbs more than R a raster cell along an axis: its corners are a cell
    apart or more, or it lies in one cell, where a bilinear surface climbs by no more than the cell's corners differ
    (a bicubic one: see above). So half steps of u and v cells along x and y move it by (u + v) R; and by no more
    than (u + v) times the steepest climbs of all along x and y, added up. Where a rim cuts edges, a new vertex lies
    between two that are rounded, and is rounded again. A detail climbs by what it does, wherever it is.
    """
    lattice = field.lattice
    climb = field.steepest_x * lattice.step_x + field.steepest_y * lattice.step_y  # metres a cell
    times = 2.0 if lattice.is_padded else 1.0
    x, y, z = (times * off for off in position_rounding(field, depth, vertical_scale, vertical_offset))
    cells = (x / lattice.step_x + y / lattice.step_y) * OUTWARD
    lean = cells * (BICUBIC_LEAN if field.interpolation == "bicubic" else 1.0)
    # ... and its places, of which float64 holds no more, move it as little.
    spare = DISPLACEMENT_ERROR * add_up(lattice.span[k] * (lattice.step_x, lattice.step_y)[k] for k in (0, 1))
    along = steepest(field.parts) * abs(vertical_scale)
    detail = along * (cells * (lattice.step_x + lattice.step_y) + spare) if along else 0.0
    return Rounding(z * OUTWARD + detail, lean, cells * climb * abs(vertical_scale))


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
