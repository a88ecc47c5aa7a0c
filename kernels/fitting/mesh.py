# SPDX-License-Identifier: GPL-3.0-or-later
"""The mesh m of a fit: welded triangles that know their neighbours, and are bisected in place.

Corners of a triangle, counter-clockwise: left, apex, right; its longest edge is the one from right to left. Arrays have
room for triangles and vertices to come. `corner_verts` [3 T] has the vertices of triangles; of a vertex, `point` is its
position in lattice units and `z` its height, metres after vertical scaling.
"""

import warp as wp

from ..field.domain import Domain
from ..leb.halfway import middle_between
from .facet import Facet, surface_height
from .raising import RaisedCodes, raise_ancestors

# States of a vertex, bits.
KNOWN = wp.constant(wp.uint8(1))  # it was in the mesh before
PINNED = wp.constant(wp.uint8(2))  # on the surface, for good
NOT_MEASURED = wp.constant(wp.float64(-1.0))  # in place of a triangle's distance, until it is measured


@wp.struct
class FitMesh:
    """A mesh whose vertices' heights are fitted."""

    domain: Domain
    snap: wp.int32  # mesh vertices are multiples of 2**snap units
    error: wp.float64  # requested error of the criterion, metres
    bound: wp.float64  # metres of distance from the surface that a triangle may have
    capacity: wp.int32  # triangles that the arrays have room for
    round: wp.int32  # number of the round: sweeps that move vertices, then splits
    corner_verts: wp.array(dtype=wp.int32)  # [3 T]
    neighbours: wp.array(dtype=wp.int32)  # [3 T] triangle across the edge from a corner to the next, -1 at the border
    level: wp.array(dtype=wp.int32)  # [T]
    worst: wp.array(dtype=wp.float64)  # [T] largest distance, metres after vertical scaling, or NOT_MEASURED
    seen: wp.array(dtype=wp.vec3f)  # [T] `z` of the corners when that was measured
    pushes: wp.array(dtype=wp.vec2f)  # [3 T] (push, weight) of each triangle on its corners
    active: wp.array(dtype=wp.int32)  # [T] the listed triangles
    marks: wp.array(dtype=wp.uint32)  # [T / 32] bits: triangles to be listed
    awake: wp.array(dtype=wp.int32)  # [T] the last round that measured it, or found it beyond the bound
    point: wp.array(dtype=wp.vec2i)  # [V] lattice units
    z: wp.array(dtype=wp.float32)  # [V] height, metres after vertical scaling
    state: wp.array(dtype=wp.uint8)  # [V] KNOWN and PINNED
    first: wp.array(dtype=wp.int32)  # [V] a triangle that has it
    push: wp.array(dtype=wp.float64)  # [2 V] sums of pushes and of weights, 0 between sweeps
    movers: wp.array(dtype=wp.int32)  # [V] the vertices that a sweep moves
    raised: RaisedCodes
    codes: wp.array(dtype=wp.uint8)  # errors that are raised with each split, see raising.py
    splitting: wp.array(dtype=wp.int32)  # scratch: triangles that are to be split
    climbing: wp.array(dtype=wp.vec3i)  # scratch: diamonds whose errors are to rise


@wp.func
def facet_of(m: FitMesh, t: wp.int32) -> Facet:
    """Return triangle t as a Facet: a plane over its legs, in metres before scaling and lattice units.

    The legs are orthogonal and equally long.
    """
    left = m.corner_verts[3 * t]
    apex = m.corner_verts[3 * t + 1]
    right = m.corner_verts[3 * t + 2]
    apex_point = m.point[apex]
    to_left = m.point[left] - apex_point
    to_right = m.point[right] - apex_point
    s = Facet()
    s.x = apex_point[0]
    s.y = apex_point[1]
    s.left_x = to_left[0]
    s.left_y = to_left[1]
    s.right_x = to_right[0]
    s.right_y = to_right[1]
    z = wp.float64(m.z[apex])
    s.z = (z - m.domain.height_offset) / m.domain.height_scale
    length2 = wp.float64(s.left_x) * wp.float64(s.left_x) + wp.float64(s.left_y) * wp.float64(s.left_y)
    per_unit2 = wp.float64(1.0) / (length2 * m.domain.height_scale)
    # Rises along the two legs over their squared length.
    zl = (wp.float64(m.z[left]) - z) * per_unit2
    zr = (wp.float64(m.z[right]) - z) * per_unit2
    s.slope_x = zl * wp.float64(s.left_x) + zr * wp.float64(s.right_x)
    s.slope_y = zl * wp.float64(s.left_y) + zr * wp.float64(s.right_y)
    return s


@wp.func
def is_marked(m: FitMesh, t: wp.int32) -> wp.bool:
    """Return whether triangle t is marked to be measured in the next sweep over the mesh."""
    return ((m.marks[t >> 5] >> wp.uint32(t & 31)) & wp.uint32(1)) != wp.uint32(0)


@wp.func
def mark(m: FitMesh, t: wp.int32):
    """Mark triangle t to be measured in the next sweep."""
    m.marks[t >> 5] = m.marks[t >> 5] | (wp.uint32(1) << wp.uint32(t & 31))


@wp.func
def corner_of(m: FitMesh, t: wp.int32, v: wp.int32) -> wp.int32:
    """Return which corner of triangle t is vertex v, which must be one: 0 left, 1 apex, 2 right."""
    k = wp.int32(0)
    if m.corner_verts[3 * t + 1] == v:
        k = 1
    if m.corner_verts[3 * t + 2] == v:
        k = 2
    return k


@wp.func
def mark_around(m: FitMesh, v: wp.int32):
    """Mark all triangles that share vertex v to be measured in the next sweep."""
    start = m.first[v]
    t = start
    turn = wp.int32(0)  # 0: on across the edge that begins at v; 2: across the one that ends there
    while t >= 0:
        mark(m, t)
        t = m.neighbours[3 * t + (corner_of(m, t, v) + turn) % 3]
        if t < 0 and turn == 0:  # at the border; now the other way round
            turn = 2
            t = m.neighbours[3 * start + (corner_of(m, start, v) + turn) % 3]
        elif t == start:
            t = -1


@wp.func
def list_marked(m: FitMesh, triangles: wp.int32) -> wp.int32:
    """List the marked triangles in their order in `m.active`, clear the marks, and return the number listed.

    Memory is then read in its order too, which halves the time of a sweep over many triangles. triangles: their number
    in the mesh.
    """
    count = wp.int32(0)
    for word in range((triangles + 31) >> 5):
        marks = m.marks[word]
        if marks != wp.uint32(0):
            m.marks[word] = wp.uint32(0)
            for k in range(32):
                m.active[count] = 32 * word + k  # counted only if it is marked
                count += wp.int32((marks >> wp.uint32(k)) & wp.uint32(1))
    return count


@wp.func
def put_on_surface(m: FitMesh, v: wp.int32):
    """Move vertex v to the height of the surface at its lattice point."""
    d = m.domain
    m.z[v] = wp.float32(surface_height(d, m.point[v][0], m.point[v][1]) * d.height_scale + d.height_offset)


@wp.func
def replace_neighbour(m: FitMesh, t: wp.int32, old: wp.int32, new: wp.int32):
    """Replace the neighbour `old` of triangle t by `new`; nothing happens if t is below 0, which is no triangle."""
    if t >= 0:
        for k in range(3):
            if m.neighbours[3 * t + k] == old:
                m.neighbours[3 * t + k] = new


@wp.func
def put_triangle(m: FitMesh, t: wp.int32, corners: wp.vec3i, neighbours: wp.vec3i, level: wp.int32):
    """Write triangle t with its corners (left, apex, right) and its level; it counts as not measured.

    neighbours: those across the edges from each corner to the next, -1 at the border.
    """
    for c in range(3):
        m.corner_verts[3 * t + c] = corners[c]
        m.neighbours[3 * t + c] = neighbours[c]
    m.level[t] = level
    m.worst[t] = NOT_MEASURED


@wp.func
def bisect_triangle(m: FitMesh, t: wp.int32, new: wp.int32, middle: wp.int32, across: wp.int32, across_new: wp.int32):
    """Bisect triangle t at the vertex `middle` of its longest edge: t becomes its left half, `new` its right one.

    across, across_new: halves of the neighbour behind that edge: `across` is beside `new` and `across_new` beside
    t; -1 at the border. m.first: a triangle of each vertex.
    """
    left = m.corner_verts[3 * t]
    apex = m.corner_verts[3 * t + 1]
    right = m.corner_verts[3 * t + 2]
    over_left_leg = m.neighbours[3 * t]
    over_right_leg = m.neighbours[3 * t + 1]
    level = m.level[t] + 1
    put_triangle(m, t, wp.vec3i(apex, middle, left), wp.vec3i(new, across_new, over_left_leg), level)
    put_triangle(m, new, wp.vec3i(right, middle, apex), wp.vec3i(across, t, over_right_leg), level)
    replace_neighbour(m, over_right_leg, t, new)
    m.first[left] = t
    m.first[right] = new
    m.first[apex] = t


@wp.func
def split(m: FitMesh, t: wp.int32, size: wp.vec2i) -> wp.vec2i:
    """Bisect triangle t and those that a conforming mesh requires; raise the error codes of their diamonds.

    The codes become `m.raised.split`, so that the next walk splits them, too.
    `size`: numbers of triangles and vertices; returns the new ones, for which the arrays must have room. New vertices
    are samples, on the surface and not pinned. The triangles around them, all new ones among them, are marked.
    """
    d = m.domain
    triangles = size[0]
    vertices = size[1]
    top = wp.int32(1)
    m.splitting[0] = t
    while top > 0:
        triangle = m.splitting[top - 1]
        partner = m.neighbours[3 * triangle + 2]
        if partner >= 0 and m.neighbours[3 * partner + 2] != triangle:
            m.splitting[top] = partner  # the partner is coarser by one bisection, and is split first
            top += 1
        else:
            top -= 1
            left = m.corner_verts[3 * triangle]
            right = m.corner_verts[3 * triangle + 2]
            p = middle_between(m.point[left], m.point[right])
            raise_ancestors(d, p[0], p[1], m.level[triangle], m.raised.split, m.codes, m.climbing)
            new_vertex = vertices
            vertices += 1
            m.point[new_vertex] = p
            put_on_surface(m, new_vertex)
            m.state[new_vertex] = wp.uint8(0)
            m.push[2 * new_vertex] = wp.float64(0.0)
            m.push[2 * new_vertex + 1] = wp.float64(0.0)
            m.first[new_vertex] = triangle  # one of those around it
            new = triangles
            triangles += 1
            if partner >= 0:
                bisect_triangle(m, triangle, new, new_vertex, partner, new + 1)
                bisect_triangle(m, partner, new + 1, new_vertex, triangle, new)
                triangles += 1
            else:
                bisect_triangle(m, triangle, new, new_vertex, -1, -1)  # at the border there is no triangle across
            mark_around(m, new_vertex)
    return wp.vec2i(triangles, vertices)
