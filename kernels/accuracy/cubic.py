# SPDX-License-Identifier: GPL-3.0-or-later
"""The C1 bicubic reference surface as the measurement evaluates it: by cubic Hermite interpolation.

Slopes at samples are central differences; beyond the border heights go on straight. kernels/bicubic/surface.py
displaces by the same surface with other arithmetic, so that a fault in one of the two shows in the other.
"""

import warp as wp

from ..field.codes import Samples, sample_at


@wp.func
def hermite(p0: wp.float64, p1: wp.float64, p2: wp.float64, p3: wp.float64, s: wp.float64) -> wp.float64:
    """Return the Hermite cubic through p1 at s = 0 and p2 at s = 1, with slopes (p2 - p0) / 2 and (p3 - p1) / 2 there.

    p0 .. p3: four samples in a row, metres.
    """
    rise = p2 - p1
    start_slope = wp.float64(0.5) * (p2 - p0)
    end_slope = wp.float64(0.5) * (p3 - p1)
    cubic_term = start_slope + end_slope - wp.float64(2.0) * rise
    square_term = wp.float64(3.0) * rise - wp.float64(2.0) * start_slope - end_slope
    return ((cubic_term * s + square_term) * s + start_slope) * s + p1


@wp.func
def height_along_row(samples: Samples, i: wp.int32, j: wp.int32, s: wp.float64):
    """Return the height, metres before scaling, of the Hermite cubic along row j, `s` cells (0 .. 1) east of column i.

    Samples beyond the border are extrapolated linearly.
    """
    index = wp.int64(j) * wp.int64(samples.columns) + wp.int64(i)
    p1 = wp.float64(sample_at(samples, index))
    p2 = wp.float64(sample_at(samples, index + wp.int64(1)))
    p0 = wp.float64(2.0) * p1 - p2
    p3 = wp.float64(2.0) * p2 - p1
    if i > 0:
        p0 = wp.float64(sample_at(samples, index - wp.int64(1)))
    if i < samples.columns - 2:
        p3 = wp.float64(sample_at(samples, index + wp.int64(2)))
    return hermite(p0, p1, p2, p3, s)


@wp.func
def cubic_at(samples: Samples, i: wp.int32, j: wp.int32, s: wp.float64, t: wp.float64) -> wp.float64:
    """Return the height of the bicubic surface in cell (i, j), metres before vertical scaling.

    s, t: position in the cell from its south-west corner, 0 .. 1.
    """
    z1 = height_along_row(samples, i, j, s)
    z2 = height_along_row(samples, i, j + 1, s)
    z0 = wp.float64(2.0) * z1 - z2
    z3 = wp.float64(2.0) * z2 - z1
    if j > 0:
        z0 = height_along_row(samples, i, j - 1, s)
    if j < samples.rows - 2:
        z3 = height_along_row(samples, i, j + 2, s)
    return hermite(z0, z1, z2, z3, t)


@wp.func
def height_bounds(samples: Samples, i: wp.int32, j: wp.int32):
    """Return a lower and an upper bound of the bicubic surface in cell (i, j), metres before vertical scaling.

    The surface is a weighted mean of the 4 x 4 samples around. Its negative weights add up to 1/8 at most in one
    direction, hence to 9/32 in two, so it leaves the samples' range by at most 9/32 of the range. At the border
    extrapolated samples are sums of those inside, and negative weights are smaller.
    """
    low = wp.float64(wp.inf)
    high = -wp.float64(wp.inf)
    for row in range(wp.max(j - 1, 0), wp.min(j + 2, samples.rows - 1) + 1):
        for column in range(wp.max(i - 1, 0), wp.min(i + 2, samples.columns - 1) + 1):
            h = wp.float64(sample_at(samples, wp.int64(row) * wp.int64(samples.columns) + wp.int64(column)))
            low = wp.where(h < low, h, low)
            high = wp.where(h > high, h, high)
    margin = (high - low) * wp.float64(0.28125)
    return low - margin, high + margin
