# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshlets: each leaf becomes 4^m triangles by a template of 2m bisections.

An even number of bisections puts 2^m segments on each of the three edges, so neighbours of any depth match. Points on
an edge belong to the edge and are made once, in its own direction, from integers: the same for both leaves.

The template numbers a leaf's points in this order: left, apex and right corner, those between them on each side, those
inside. Side 0 runs from left to apex, 1 from apex to right, 2 from right to left. Lines likewise.
"""

import warp as wp

from ..refine.runs import NOT_CLEAR, Run
from ..unchecked import item_at, look_up, number_row, put


@wp.struct
class Template:
    """Triangles and lines of one leaf: tables of indices into the template's order of points and lines."""

    segments: wp.int32  # n = 2^m on an edge
    levels: wp.int32  # 2m bisections
    triangles: wp.int32
    points: wp.int32
    lines: wp.int32
    inner_points: wp.int32
    inner_lines: wp.int32
    corners: wp.array(dtype=wp.int32)  # [2, triangles * 3] into points: of a leaf of even depth, then of odd depth
    sides: wp.array(dtype=wp.int32)  # [2, triangles * 3] into lines
    weights: wp.array(dtype=wp.vec2i)  # inner points: n-ths of the way from left to apex and from left to right
    ends: wp.array(dtype=wp.int32)  # [inner_lines * 2] into points


@wp.struct
class WeldedMesh:
    """A welded mesh, before or after the expansion."""

    vertices: wp.int32
    edge_count: wp.int32
    point: wp.array(dtype=wp.vec2i)  # of each vertex, lattice units
    corner_verts: wp.array(dtype=wp.int32)  # [3 triangles]
    corner_edges: wp.array(dtype=wp.int32)  # [3 triangles]: the edge from each corner to the next
    edges: wp.array(dtype=wp.vec2i)  # ends of each edge
    level: wp.array(dtype=wp.int32)  # of each triangle


@wp.func
def step_along(p: wp.vec2i, q: wp.vec2i, n: wp.int32) -> wp.vec2i:
    """Return an n-th of the vector from p to q; it is exact, because segments are whole lattice units."""
    return wp.vec2i((q[0] - p[0]) / n, (q[1] - p[1]) / n)


@wp.func
def expand_edge(e: wp.int32, n: wp.int32, source: WeldedMesh, out: WeldedMesh):
    """Write the n - 1 points inside edge e of the source, and its n segments, to the expanded mesh `out`.

    Vertices of the source keep their numbers; the points follow, edge by edge, and so do segments, from 0 on.
    """
    ends = source.edges[e]
    p = source.point[ends[0]]
    step = step_along(p, source.point[ends[1]], n)
    first = source.vertices + e * (n - 1)
    previous = ends[0]
    for j in range(n - 1):
        p += step
        put(out.point, wp.int64(first + j), p)
        put(out.edges, wp.int64(e * n + j), wp.vec2i(previous, first + j))
        previous = first + j
    put(out.edges, wp.int64(e * n + n - 1), wp.vec2i(previous, ends[1]))


@wp.func
def number_side(
    s: wp.int32,
    v: wp.int32,
    e: wp.int32,
    t: Template,
    source: WeldedMesh,
    numbers: wp.array(dtype=wp.int32),
    points: wp.int32,
    lines: wp.int32,
):
    """Write the numbers of the points and lines on side s of a leaf to `numbers`, in the template's order.

    The side begins at the leaf's corner v and is edge e of the source, which has v at either end. t: the template.
    points, lines: entries in `numbers` where those of the leaf begin.
    """
    n = t.segments
    first_point = source.vertices + e * (n - 1)
    first_line = e * n
    step = wp.int32(1)
    if source.edges[e][0] != v:  # the edge runs the other way
        first_point += n - 2
        first_line += n - 1
        step = -1
    number_row(numbers, points + 3 + s * (n - 1), n - 1, first_point, step)
    number_row(numbers, lines + s * n, n, first_line, step)


@wp.kernel
def expand(
    first_edge: wp.int32,
    end_edge: wp.int32,
    first_leaf: wp.int32,
    end_leaf: wp.int32,
    scratch: wp.int32,
    t: Template,
    source: WeldedMesh,
    out: WeldedMesh,
    numbers: wp.array(dtype=wp.int32),
):
    """Write points, lines and triangles of edges first_edge .. end_edge - 1 and leaves first_leaf .. end_leaf - 1.

    t: the template. source, out: the mesh before and after the expansion. numbers: scratch from entry `scratch` on, for
    the numbers of one leaf's points and lines in the template's order.
    """
    n = t.segments
    for e in range(first_edge, end_edge):
        expand_edge(e, n, source, out)
    points = scratch
    lines = scratch + t.points
    for leaf in range(first_leaf, end_leaf):
        level = source.level[leaf]
        odd = level & 1
        o = 3 * leaf
        # Corners are left, apex, right at odd depths, right, apex, left at even ones; edge k begins at corner k.
        left = o + 2 - 2 * odd
        right = o + 2 * odd
        v0 = source.corner_verts[left]
        v1 = source.corner_verts[o + 1]
        v2 = source.corner_verts[right]
        number_side(0, v0, source.corner_edges[o + 1 - odd], t, source, numbers, points, lines)
        number_side(1, v1, source.corner_edges[o + odd], t, source, numbers, points, lines)
        number_side(2, v2, source.corner_edges[o + 2], t, source, numbers, points, lines)
        numbers[points] = v0
        numbers[points + 1] = v1
        numbers[points + 2] = v2
        first_point = source.vertices + source.edge_count * (n - 1) + leaf * t.inner_points
        first_line = source.edge_count * n + leaf * t.inner_lines
        number_row(numbers, points + 3 * n, t.inner_points, first_point, 1)
        number_row(numbers, lines + 3 * n, t.inner_lines, first_line, 1)
        p = source.point[v0]
        to_apex = step_along(p, source.point[v1], n)
        to_right = step_along(p, source.point[v2], n)
        for k in range(t.inner_points):
            w = item_at(t.weights, wp.int64(k))
            put(out.point, wp.int64(first_point + k), p + to_apex * w[0] + to_right * w[1])
        # `look_up` replaces the template's numbers in a row of a table by those of the mesh. `edges` has pairs of them.
        look_up(t.ends, 0, 2 * t.inner_lines, numbers, points, out.edges, first_line)
        c = 3 * t.triangles
        look_up(t.corners, c * odd, c, numbers, points, out.corner_verts, c * leaf)
        look_up(t.sides, c * odd, c, numbers, lines, out.corner_edges, c * leaf)
        number_row(out.level, leaf * t.triangles, t.triangles, level + t.levels, 0)  # step 0: all are equal


@wp.func
def length_of(level: wp.int32) -> wp.int64:
    """Return the part of a root square's curve that a leaf of a level takes, times 2^62."""
    return wp.int64(1) << wp.int64(62 - level)


@wp.kernel
def find_common_points(
    last_leaves: wp.int32,
    leaves: wp.int32,
    last_level: wp.array(dtype=wp.int32),
    level: wp.array(dtype=wp.int32),
    last_first: wp.int32,
    first: wp.int32,
    points: wp.int32,
    runs: wp.array(dtype=Run),
    count: wp.array(dtype=wp.int64),
):
    """Write the runs of points inside leaves that this and the last mesh both have, and count[0], the number of runs.

    One thread. Levels in curve order locate every leaf: overlapping leaves of equal level are the same leaf.
    last_leaves, leaves: number of leaves of either mesh. last_level, level: their levels. points: points inside one
    leaf. last_first, first: number of the first such point of either mesh. runs: room for one per leaf of the smaller
    mesh. It is not known what footprints their points have and whether they are in the frustum, so geomorphing computes
    them again.
    """
    i = wp.int32(0)
    j = wp.int32(0)
    ahead = wp.int64(0)  # end of leaf i along the curve minus that of leaf j, in the unit of `length_of`
    num_runs = wp.int64(0)
    is_run_open = wp.bool(False)  # whether the previous leaf belongs to the last run
    if leaves > 0 and last_leaves > 0:
        ahead = length_of(level[0]) - length_of(last_level[0])
    while i < leaves and j < last_leaves:
        is_same = level[i] == last_level[j]
        if is_same:
            if not is_run_open:
                runs[num_runs].first = wp.int64(first) + wp.int64(points) * wp.int64(i)
                runs[num_runs].before = wp.int64(last_first) + wp.int64(points) * wp.int64(j)
                runs[num_runs].count = wp.int64(0)
                runs[num_runs].coarse = wp.float64(wp.inf)
                runs[num_runs].clear_below = NOT_CLEAR
                num_runs += wp.int64(1)
            runs[num_runs - wp.int64(1)].count = runs[num_runs - wp.int64(1)].count + wp.int64(points)
        is_run_open = is_same
        # Go on from the leaf that ends first, or from both.
        next_i = ahead <= wp.int64(0)
        next_j = ahead >= wp.int64(0)
        if next_i:
            i += 1
            if i < leaves:
                ahead += length_of(level[i])
        if next_j:
            j += 1
            if j < last_leaves:
                ahead -= length_of(last_level[j])
    count[0] = num_runs
