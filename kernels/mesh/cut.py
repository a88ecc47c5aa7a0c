# SPDX-License-Identifier: GPL-3.0-or-later
"""A triangle mesh cut where a signed value at its vertices is 0; what is negative goes.

A vertex is new where an edge changes sign, one for both triangles, so no T-junction comes of it. What stays keeps its
number, but for the last ones, which fill the gaps: only what a cut touches costs time.
"""

import warp as wp

from ..unchecked import has_near_corner

wp.set_module_options({"enable_backward": False})


@wp.struct
class Cut:
    """A welded mesh in arrays with room behind what they hold."""

    corner_verts: wp.array(dtype=wp.int32)
    corner_edges: wp.array(dtype=wp.int32)
    edges: wp.array(dtype=wp.vec2i)
    value: wp.array(dtype=wp.float64)  # of each vertex of a listed triangle
    listed: wp.array(dtype=wp.int32)  # triangles that are cut, left out or use what may move, and new ones
    ends: wp.array(dtype=wp.vec2i)  # of each new vertex' edge: the positive end and the negative one
    parent: wp.array(dtype=wp.int32)  # of each new triangle
    gone: wp.array(dtype=wp.uint8, ndim=2)  # [VERTEX .. TRIANGLE, number]: 1 where it goes
    doomed: wp.array(dtype=wp.int32, ndim=2)  # ... and the numbers for which that has ever been 1
    moved: wp.array(dtype=wp.int32, ndim=2)  # ... and to where those behind the new end move, -1 for those that go
    counts: wp.array(dtype=wp.int32)  # [COUNTS]


VERTEX, EDGE, TRIANGLE = wp.constant(0), wp.constant(1), wp.constant(2)
LISTED = wp.constant(3)  # counts[kind] is how many there are, counts[LISTED] how many triangles are listed
DOOMED = wp.constant(4)  # counts[DOOMED + kind]
END = wp.constant(7)  # counts[END + kind]: how many stay
COUNTS = 10


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
    """Triangles from `first` to `end` that have a vertex in `near`, to listed[first ..]; found[slot] is how many."""
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
    """Flag a triangle whose middle is in a cell with a sample that is not valid.

    `corner`: the raster's south-western one; `columns`, `rows`: its samples.
    """
    t = offset + wp.tid()
    x = wp.float64(0.0)
    y = wp.float64(0.0)
    for c in range(3):
        p = positions[corner_verts[3 * t + c]]
        x += wp.float64(p[0]) - corner[0]
        y += wp.float64(p[1]) - corner[1]
    i = wp.clamp(wp.int32(x / (wp.float64(3.0) * step[0])), 0, columns - 2)
    j = wp.clamp(wp.int32(y / (wp.float64(3.0) * step[1])), 0, rows - 2)
    at = wp.int64(j) * wp.int64(columns) + wp.int64(i)
    above = at + wp.int64(columns)
    one = wp.int64(1)
    if wp.min(wp.min(valid[at], valid[at + one]), wp.min(valid[above], valid[above + one])) == wp.uint8(0):
        flags[t] = wp.uint8(1)


@wp.kernel
def put_on_line(tolerance: wp.float64, m: Cut):
    """A vertex that is nearer to where an edge would be cut than this part of the edge is on the line: no sliver."""
    for i in range(m.counts[LISTED]):
        o = 3 * m.listed[i]
        for c in range(3):
            p = m.corner_verts[o + c]
            q = m.corner_verts[o + (c + 1) % 3]
            a = m.value[p]
            b = m.value[q]
            if (a < wp.float64(0.0) and b > wp.float64(0.0)) or (a > wp.float64(0.0) and b < wp.float64(0.0)):
                part = a / (a - b)
                if part < tolerance:
                    m.value[p] = wp.float64(0.0)
                elif wp.float64(1.0) - part < tolerance:
                    m.value[q] = wp.float64(0.0)


@wp.func
def doom(m: Cut, kind: wp.int32, number: wp.int32):
    """Whatever is not used by a triangle that stays will go."""
    if m.gone[kind, number] == wp.uint8(0):
        m.gone[kind, number] = wp.uint8(1)
        at = m.counts[DOOMED + kind]
        m.doomed[kind, at] = number
        m.counts[DOOMED + kind] = at + 1


@wp.func
def doom_triangle(m: Cut, t: wp.int32):
    doom(m, TRIANGLE, t)
    for c in range(3):
        doom(m, VERTEX, m.corner_verts[3 * t + c])
        doom(m, EDGE, m.corner_edges[3 * t + c])


@wp.func
def added(m: Cut, kind: wp.int32) -> wp.int32:
    """The number of one more."""
    number = m.counts[kind]
    m.counts[kind] = number + 1
    return number


@wp.func
def cut_point(m: Cut, first: wp.int32, e: wp.int32, p: wp.int32, q: wp.int32) -> wp.int32:
    """The vertex where edge e from p (positive) to q (negative) is cut; whoever comes first makes it, in place of q."""
    a = m.edges[e][0]
    b = m.edges[e][1]
    n = a + b - p
    if n == q:
        n = added(m, VERTEX)
        m.ends[n - first] = wp.vec2i(p, q)
        if a == q:
            m.edges[e] = wp.vec2i(n, b)
        else:
            m.edges[e] = wp.vec2i(a, n)
    return n


@wp.func
def new_edge(m: Cut, p: wp.int32, q: wp.int32) -> wp.int32:
    e = added(m, EDGE)
    m.edges[e] = wp.vec2i(p, q)
    return e


@wp.func
def put_triangle(m: Cut, t: wp.int32, v: wp.vec3i, e: wp.vec3i):
    for c in range(3):
        m.corner_verts[3 * t + c] = v[c]
        m.corner_edges[3 * t + c] = e[c]


@wp.func
def cut_triangle(m: Cut, t: wp.int32, first_vertex: wp.int32, first_triangle: wp.int32):
    """Keep what is positive of a triangle that has a positive and a negative corner: a triangle or two."""
    o = 3 * t
    # Corner a is alone on its side of the line; b and c follow counter-clockwise.
    k = wp.int32(0)
    negative = wp.int32(0)
    for i in range(3):
        if m.value[m.corner_verts[o + i]] < wp.float64(0.0):
            negative += 1
    for i in range(3):
        s = m.value[m.corner_verts[o + i]]
        if (negative == 1 and s < wp.float64(0.0)) or (negative == 2 and s > wp.float64(0.0)):
            k = i
    a = m.corner_verts[o + k]
    b = m.corner_verts[o + (k + 1) % 3]
    c = m.corner_verts[o + (k + 2) % 3]
    ab = m.corner_edges[o + k]
    bc = m.corner_edges[o + (k + 1) % 3]
    ca = m.corner_edges[o + (k + 2) % 3]
    if negative == 2:
        p = cut_point(m, first_vertex, ab, a, b)
        q = cut_point(m, first_vertex, ca, a, c)
        doom(m, VERTEX, b)
        doom(m, VERTEX, c)
        doom(m, EDGE, bc)
        put_triangle(m, t, wp.vec3i(a, p, q), wp.vec3i(ab, new_edge(m, p, q), ca))
        return
    doom(m, VERTEX, a)
    if m.value[b] == wp.float64(0.0):
        q = cut_point(m, first_vertex, ca, c, a)
        doom(m, EDGE, ab)
        put_triangle(m, t, wp.vec3i(b, c, q), wp.vec3i(bc, ca, new_edge(m, q, b)))
    elif m.value[c] == wp.float64(0.0):
        p = cut_point(m, first_vertex, ab, b, a)
        doom(m, EDGE, ca)
        put_triangle(m, t, wp.vec3i(p, b, c), wp.vec3i(ab, bc, new_edge(m, c, p)))
    else:
        p = cut_point(m, first_vertex, ab, b, a)
        q = cut_point(m, first_vertex, ca, c, a)
        across = new_edge(m, p, c)
        put_triangle(m, t, wp.vec3i(p, b, c), wp.vec3i(ab, bc, across))
        other = added(m, TRIANGLE)
        m.parent[other - first_triangle] = t
        m.listed[added(m, LISTED)] = other
        put_triangle(m, other, wp.vec3i(p, c, q), wp.vec3i(across, ca, new_edge(m, q, p)))


@wp.kernel
def cut(m: Cut):
    """Cut every listed triangle; one serial thread, as all that follow."""
    first_vertex = m.counts[VERTEX]
    first_triangle = m.counts[TRIANGLE]
    listed = m.counts[LISTED]  # those that come meanwhile are cut already
    for i in range(listed):
        t = m.listed[i]
        if m.gone[TRIANGLE, t] == wp.uint8(0):
            positive = wp.int32(0)
            negative = wp.int32(0)
            for c in range(3):
                s = m.value[m.corner_verts[3 * t + c]]
                if s > wp.float64(0.0):
                    positive += 1
                elif s < wp.float64(0.0):
                    negative += 1
            if negative > 0 and positive > 0:
                cut_triangle(m, t, first_vertex, first_triangle)
            elif negative > 0:
                doom_triangle(m, t)


@wp.kernel
def drop(flagged: wp.array(dtype=wp.uint8), m: Cut):
    """Leave out the listed triangles that are flagged."""
    for i in range(m.counts[LISTED]):
        if flagged[m.listed[i]] != wp.uint8(0):
            doom_triangle(m, m.listed[i])


@wp.func
def fill_gaps(m: Cut, kind: wp.int32):
    """Have the last of those that stay moved to where others go."""
    total = m.counts[kind]
    end = total
    for i in range(m.counts[DOOMED + kind]):
        end -= wp.int32(m.gone[kind, m.doomed[kind, i]])
    m.counts[END + kind] = end
    i = wp.int32(0)
    for number in range(end, total):
        m.moved[kind, number - end] = -1
        if m.gone[kind, number] == wp.uint8(0):
            gap = m.doomed[kind, i]
            while gap >= end or m.gone[kind, gap] == wp.uint8(0):
                i += 1
                gap = m.doomed[kind, i]
            m.moved[kind, number - end] = gap
            i += 1


@wp.kernel
def close(m: Cut):
    """What a triangle that stays uses stays; the rest is left out."""
    for i in range(m.counts[LISTED]):
        t = m.listed[i]
        if m.gone[TRIANGLE, t] == wp.uint8(0):
            for c in range(3):
                m.gone[VERTEX, m.corner_verts[3 * t + c]] = wp.uint8(0)
                m.gone[EDGE, m.corner_edges[3 * t + c]] = wp.uint8(0)
    for kind in range(3):
        fill_gaps(m, kind)


@wp.func
def renumbered(m: Cut, kind: wp.int32, number: wp.int32) -> wp.int32:
    at = number - m.counts[END + kind]
    if at >= 0:
        return m.moved[kind, at]
    return number


@wp.kernel
def fill(m: Cut):
    """Move what is to fill gaps, and say so in the listed triangles: no other uses any of it."""
    for i in range(m.counts[LISTED]):
        t = m.listed[i]
        if m.gone[TRIANGLE, t] == wp.uint8(0):
            for c in range(3):
                e = m.corner_edges[3 * t + c]
                m.edges[e] = wp.vec2i(renumbered(m, VERTEX, m.edges[e][0]), renumbered(m, VERTEX, m.edges[e][1]))
                m.corner_edges[3 * t + c] = renumbered(m, EDGE, e)
                m.corner_verts[3 * t + c] = renumbered(m, VERTEX, m.corner_verts[3 * t + c])
    end = m.counts[END + EDGE]
    for i in range(m.counts[EDGE] - end):
        to = m.moved[EDGE, i]
        if to >= 0:
            m.edges[to] = m.edges[end + i]
    end = m.counts[END + TRIANGLE]
    for i in range(m.counts[TRIANGLE] - end):
        to = m.moved[TRIANGLE, i]
        if to >= 0:
            for c in range(3):
                m.corner_verts[3 * to + c] = m.corner_verts[3 * (end + i) + c]
                m.corner_edges[3 * to + c] = m.corner_edges[3 * (end + i) + c]
