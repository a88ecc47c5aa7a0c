# SPDX-License-Identifier: GPL-3.0-or-later
"""Height and gradient of the C1 bicubic surface through the samples.

In each direction it is the cubic convolution of Keys (1981), "Cubic convolution interpolation for digital image
processing", with a = -1/2: at a sample its slope is the central difference. Beyond the border heights are extrapolated,
h(-1) = 2 h(0) - h(1), which makes that slope the one-sided difference there. Heights are metres before vertical
scaling.

In finer tiles (kernels/field/finer.py) the surface is the bilinear one between finer heights plus `off_corners`. It has
the finer heights at finer samples, and continues the patches around the tiles.
"""

import warp as wp

from ..field.codes import Samples, sample_at, sample_index


@wp.func
def weights(s: wp.float64) -> wp.vec4d:
    """Return the weights of samples -1, 0, 1 and 2 in the height at s (0 .. 1) between samples 0 and 1."""
    half = wp.float64(0.5)
    one = wp.float64(1.0)
    three = wp.float64(3.0)
    r = one - s
    return wp.vec4d(
        -half * s * r * r,
        one - half * s * s * (wp.float64(5.0) - three * s),
        half * s * (one + s * (wp.float64(4.0) - three * s)),
        -half * s * s * r,
    )


@wp.func
def slopes(s: wp.float64) -> wp.vec4d:
    """Return the derivatives of `weights` by s: the weights of four samples in the slope at s."""
    half = wp.float64(0.5)
    one = wp.float64(1.0)
    three = wp.float64(3.0)
    nine = wp.float64(9.0)
    return wp.vec4d(
        -half * (one - s) * (one - three * s),
        half * s * (nine * s - wp.float64(10.0)),
        half * (one + s * (wp.float64(8.0) - nine * s)),
        half * s * (three * s - wp.float64(2.0)),
    )


@wp.func
def border_weights(w: wp.vec4d, cell: wp.int32, count: wp.int32) -> wp.vec4d:
    """Return four sample weights `w` corrected for the first and last cell of a row, where a sample is extrapolated.

    cell: its number in the row. count: samples of the row.
    """
    zero = wp.float64(0.0)
    two = wp.float64(2.0)
    if cell == 0:
        w = wp.vec4d(zero, w[1] + two * w[0], w[2] - w[0], w[3])
    if cell == count - 2:
        w = wp.vec4d(w[0], w[1] - w[3], w[2] + two * w[3], zero)
    return w


@wp.func
def in_patch(samples: Samples, i: wp.int32, j: wp.int32, s: wp.float64, t: wp.float64):
    """Return the height (metres) and its slopes (metres a cell, east and north) in cell (i, j).

    s, t: position in the cell from its south-west corner, 0 .. 1.
    """
    wx = border_weights(weights(s), i, samples.columns)
    wy = border_weights(weights(t), j, samples.rows)
    dx = border_weights(slopes(s), i, samples.columns)
    dy = border_weights(slopes(t), j, samples.rows)
    # Relative to a height of the cell, so a constant map stays constant to the last bit.
    base = wp.float64(sample_at(samples, sample_index(samples, i, j)))
    height_and_slopes = wp.vec3d(base, wp.float64(0.0), wp.float64(0.0))
    for b in range(4):
        h = row_around(samples, i, j + b - 1, base)
        z = wp.dot(wx, h)
        height_and_slopes += wp.vec3d(wy[b] * z, wy[b] * wp.dot(dx, h), dy[b] * z)
    return height_and_slopes


@wp.func
def row_around(samples: Samples, i: wp.int32, j: wp.int32, base: wp.float64) -> wp.vec4d:
    """Return the samples i - 1 .. i + 2 of row j minus `base`, metres.

    Beyond the border the border's sample is repeated: `border_weights` gives the copy no weight.
    """
    row = wp.int64(wp.clamp(j, 0, samples.rows - 1)) * wp.int64(samples.columns)
    west = wp.int64(wp.max(i - 1, 0))
    far = wp.int64(wp.min(i + 2, samples.columns - 1))
    return wp.vec4d(
        wp.float64(sample_at(samples, row + west)) - base,
        wp.float64(sample_at(samples, row + wp.int64(i))) - base,
        wp.float64(sample_at(samples, row + wp.int64(i + 1))) - base,
        wp.float64(sample_at(samples, row + far)) - base,
    )


@wp.func
def off_corners(samples: Samples, bits: wp.int32, i: wp.int32, j: wp.int32, s: wp.float64, t: wp.float64):
    """Return the bicubic surface minus its bilinear interpolation between the corners of a finer cell.

    The result is a height (metres) and its slopes (metres a raster cell, east and north), and 0 at the corners to the
    last bit. bits: a raster cell has 2^bits finer cells a side. (i, j): the finer cell. s, t: position in it, 0 .. 1.
    """
    x = wp.min(i >> bits, samples.columns - 2)  # at the border the finer cell is one beyond, and s is 0
    y = wp.min(j >> bits, samples.rows - 2)
    cells_a_side = wp.float64(wp.int32(1) << bits)
    finer_side = wp.float64(1.0) / cells_a_side  # exact: a power of two
    west = wp.float64(i - (x << bits)) * finer_side
    south = wp.float64(j - (y << bits)) * finer_side
    one = wp.float64(1.0)
    # Weights of samples in the heights on the finer cell's four sides.
    west_weights = weights(west)
    east_weights = weights(west + finer_side)
    south_weights = weights(south)
    north_weights = weights(south + finer_side)
    wx = border_weights(weights(west + s * finer_side), x, samples.columns)
    wy = border_weights(weights(south + t * finer_side), y, samples.rows)
    dx = border_weights(slopes(west + s * finer_side), x, samples.columns)
    dy = border_weights(slopes(south + t * finer_side), y, samples.rows)
    # The weights of the same samples in the bilinear interpolation between the finer cell's corners.
    bx = border_weights(west_weights * (one - s) + east_weights * s, x, samples.columns)
    by = border_weights(south_weights * (one - t) + north_weights * t, y, samples.rows)
    ex = border_weights((east_weights - west_weights) * cells_a_side, x, samples.columns)
    ey = border_weights((north_weights - south_weights) * cells_a_side, y, samples.rows)
    base = wp.float64(sample_at(samples, sample_index(samples, x, y)))
    difference = wp.vec3d()
    for b in range(4):
        h = row_around(samples, x, y + b - 1, base)
        z = wp.dot(wx, h)
        c = wp.dot(bx, h)
        difference += wp.vec3d(
            wy[b] * z - by[b] * c, wy[b] * wp.dot(dx, h) - by[b] * wp.dot(ex, h), dy[b] * z - ey[b] * c
        )
    return difference
