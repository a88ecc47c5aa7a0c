# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the fit: triangles that are too far from the surface push their corners, and vertices move.

The *aim* is AIM times the bound on distances. The part of a point's distance beyond the aim pushes the three corners of
its triangle, by their weights there; a vertex moves by the weighted mean of its pushes. Weights of a point add up to 1,
so a step of less than twice that mean never leads away from heights that keep the bound, if there are any: simultaneous
projections as in SIRT (Gilbert 1972; convergence in Censor and Elfving 2002). All moves of a sweep use the heights of
the last one: no order, no history.

A triangle's distance from the surface is that from the raster's, measured, plus the stored error over the triangle of
what finer tiles change (`missed_change` in finer.py).

A sweep reads the listed triangles, of which a corner has moved, and measures one of them only if its corners moved by
more than it was within the aim.

Of the mesh m (FitMesh), by triangle: `active`, the list; `worst`, its distance from the surface, metres after scaling;
`seen`, heights of its corners when that was measured; `pushes`, (push, weight) on each corner; `awake`, the last round
in which it was measured or found beyond the bound. By vertex: `z`, its height; `push`, the sums of pushes and weights.
`corner_verts` [3 T] has the vertices of triangles (left, apex, right), and `point` their positions, lattice units.
"""

import warp as wp

from .facet import farthest
from .finer import missed_change
from .mesh import NOT_MEASURED, PINNED, FitMesh, facet_of, is_marked, list_marked, mark, mark_around
from .push import Pushes, pushes_in_cell, pushes_of

# Points beyond this part of the bound push; length of a step over the mean push, below 2.
AIM, STRETCH = wp.constant(wp.float64(0.95)), wp.constant(wp.float64(1.25))
# Above what single precision rounds off, relative to the heights in a triangle, and to a sum of weights.
ROUNDED = wp.constant(wp.float64(1e-6))
NO_WEIGHT = wp.constant(wp.float32(1e-4))


@wp.kernel
def measure(offset: int, m: FitMesh):
    """Write to `m.worst` the distance of triangle `offset + tid` from the surface, in float64; reset its pushes.

    The distance is metres after vertical scaling; `m.seen` receives the corners' heights.
    """
    t = offset + wp.tid()
    left = m.point[m.corner_verts[3 * t]]  # the ends of its longest edge
    right = m.point[m.corner_verts[3 * t + 2]]
    finer_error = missed_change(m.domain, left, right, m.level[t])  # of finer tiles, scaled already
    m.worst[t] = farthest(m.domain, facet_of(m, t)) * m.domain.error_scale + finer_error
    m.seen[t] = corner_heights(m, t)
    for c in range(3):
        m.pushes[3 * t + c] = wp.vec2f()


@wp.func
def corner_heights(m: FitMesh, t: wp.int32) -> wp.vec3f:
    """Return the heights of the left, apex and right corner of triangle t, metres after vertical scaling."""
    return wp.vec3f(m.z[m.corner_verts[3 * t]], m.z[m.corner_verts[3 * t + 1]], m.z[m.corner_verts[3 * t + 2]])


@wp.func
def push_and_weight(q: wp.float32, weight: wp.float32, sum_weights: wp.float32) -> wp.vec2f:
    """Return (q, weight) of a corner's push; (0, 0) if the weight is only rounding of `sum_weights`.

    A push is a weighted sum q of distances of the surface beyond the aim, metres before scaling. sum_weights: sum of
    the weights of all three corners.
    """
    return wp.where(weight > NO_WEIGHT * sum_weights, wp.vec2f(q, weight), wp.vec2f())


@wp.kernel
def measure_pushes(first: int, end: int, m: FitMesh):
    """Measure listed triangles first .. end - 1: their distance from the surface, and pushes on their corners.

    A triangle is measured only if it never was, or if its corners have moved enough to bring it beyond the aim; then
    `m.worst`, `m.pushes`, `m.seen` and `m.awake` change.
    """
    d = m.domain
    per_scale = wp.float64(1.0) / d.height_scale  # `error_scale` is its magnitude, for distances
    for k in range(first, end):
        t = m.active[k]
        z = corner_heights(m, t)
        aim = AIM * m.bound
        known = m.worst[t]
        must_measure = known == NOT_MEASURED
        if not must_measure:
            last = m.seen[t]
            moved = wp.max(wp.max(wp.abs(z[0] - last[0]), wp.abs(z[1] - last[1])), wp.abs(z[2] - last[2]))
            must_measure = moved > wp.float32(0.0) and known + wp.float64(moved) > aim
        if must_measure:
            left = m.point[m.corner_verts[3 * t]]
            apex = m.point[m.corner_verts[3 * t + 1]]
            right = m.point[m.corner_verts[3 * t + 2]]
            m.seen[t] = z
            m.awake[t] = m.round
            rise_left = (wp.float64(z[0]) - wp.float64(z[1])) * per_scale
            rise_right = (wp.float64(z[2]) - wp.float64(z[1])) * per_scale
            finer_error = missed_change(d, left, right, m.level[t])  # of finer tiles
            aim = wp.max(aim - finer_error, wp.float64(0.0))  # for the distance from the raster's surface
            q = Pushes()  # largest distance, then weight and push of the apex, the left and the right corner
            if m.level[t] <= 2 * d.levels + 1:  # its corners are samples; smaller ones are inside a cell
                height = (wp.float64(z[1]) - d.height_offset) * per_scale
                corner_climbs = wp.vec2f(wp.float32(rise_left), wp.float32(rise_right))
                q = pushes_of(d, left, apex, right, height, corner_climbs, wp.float32(aim / d.error_scale))
            else:
                q = pushes_in_cell(d, facet_of(m, t), aim / d.error_scale)
            magnitude = wp.abs(rise_left) + wp.abs(rise_right) + wp.float64(q[0])
            m.worst[t] = (wp.float64(q[0]) + ROUNDED * magnitude) * d.error_scale + finer_error
            sum_weights = q[1] + q[3] + q[5]
            m.pushes[3 * t] = push_and_weight(q[4], q[3], sum_weights)
            m.pushes[3 * t + 1] = push_and_weight(q[2], q[1], sum_weights)
            m.pushes[3 * t + 2] = push_and_weight(q[6], q[5], sum_weights)


@wp.func
def add_push(m: FitMesh, v: wp.int32, q: wp.vec2f):
    """Add a push and its weight (q) to the sums of vertex v."""
    m.push[2 * v] = m.push[2 * v] + wp.float64(q[0])
    m.push[2 * v + 1] = m.push[2 * v + 1] + wp.float64(q[1])


@wp.kernel
def move(count: int, triangles: int, m: FitMesh, found: wp.array(dtype=wp.int32)):
    """Move the vertices of triangles beyond the bound by STRETCH times the weighted mean of their pushes.

    One thread. Pinned vertices stay. `m.active` becomes the list of triangles for the next sweep: those with a moved
    corner, and those beyond the aim that push a vertex. count: number of listed triangles. triangles: number of all.
    found [2] receives the length of the new list, and the number of triangles beyond the bound. `m.push` [2 V] has the
    sums of pushes (metres before scaling) and of weights of each vertex.
    """
    num_beyond = wp.int32(0)
    # Triangles beyond the bound decide which vertices move. Those that are not awake in this round push none.
    num_movers = wp.int32(0)
    for k in range(count):
        t = m.active[k]
        if m.worst[t] > m.bound and m.awake[t] == m.round:
            num_beyond += 1
            for c in range(3):
                q = m.pushes[3 * t + c]
                if q[1] > wp.float32(0.0):  # it pushes this corner
                    v = m.corner_verts[3 * t + c]
                    if m.push[2 * v + 1] == wp.float64(0.0):  # the first push of the vertex
                        m.movers[num_movers] = v
                        num_movers += 1
                    add_push(m, v, q)
            mark(m, t)
    # Other triangles beyond the aim push those of their corners that move.
    for k in range(count):
        t = m.active[k]
        if m.worst[t] > AIM * m.bound and not is_marked(m, t) and m.awake[t] == m.round:
            for c in range(3):
                v = m.corner_verts[3 * t + c]
                if m.push[2 * v + 1] > wp.float64(0.0):  # the vertex moves
                    add_push(m, v, m.pushes[3 * t + c])
            mark(m, t)
    for k in range(num_movers):
        v = m.movers[k]
        step = STRETCH * m.push[2 * v] / m.push[2 * v + 1] * m.domain.height_scale
        m.push[2 * v] = wp.float64(0.0)
        m.push[2 * v + 1] = wp.float64(0.0)
        if (m.state[v] & PINNED) == wp.uint8(0):
            z = wp.float32(wp.float64(m.z[v]) + step)
            if z != m.z[v]:
                m.z[v] = z
                mark_around(m, v)
    found[0] = list_marked(m, triangles)
    found[1] = num_beyond
