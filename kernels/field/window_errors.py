# SPDX-License-Identifier: GPL-3.0-or-later
"""The error of a triangle that is larger than a window of the raster, over that window.

The plane of the triangle is evaluated with the same operations as in `hierarchy.py`, so the largest result of all
windows is the result for the whole raster, bit by bit. Heights and errors are metres before vertical scaling.
"""

import warp as wp

from ..unchecked import item_at
from .codes import Samples


@wp.struct
class Corner:
    """A right triangle with the corner (x, y), in samples, and legs of `legs` samples.

    The legs run east (`right` 1) or west (-1), and north (`up` 1) or south (-1). The plane has the height `plane` at
    the corner, and slopes in metres a sample.
    """

    x: wp.int32
    y: wp.int32
    right: wp.int32
    up: wp.int32
    legs: wp.int32
    plane: wp.float64
    slope_x: wp.float64
    slope_y: wp.float64


@wp.kernel
def window_errors(
    offset: int, measured: Samples, west: int, south: int, corner: Corner, largest: wp.array(dtype=wp.float64)
):
    """Raise `largest` of row `offset + tid` to the largest distance, metres, of the surface from a triangle's plane.

    measured: a window of the raster, NaN where samples do not count. (west, south): its first sample. corner: the
    triangle, which may extend beyond the window. A cell that the longest edge crosses counts only if the window has all
    four of its samples.
    """
    row = offset + wp.tid()
    c = corner
    h = measured.floats
    width = measured.columns
    start = row * width
    j = c.up * (south + row - c.y)  # rows from the corner along its leg
    max_distance = largest[row]
    if j >= 0 and j < c.legs:  # the row meets the triangle
        plane = c.plane + c.slope_y * wp.float64(c.up * j)
        first = c.x + wp.min(c.right, 0) * (c.legs - j)
        begin = wp.max(first, west)
        end = wp.min(first + c.legs + 1 - j, west + width)
        for x in range(begin, end):
            height = wp.float64(item_at(h, start + x - west))
            distance = wp.abs(height - (plane + c.slope_x * wp.float64(x - c.x)))
            max_distance = wp.where(distance > max_distance, distance, max_distance)
    # The longest edge runs from (x, y + up * legs) along (right, -up); cell i of it is between its rows i and i + 1.
    i = c.legs - c.up * (south + row - c.y)
    if c.up > 0:  # the edge begins in the north: the cell above this row comes before it
        i = i - 1
    edge_x = c.x + c.right * i
    cell_x = wp.min(edge_x, edge_x + c.right)
    # The window has all four samples of the cell.
    if i >= 0 and i < c.legs and cell_x >= west and cell_x + 1 < west + width and row + 1 < measured.rows:
        top = c.plane + c.slope_y * wp.float64(c.up * c.legs)
        across = c.slope_x * wp.float64(c.right) - c.slope_y * wp.float64(c.up)
        index = start + edge_x - west
        if c.up > 0:
            index = index + width
        aside_index = index + c.right
        below_index = index - c.up * width
        far_index = below_index + c.right
        e0 = wp.float64(h[index]) - (top + across * wp.float64(i))
        e1 = wp.float64(h[far_index]) - (top + across * wp.float64(i + 1))
        twist = (
            wp.float64(h[index]) + wp.float64(h[far_index]) - wp.float64(h[aside_index]) - wp.float64(h[below_index])
        )
        # the distance is a parabola between the samples; it counts if it turns there
        if wp.abs(e1 - e0) < wp.abs(twist):
            rest = twist - (e1 - e0)
            max_distance = wp.max(max_distance, wp.abs(e0 - rest * rest / (wp.float64(4.0) * twist)))
    largest[row] = max_distance
