# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshlets: each leaf becomes 4^m triangles by a template of 2m bisections.

An even number of bisections puts 2^m segments on each of the three edges, so neighbours of any depth match. Points on
an edge belong to the edge and are made once, in its own direction, from integers: the same for both leaves.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Template:
    """What one leaf becomes, by classes: 0 a corner of the leaf, 1 a place on one of its edges, 2 inside."""

    segments: wp.int32  # n = 2^m on an edge
    triangles: wp.int32
    points: wp.int32
    lines: wp.int32
    inner_points: wp.int32
    inner_lines: wp.int32
    corners: wp.array(dtype=wp.int32)  # [triangles * 3] into points: left, apex, right
    sides: wp.array(dtype=wp.int32)  # [triangles * 3] into lines
    point_class: wp.array(dtype=wp.vec3i)  # class; which corner, edge or inner point; place on the edge
    line_class: wp.array(dtype=wp.vec3i)
    weights: wp.array(dtype=wp.vec3i)  # inner points: barycentric, in n-ths
    ends: wp.array(dtype=wp.vec2i)  # inner lines, into points


@wp.struct
class Mesh:
    """A welded mesh, on either side of the expansion."""

    vertices: wp.int32
    edge_count: wp.int32
    point: wp.array(dtype=wp.vec2i)
    corner_verts: wp.array(dtype=wp.int32)
    corner_edges: wp.array(dtype=wp.int32)
    edges: wp.array(dtype=wp.vec2i)
    level: wp.array(dtype=wp.int32)


@wp.kernel
def expand_edges(offset: wp.int32, n: wp.int32, source: Mesh, out: Mesh):
    """The points and segments on each edge."""
    e = wp.tid() + offset
    a = source.edges[e][0]
    b = source.edges[e][1]
    p = source.point[a]
    q = source.point[b]
    first = source.vertices + e * (n - 1)
    behind = a
    for j in range(1, n):
        # exact: a lattice unit is fine enough for every segment
        x = wp.int32((wp.int64(p[0]) * wp.int64(n - j) + wp.int64(q[0]) * wp.int64(j)) / wp.int64(n))
        y = wp.int32((wp.int64(p[1]) * wp.int64(n - j) + wp.int64(q[1]) * wp.int64(j)) / wp.int64(n))
        out.point[first + j - 1] = wp.vec2i(x, y)
        out.edges[e * n + j - 1] = wp.vec2i(behind, first + j - 1)
        behind = first + j - 1
    out.edges[e * n + n - 1] = wp.vec2i(behind, b)


@wp.func
def pick(which: wp.int32, a: wp.int32, b: wp.int32, c: wp.int32) -> wp.int32:
    r = a
    if which == 1:
        r = b
    elif which == 2:
        r = c
    return r


@wp.kernel
def expand_leaves(
    first: wp.int32,
    end: wp.int32,
    scratch: wp.int32,
    t: Template,
    source: Mesh,
    out: Mesh,
    levels: wp.int32,
    point_number: wp.array(dtype=wp.int32),
    line_number: wp.array(dtype=wp.int32),
):
    """The triangles of leaves first .. end, serially; `scratch` is where this slice's numbers of one template begin."""
    n = t.segments
    for leaf in range(first, end):
        odd = source.level[leaf] & 1
        o = 3 * leaf
        v0 = source.corner_verts[o]
        v1 = source.corner_verts[o + 1]
        v2 = source.corner_verts[o + 2]
        e0 = source.corner_edges[o]
        e1 = source.corner_edges[o + 1]
        e2 = source.corner_edges[o + 2]
        if odd == 0:  # stored right, apex, left
            v0 = source.corner_verts[o + 2]
            v2 = source.corner_verts[o]
            e0 = source.corner_edges[o + 1]
            e1 = source.corner_edges[o]
        p0 = source.point[v0]
        p1 = source.point[v1]
        p2 = source.point[v2]
        # does each edge run the way of left - apex - right - left?
        with0 = wp.int32(0)
        with1 = wp.int32(0)
        with2 = wp.int32(0)
        if source.edges[e0][0] == v0:
            with0 = 1
        if source.edges[e1][0] == v1:
            with1 = 1
        if source.edges[e2][0] == v2:
            with2 = 1
        inner_point = source.vertices + source.edge_count * (n - 1) + leaf * t.inner_points
        inner_line = source.edge_count * n + leaf * t.inner_lines
        for k in range(t.points):
            c = t.point_class[k]
            number = inner_point + c[1]
            if c[0] == 0:
                number = pick(c[1], v0, v1, v2)
            elif c[0] == 1:
                j = c[2]
                if pick(c[1], with0, with1, with2) == 0:
                    j = n - j
                number = source.vertices + pick(c[1], e0, e1, e2) * (n - 1) + j - 1
            point_number[scratch + k] = number
        for k in range(t.lines):
            c = t.line_class[k]
            number = inner_line + c[1]
            if c[0] == 1:
                j = c[2]
                if pick(c[1], with0, with1, with2) == 0:
                    j = n - 1 - j
                number = pick(c[1], e0, e1, e2) * n + j
            line_number[scratch + k] = number
        for k in range(t.inner_points):
            b = t.weights[k]
            x = wp.int64(p0[0]) * wp.int64(b[0]) + wp.int64(p1[0]) * wp.int64(b[1]) + wp.int64(p2[0]) * wp.int64(b[2])
            y = wp.int64(p0[1]) * wp.int64(b[0]) + wp.int64(p1[1]) * wp.int64(b[1]) + wp.int64(p2[1]) * wp.int64(b[2])
            out.point[inner_point + k] = wp.vec2i(wp.int32(x / wp.int64(n)), wp.int32(y / wp.int64(n)))
        for k in range(t.inner_lines):
            ends = t.ends[k]
            out.edges[inner_line + k] = wp.vec2i(point_number[scratch + ends[0]], point_number[scratch + ends[1]])
        for k in range(t.triangles):
            q = 3 * (leaf * t.triangles + k)
            out.corner_verts[q + 1] = point_number[scratch + t.corners[3 * k + 1]]
            out.corner_edges[q + 2] = line_number[scratch + t.sides[3 * k + 2]]
            if odd == 1:
                out.corner_verts[q] = point_number[scratch + t.corners[3 * k]]
                out.corner_verts[q + 2] = point_number[scratch + t.corners[3 * k + 2]]
                out.corner_edges[q] = line_number[scratch + t.sides[3 * k]]
                out.corner_edges[q + 1] = line_number[scratch + t.sides[3 * k + 1]]
            else:
                out.corner_verts[q] = point_number[scratch + t.corners[3 * k + 2]]
                out.corner_verts[q + 2] = point_number[scratch + t.corners[3 * k]]
                out.corner_edges[q] = line_number[scratch + t.sides[3 * k + 1]]
                out.corner_edges[q + 1] = line_number[scratch + t.sides[3 * k]]
            out.level[leaf * t.triangles + k] = source.level[leaf] + levels
