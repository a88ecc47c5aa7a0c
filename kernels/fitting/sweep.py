# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the fit: triangles that are too far from the surface push their corners, and vertices move.

What of a point's distance is beyond the aim pushes the three corners of its triangle, by their weights there; a vertex
moves by the weighted mean of what pushes it. Weights of a point add up to 1, so a step of less than twice that mean
never leads away from heights that keep the bound, if there are any: simultaneous projections as in SIRT (Gilbert 1972;
convergence in Censor and Elfving 2002). All moves of a sweep use the heights of the last one: no order, no history.
"""

import warp as wp

from ..criterion import Domain
from .facet import Facet, farthest, pushed

wp.set_module_options({"enable_backward": False})

# What is known of a vertex, bits.
KNOWN = wp.constant(wp.uint8(1))  # it was in the mesh before
PINNED = wp.constant(wp.uint8(2))  # on the surface, for good
HOT = wp.constant(wp.uint8(4))  # its triangles are not known to keep the bound


@wp.struct
class Fit:
    """A mesh and its vertices' heights."""

    domain: Domain
    snap: wp.int32  # mesh vertices lie on multiples of 2**snap units
    bound: wp.float64  # metres, the distance that is allowed
    aim: wp.float64  # metres, a little less: points beyond it push
    stretch: wp.float64  # length of a step over the mean push, below 2
    corner_verts: wp.array(dtype=wp.int32)
    level: wp.array(dtype=wp.int32)
    positions: wp.array(dtype=wp.vec3f)
    point: wp.array(dtype=wp.vec2i)  # [V] of each vertex
    state: wp.array(dtype=wp.uint8)  # [V]
    moved: wp.array(dtype=wp.int32)  # [V] the last sweep that moved it
    push: wp.array(dtype=wp.float64)  # [2 V] pushes and weights
    worst: wp.array(dtype=wp.float64)  # [T] metres, largest distance
    pushes: wp.array(dtype=wp.vec2f)  # [3 T] of each triangle on its corners


@wp.func
def facet_of(f: Fit, left: wp.int32, apex: wp.int32, right: wp.int32) -> Facet:
    """The triangle between three vertices. Legs are orthogonal and of one length."""
    at = f.point[apex]
    to_left = f.point[left] - at
    to_right = f.point[right] - at
    s = Facet()
    s.x = at[0]
    s.y = at[1]
    s.left_x = to_left[0]
    s.left_y = to_left[1]
    s.right_x = to_right[0]
    s.right_y = to_right[1]
    z = wp.float64(f.positions[apex][2])
    s.z = (z - f.domain.height_offset) / f.domain.height_scale
    length2 = wp.float64(s.left_x) * wp.float64(s.left_x) + wp.float64(s.left_y) * wp.float64(s.left_y)
    per_unit2 = wp.float64(1.0) / (length2 * f.domain.height_scale)
    zl = (wp.float64(f.positions[left][2]) - z) * per_unit2
    zr = (wp.float64(f.positions[right][2]) - z) * per_unit2
    s.slope_x = zl * wp.float64(s.left_x) + zr * wp.float64(s.right_x)
    s.slope_y = zl * wp.float64(s.left_y) + zr * wp.float64(s.right_y)
    return s


@wp.func
def push_on(s: wp.float64, n: wp.float64, all: wp.float64):
    """Push and weight on a corner; none where the weight is only rounding."""
    q = wp.vec2f()
    if n > wp.float64(1e-9) * all:
        q = wp.vec2f(wp.float32(s), wp.float32(n))
    return q


@wp.kernel
def pull(offset: int, sweep: int, f: Fit):
    """How far each triangle is from the surface and how it pushes its corners, if one of them has moved."""
    t = offset + wp.tid()
    left = f.corner_verts[3 * t]
    apex = f.corner_verts[3 * t + 1]
    right = f.corner_verts[3 * t + 2]
    last = wp.max(wp.max(f.moved[left], f.moved[apex]), f.moved[right])
    if last < sweep - 1:
        if sweep == 1:
            f.worst[t] = wp.float64(0.0)
        return
    d = f.domain
    scale = wp.abs(d.height_scale)
    s = facet_of(f, left, apex, right)
    worst = farthest(d, s) * scale
    f.worst[t] = worst
    if worst > f.aim:
        p = pushed(d, s, f.aim / scale)
        lx = wp.float64(s.left_x)
        ly = wp.float64(s.left_y)
        rx = wp.float64(s.right_x)
        ry = wp.float64(s.right_y)
        part = wp.float64(1.0) / (lx * lx + ly * ly)
        n_left = (p.n_x * lx + p.n_y * ly) * part
        n_right = (p.n_x * rx + p.n_y * ry) * part
        s_left = (p.s_x * lx + p.s_y * ly) * part
        s_right = (p.s_x * rx + p.s_y * ry) * part
        f.pushes[3 * t] = push_on(s_left, n_left, p.n)
        f.pushes[3 * t + 1] = push_on(p.s - s_left - s_right, p.n - n_left - n_right, p.n)
        f.pushes[3 * t + 2] = push_on(s_right, n_right, p.n)


@wp.kernel
def move(sweep: int, triangles: int, vertices: int, f: Fit, hurt: wp.array(dtype=wp.int32)):
    """Every vertex by what pushes it; `hurt` [1] receives how many triangles are beyond the bound."""
    beyond = wp.int32(0)
    for t in range(triangles):
        worst = f.worst[t]
        if worst > f.aim:
            if worst > f.bound:
                beyond += 1
            for k in range(3):
                v = f.corner_verts[3 * t + k]
                q = f.pushes[3 * t + k]
                f.push[2 * v] = f.push[2 * v] + wp.float64(q[0])
                f.push[2 * v + 1] = f.push[2 * v + 1] + wp.float64(q[1])
    hurt[0] = beyond
    for v in range(vertices):
        weight = f.push[2 * v + 1]
        if weight > wp.float64(0.0):
            step = f.stretch * f.push[2 * v] / weight * f.domain.height_scale
            f.push[2 * v] = wp.float64(0.0)
            f.push[2 * v + 1] = wp.float64(0.0)
            if (f.state[v] & PINNED) == wp.uint8(0):
                p = f.positions[v]
                z = wp.float32(wp.float64(p[2]) + step)
                if z != p[2]:
                    f.positions[v] = wp.vec3f(p[0], p[1], z)
                    f.moved[v] = sweep


@wp.kernel
def gather(offset: int, f: Fit, heights: wp.array(dtype=wp.float32), states: wp.array(dtype=wp.uint8)):
    """Where each vertex is on the lattice, and the height that it had before."""
    v = offset + wp.tid()
    d = f.domain
    p = f.positions[v]
    grid = wp.float64(wp.int32(1) << f.snap)
    x = wp.int32(wp.rint((wp.float64(p[0]) - d.west) / (d.unit_x * grid))) << f.snap
    y = wp.int32(wp.rint((wp.float64(p[1]) - d.south) / (d.unit_y * grid))) << f.snap
    f.point[v] = wp.vec2i(x, y)
    f.push[2 * v] = wp.float64(0.0)
    f.push[2 * v + 1] = wp.float64(0.0)
    bits = d.unit_bits - d.levels
    state = PINNED  # inside a raster's cell
    if ((x | y) & ((1 << bits) - 1)) == 0:
        at = wp.int64(y >> bits) * wp.int64(d.width) + wp.int64(x >> bits)
        state = states[at]
        if (state & KNOWN) != wp.uint8(0):
            f.positions[v] = wp.vec3f(p[0], p[1], heights[at])
    f.moved[v] = wp.where((state & (KNOWN | HOT)) == KNOWN, -1, 0)
    f.state[v] = state & PINNED


@wp.kernel
def keep(offset: int, f: Fit, heights: wp.array(dtype=wp.float32), states: wp.array(dtype=wp.uint8)):
    """What `gather` of the next mesh is to find."""
    v = offset + wp.tid()
    d = f.domain
    bits = d.unit_bits - d.levels
    p = f.point[v]
    if ((p[0] | p[1]) & ((1 << bits) - 1)) == 0:
        at = wp.int64(p[1] >> bits) * wp.int64(d.width) + wp.int64(p[0] >> bits)
        heights[at] = f.positions[v][2]
        states[at] = f.state[v] | KNOWN
