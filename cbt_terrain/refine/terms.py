# SPDX-License-Identifier: GPL-3.0-or-later
"""The terms of an error bound, and bounds of the error that float32 positions add.

The *source* is the raster that was imported; its heights are rounded, for example to whole metres. Heights become
height * vertical_scale + vertical_offset metres.
"""

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
# Relative; above the rounding of the sums below.
OUTWARD = 1 + 1e-6
MARGIN = 1e-12  # relative; above the rounding of a bound


@dataclass(frozen=True)
class Terms:
    """The terms of a bound, in its unit; they add up to it.

    `geometric`: error of the drawn triangles. `precision`: rounding of float32 positions. `source`: the source's
    rounding of its heights.
    """

    geometric: float
    precision: float
    source: float

    @classmethod
    def shares(cls, bound: float, *parts: float) -> "Terms":
        """Divide a bound in proportion to its parts, all in one unit: geometric, by precision, and by the source.

        All terms are 0 if the parts are.
        """
        total = add_up(parts)
        scale = bound / total if total > 0.0 else 0.0
        return cls(*(part * scale for part in parts))


@dataclass(frozen=True)
class Rounding:
    """Metres of height by which float32 positions can move a mesh.

    `height`: rounding of the heights. Rounded plane coordinates move a facet sideways, and so up or down by that times
    its slope: `lean` metres per metre of the range of heights in its diamond's box, and at most `max_lean` metres.
    `near`: fraction of that which remains per metre between the box and the anchor along x and y, 1 at most; (0, 0)
    without an anchor, where all counts everywhere.
    """

    height: float = 0.0
    lean: float = 0.0
    max_lean: float = 0.0
    near: tuple[float, float] = (0.0, 0.0)


def error_without_source(error_m: float, source: float) -> float:
    """Return the part of a height error, metres, that remains for everything but the source's rounding.

    error_m: the requested error. source: largest error of the source's heights by rounding, metres. If the source takes
    more than half of the error, four fifths of the error remain: less would cost many triangles for little gain.
    """
    return error_m - source if source <= 0.5 * error_m else 0.8 * error_m


def weighed_as(error_m: float, source: float, mean: float) -> float:
    """Return the weighed metres to request so that the error of all heights is at most `error_m`.

    A diamond's weighed error (`metres2_of` in kernels/refine/diamond.py) is its geometric error plus the roundings,
    which count only up to a multiple of it, so that they alone split nothing. source: the source's rounding. mean: from
    `mean_ramp`; geomorphing adds mean - 1 times the tolerance to the finest mesh's error.
    """
    remaining = error_without_source(error_m, source)
    # Weighed as w, an error without the source's is at most w - source or 0.8 w, whichever is more; geomorphing adds
    # (mean - 1) w. So w is the largest with w * mean <= remaining + source and w * (mean - 0.2) <= remaining.
    return min((remaining + source) / mean, remaining * (1.25 / (1.25 * mean - 0.25)))


def rounding(field: HeightField, depth: int, vertical_scale: float, vertical_offset: float) -> Rounding:
    """Return the rounding of float32 positions of leaves at `depth` or above.

    The *lean* is what rounded plane coordinates add: they move a facet sideways, and so up or down by its slope. A
    height is rounded by half the spacing of float32 at the highest height. Coordinates that float32 represents exactly
    do not count. Let R be the range of heights. No facet climbs more than R per raster cell along an axis: its corners
    are at least a cell apart, or it is inside one cell, where a bilinear surface climbs by no more than the cell's
    corners differ (BICUBIC_LEAN covers a bicubic one). So rounding by u and v cells along x and y moves the facet by at
    most (u + v) R, and by at most (u + v) times the sum of the steepest climbs along x and y. Where the border cuts an
    edge, the new vertex is between two rounded ones and is rounded again. Displacement adds its steepest slope. A
    coordinate is rounded by at most 2^-24 of itself.
    """
    lattice = field.lattice
    climb = field.steepest_x * lattice.step_x + field.steepest_y * lattice.step_y  # metres a cell
    times = 2.0 if lattice.is_padded else 1.0  # vertices cut at the border are rounded twice
    x, y, z = (times * rounding_m for rounding_m in position_rounding(field, depth, vertical_scale, vertical_offset))
    moved_cells = (x / lattice.step_x + y / lattice.step_y) * OUTWARD
    lean = moved_cells * (BICUBIC_LEAN if field.interpolation == "bicubic" else 1.0)
    finer = field.raster.finer
    if finer is not None:  # corners of a facet are at least a finer cell apart
        lean *= 1 << finer.bits
    # The float64 rounding of the positions at which displacement is evaluated adds to this.
    spare = DISPLACEMENT_ERROR * add_up(lattice.span[k] * (lattice.step_x, lattice.step_y)[k] for k in (0, 1))
    detail_slope = steepest(field.parts) * abs(vertical_scale)
    detail = detail_slope * (moved_cells * (lattice.step_x + lattice.step_y) + spare) if detail_slope else 0.0
    near = (0.0, 0.0)  # fraction of the lean that counts per metre from the anchor; all of it without one
    if (lattice.anchor_x or lattice.anchor_y) and moved_cells:
        relative_error = times * 2.0**-SINGLE_BITS * OUTWARD / moved_cells
        near = relative_error / lattice.step_x if x else 0.0, relative_error / lattice.step_y if y else 0.0
    max_lean = moved_cells * climb * abs(vertical_scale)
    return Rounding(height=z * OUTWARD + detail, lean=lean, max_lean=max_lean, near=near)


def position_rounding(
    field: HeightField, depth: int, vertical_scale: float, vertical_offset: float
) -> tuple[float, float, float]:
    """Return the largest errors of float32 positions of leaves at `depth` or above: metres along x, y and z.

    An error is half the spacing of float32 at the largest coordinate (`_half_step`), 0 in a plane coordinate that is
    always exact. Along z the float64 rounding of the computed height is added.
    """
    lattice, errors_in_plane = field.lattice, []
    sides = (
        (lattice.cells_x, lattice.span[0], lattice.step_x, lattice.anchor_x),
        (lattice.cells_y, lattice.span[1], lattice.step_y, lattice.anchor_y),
    )
    for cells, span, step, anchor in sides:
        # spacing: of lattice lines at this depth. largest: distance from the anchor to an end of the squares.
        spacing = step * 2.0 ** (lattice.levels - depth // 2)
        largest = max(0.5 * cells * step + anchor, (span - 0.5 * cells) * step - anchor)
        errors_in_plane.append(0.0 if _is_exact(largest, spacing) else _half_step(largest))
    heights = max(abs(field.min_height), abs(field.max_height)) * abs(vertical_scale)
    highest = max(abs(h * vertical_scale + vertical_offset) for h in (field.min_height, field.max_height))
    # A bicubic height is a sum of sixteen, which rounds about twice as much.
    relative_error = DISPLACEMENT_ERROR * (2 if field.interpolation == "bicubic" else 1)
    # Heights of the raster are rounded where finer tiles hold them.
    finer = 2.0 * _half_step(heights) if field.raster.finer is not None else 0.0
    error_x, error_y = errors_in_plane
    return error_x, error_y, _half_step(highest) + relative_error * (heights + abs(vertical_offset)) + finer


def _half_step(largest: float) -> float:
    """Return half the spacing of float32 at a number: the largest error of rounding to it."""
    return 0.5 * float(np.spacing(np.float32(largest))) if largest else 0.0


def _is_exact(largest: float, spacing: float) -> bool:
    """Return whether float32 represents all multiples of `spacing` from -largest to largest exactly.

    Both numbers are positive.
    """
    quantum = min(_power_of_two(largest), _power_of_two(spacing))  # a power of two that divides both
    return largest <= quantum * 2.0**SINGLE_BITS


def _power_of_two(number: float) -> float:
    """Return the largest power of two of which a positive number is a multiple."""
    numerator, denominator = number.as_integer_ratio()
    return (numerator & -numerator) / denominator
