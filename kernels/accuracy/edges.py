# SPDX-License-Identifier: GPL-3.0-or-later
"""The edges of a mesh, cell by cell: they and the samples have every extremum of mesh minus bilinear reference.

Over one cell the reference is a saddle, so its difference from a plane has extrema only on the border of the part of
the cell that a triangle covers. Along cell borders both are straight; along a triangle's edge the difference is a
parabola in each cell. For a bicubic reference the difference is a polynomial of degree six there, and with detail it is
no polynomial: both are evaluated at PLACES points of each stretch. Heights are metres after vertical scaling.

`ground` is the reference surface. A triangle f (MeasuredFacet) has its corners (x, y) in lattice units, of which a cell
has 2^bits a side.

A *stretch* of an edge is its part in one cell, `from_` to `to` (0 .. 1 along the edge); line_x and line_y are the
numbers of the next grid lines that the edge meets.
"""

import warp as wp

from .facets import DeliveredMesh, MeasuredFacet, Reference, facet_of, plane_at, reference_at

PLACES = wp.constant(8)  # points of a stretch on a curved reference


@wp.struct
class Stretch:
    """Part of a triangle's edge inside one cell, where mesh minus bilinear reference is a parabola.

    A curved reference leaves `turn` and `difference` unset.
    """

    from_: wp.float64  # along the edge, 0 .. 1
    to: wp.float64
    turn: wp.float64  # where the parabola turns, along the edge; its middle if it does not turn
    difference: wp.float64  # mesh minus reference at `to`, metres
    line_x: wp.int64  # numbers of the next grid lines that the edge meets
    line_y: wp.int64


@wp.func
def next_line(at: wp.int64, step: wp.int64, bits: wp.int64) -> wp.int64:
    """Return the number of the first grid line beyond the lattice coordinate `at`, in the direction of `step`.

    Grid lines are 2^bits units apart.
    """
    line = (at >> bits) + wp.int64(1)
    if step < wp.int64(0):  # the line before `at`, which may be on a line itself
        line = -((-at) >> bits) - wp.int64(1)
    return line


@wp.func
def on_edge(ground: Reference, f: MeasuredFacet, k: wp.int32, along: wp.float64):
    """Return a point of edge k of a triangle as cells east and north (u, v).

    `along`: 0 at corner k, 1 at the next corner.
    """
    n = (k + 1) % 3
    per_unit = wp.float64(1.0) / wp.float64(wp.int64(1) << wp.int64(ground.bits))
    u = (wp.float64(f.x[k]) + along * wp.float64(f.x[n] - f.x[k])) * per_unit
    v = (wp.float64(f.y[k]) + along * wp.float64(f.y[n] - f.y[k])) * per_unit
    return u, v


@wp.func
def difference_at(ground: Reference, f: MeasuredFacet, u: wp.float64, v: wp.float64) -> wp.float64:
    """Return the height of the mesh minus that of the reference surface at (u, v) cells, metres."""
    return plane_at(f, u, v) - reference_at(ground, u, v)


@wp.func
def turning_point(e0: wp.float64, e1: wp.float64, e2: wp.float64) -> wp.float64:
    """Return where the parabola through (0, e0), (1/2, e1), (1, e2) turns, 1/2 if it does not turn between 0 and 1."""
    curvature = wp.float64(2.0) * (e0 + e2 - wp.float64(2.0) * e1)
    slope = e2 - e0 - curvature
    turn = wp.float64(0.5)
    if slope * curvature < wp.float64(0.0) and wp.abs(slope) < wp.float64(2.0) * wp.abs(curvature):
        turn = -slope / (wp.float64(2.0) * curvature)
    return turn


@wp.func
def empty_stretch(ground: Reference, f: MeasuredFacet, k: wp.int32) -> Stretch:
    """Return the empty stretch at the start of edge k, from which `next_stretch` goes on.

    Edge k runs from corner k to the next corner.
    """
    n = (k + 1) % 3
    s = Stretch()
    u, v = on_edge(ground, f, k, wp.float64(0.0))
    s.difference = difference_at(ground, f, u, v)
    s.line_x = next_line(f.x[k], f.x[n] - f.x[k], wp.int64(ground.bits))
    s.line_y = next_line(f.y[k], f.y[n] - f.y[k], wp.int64(ground.bits))
    return s


@wp.func
def meets_line(at: wp.int64, step: wp.int64, line: wp.int64, bits: wp.int64) -> wp.float64:
    """Return where along an edge (0 .. 1) it meets a grid line; 2 if it is parallel to the line.

    at, step: the edge's begin and vector along one axis, lattice units. line: number of the grid line; lines are 2^bits
    units apart.
    """
    along = wp.float64(2.0)
    if step != wp.int64(0):
        along = wp.float64((line << bits) - at) / wp.float64(step)
    return along


@wp.func
def next_stretch(ground: Reference, f: MeasuredFacet, k: wp.int32, s: Stretch) -> Stretch:
    """Return the stretch of edge k of triangle f after stretch `s`, up to the next grid line or the end of the edge.

    On a bilinear reference it also receives the position `turn` at which mesh minus reference has its extremum.
    """
    n = (k + 1) % 3
    dx = f.x[n] - f.x[k]
    dy = f.y[n] - f.y[k]
    meets_x = meets_line(f.x[k], dx, s.line_x, wp.int64(ground.bits))
    meets_y = meets_line(f.y[k], dy, s.line_y, wp.int64(ground.bits))
    s.from_ = s.to
    s.to = wp.min(wp.float64(1.0), wp.min(meets_x, meets_y))
    if meets_x <= s.to:
        s.line_x += wp.where(dx < wp.int64(0), wp.int64(-1), wp.int64(1))
    if meets_y <= s.to:
        s.line_y += wp.where(dy < wp.int64(0), wp.int64(-1), wp.int64(1))
    if ground.curved == 0:
        e0 = s.difference
        u, v = on_edge(ground, f, k, wp.float64(0.5) * (s.from_ + s.to))
        e1 = difference_at(ground, f, u, v)
        u, v = on_edge(ground, f, k, s.to)
        s.difference = difference_at(ground, f, u, v)
        s.turn = s.from_ + turning_point(e0, e1, s.difference) * (s.to - s.from_)
    return s


@wp.func
def num_points(ground: Reference) -> wp.int32:
    """Return the number of points at which a stretch is evaluated.

    A curved reference needs more: its extrema have no closed form.
    """
    return wp.where(ground.curved == 1, PLACES, 2)


@wp.func
def point_of_stretch(ground: Reference, f: MeasuredFacet, k: wp.int32, s: Stretch, q: wp.int32):
    """Return point q (1 .. `num_points`, the last at the end) of a stretch of edge k, as cells east and north.

    On a bilinear reference there are two points: where mesh minus reference turns, and the end.
    """
    along = wp.where(q == 1, s.turn, s.to)
    if ground.curved == 1:
        along = s.from_ + (s.to - s.from_) * (wp.float64(q) / wp.float64(PLACES))
    u, v = on_edge(ground, f, k, along)
    return u, v


@wp.func
def rounding_at_corner(ground: Reference, f: MeasuredFacet, k: wp.int32, position: wp.vec3f) -> wp.float64:
    """Bound the height, metres, by which float32 rounding has moved corner k of triangle f off the reference surface.

    It has two parts: the rounding of x and y, times the slope of the triangle, and the rounding of z. Both together are
    measured, unless z is off the surface by more than rounding explains; then half a float32 step stands for its part.
    position: the corner as delivered, metres.
    """
    u, v = on_edge(ground, f, k, wp.float64(0.0))  # the corner's lattice point: x and y before rounding
    z = wp.float64(position[2])
    by_plane = plane_at(f, u, v) - z  # by the rounding of x and y
    by_height = z - reference_at(ground, u, v)  # by that of z
    float_bits = wp.cast(wp.abs(position[2]), wp.int32)
    # half of the distance to the next float32
    half_ulp = wp.float64(0.5) * (wp.float64(wp.cast(float_bits + 1, wp.float32)) - wp.abs(z))
    moved = wp.abs(by_plane + by_height)
    if wp.abs(by_height) > half_ulp * wp.float64(1.001):  # it was off the surface before rounding, as in a fitted mesh
        moved = wp.abs(by_plane) + half_ulp
    return moved


@wp.kernel
def raise_to_maxima(
    first: wp.int32,
    end: wp.int32,
    ground: Reference,
    mesh: DeliveredMesh,
    worst: wp.array(dtype=wp.float64),
    rounding: wp.array(dtype=wp.float64),
):
    """Raise worst[t] of triangles first .. end - 1 to the largest |mesh - reference surface| along their edges, metres.

    Write to rounding[t] a bound of the height by which float32 has moved a corner, metres. Triangles that cover nothing
    keep worst[t] and have a rounding of 0.
    """
    for t in range(first, end):
        f = facet_of(ground, mesh, t)
        largest = worst[t]
        moved = wp.float64(0.0)
        if f.area2 > wp.int64(0):
            for k in range(3):
                moved = wp.max(moved, rounding_at_corner(ground, f, k, mesh.positions[mesh.corners[3 * t + k]]))
                s = empty_stretch(ground, f, k)
                while s.to < wp.float64(1.0):
                    s = next_stretch(ground, f, k, s)
                    for q in range(1, num_points(ground) + 1):
                        u, v = point_of_stretch(ground, f, k, s, q)
                        largest = wp.max(largest, wp.abs(difference_at(ground, f, u, v)))
        worst[t] = largest
        rounding[t] = moved
