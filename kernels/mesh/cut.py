# SPDX-License-Identifier: GPL-3.0-or-later
"""Cut of a triangle mesh where a signed value at its vertices is 0; the negative part is removed.

An edge that changes sign gets one new vertex, which both of its triangles share, so the cut makes no T-junctions.
Remaining elements keep their numbers, except that the last ones move into the gaps. So the cost depends only on the
elements that a cut touches. `m`: the mesh that is cut: `m.listed` has the counts[LISTED] triangles near the cut,
`m.removed[kind, number]` marks vertices, edges and triangles, and `m.counts[kind]` is their number.
"""

import warp as wp

from ..field.holes import is_whole
from ..unchecked import has_near_corner


@wp.struct
class Cut:
    """A welded mesh in arrays with room for new elements at their ends."""

    corner_verts: wp.array(dtype=wp.int32)  # [3 triangles]
    corner_edges: wp.array(dtype=wp.int32)  # [3 triangles]: the edge from each corner to the next
    edges: wp.array(dtype=wp.vec2i)  # ends of each edge
    value: wp.array(dtype=wp.float64)  # of each vertex of a listed triangle
    listed: wp.array(dtype=wp.int32)  # triangles that are cut, removed, new, or may use moved elements
    ends: wp.array(dtype=wp.vec2i)  # positive and negative end of each new vertex' edge
    parent: wp.array(dtype=wp.int32)  # of each new triangle
    removed: wp.array(dtype=wp.uint8, ndim=2)  # [VERTEX .. TRIANGLE, number]: 1 if it is removed
    counts: wp.array(dtype=wp.int32)  # [VERTEX .. LISTED]: number of each, and of listed triangles


VERTEX, EDGE, TRIANGLE, LISTED = wp.constant(0), wp.constant(1), wp.constant(2), wp.constant(3)


@wp.kernel
def list_near(
    first: wp.int32,
    end: wp.int32,
    slot: wp.int32,
    near: wp.array(dtype=wp.uint8),
    corner_verts: wp.array(dtype=wp.int32),
    listed: wp.array(dtype=wp.int32),
    found: wp.array(dtype=wp.int32),
):
    """List triangles first .. end - 1 that have a vertex in `near`, from listed[first] on.

    found[slot] becomes their number. near: 1 for each vertex close to the cut. corner_verts: vertices of each
    triangle's three corners. The caller joins the lists of its slots.
    """
    n = first
    for t in range(first, end):
        if has_near_corner(near, corner_verts, t):
            listed[n] = t
            n += 1
    found[slot] = n - first


@wp.kernel
def flag_holes(
    offset: int,
    corner: wp.vec2d,
    step: wp.vec2d,
    columns: int,
    rows: int,
    positions: wp.array(dtype=wp.vec3f),
    corner_verts: wp.array(dtype=wp.int32),
    valid: wp.array(dtype=wp.uint8),
    flags: wp.array(dtype=wp.uint8),
):
    """Set flags[t] to 1 if the middle of triangle t = offset + tid is in a raster cell with a missing sample.

    corner: the raster's south-western corner, metres. step: metres between samples, of which there are `columns` x
    `rows`. valid: 0 for missing samples. positions [V], corner_verts [3 T]: the mesh's.
    """
    t = offset + wp.tid()
    x = wp.float64(0.0)  # sums over the three corners, from the raster's corner
    y = wp.float64(0.0)
    for c in range(3):
        p = positions[corner_verts[3 * t + c]]
        x += wp.float64(p[0]) - corner[0]
        y += wp.float64(p[1]) - corner[1]
    i = wp.clamp(wp.int32(x / (wp.float64(3.0) * step[0])), 0, columns - 2)
    j = wp.clamp(wp.int32(y / (wp.float64(3.0) * step[1])), 0, rows - 2)
    if not is_whole(valid, columns, i, j):
        flags[t] = wp.uint8(1)


@wp.func
def tolerance_along(tolerance: wp.float64, p: wp.vec3f, q: wp.vec3f) -> wp.float64:
    """Return the tolerance of a position on the edge p q, as a fraction of the edge's length in plan.

    tolerance: relative to the largest coordinate of p and q.
    """
    largest = wp.max(wp.max(wp.abs(p[0]), wp.abs(p[1])), wp.max(wp.abs(q[0]), wp.abs(q[1])))
    x = wp.float64(q[0]) - wp.float64(p[0])
    y = wp.float64(q[1]) - wp.float64(p[1])
    return tolerance * wp.float64(largest) / wp.sqrt(x * x + y * y)


@wp.kernel
def snap_to_line(tolerance: wp.float64, positions: wp.array(dtype=wp.vec3f), m: Cut):
    """Set a vertex's signed value to 0 if the cut of one of its edges is nearer to it than float32 positions resolve.

    The mesh is cut where the values are 0. One thread. tolerance: rounding of a position, relative to the largest
    coordinate. m: the mesh with its values.
    """
    for i in range(m.counts[LISTED]):
        o = 3 * m.listed[i]
        for c in range(3):
            p = m.corner_verts[o + c]
            q = m.corner_verts[o + (c + 1) % 3]
            at_p = m.value[p]
            at_q = m.value[q]
            # The edge is cut.
            if (at_p < wp.float64(0.0) and at_q > wp.float64(0.0)) or (
                at_p > wp.float64(0.0) and at_q < wp.float64(0.0)
            ):
                fraction = at_p / (at_p - at_q)
                if wp.min(fraction, wp.float64(1.0) - fraction) < tolerance_along(
                    tolerance, positions[p], positions[q]
                ):
                    m.value[wp.where(fraction < wp.float64(0.5), p, q)] = wp.float64(0.0)


@wp.func
def remove_triangle(m: Cut, t: wp.int32):
    """Mark triangle t, its vertices and its edges as removed; `keep_used` clears the marks that others still need."""
    m.removed[TRIANGLE, t] = wp.uint8(1)
    for c in range(3):
        m.removed[VERTEX, m.corner_verts[3 * t + c]] = wp.uint8(1)
        m.removed[EDGE, m.corner_edges[3 * t + c]] = wp.uint8(1)


@wp.func
def next_number(m: Cut, kind: wp.int32) -> wp.int32:
    """Return the number of a new element and count it.

    kind: VERTEX, EDGE, TRIANGLE or LISTED (an entry of the list).
    """
    number = m.counts[kind]
    m.counts[kind] = number + 1
    return number


@wp.func
def cut_point(m: Cut, first: wp.int32, e: wp.int32, p: wp.int32, q: wp.int32) -> wp.int32:
    """Return the vertex at which edge e from p (positive) to q (negative) is cut.

    The first call makes it and puts it in place of q in the edge; the call for the edge's other triangle finds it in
    the edge. Its position is computed by the caller of the kernel, from `m.ends`. first: the first number of vertices
    that this cut makes.
    """
    a = m.edges[e][0]
    b = m.edges[e][1]
    new = a + b - p  # the end of e that is not p
    if new == q:  # the edge is not cut yet
        new = next_number(m, VERTEX)
        m.ends[new - first] = wp.vec2i(p, q)
        if a == q:
            m.edges[e] = wp.vec2i(new, b)
        else:
            m.edges[e] = wp.vec2i(a, new)
    return new


@wp.func
def put_triangle(m: Cut, t: wp.int32, v: wp.vec3i, e: wp.vec3i):
    """Write triangle t with vertices v and edges e, not removed."""
    m.removed[TRIANGLE, t] = wp.uint8(0)
    for c in range(3):
        m.corner_verts[3 * t + c] = v[c]
        m.corner_edges[3 * t + c] = e[c]


@wp.func
def clip(m: Cut, t: wp.int32, first_vertex: wp.int32, first_triangle: wp.int32):
    """Replace triangle t, whose corners have values of both signs, by its non-negative part: one or two triangles.

    This is the polygon clipping of Sutherland and Hodgman (1974). The part is written to t, and the second triangle
    behind all others and to the list, with t as its parent. first_vertex, first_triangle: first numbers that this cut
    makes.
    """
    v = wp.vec4i()  # corners of the non-negative part, counter-clockwise
    e = wp.vec4i()  # ... and the edge from each to the next
    num_corners = wp.int32(0)
    line = next_number(m, EDGE)  # the new edge along the cut
    for i in range(3):
        p = m.corner_verts[3 * t + i]
        q = m.corner_verts[3 * t + (i + 1) % 3]
        edge = m.corner_edges[3 * t + i]
        at_p = m.value[p]
        at_q = m.value[q]
        if at_p >= wp.float64(0.0):  # the corner stays
            v[num_corners] = p
            e[num_corners] = wp.where(at_p == wp.float64(0.0) and at_q < wp.float64(0.0), line, edge)
            num_corners += 1
        if at_p > wp.float64(0.0) and at_q < wp.float64(0.0):  # the edge leaves the part
            v[num_corners] = cut_point(m, first_vertex, edge, p, q)
            e[num_corners] = line
            num_corners += 1
        if at_p < wp.float64(0.0) and at_q > wp.float64(0.0):  # the edge enters the part
            v[num_corners] = cut_point(m, first_vertex, edge, q, p)
            e[num_corners] = edge
            num_corners += 1
    k = wp.int32(0)
    for i in range(num_corners):
        if e[i] == line:
            k = i
    # The new edge is from corner v[k] to v[a]; the other corners follow.
    a = (k + 1) % num_corners
    b = (k + 2) % num_corners
    m.edges[line] = wp.vec2i(v[k], v[a])
    if num_corners == 3:
        put_triangle(m, t, wp.vec3i(v[k], v[a], v[b]), wp.vec3i(line, e[a], e[b]))
    else:  # four corners: two triangles with a new edge between them
        c = (k + 3) % num_corners
        across = next_number(m, EDGE)
        m.edges[across] = wp.vec2i(v[a], v[c])
        put_triangle(m, t, wp.vec3i(v[a], v[b], v[c]), wp.vec3i(e[a], e[b], across))
        other = next_number(m, TRIANGLE)
        m.parent[other - first_triangle] = t
        m.listed[next_number(m, LISTED)] = other
        put_triangle(m, other, wp.vec3i(v[a], v[c], v[k]), wp.vec3i(across, e[c], line))


@wp.kernel
def cut(m: Cut):
    """Cut every listed triangle where the signed values at its vertices are 0; the negative part is removed.

    One thread. New elements are appended. Elements to be removed are only marked, those still needed among them:
    `keep_used` follows.
    """
    first_vertex = m.counts[VERTEX]
    first_triangle = m.counts[TRIANGLE]
    listed = m.counts[LISTED]  # triangles that `clip` adds are cut already
    for i in range(listed):
        t = m.listed[i]
        if m.removed[TRIANGLE, t] == wp.uint8(0):
            lowest = wp.float64(wp.inf)
            highest = -wp.float64(wp.inf)
            for c in range(3):
                value = m.value[m.corner_verts[3 * t + c]]
                lowest = wp.min(lowest, value)
                highest = wp.max(highest, value)
            if lowest < wp.float64(0.0):
                remove_triangle(m, t)
                if highest > wp.float64(0.0):
                    clip(m, t, first_vertex, first_triangle)


@wp.kernel
def remove_flagged(flagged: wp.array(dtype=wp.uint8), m: Cut):
    """Remove the listed triangles that are flagged; `keep_used` keeps vertices and edges that others still use.

    One thread. flagged: 1 for each triangle to remove.
    """
    for i in range(m.counts[LISTED]):
        if flagged[m.listed[i]] != wp.uint8(0):
            remove_triangle(m, m.listed[i])


@wp.kernel
def keep_used(m: Cut):
    """Clear the marks of vertices and edges that remaining triangles use, so that only unused ones are removed.

    One thread. Listed triangles suffice: every triangle that shares a vertex with a removed one is listed.
    """
    for i in range(m.counts[LISTED]):
        t = m.listed[i]
        if m.removed[TRIANGLE, t] == wp.uint8(0):
            for c in range(3):
                m.removed[VERTEX, m.corner_verts[3 * t + c]] = wp.uint8(0)
                m.removed[EDGE, m.corner_edges[3 * t + c]] = wp.uint8(0)


@wp.func
def new_number(number: wp.int32, end: wp.int32, moved: wp.array(dtype=wp.int32)) -> wp.int32:
    """Return the new number of an element: moved[number - end] if it was at or behind `end`, otherwise its old one."""
    if number >= end:
        return moved[number - end]
    return number


@wp.kernel
def renumber(
    m: Cut,
    vertices: wp.int32,
    edges: wp.int32,
    moved_vertices: wp.array(dtype=wp.int32),
    moved_edges: wp.array(dtype=wp.int32),
):
    """Replace the numbers of vertices and edges that were moved into gaps, in the listed triangles that remain.

    All triangles with such a vertex or edge are listed. A shared edge is visited twice, which changes nothing: new
    numbers are smaller than `vertices`. One thread. vertices, edges: how many remain. moved_vertices, moved_edges: new
    numbers of the elements with the old numbers `vertices`, `vertices` + 1 .. or `edges`, `edges` + 1 .. The ends of
    edges are renumbered in place: the caller moves the edges and vertices themselves afterwards.
    """
    for i in range(m.counts[LISTED]):
        t = m.listed[i]
        if m.removed[TRIANGLE, t] == wp.uint8(0):
            for c in range(3):
                e = m.corner_edges[3 * t + c]
                ends = m.edges[e]
                p = new_number(ends[0], vertices, moved_vertices)
                m.edges[e] = wp.vec2i(p, new_number(ends[1], vertices, moved_vertices))
                m.corner_edges[3 * t + c] = new_number(e, edges, moved_edges)
                m.corner_verts[3 * t + c] = new_number(m.corner_verts[3 * t + c], vertices, moved_vertices)
