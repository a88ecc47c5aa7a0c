# SPDX-License-Identifier: GPL-3.0-or-later
"""A triangle of a mesh over the surface that it stands for, and the largest distance between the two.

The difference of the bilinear surface from a plane has its extrema at samples, at the triangle's corners, and on the
diagonals of cells along its sides: `farthest` evaluates all of them. Lengths are lattice units, heights metres before
scaling, in float64: planes through float32 heights at power-of-two distances are exact.

Of the domain d: a root square has 2^levels cells and 2^unit_bits units a side; the raster ends at the units `east` and
`north`, beyond which the lattice has only padding.

A Facet has its apex, with the right angle, at (x, y) and the height z; (left_x, left_y) and (right_x, right_y) are the
vectors from the apex to the other two corners; slope_x, slope_y: metres a unit.
"""

import warp as wp

from ..field.codes import Samples, bilinear, corners_of, sample_index
from ..field.domain import Domain
from ..unchecked import item_at


@wp.struct
class Facet:
    """A triangle in the plan, lattice units, and its plane, metres before scaling."""

    x: wp.int32  # the apex, which has the right angle
    y: wp.int32
    left_x: wp.int32  # the left and the right corner, from the apex
    left_y: wp.int32
    right_x: wp.int32
    right_y: wp.int32
    z: wp.float64  # height at the apex
    slope_x: wp.float64  # metres a unit
    slope_y: wp.float64


@wp.func
def surface_height(d: Domain, x: wp.int32, y: wp.int32) -> wp.float64:
    """Return the surface's height at lattice point (x, y), metres before scaling; that of the border beyond it."""
    bits = d.unit_bits - d.levels
    x = wp.min(x, d.east)
    y = wp.min(y, d.north)
    i = wp.min(x >> bits, d.samples.columns - 2)
    j = wp.min(y >> bits, d.samples.rows - 2)
    per_unit = wp.float64(1.0) / wp.float64(wp.int32(1) << bits)
    s = wp.float64(x - (i << bits)) * per_unit
    t = wp.float64(y - (j << bits)) * per_unit
    return bilinear(corners_of(d.samples, i, j), s, t)


@wp.func
def is_beyond_border(d: Domain, facet: Facet) -> wp.bool:
    """Return whether a facet is completely outside the raster, in the padding of the lattice."""
    west = facet.x + wp.min(wp.min(facet.left_x, facet.right_x), 0)
    south = facet.y + wp.min(wp.min(facet.left_y, facet.right_y), 0)
    return west >= d.east or south >= d.north


@wp.func
def height_above(d: Domain, facet: Facet, x: wp.int32, y: wp.int32) -> wp.float64:
    """Return the height of the surface above the facet, metres before scaling.

    (x, y): lattice units from the facet's apex.
    """
    return surface_height(d, facet.x + x, facet.y + y) - (
        facet.z + facet.slope_x * wp.float64(x) + facet.slope_y * wp.float64(y)
    )


@wp.func
def rows_of(facet: Facet, bits: wp.int32):
    """Return the southernmost row of samples in the facet, counted from its apex, and the number of rows in it.

    A facet smaller than a cell has 0 rows. bits: a cell has 2^bits lattice units a side.
    """
    first_row = wp.min(wp.min(facet.left_y, facet.right_y), 0) >> bits
    last_row = wp.max(wp.max(facet.left_y, facet.right_y), 0) >> bits
    count = last_row - first_row + 1
    if wp.max(wp.abs(facet.left_x), wp.abs(facet.left_y)) < (1 << bits):  # smaller than a cell
        count = 0
    return first_row, count


@wp.func
def row_of(facet: Facet, bits: wp.int32, j: wp.int32):
    """Return the westernmost sample of row `j` of the facet and the number of its samples.

    Rows and samples are counted from its apex. bits: a cell has 2^bits lattice units a side.
    """
    leg_cells = wp.max(wp.abs(facet.left_x), wp.abs(facet.left_y)) >> bits
    rows_away = wp.abs(j)
    first = wp.int32(0)
    count = leg_cells + 1 - rows_away
    if facet.left_x == 0 or facet.left_y == 0:  # the legs lie along a row and a column
        if facet.left_x + facet.right_x < 0:  # the facet is west of the apex
            first = rows_away - leg_cells
    elif facet.left_x == facet.right_x:  # the longest side stands upright
        first = wp.where(facet.left_x > 0, rows_away, -leg_cells)
    else:  # the longest side lies along a row
        first = -rows_away
        count = 2 * rows_away + 1
    return first, count


@wp.func
def twist_over(d: Domain, x: wp.int32, y: wp.int32, dx: wp.int32, dy: wp.int32) -> wp.float64:
    """Return the twist of the surface over a step (dx, dy) from (x, y), metres before scaling, with its sign.

    The twist is the sum of the heights at the two ends of the step, minus that at the other two corners of the square
    around it. The step is in one cell and parallel to a diagonal, so |dx| = |dy|, lattice units.
    """
    bits = d.unit_bits - d.levels
    i = wp.min(x, x + dx) >> bits
    j = wp.min(y, y + dy) >> bits
    p = corners_of(d.samples, i, j)
    cell = wp.float64(wp.int32(1) << bits)
    return ((p[0] - p[1]) + (p[3] - p[2])) * (wp.float64(dx) / cell) * (wp.float64(dy) / cell)


@wp.func
def bulge(r0: wp.float64, r1: wp.float64, twist: wp.float64):
    """Return (t, r): where r0 (1 - t) + r1 t - twist t (1 - t) has its extremum, and its value there.

    It is (0, r0) if the extremum is not between t = 0 and 1. r0, r1: distances at the ends of a side, metres. twist: of
    the surface between these ends, metres with a sign.
    """
    slope = r1 - r0 - twist
    t = wp.float64(0.0)
    r = r0
    # The parabola turns between t = 0 and 1.
    if slope * twist < wp.float64(0.0) and wp.abs(slope) < wp.float64(2.0) * wp.abs(twist):
        t = -slope / (wp.float64(2.0) * twist)
        r = r0 + t * (slope + twist * t)
    return t, r


@wp.func
def row_error(
    h: wp.array(dtype=wp.float32), first: wp.int64, count: int, plane: wp.float64, slope: wp.float64
) -> wp.float64:
    """Return the largest distance, metres, of `count` samples in a row from a plane.

    h: samples of the raster. first: index of the first one. plane: height of the plane at it. slope: the plane's metres
    a sample along the row. NaN samples do not count.
    """
    largest = wp.float64(0.0)
    for i in range(count):
        distance = wp.abs(wp.float64(item_at(h, first + wp.int64(i))) - (plane + slope * wp.float64(i)))
        largest = wp.where(distance > largest, distance, largest)
    return largest


@wp.func
def row_inside(raster: Samples, x: int, y: int, count: int, plane: wp.float64, slope: wp.float64) -> wp.float64:
    """Return the largest distance of the samples (x, y) .. (x + count - 1, y) from a line, metres; 0 if none is inside.

    The line has the height `plane` at the first sample and rises by `slope` a sample. Samples outside the raster do not
    count.
    """
    num_inside = wp.min(count, raster.columns - x)
    largest = wp.float64(0.0)
    if num_inside > 0 and y < raster.rows:
        largest = row_error(raster.floats, sample_index(raster, x, y), num_inside, plane, slope)
    return largest


@wp.func
def diagonal_inside(
    raster: Samples, x: int, y: int, right: int, up: int, cells: int, plane: wp.float64, slope: wp.float64
) -> wp.float64:
    """Return the largest distance of the bilinear surface from a plane, between samples on diagonals of `cells` cells.

    The diagonals start at (x, y) and run east (`right` 1) or west (-1), north (`up` 1) or south (-1). Those beyond the
    border do not count. plane: height of the plane at (x, y); slope: its metres a cell along the diagonal. In a cell
    the distance is e(t) = e0 (1-t) + e1 t - c t (1-t). c: the cell's twist, the sum of the heights at the ends of the
    diagonal minus that at the other corners. Only a turning point counts, so that the result is 0 without one:
    `row_inside` measures at the samples.
    """
    h = raster.floats
    to_side = wp.int64(right)  # to the next sample in a row, and in a column
    to_row = wp.int64(up) * wp.int64(raster.columns)
    # The cells inside the border.
    first = wp.int32(0)
    end = cells
    if right > 0:
        end = wp.min(end, raster.columns - 1 - x)
    else:
        first = wp.max(first, x - (raster.columns - 1))
    if up > 0:
        end = wp.min(end, raster.rows - 1 - y)
    else:
        first = wp.max(first, y - (raster.rows - 1))
    largest = wp.float64(0.0)
    if first < end:
        index = sample_index(raster, x + right * first, y + up * first)
        z0 = wp.float64(item_at(h, index))
        e0 = z0 - (plane + slope * wp.float64(first))
        for i in range(first, end):
            far_index = index + to_side + to_row
            z1 = wp.float64(item_at(h, far_index))
            e1 = z1 - (plane + slope * wp.float64(i + 1))
            twist = z0 + z1 - wp.float64(item_at(h, index + to_side)) - wp.float64(item_at(h, index + to_row))
            # The parabola e0 - fall t + twist t^2 turns inside the cell.
            if wp.abs(e1 - e0) < wp.abs(twist):
                fall = twist - (e1 - e0)
                largest = wp.max(largest, wp.abs(e0 - fall * fall / (wp.float64(4.0) * twist)))
            z0 = z1
            e0 = e1
            index = far_index
    return largest


@wp.func
def farthest_on_diagonal(
    d: Domain, facet: Facet, x0: wp.int32, y0: wp.int32, x1: wp.int32, y1: wp.int32, known: wp.float64
) -> wp.float64:
    """Return the larger of `known` and the largest distance along a diagonal side of the facet, metres before scaling.

    (x0, y0), (x1, y1): ends of the side, lattice units from the apex. Along a side of whole cells only the extremum of
    each cell's parabola counts, inside the border: `farthest` measures at the samples between. A shorter side is inside
    one cell, and its two ends and the extremum count.
    """
    bits = d.unit_bits - d.levels
    dx = x1 - x0
    dy = y1 - y0
    largest = known
    cells = wp.abs(dx) >> bits
    if cells > 0:
        cell_x = wp.where(dx > 0, 1, -1)
        cell_y = wp.where(dy > 0, 1, -1)
        start = facet.z + facet.slope_x * wp.float64(x0) + facet.slope_y * wp.float64(y0)
        unit = wp.float64(wp.int32(1) << bits)
        slope = (facet.slope_x * wp.float64(cell_x) + facet.slope_y * wp.float64(cell_y)) * unit
        i = (facet.x + x0) >> bits
        j = (facet.y + y0) >> bits
        largest = wp.max(largest, diagonal_inside(d.samples, i, j, cell_x, cell_y, cells, start, slope))
    else:
        r0 = height_above(d, facet, x0, y0)
        r1 = height_above(d, facet, x1, y1)
        t, r = bulge(r0, r1, twist_over(d, facet.x + x0, facet.y + y0, dx, dy))
        largest = wp.max(wp.max(largest, wp.abs(r)), wp.max(wp.abs(r0), wp.abs(r1)))
    return largest


@wp.func
def farthest(d: Domain, facet: Facet) -> wp.float64:
    """Return the largest distance between the facet and the surface, metres before scaling; 0 beyond the border."""
    if is_beyond_border(d, facet):
        return wp.float64(0.0)
    bits = d.unit_bits - d.levels
    unit = wp.float64(wp.int32(1) << bits)
    i = facet.x >> bits
    j = facet.y >> bits
    largest = wp.float64(0.0)
    south, count = rows_of(facet, bits)
    for k in range(count):
        first, samples = row_of(facet, bits, south + k)
        plane = facet.z + facet.slope_y * (wp.float64(south + k) * unit) + facet.slope_x * (wp.float64(first) * unit)
        slope = facet.slope_x * unit
        largest = wp.max(largest, row_inside(d.samples, i + first, j + south + k, samples, plane, slope))
    if facet.left_x == 0 or facet.left_y == 0:  # the legs lie along a row and a column: the longest side is diagonal
        if count == 0:  # smaller than a cell: no row of samples has measured the apex
            largest = wp.abs(height_above(d, facet, 0, 0))
        largest = farthest_on_diagonal(d, facet, facet.left_x, facet.left_y, facet.right_x, facet.right_y, largest)
    else:  # both legs are diagonal
        largest = farthest_on_diagonal(d, facet, 0, 0, facet.left_x, facet.left_y, largest)
        largest = farthest_on_diagonal(d, facet, 0, 0, facet.right_x, facet.right_y, largest)
    return largest
