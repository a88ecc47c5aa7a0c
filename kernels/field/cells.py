# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights of the bilinear surface with slopes that are interpolated between samples, so that shading has no steps."""

import warp as wp

from .codes import Samples, corners_of, height_at


@wp.func
def per_cell(cells: wp.int32) -> wp.float64:
    """Return the factor that converts a height difference over 1 or 2 cells to one per cell."""
    return wp.where(cells == 2, wp.float64(0.5), wp.float64(1.0))


@wp.func
def on_sample(samples: Samples, i: wp.int32, j: wp.int32):
    """Return the height and its slopes (per cell, east and north) at sample (i, j), metres before vertical scaling.

    Slopes are central differences, one-sided at the border.
    """
    west = wp.min(i, 1)  # cells to the west, at most 1
    east = wp.min(samples.columns - 1 - i, 1)
    south = wp.min(j, 1)
    north = wp.min(samples.rows - 1 - j, 1)
    row = wp.int64(samples.columns)
    index = wp.int64(j) * row + wp.int64(i)
    gx = (height_at(samples, index + wp.int64(east)) - height_at(samples, index - wp.int64(west))) * per_cell(
        west + east
    )
    gy = height_at(samples, index + wp.int64(north) * row) - height_at(samples, index - wp.int64(south) * row)
    return wp.vec3d(height_at(samples, index), gx, gy * per_cell(south + north))


@wp.func
def in_cell(samples: Samples, i: wp.int32, j: wp.int32, s: wp.float64, t: wp.float64):
    """Return the height and its slopes (per cell) in cell (i, j), bilinear between those of its samples.

    The height is metres before vertical scaling. s, t: position in the cell, 0 .. 1. Slopes at samples are central
    differences, one-sided at the border. Each of the twelve samples that it needs is read once.
    """
    west = wp.min(i, 1)  # cells to the west, at most 1
    east = wp.min(samples.columns - 2 - i, 1)
    south = wp.min(j, 1)
    north = wp.min(samples.rows - 2 - j, 1)
    p = corners_of(samples, i, j)  # in the order south-west (a), south-east (b), north-west (c), north-east (d)
    row = wp.int64(samples.columns)
    one = wp.int64(1)
    index = wp.int64(j) * row + wp.int64(i)
    above = index + row
    per_x = per_cell(west + 1)
    a_x = (p[1] - height_at(samples, index - wp.int64(west))) * per_x
    c_x = (p[3] - height_at(samples, above - wp.int64(west))) * per_x
    per_x = per_cell(east + 1)
    b_x = (height_at(samples, index + one + wp.int64(east)) - p[0]) * per_x
    d_x = (height_at(samples, above + one + wp.int64(east)) - p[2]) * per_x
    # `below` and from here on `above` are rows beyond the cell, or at the border its own.
    below = index - wp.int64(south) * row
    above += wp.int64(north) * row
    per_y = per_cell(south + 1)
    a_y = (p[2] - height_at(samples, below)) * per_y
    b_y = (p[3] - height_at(samples, below + one)) * per_y
    per_y = per_cell(north + 1)
    c_y = (height_at(samples, above) - p[0]) * per_y
    d_y = (height_at(samples, above + one) - p[1]) * per_y
    whole = wp.float64(1.0)
    lower = wp.vec3d(p[0], a_x, a_y) * ((whole - s) * (whole - t)) + wp.vec3d(p[1], b_x, b_y) * (s * (whole - t))
    upper = wp.vec3d(p[2], c_x, c_y) * ((whole - s) * t) + wp.vec3d(p[3], d_x, d_y) * (s * t)
    return lower + upper
