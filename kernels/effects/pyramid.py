# SPDX-License-Identifier: GPL-3.0-or-later
"""The pyramid of prefiltered heights, and the jet of the ground at a place and a scale.

Level l has the samples at multiples of 2**l, each a mean of the level below with the weights [1 2 1] x [1 2 1] / 16
(P. J. Burt, "Fast filter transforms for image processing", 1981). A jet is the height and its first and second
derivatives, of the uniform cubic B-spline over 4 x 4 samples (its second derivatives are continuous), linear between
two levels. At the rim heights go on in straight lines, h(-1) = 2 h(0) - h(1), so a plane stays one to the last sample.
"""

import warp as wp

from ..bicubic.surface import inside
from ..field.codes import Samples, sample_at
from ..unchecked import height_at

wp.set_module_options({"enable_backward": False})

# Height in metres; d/dx, d/dy; d2/dx2, d2/dxdy, d2/dy2: x to the east, y to the north, per metre.
Jet = wp.types.vector(length=6, dtype=wp.float64)


@wp.struct
class Ground:
    """The prefiltered heights of a terrain, and where they are; memory is shared with the height field."""

    samples: Samples  # level 0
    coarser: wp.array(dtype=wp.float32)  # metres, the levels above it one after the other
    first: wp.array(dtype=wp.int64)  # [levels]: the first sample of each level there; of level 0 no use
    columns: wp.array(dtype=wp.int32)  # [levels]: samples in a row
    rows: wp.array(dtype=wp.int32)
    levels: wp.int32
    step_x: wp.float64  # metres between samples of level 0
    step_y: wp.float64
    west: wp.float64  # metres, of the first sample
    south: wp.float64
    height_scale: wp.float64
    height_offset: wp.float64


@wp.func
def filtered_height(ground: Ground, level: wp.int32, i: wp.int64) -> wp.float64:
    """Sample `i` of a level, metres."""
    h = wp.float32(0.0)
    if level == 0:
        h = sample_at(ground.samples, i)
    else:
        h = height_at(ground.coarser, ground.first[level] + i)
    return wp.float64(h)


@wp.func
def row_height(ground: Ground, level: wp.int32, x: wp.int32, y: wp.int32) -> wp.float64:
    """The same in row y; beyond its ends the row goes on as its image in the point of the last sample."""
    last = ground.columns[level] - 1
    edge = wp.clamp(x, 0, last)
    row = wp.int64(y) * wp.int64(last + 1)
    h = filtered_height(ground, level, row + wp.int64(edge))
    if x != edge:
        h = wp.float64(2.0) * h - filtered_height(ground, level, row + wp.int64(2 * edge - x))
    return h


@wp.func
def extended_height(ground: Ground, level: wp.int32, x: wp.int32, y: wp.int32) -> wp.float64:
    """The same beyond the first and the last row, too."""
    edge = wp.clamp(y, 0, ground.rows[level] - 1)
    h = row_height(ground, level, x, edge)
    if y != edge:
        h = wp.float64(2.0) * h - row_height(ground, level, x, 2 * edge - y)
    return h


@wp.func
def filtered_row(ground: Ground, level: wp.int32, x: wp.int32, y: wp.int32, inner: wp.bool) -> wp.float64:
    """Four times the mean along x at a sample."""
    west = wp.float64(0.0)
    here = wp.float64(0.0)
    east = wp.float64(0.0)
    if inner:
        at = wp.int64(y) * wp.int64(ground.columns[level]) + wp.int64(x)
        west = filtered_height(ground, level, at - wp.int64(1))
        here = filtered_height(ground, level, at)
        east = filtered_height(ground, level, at + wp.int64(1))
    else:
        west = extended_height(ground, level, x - 1, y)
        here = extended_height(ground, level, x, y)
        east = extended_height(ground, level, x + 1, y)
    return (west + east) + wp.float64(2.0) * here


@wp.kernel
def halve(offset: int, ground: Ground, level: int, out: wp.array(dtype=wp.float32)):
    """Row `offset + tid` of `level` from the level below it, which has at least two cells each way. `out` is
    ground.coarser."""
    row = offset + wp.tid()
    below = level - 1
    y = 2 * row
    middle = y > 0 and y < ground.rows[below] - 1
    to = ground.first[level] + wp.int64(row) * wp.int64(ground.columns[level])
    for column in range(ground.columns[level]):
        x = 2 * column
        inner = middle and x > 0 and x < ground.columns[below] - 1
        h = filtered_row(ground, below, x, y - 1, inner) + filtered_row(ground, below, x, y + 1, inner)
        h += wp.float64(2.0) * filtered_row(ground, below, x, y, inner)
        out[to + wp.int64(column)] = wp.float32(h * wp.float64(0.0625))


@wp.func
def spline(u: wp.float64) -> wp.vec4d:
    """What the samples -1, 0, 1 and 2 weigh at u between samples 0 and 1."""
    o = wp.float64(1.0) - u
    sixth = wp.float64(1.0 / 6.0)
    four = wp.float64(4.0)
    six = wp.float64(6.0)
    three = wp.float64(3.0)
    return wp.vec4d(
        o * o * o * sixth,
        (four - u * u * (six - three * u)) * sixth,
        (four - o * o * (six - three * o)) * sixth,
        u * u * u * sixth,
    )


@wp.func
def spline_slope(u: wp.float64) -> wp.vec4d:
    """Derivatives of the weights."""
    o = wp.float64(1.0) - u
    half = wp.float64(0.5)
    two = wp.float64(2.0)
    more = wp.float64(1.5)
    return wp.vec4d(-half * o * o, u * (more * u - two), o * (two - more * o), half * u * u)


@wp.func
def spline_bend(u: wp.float64) -> wp.vec4d:
    """Second derivatives of the weights."""
    o = wp.float64(1.0) - u
    three = wp.float64(3.0)
    two = wp.float64(2.0)
    return wp.vec4d(o, three * u - two, three * o - two, u)


@wp.func
def four_heights(ground: Ground, level: wp.int32, row: wp.int32, near: wp.vec4i, base: wp.float64) -> wp.vec4d:
    """Samples of a row in the columns `near`, metres above `base`."""
    at = wp.int64(row) * wp.int64(ground.columns[level])
    a = at + wp.int64(near[0])
    b = at + wp.int64(near[1])
    c = at + wp.int64(near[2])
    d = at + wp.int64(near[3])
    h = wp.vec4f()
    if level == 0:
        s = ground.samples
        h = wp.vec4f(sample_at(s, a), sample_at(s, b), sample_at(s, c), sample_at(s, d))
    else:
        z = ground.first[level]
        f = ground.coarser
        h = wp.vec4f(height_at(f, z + a), height_at(f, z + b), height_at(f, z + c), height_at(f, z + d))
    return wp.vec4d(wp.float64(h[0]) - base, wp.float64(h[1]) - base, wp.float64(h[2]) - base, wp.float64(h[3]) - base)


@wp.func
def level_jet(ground: Ground, level: wp.int32, x: wp.float64, y: wp.float64) -> Jet:
    """At x, y cells of a level from its first sample; derivatives per metre, of heights as they are in the field."""
    columns = ground.columns[level]
    rows = ground.rows[level]
    i = wp.min(wp.int32(x), columns - 2)
    j = wp.min(wp.int32(y), rows - 2)
    u = x - wp.float64(i)
    v = y - wp.float64(j)
    bx = spline(u)
    dx = spline_slope(u)
    sx = spline_bend(u)
    by = spline(v)
    dy = spline_slope(v)
    sy = spline_bend(v)
    if i == 0 or i == columns - 2:
        bx = inside(bx, i, columns)
        dx = inside(dx, i, columns)
        sx = inside(sx, i, columns)
    if j == 0 or j == rows - 2:
        by = inside(by, j, rows)
        dy = inside(dy, j, rows)
        sy = inside(sy, j, rows)
    near = wp.vec4i(wp.max(i - 1, 0), i, i + 1, wp.min(i + 2, columns - 1))
    # About a height of the cell: level ground is level to the last bit.
    base = filtered_height(ground, level, wp.int64(j) * wp.int64(columns) + wp.int64(i))
    q = Jet()
    for b in range(4):
        h = four_heights(ground, level, wp.clamp(j + b - 1, 0, rows - 1), near, base)
        z = wp.dot(bx, h)
        g = wp.dot(dx, h)
        q += Jet(by[b] * z, by[b] * g, dy[b] * z, by[b] * wp.dot(sx, h), dy[b] * g, sy[b] * z)
    per_x = wp.float64(1.0) / (ground.step_x * wp.float64(wp.int32(1) << level))
    per_y = wp.float64(1.0) / (ground.step_y * wp.float64(wp.int32(1) << level))
    return Jet(
        base + q[0], q[1] * per_x, q[2] * per_y, q[3] * per_x * per_x, q[4] * per_x * per_y, q[5] * per_y * per_y
    )


@wp.func
def jet_at(ground: Ground, x: wp.float64, y: wp.float64, level: wp.float32) -> Jet:
    """At x, y metres in the terrain's own space and a level that need not be whole; of heights as displaced.

    Beyond the raster it is that of the rim's nearest point.
    """
    last_x = wp.float64(ground.columns[0] - 1)
    last_y = wp.float64(ground.rows[0] - 1)
    cell_x = wp.clamp((x - ground.west) / ground.step_x, wp.float64(0.0), last_x)
    cell_y = wp.clamp((y - ground.south) / ground.step_y, wp.float64(0.0), last_y)
    scale = wp.clamp(level, wp.float32(0.0), wp.float32(ground.levels - 1))
    below = wp.int32(scale)
    part = wp.float64(scale) - wp.float64(below)
    per = wp.float64(1.0) / wp.float64(wp.int32(1) << below)
    q = level_jet(ground, below, cell_x * per, cell_y * per)
    if part > wp.float64(0.0):
        per *= wp.float64(0.5)
        q += (level_jet(ground, below + 1, cell_x * per, cell_y * per) - q) * part
    q *= ground.height_scale
    q[0] = q[0] + ground.height_offset
    return q
