# SPDX-License-Identifier: GPL-3.0-or-later
"""From a welded mesh to one that is fitted, and the heights and states that the next one starts with.

Of the mesh m (FitMesh) these arrays are written: `point`, lattice positions of the vertices; `z`, their heights, metres
after vertical scaling; `state`, bits KNOWN (in the mesh before) and PINNED (not to be moved); `first`, a triangle of
each vertex; `neighbours`, the triangle across the edge from each corner to the next. A root square of the lattice has
2^levels cells and 2^unit_bits units a side.
"""

import warp as wp

from ..field.domain import Domain
from ..unchecked import item_at, put
from .facet import surface_height
from .finer import change_at
from .mesh import KNOWN, PINNED, FitMesh


@wp.func
def vertex_index(d: Domain, i: wp.int32, j: wp.int32) -> wp.int64:
    """Return the index of vertex (i, j), a sample or a point of the padding, in the arrays of `store_heights`."""
    return wp.int64(j) * wp.int64((d.columns << d.levels) + 1) + wp.int64(i)


@wp.kernel
def place_vertices(
    offset: int,
    m: FitMesh,
    positions: wp.array(dtype=wp.vec3f),
    heights: wp.array(dtype=wp.float32),
    states: wp.array(dtype=wp.uint8),
):
    """Write the lattice position of vertex `offset + tid` to m, and restore height and state from the mesh before.

    positions: metres; the height of a vertex that was in that mesh is replaced. heights (metres after vertical
    scaling), states: by `vertex_index`, from `store_heights`. A vertex that is no sample, inside a cell, is PINNED.
    Heights of m are without the change of finer tiles, and `positions` have it. The sums m.push become 0.
    """
    v = offset + wp.tid()
    d = m.domain
    p = positions[v]
    units_per_step = wp.float64(wp.int32(1) << m.snap)  # vertices are at multiples of 2^snap units
    x = wp.int32(wp.rint((wp.float64(p[0]) - d.west) / (d.unit_x * units_per_step))) << m.snap
    y = wp.int32(wp.rint((wp.float64(p[1]) - d.south) / (d.unit_y * units_per_step))) << m.snap
    m.point[v] = wp.vec2i(x, y)
    m.push[2 * v] = wp.float64(0.0)
    m.push[2 * v + 1] = wp.float64(0.0)
    bits = d.unit_bits - d.levels  # a cell has 2^bits lattice units a side
    if d.has_finer == 1:
        p = wp.vec3f(p[0], p[1], wp.float32(surface_height(d, x, y) * d.height_scale + d.height_offset))
    state = PINNED  # inside a raster's cell
    if ((x | y) & ((1 << bits) - 1)) == 0:  # a sample
        entry = vertex_index(d, x >> bits, y >> bits)
        state = item_at(states, entry)
        if (state & KNOWN) != wp.uint8(0):  # it was in the mesh before
            p = wp.vec3f(p[0], p[1], item_at(heights, entry))
            delivered = wp.float32(wp.float64(p[2]) + change_at(d, x, y) * d.height_scale)
            positions[v] = wp.vec3f(p[0], p[1], delivered)
    m.z[v] = p[2]
    m.state[v] = state & PINNED


@wp.kernel
def link_triangles(triangles: int, m: FitMesh, corner_edges: wp.array(dtype=wp.int32), side: wp.array(dtype=wp.int32)):
    """Write to m the neighbours of all triangles, and one triangle of each vertex.

    One thread. corner_edges: the edge from each corner to the next. side [E]: scratch, the corner of the first triangle
    at each edge; -1 before.
    """
    for c in range(3 * triangles):
        m.first[m.corner_verts[c]] = c / 3
        edge = corner_edges[c]
        other = side[edge]
        m.neighbours[c] = -1
        if other < 0:
            side[edge] = c
        else:
            m.neighbours[c] = other / 3
            m.neighbours[other] = c / 3


@wp.kernel
def store_heights(offset: int, m: FitMesh, heights: wp.array(dtype=wp.float32), states: wp.array(dtype=wp.uint8)):
    """Store height and state of vertex `offset + tid`, if it is a sample, for `place_vertices` of the next mesh.

    heights (metres after vertical scaling), states: by `vertex_index`.
    """
    v = offset + wp.tid()
    d = m.domain
    bits = d.unit_bits - d.levels  # a cell has 2^bits lattice units a side
    p = m.point[v]
    if ((p[0] | p[1]) & ((1 << bits) - 1)) == 0:  # a sample
        entry = vertex_index(d, p[0] >> bits, p[1] >> bits)
        put(heights, entry, m.z[v])
        put(states, entry, m.state[v] | KNOWN)
