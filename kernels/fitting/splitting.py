# SPDX-License-Identifier: GPL-3.0-or-later
"""Where moving vertices is not enough: triangles that the fit splits, and vertices that go back to the surface."""

import warp as wp

from ..refine.diamond import metres2_of
from ..refine.stored_errors import cell_error, error_at
from .mesh import PINNED, Mesh, list_marked, mark, mark_around, put_on_surface, split
from .raising import raise_cells


@wp.kernel
def refine(count: int, max_depth: int, local: wp.float64, m: Mesh, found: wp.array(dtype=wp.int32)):
    """Split triangles beyond the bound that interpolation would split too; of others the vertices go to the surface.

    `local`: only those whose excess is at least this part of the largest among the triangles that they touch, since
    one split may help them all. `m.active` becomes the list for the next sweep. Triangles above the raster's cells are
    split where they lie, those in cells only in `m.codes`, for the next walk.
    `found` [8] receives how many are listed, triangles and vertices (which it holds before), how many are split, how
    many vertices are new on the surface, how many splits wait for the next walk, splits that interpolation would not
    make (only what float32 positions add is beyond the bound), and triangles too coarse at the deepest level.
    """
    d = m.domain
    bits = d.unit_bits - d.levels
    asked2 = m.asked * m.asked
    size = wp.vec2i(found[1], found[2])
    splits = wp.int32(0)
    pins = wp.int32(0)
    later = wp.int32(0)
    deepest = wp.int32(0)
    for k in range(count):
        t = m.active[k]
        over = m.worst[t] - m.bound
        if over > wp.float64(0.0):
            for c in range(3):
                v = m.corner_verts[3 * t + c]
                m.push[2 * v] = wp.max(m.push[2 * v], over)
    for k in range(count):
        t = m.active[k]
        over = m.worst[t] - m.bound
        if over > wp.float64(0.0):
            m.awake[t] = m.round + 1
            mark(m, t)
            left = m.corner_verts[3 * t]
            apex = m.corner_verts[3 * t + 1]
            right = m.corner_verts[3 * t + 2]
            most = wp.max(m.push[2 * left], wp.max(m.push[2 * apex], m.push[2 * right]))
            if over >= local * most:
                depth = m.level[t]
                p = (m.point[left] + m.point[right]) / 2
                x = p[0]
                y = p[1]
                finer = depth - 2 * d.levels - 1
                error = wp.float32(0.0)
                if finer < 0:
                    error = error_at(d, x, y, depth)
                else:
                    # The cell that it is in: between its apex and the middle of its longest edge.
                    x = (x + m.point[apex][0]) >> 1
                    y = (y + m.point[apex][1]) >> 1
                    error = cell_error(d, x >> bits, y >> bits)
                    error = error / wp.float32(wp.int64(1) << wp.int64(finer + (finer & 1)))
                metres2 = metres2_of(d, error, d.rounding + d.most_lean)
                too_coarse = metres2 > asked2
                pinned = m.state[left] & m.state[apex] & m.state[right] & PINNED
                fresh = m.push[2 * left + 1] + m.push[2 * apex + 1] + m.push[2 * right + 1]
                held = pinned != wp.uint8(0) and fresh == wp.float64(0.0)
                rounded = held and wp.float64(error) * d.error_scale > wp.float64(0.5) * m.bound
                if depth < max_depth and (too_coarse or rounded):
                    if finer < 0:
                        if size[0] + 2 * depth + 2 < m.room:
                            size = split(m, t, size)
                        else:
                            later += 1
                    else:
                        raise_cells(d, x >> bits, y >> bits, (finer + 1) >> 1, m.codes, m.climbing)
                        later += 1
                    splits += 1
                else:
                    if too_coarse:
                        deepest += 1
                    for c in range(3):
                        v = m.corner_verts[3 * t + c]
                        if (m.state[v] & PINNED) == wp.uint8(0):
                            m.state[v] = m.state[v] | PINNED
                            m.push[2 * v + 1] = wp.float64(1.0)  # its triangles' distances are of before
                            put_on_surface(m, v)
                            pins += 1
                            mark_around(m, v)
    listed = list_marked(m, size[0])
    for k in range(listed):
        t = m.active[k]
        for c in range(3):
            v = m.corner_verts[3 * t + c]
            m.push[2 * v] = wp.float64(0.0)
            m.push[2 * v + 1] = wp.float64(0.0)
    found[0] = listed
    found[1] = size[0]
    found[2] = size[1]
    found[3] = splits
    found[4] = pins
    found[5] = later
    found[6] = deepest
