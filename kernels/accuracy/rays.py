# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays against the reference surface: they walk cell by cell, and skip whole blocks of cells above or below.

Blocks of 4 x 4 cells, and of twice the side at each level above, hold the lowest and the highest height; a ray climbs
to larger blocks while it clears them and descends where it does not (Tevs, Ihrke and Seidel 2008, maximum mipmaps; here
with minima, as a ray may also run below). In one cell, ray minus bilinear surface is a parabola along the ray, and the
crossing is exact. Against a bicubic surface, or one with detail, the ray is evaluated at PLACES + 1 points in the cell,
and a change of sides between two of them is bisected: a ray that dips into the surface and out again between two points
is not seen to touch it. Cells are left by their number, never by a rounded coordinate, and a change of sides between
two cells is a crossing, so that no ray slips through. All arithmetic is float64. Heights are metres after vertical
scaling. `ground` is the reference surface, `blocks` the heights of its blocks. A ray has the points (u, v, z) + t *
(du, dv, dz), cells and metres; it is on the surface within its `tolerance`, metres.
"""

import warp as wp

from ..field.codes import corners_of
from ..query.rays import within
from ..unchecked import item_at
from .cubic import height_bounds
from .facets import Reference, reference_in_cell

CELL_BITS = wp.constant(1)  # level 1 is 2^(1 + 1) cells a side
NOWHERE = wp.constant(wp.float64(wp.inf))  # t of a ray that meets nothing
PLACES = wp.constant(8)  # parts of a ray in a cell of a curved surface, at whose ends it is evaluated
HALVINGS = wp.constant(44)  # of the way between two places: what float64 holds of it


@wp.struct
class HeightBlocks:
    """The lowest and highest heights of blocks: level k (1 .. levels) is row-major from base[k] on, width[k] a row."""

    levels: wp.int32
    low_z: wp.float64  # of the whole surface, metres
    high_z: wp.float64
    tolerance: wp.float64  # metres: a surface that rises above a ray by less than this does not hide
    base: wp.array(dtype=wp.int64)
    width: wp.array(dtype=wp.int32)
    low: wp.array(dtype=wp.float32)  # metres before vertical scaling, like `high`; scaled, either may be the lower one
    high: wp.array(dtype=wp.float32)


@wp.struct
class SightRay:
    """Points (u, v, z) + t * (du, dv, dz): cells and metres.

    `tolerance`: metres below the surface that count as on it.
    """

    u: wp.float64
    v: wp.float64
    z: wp.float64
    du: wp.float64
    dv: wp.float64
    dz: wp.float64
    tolerance: wp.float64


@wp.func
def side_of(e: wp.float64, tolerance: wp.float64) -> wp.float64:
    """Return 1 if a ray is above the surface, -1 if it is below, 0 if it is within the tolerance.

    e: height of the ray minus that of the surface, metres. tolerance: metres.
    """
    side = wp.float64(0.0)
    if e > tolerance:
        side = wp.float64(1.0)
    if e < -tolerance:
        side = wp.float64(-1.0)
    return side


@wp.func
def first_root(a: wp.float64, b: wp.float64, c: wp.float64) -> wp.float64:
    """Return the smallest positive root of a t^2 + b t + c, which is positive at 0 and negative at some positive t.

    If it is negative nowhere, the result is 0 or meaningless: the caller checks that before.
    """
    root = wp.sqrt(wp.max(b * b - wp.float64(4.0) * a * c, wp.float64(0.0)))
    t = wp.float64(0.0)
    if b < wp.float64(0.0):
        t = wp.float64(2.0) * c / (root - b)
    elif a < wp.float64(0.0):
        t = (b + root) / (wp.float64(-2.0) * a)
    return t


@wp.func
def in_one_cell(
    ground: Reference, ray: SightRay, i: wp.int32, j: wp.int32, first: wp.float64, last: wp.float64, side: wp.float64
):
    """Return (t, side): where the ray crosses the bilinear surface in cell (i, j), and its side before the crossing.

    t is between first and last, which are the ray's t at the ends of the cell, or NOWHERE without a crossing; the side
    is then that at the cell's end, too. side: 1 above the surface, -1 below, 0 if the ray has been on it so far; the
    argument is that at `first`.
    """
    zero = wp.float64(0.0)
    p = corners_of(ground.samples, i, j)
    s = ray.u + first * ray.du - wp.float64(i)
    r = ray.v + first * ray.dv - wp.float64(j)
    low = p[0] + (p[1] - p[0]) * s
    high = p[2] + (p[3] - p[2]) * s
    per_s = (p[1] - p[0]) * ground.scale
    per_r = (p[2] - p[0]) * ground.scale
    twist = (p[3] - p[1] - p[2] + p[0]) * ground.scale
    # The ray's height above the surface at `first` + t is a t^2 + b t + c.
    a = -twist * ray.du * ray.dv
    b = ray.dz - per_s * ray.du - per_r * ray.dv - twist * (s * ray.dv + r * ray.du)
    c = ray.z + first * ray.dz - ((low + (high - low) * r) * ground.scale + ground.offset)
    length = last - first
    turn = length  # where the parabola turns, or the end
    if a != zero and a * b < zero:
        turn = wp.min(-b / (wp.float64(2.0) * a), length)
    e_turn = (a * turn + b) * turn + c
    e_last = (a * length + b) * length + c
    if side == zero:
        side = side_of(c, ray.tolerance)
    if side == zero:
        side = side_of(e_turn, ray.tolerance)
    if side == zero:
        side = side_of(e_last, ray.tolerance)
    hit = NOWHERE
    if side != zero:
        clearance = side * c + ray.tolerance
        if clearance < zero:
            hit = first
        elif side * e_turn + ray.tolerance < zero or side * e_last + ray.tolerance < zero:  # to the other side
            hit = first + wp.min(first_root(side * a, side * b, clearance), length)
    return hit, side


@wp.func
def height_above_patch(ground: Reference, ray: SightRay, i: wp.int32, j: wp.int32, t: wp.float64) -> wp.float64:
    """Return the height of the ray above the surface, metres, at its point t, which is in cell (i, j)."""
    return ray.z + t * ray.dz - reference_in_cell(ground, i, j, ray.u + t * ray.du, ray.v + t * ray.dv)


@wp.func
def bisect_crossing(
    ground: Reference, ray: SightRay, i: wp.int32, j: wp.int32, first: wp.float64, last: wp.float64, side: wp.float64
) -> wp.float64:
    """Return the t at which the ray crosses the surface in cell (i, j), between `first` and `last`, by bisection.

    It is the end of the last interval, where the ray is just beyond. side: 1 if the ray is above the surface at
    `first`, -1 if below; at `last` it is on the other side by more than its tolerance.
    """
    low = first
    high = last
    for _ in range(HALVINGS):
        middle = wp.float64(0.5) * (low + high)
        if side * height_above_patch(ground, ray, i, j, middle) + ray.tolerance < wp.float64(0.0):
            high = middle
        else:
            low = middle
    return high


@wp.func
def side_of_span(ray: SightRay, t: wp.float64, out: wp.float64, a: wp.float64, b: wp.float64) -> wp.float64:
    """Return 1 if the ray is above all heights between a and b from t to `out`, -1 if it is below them, 0 if neither.

    a, b: metres, in either order. The ray must clear them by its tolerance.
    """
    z0 = ray.z + t * ray.dz
    z1 = ray.z + out * ray.dz
    side = wp.float64(0.0)
    if wp.min(z0, z1) - wp.max(a, b) > ray.tolerance:
        side = wp.float64(1.0)
    elif wp.min(a, b) - wp.max(z0, z1) > ray.tolerance:
        side = wp.float64(-1.0)
    return side


@wp.func
def in_one_patch(
    ground: Reference, ray: SightRay, i: wp.int32, j: wp.int32, first: wp.float64, last: wp.float64, side: wp.float64
):
    """Return (t, side): where the ray crosses the curved surface in cell (i, j), and its side before the crossing.

    There is no closed form: PLACES + 1 points of the ray between t = first and last are compared with the surface, and
    a change of sides is bisected. t is NOWHERE without a crossing; the side is then that at the cell's end, too. side:
    1 above, -1 below, 0 on the surface so far; the argument is that at `first`. If the ray clears all heights of the
    cell, its side is known without points, and a change from `side` is a crossing at `first`.
    """
    hit = NOWHERE
    a, b = height_bounds(ground.samples, i, j)
    a = (a - ground.max_detail) * ground.scale + ground.offset
    b = (b + ground.max_detail) * ground.scale + ground.offset
    on_side = side_of_span(ray, first, last, a, b)
    if on_side != wp.float64(0.0):  # it clears all heights of the cell
        if side * on_side < wp.float64(0.0):  # it came from the other side
            hit = first
        side = on_side
    else:
        before = first
        k = wp.int32(0)
        while k <= PLACES and hit == NOWHERE:
            t = first + (last - first) * (wp.float64(k) / wp.float64(PLACES))
            e = height_above_patch(ground, ray, i, j, t)
            if side == wp.float64(0.0):
                side = side_of(e, ray.tolerance)
            elif side * e + ray.tolerance < wp.float64(0.0):  # it has changed sides
                hit = bisect_crossing(ground, ray, i, j, before, t, side)
            before = t
            k += 1
    return hit, side


@wp.func
def over_ground(ground: Reference, blocks: HeightBlocks, ray: SightRay, start: wp.float64, end: wp.float64):
    """Return the first and last t of start .. end where the ray is over the raster and near its range of heights.

    There is none if first > last. `within` cuts the interval of t down to a range of one coordinate.
    """
    zero = wp.float64(0.0)
    first, last = within(start, end, ray.u, ray.du, zero, wp.float64(ground.samples.columns - 1))
    first, last = within(first, last, ray.v, ray.dv, zero, wp.float64(ground.samples.rows - 1))
    # So far outside the heights, a ray clears them by more than its tolerance, also on flat ground: its side is known.
    spare = blocks.high_z - blocks.low_z + ground.step_x + wp.float64(1e3) * blocks.tolerance
    return within(first, last, ray.z, ray.dz, blocks.low_z - spare, blocks.high_z + spare)


@wp.func
def exit_along_axis(start: wp.float64, direction: wp.float64, low: wp.int32, high: wp.int32) -> wp.float64:
    """Return the ray's t where it leaves cells low .. high - 1 along one axis, NOWHERE if it never does.

    start, direction: the ray's position and direction along the axis, in cells.
    """
    t = NOWHERE
    if direction != wp.float64(0.0):
        t = (wp.float64(wp.where(direction > wp.float64(0.0), high, low)) - start) / direction
    return t


@wp.func
def cell_along_axis(
    start: wp.float64, direction: wp.float64, out: wp.float64, low: wp.int32, high: wp.int32
) -> wp.int32:
    """Return the cell along one axis that contains the ray's point t = `out`, clamped to low .. high - 1.

    start, direction: the ray's position and direction along that axis, in cells.
    """
    return wp.clamp(wp.int32(wp.floor(start + out * direction)), low, high - 1)


@wp.func
def first_crossing(
    ground: Reference, blocks: HeightBlocks, ray: SightRay, start: wp.float64, end: wp.float64, start_level: wp.int32
) -> wp.float64:
    """Return the first t in start .. end where the ray passes through the surface, NOWHERE if it does not.

    The ray may begin on either side; where it only touches the surface within its tolerance, it does not pass.
    start_level: level of the first block of cells that is tried: 0 near the surface, the highest far from it.
    """
    zero = wp.float64(0.0)
    cells_x = ground.samples.columns - 1
    cells_y = ground.samples.rows - 1
    t, last = over_ground(ground, blocks, ray, start, end)
    hit = NOWHERE
    if t > last:
        return hit
    side = zero  # of the ray so far: 1 above the surface, -1 below, 0 not yet known
    level = wp.min(start_level, blocks.levels)
    i = cell_along_axis(ray.u, ray.du, t, 0, cells_x)
    j = cell_along_axis(ray.v, ray.dv, t, 0, cells_y)
    while True:
        # The block around cell (i, j), and the ray's t where it leaves the block.
        bits = wp.where(level == 0, 0, level + CELL_BITS)
        x0 = (i >> bits) << bits
        y0 = (j >> bits) << bits
        x1 = wp.min(x0 + (1 << bits), cells_x)
        y1 = wp.min(y0 + (1 << bits), cells_y)
        to_x = exit_along_axis(ray.u, ray.du, x0, x1)
        to_y = exit_along_axis(ray.v, ray.dv, y0, y1)
        out = wp.max(t, wp.min(wp.min(to_x, to_y), last))
        is_clear = True
        if level == 0 and ground.curved == 1:
            hit, side = in_one_patch(ground, ray, i, j, t, out, side)
        elif level == 0:
            hit, side = in_one_cell(ground, ray, i, j, t, out, side)
        else:
            n = blocks.base[level] + wp.int64(y0 >> bits) * wp.int64(blocks.width[level]) + wp.int64(x0 >> bits)
            low = wp.float64(item_at(blocks.low, n)) * ground.scale + ground.offset
            high = wp.float64(item_at(blocks.high, n)) * ground.scale + ground.offset
            block_side = side_of_span(ray, t, out, low, high)
            is_clear = block_side != zero
            hit = wp.where(side * block_side < zero, t, NOWHERE)
            side = wp.where(is_clear, block_side, side)
        if hit < NOWHERE or (is_clear and out >= last):
            break
        # Go on in the next cell, by a larger block if the line that is crossed is a side of one, or descend.
        if is_clear:
            line = wp.where(ray.dv > zero, y1, y0)
            if to_x <= to_y:
                line = wp.where(ray.du > zero, x1, x0)
                i = wp.where(ray.du > zero, x1, x0 - 1)
                j = cell_along_axis(ray.v, ray.dv, out, y0, y1)
            else:
                j = wp.where(ray.dv > zero, y1, y0 - 1)
                i = cell_along_axis(ray.u, ray.du, out, x0, x1)
            t = out
            if i < 0 or j < 0 or i >= cells_x or j >= cells_y:  # it leaves the raster
                break
            if level < blocks.levels and (line & ((1 << (level + 1 + CELL_BITS)) - 1)) == 0:
                level += 1
        else:
            level -= 1
    return hit
