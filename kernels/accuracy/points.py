# SPDX-License-Identifier: GPL-3.0-or-later
"""The triangle of a mesh that covers each of many points, and its distance from the reference surface there.

Points are on a grid 2^7 times finer than the lattice, sorted along the Morton curve. The points of a square whose side
is a power of two are one run of them, so a triangle finds its points by one search in each of the at most four squares
of its size that hold it (Morton 1966; Samet 1990, linear quadtrees).

`ground` is the reference surface, of which a cell has 2^bits lattice units a side. The box of a triangle f (west,
south, east, north) is in these units.

Of MeasuredPoints: `key` has the Morton keys in ascending order, and `order` the numbers of their points.
"""

import warp as wp

from .facets import DeliveredMesh, MeasuredFacet, Reference, covers, facet_of, plane_at, reference_at, shift_of

POINT_BITS = wp.constant(7)  # a point has 23 + 7 bits a side, so that its cross products with edges fit int64


@wp.struct
class MeasuredPoints:
    """Points in units of 2^-(bits + 7) cells, and the results for them."""

    count: wp.int32
    x: wp.array(dtype=wp.int64)
    y: wp.array(dtype=wp.int64)
    key: wp.array(dtype=wp.int64)  # Morton keys, sorted
    order: wp.array(dtype=wp.int64)  # the point of each key
    difference: wp.array(dtype=wp.float64)  # mesh minus reference, metres
    owner: wp.array(dtype=wp.int32)  # the triangle that covers the point


@wp.func
def spread_bits(value: wp.int64) -> wp.int64:
    """Return the lowest 31 bits of a value, spread: bit k becomes bit 2 k, and the others are 0."""
    b = value
    b = (b | (b << wp.int64(16))) & wp.int64(0x0000FFFF0000FFFF)
    b = (b | (b << wp.int64(8))) & wp.int64(0x00FF00FF00FF00FF)
    b = (b | (b << wp.int64(4))) & wp.int64(0x0F0F0F0F0F0F0F0F)
    b = (b | (b << wp.int64(2))) & wp.int64(0x3333333333333333)
    return (b | (b << wp.int64(1))) & wp.int64(0x5555555555555555)


@wp.func
def morton(x: wp.int64, y: wp.int64) -> wp.int64:
    """Return the Morton key of (x, y), their interleaved bits: squares of points are contiguous in its order."""
    return spread_bits(x) | (spread_bits(y) << wp.int64(1))


@wp.kernel
def compute_morton_keys(
    offset: wp.int32,
    end_x: wp.int64,
    end_y: wp.int64,
    x: wp.array(dtype=wp.int64),
    y: wp.array(dtype=wp.int64),
    key: wp.array(dtype=wp.int64),
):
    """Write the Morton key of point `offset + tid`. Points on the far borders (end_x, end_y) get keys just inside.

    So the last squares of triangles at the border hold them. x, y: the points, in the units of MeasuredPoints.
    """
    p = offset + wp.tid()
    key[p] = morton(wp.min(x[p], end_x - wp.int64(1)), wp.min(y[p], end_y - wp.int64(1)))


@wp.func
def first_from(points: MeasuredPoints, key: wp.int64) -> wp.int32:
    """Return the index of the first sorted key not below `key`, by bisection; the number of points without one."""
    low = wp.int32(0)
    high = points.count
    while low < high:
        middle = low + (high - low) / 2
        if points.key[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


@wp.func
def measure_square(
    ground: Reference, f: MeasuredFacet, t: wp.int32, points: MeasuredPoints, corner: wp.int64, side_bits: wp.int64
):
    """Write the difference (mesh minus reference, metres) and owner of the points in a square that triangle t owns.

    corner: Morton key of the square's first point. side_bits: its side is 2^side_bits units of MeasuredPoints.
    """
    bits = wp.int64(ground.bits) + wp.int64(POINT_BITS)
    units_a_lattice_unit = wp.int64(1) << wp.int64(POINT_BITS)
    cells_a_unit = wp.float64(1.0) / wp.float64(wp.int64(1) << bits)
    end_x = wp.int64(ground.samples.columns - 1) << bits
    end_y = wp.int64(ground.samples.rows - 1) << bits
    end = corner + (wp.int64(1) << (side_bits + side_bits))
    entry = first_from(points, corner)
    while entry < points.count:
        if points.key[entry] >= end:
            break
        p = points.order[entry]
        x = points.x[p]
        y = points.y[p]
        if covers(f, units_a_lattice_unit, x, y, shift_of(x, end_x), shift_of(y, end_y)):
            u = wp.float64(x) * cells_a_unit
            v = wp.float64(y) * cells_a_unit
            points.owner[p] = t
            points.difference[p] = plane_at(f, u, v) - reference_at(ground, u, v)
        entry += 1


@wp.kernel
def locate(first: wp.int32, end: wp.int32, ground: Reference, mesh: DeliveredMesh, points: MeasuredPoints):
    """Write the difference (mesh minus reference, metres) and owner of every point that triangles first .. end - 1 own.

    The points of a triangle are found by squares of the Morton curve that cover its bounding box.
    """
    one = wp.int64(1)
    point_bits = wp.int64(POINT_BITS)
    for t in range(first, end):
        f = facet_of(ground, mesh, t)
        if f.area2 > wp.int64(0):
            extent = wp.max(f.east - f.west, f.north - f.south) << point_bits
            side_bits = wp.int64(0)
            while (one << side_bits) < extent:
                side_bits += one
            x = (f.west << point_bits) >> side_bits
            y0 = (f.south << point_bits) >> side_bits
            last_x = ((f.east << point_bits) - one) >> side_bits
            last_y = ((f.north << point_bits) - one) >> side_bits
            while x <= last_x:
                y = y0
                while y <= last_y:
                    measure_square(ground, f, t, points, morton(x << side_bits, y << side_bits), side_bits)
                    y += one
                x += one
