# SPDX-License-Identifier: GPL-3.0-or-later
"""Where moving vertices is not enough: diamonds that the fit splits, and vertices that go back to the surface."""

import warp as wp

from ..criterion import Domain, cell_error, place
from ..layout import tile_index
from ..unchecked import height_at
from .facet import surface
from .sweep import HOT, PINNED, Fit

wp.set_module_options({"enable_backward": False})


@wp.func
def diamond_entry(d: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.int64:
    """Where the arrays hold the diamond split at (x, y), or the raster's cell that it is in."""
    at = d.cell_base
    if depth <= 2 * d.levels:
        at = place(d, x, y, depth)
    else:
        bits = d.unit_bits - d.levels
        i = wp.min(x >> bits, d.width - 2)
        j = wp.min(y >> bits, d.height - 2)
        at = at + tile_index(i, j, d.cell_pages)
    return at


@wp.func
def apex_step(d: Domain, x: wp.int32, y: wp.int32, depth: wp.int32):
    """From the split vertex (x, y) of a diamond to an apex; the other is as far on the other side."""
    half = wp.int32(1) << (d.unit_bits - ((depth - 1) >> 1) - 1)
    step = wp.vec2i(half, half)
    if (depth & 1) == 1:
        # A cell's centre: the corners off its diagonal. Root squares have all the same.
        if depth > 1 and ((x / (2 * half) + y / (2 * half)) & 1) == 0:
            step = wp.vec2i(half, -half)
    elif (x & half) != 0:
        step = wp.vec2i(0, half)
    else:
        step = wp.vec2i(half, 0)
    return step


@wp.func
def climb(
    d: Domain,
    x: wp.int32,
    y: wp.int32,
    depth: wp.int32,
    value: wp.float32,
    errors: wp.array(dtype=wp.float32),
    stack: wp.array(dtype=wp.vec3i),
):
    """Raise the error of the diamond at (x, y), `depth` at most that of cells, and those above it to `value`."""
    top = wp.int32(1)
    stack[0] = wp.vec3i(x, y, depth)
    while top > 0:
        top -= 1
        q = stack[top]
        at = diamond_entry(d, q[0], q[1], q[2])
        if errors[at] < value:
            errors[at] = value
            if q[2] > 1:
                step = apex_step(d, q[0], q[1], q[2])
                for k in range(2):
                    px = wp.where(k == 0, q[0] - step[0], q[0] + step[0])
                    py = wp.where(k == 0, q[1] - step[1], q[1] + step[1])
                    inside = px >= 0 and py >= 0
                    if inside and px <= (d.columns << d.unit_bits) and py <= (d.rows << d.unit_bits):
                        stack[top] = wp.vec3i(px, py, q[2] - 1)
                        top += 1


@wp.func
def raise_cells(
    d: Domain,
    i: wp.int32,
    j: wp.int32,
    halvings: wp.int32,
    raised: wp.float64,
    errors: wp.array(dtype=wp.float32),
    stack: wp.array(dtype=wp.vec3i),
):
    """Raise cell (i, j) so that triangles after `halvings` of its sides are split.

    An error in a cell is a quarter after each halving, and at least a quarter of the next cells': hierarchy.py.
    """
    bits = d.unit_bits - d.levels
    for b in range(-halvings, halvings + 1):
        for a in range(-halvings, halvings + 1):
            left = halvings - wp.abs(a) - wp.abs(b)
            inside = i + a >= 0 and j + b >= 0 and i + a < d.width - 1 and j + b < d.height - 1
            if left >= 0 and inside:
                x = ((i + a) << bits) + (1 << (bits - 1))
                y = ((j + b) << bits) + (1 << (bits - 1))
                value = raised * wp.float64(wp.int64(1) << wp.int64(2 * left))
                climb(d, x, y, 2 * d.levels + 1, wp.float32(value), errors, stack)


@wp.kernel
def refine(
    triangles: int,
    max_depth: int,
    split_above: wp.float64,
    raised: wp.float64,
    local: wp.float64,
    f: Fit,
    errors: wp.array(dtype=wp.float32),
    stack: wp.array(dtype=wp.vec3i),
    found: wp.array(dtype=wp.int32),
):
    """Split triangles beyond the bound that interpolation would split too; of others the vertices go to the surface.

    `split_above`: metres before scaling, the error that interpolation allows a leaf. `local`: only those whose excess
    is at least this part of the largest among the triangles that they touch, since one split may help them all. Split
    diamonds get `raised` in `errors`. `found` [4] receives how many are split, how many vertices are new on the
    surface, splits that interpolation would not make (only what float32 positions add is beyond the bound), and
    triangles too coarse at the deepest level.
    """
    d = f.domain
    bits = d.unit_bits - d.levels
    for k in range(4):
        found[k] = 0
    for t in range(triangles):
        if f.worst[t] > f.bound:
            for k in range(3):
                v = f.corner_verts[3 * t + k]
                f.push[2 * v] = wp.max(f.push[2 * v], f.worst[t])
                f.state[v] = f.state[v] | HOT
    for t in range(triangles):
        worst = f.worst[t]
        if worst > f.bound:
            left = f.corner_verts[3 * t]
            apex = f.corner_verts[3 * t + 1]
            right = f.corner_verts[3 * t + 2]
            most = wp.max(f.push[2 * left], wp.max(f.push[2 * apex], f.push[2 * right]))
            if worst - f.bound >= local * (most - f.bound):
                x = (f.point[left][0] + f.point[right][0]) >> 1
                y = (f.point[left][1] + f.point[right][1]) >> 1
                depth = f.level[t]
                finer = depth - 2 * d.levels - 1
                error = wp.float32(0.0)
                if finer < 0:
                    error = height_at(d.error, place(d, x, y, depth))
                else:
                    # The cell that it is in: between its apex and the middle of its longest edge.
                    x = (x + f.point[apex][0]) >> 1
                    y = (y + f.point[apex][1]) >> 1
                    error = cell_error(d, x >> bits, y >> bits)
                    error = error / wp.float32(wp.int64(1) << wp.int64(finer + (finer & 1)))
                too_coarse = wp.float64(error) > split_above
                pinned = f.state[left] & f.state[apex] & f.state[right] & PINNED
                fresh = f.push[2 * left + 1] + f.push[2 * apex + 1] + f.push[2 * right + 1]
                held = pinned != wp.uint8(0) and fresh == wp.float64(0.0)
                rounded = held and wp.float64(error) > wp.float64(0.5) * split_above
                if depth < max_depth and (too_coarse or rounded):
                    if finer < 0:
                        climb(d, x, y, depth, wp.float32(raised), errors, stack)
                    else:
                        raise_cells(d, x >> bits, y >> bits, (finer + 1) >> 1, raised, errors, stack)
                    found[0] = found[0] + 1
                    if not too_coarse:
                        found[2] = found[2] + 1
                else:
                    if too_coarse:
                        found[3] = found[3] + 1
                    for k in range(3):
                        v = f.corner_verts[3 * t + k]
                        if (f.state[v] & PINNED) == wp.uint8(0):
                            f.state[v] = f.state[v] | PINNED
                            f.push[2 * v + 1] = wp.float64(1.0)  # its triangles' distances are of before
                            p = f.point[v]
                            q = f.positions[v]
                            z = surface(d, p[0], p[1]) * d.height_scale + d.height_offset
                            f.positions[v] = wp.vec3f(q[0], q[1], wp.float32(z))
                            found[1] = found[1] + 1
