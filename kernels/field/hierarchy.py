# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the error hierarchy and of the height ranges of a raster; the method is in cbt_terrain/field.

Heights `h` are one flat array, row 0 south, `width` samples a row. Errors are one array in the order of
`cbt_terrain/field/lattice.py`; kernels work on one depth of it at a time.
All arithmetic on heights is float64: planes through float32 samples at power-of-two distances are then exact, so that a
flat or planar map has an error of exactly zero.
"""

import warp as wp

from .layout import Depth, child, diamond, entry, holds


@wp.func
def round_up(value: wp.float64):
    """The smallest float32 that is not below a non-negative float64."""
    single = wp.float32(value)
    if wp.float64(single) < value:
        single = wp.cast(wp.cast(single, wp.int32) + 1, wp.float32)
    return single


@wp.func_native("""
#pragma clang fp contract(off)
    typedef float singles __attribute__((vector_size(16)));
    typedef double doubles __attribute__((vector_size(32)));
    typedef long long bits __attribute__((vector_size(32)));
    const float* row = h.data + first;
    const bits magnitude = {0x7fffffffffffffffLL, 0x7fffffffffffffffLL, 0x7fffffffffffffffLL, 0x7fffffffffffffffLL};
    doubles at = {0.0, 1.0, 2.0, 3.0};
    doubles most = {0.0, 0.0, 0.0, 0.0};
    int i = 0;
    for (; i + 4 <= count; i += 4) {
        singles four;
        __builtin_memcpy(&four, row + i, sizeof(four));
        const doubles signed_distance = __builtin_convertvector(four, doubles) - (plane + slope * at);
        const doubles distance = (doubles)((bits)signed_distance & magnitude);
        const bits more = distance > most;
        most = (doubles)(((bits)distance & more) | ((bits)most & ~more));
        at += 4.0;
    }
    double largest = 0.0;
    for (int k = 0; k < 4; ++k)
        largest = most[k] > largest ? most[k] : largest;
    for (; i < count; ++i) {
        const double distance = (double)row[i] - (plane + slope * (double)i);
        largest = distance > largest ? distance : (-distance > largest ? -distance : largest);
    }
    return largest;
""")
def row_error(
    h: wp.array(dtype=wp.float32), first: int, count: int, plane: wp.float64, slope: wp.float64
) -> wp.float64:
    """Largest distance between `count` samples of a row from index `first` on and the plane along that row.

    Nearly all time of the hierarchy passes here. As C with vectors it is four times faster than Warp's scalar loop.
    """
    ...


@wp.func
def corner(h: wp.array(dtype=wp.float32), width: int, height: int, x: int, y: int) -> wp.float64:
    """Height of a vertex: beyond the rim that of the nearest sample."""
    return wp.float64(h[wp.min(y, height - 1) * width + wp.min(x, width - 1)])


@wp.func
def row_inside(
    h: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    x: int,
    y: int,
    count: int,
    plane: wp.float64,
    slope: wp.float64,
    known: wp.float64,
):
    """`known`, or more where `count` samples from (x, y) on are farther from the plane; beyond the rim none is."""
    inside = wp.min(count, width - x)
    largest = known
    if inside > 0 and y < height:
        largest = wp.max(largest, row_error(h, y * width + x, inside, plane, slope))
    return largest


@wp.func
def diagonal_inside(
    h: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    x: int,
    y: int,
    right: int,
    up: int,
    cells: int,
    plane: wp.float64,
    slope: wp.float64,
    known: wp.float64,
):
    """`known`, or more where the bilinear surface over `cells` cells along their diagonals is farther from the plane.

    The diagonals start at (x, y) and go east (`right` 1) or west (-1), north (`up` 1) or south (-1); those beyond the
    rim are none. Along a diagonal the distance is e(t) = e0 (1-t) + e1 t - c t (1-t), c the cell's twist.
    """
    first = wp.int32(0)
    end = cells
    if right > 0:
        end = wp.min(end, width - 1 - x)
    else:
        first = wp.max(first, x - (width - 1))
    if up > 0:
        end = wp.min(end, height - 1 - y)
    else:
        first = wp.max(first, y - (height - 1))
    largest = known
    if first < end:
        at = (y + up * first) * width + x + right * first
        e0 = wp.float64(h[at]) - (plane + slope * wp.float64(first))
        for i in range(first, end):
            far = at + right + up * width
            e1 = wp.float64(h[far]) - (plane + slope * wp.float64(i + 1))
            twist = wp.float64(h[at]) + wp.float64(h[far]) - wp.float64(h[at + right]) - wp.float64(h[at + up * width])
            if wp.abs(e1 - e0) < wp.abs(twist):
                rest = twist - (e1 - e0)
                largest = wp.max(largest, wp.abs(e0 - rest * rest / (wp.float64(4.0) * twist)))
            e0 = e1
            at = far
    return largest


@wp.func
def largest_below(values: wp.array(dtype=wp.float32), finer: Depth, own: Depth, p: wp.vec2i) -> wp.float32:
    """Largest value of a diamond's up to four children."""
    largest = wp.float32(0.0)
    for k in range(4):
        c = child(own, p, k)
        if holds(finer, c):
            largest = wp.max(largest, values[entry(finer, c[0], c[1])])
    return largest


@wp.kernel
def centre_errors(
    offset: int,
    h: wp.array(dtype=wp.float32),
    measured: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    side: int,
    root: int,
    finer: Depth,
    own: Depth,
    errors: wp.array(dtype=wp.float32),
):
    """Diamonds at the centres of cells of `side` samples (at least 2).

    `root` is 1 where these cells are the root squares. `measured`: what of `h` counts, NaN elsewhere.
    """
    p = diamond(own, offset + wp.tid())
    x = p[0] * side
    y = p[1] * side
    h00 = corner(h, width, height, x, y)
    h10 = corner(h, width, height, x + side, y)
    h01 = corner(h, width, height, x, y + side)
    h11 = corner(h, width, height, x + side, y + side)
    n = wp.float64(side)
    rows = wp.min(side + 1, height - y)
    largest = wp.float64(0.0)
    if root == 1 or ((p[0] + p[1]) & 1) == 1:
        # Anti-diagonal: triangles at the south-west and at the north-east corner.
        for j in range(rows):
            v = wp.float64(j)
            low = h00 + (h01 - h00) / n * v
            slope = (h10 - h00) / n
            largest = row_inside(measured, width, height, x, y + j, side + 1 - j, low, slope, largest)
            high = h10 + (h11 - h10) / n * v
            slope = (h11 - h01) / n
            largest = row_inside(measured, width, height, x + side - j, y + j, j + 1, high - slope * v, slope, largest)
        largest = diagonal_inside(measured, width, height, x, y + side, 1, -1, side, h01, (h10 - h01) / n, largest)
    else:
        for j in range(rows):
            v = wp.float64(j)
            left = h00 + (h01 - h00) / n * v
            largest = row_inside(measured, width, height, x, y + j, j + 1, left, (h11 - h01) / n, largest)
            slope = (h10 - h00) / n
            middle = h00 + (h11 - h10) / n * v + slope * v
            largest = row_inside(measured, width, height, x + j, y + j, side + 1 - j, middle, slope, largest)
        largest = diagonal_inside(measured, width, height, x, y, 1, 1, side, h00, (h11 - h00) / n, largest)
    errors[entry(own, p[0], p[1])] = wp.max(round_up(largest), largest_below(errors, finer, own, p))


@wp.func
def flat_base_error(
    h: wp.array(dtype=wp.float32),
    measured: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    x: int,
    y: int,
    half: int,
    up: int,
):
    """Error of the triangle with a west-east longest edge about (x, y), apex `half` rows north (up 1) or south (-1)."""
    west = corner(h, width, height, x - half, y)
    east = corner(h, width, height, x + half, y)
    apex = corner(h, width, height, x, y + up * half)
    n = wp.float64(half)
    slope = (east - west) / (wp.float64(2.0) * n)
    rise = (apex - wp.float64(0.5) * (west + east)) / n
    largest = wp.float64(0.0)
    for i in range(half + 1):
        plane = west + (slope + rise) * wp.float64(i)
        largest = row_inside(
            measured, width, height, x - half + i, y + up * i, 2 * (half - i) + 1, plane, slope, largest
        )
    largest = diagonal_inside(measured, width, height, x - half, y, 1, up, half, west, slope + rise, largest)
    return diagonal_inside(measured, width, height, x + half, y, -1, up, half, east, rise - slope, largest)


@wp.func
def upright_base_error(
    h: wp.array(dtype=wp.float32),
    measured: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    x: int,
    y: int,
    half: int,
    right: int,
):
    """Error of the triangle with a south-north longest edge about (x, y), apex `half` columns east (1) or west (-1)."""
    south = corner(h, width, height, x, y - half)
    north = corner(h, width, height, x, y + half)
    apex = corner(h, width, height, x + right * half, y)
    n = wp.float64(half)
    middle = wp.float64(0.5) * (south + north)
    slope = (north - south) / (wp.float64(2.0) * n)
    rise = (apex - middle) / n
    largest = wp.float64(0.0)
    for i in range(2 * half + 1):
        v = i - half
        reach = half - wp.abs(v)
        plane = middle + slope * wp.float64(v)
        if right == 1:
            largest = row_inside(measured, width, height, x, y + v, reach + 1, plane, rise, largest)
        else:
            west = plane + rise * wp.float64(reach)
            largest = row_inside(measured, width, height, x - reach, y + v, reach + 1, west, -rise, largest)
    largest = diagonal_inside(measured, width, height, x, y - half, right, 1, half, south, slope + rise, largest)
    return diagonal_inside(measured, width, height, x, y + half, right, -1, half, north, rise - slope, largest)


@wp.kernel
def side_errors(
    offset: int,
    h: wp.array(dtype=wp.float32),
    measured: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    half: int,
    finer: Depth,
    own: Depth,
    errors: wp.array(dtype=wp.float32),
):
    """Diamonds at the middles of cells' sides, `half` samples from the ends of the side; `measured` as before."""
    p = diamond(own, offset + wp.tid())
    if not holds(own, p):
        return
    x = p[0] * half
    y = p[1] * half
    flat = p[0] & 1
    largest = wp.float64(0.0)
    if half == 1:
        # Only the sample in the middle is not a corner, and along a leg the distance is a quarter of a cell's twist,
        # which the children hold already.
        plane = corner(h, width, height, x - flat, y - 1 + flat) + corner(h, width, height, x + flat, y + 1 - flat)
        largest = row_inside(measured, width, height, x, y, 1, wp.float64(0.5) * plane, wp.float64(0.0), largest)
    elif flat == 1:
        if y > 0:
            largest = wp.max(largest, flat_base_error(h, measured, width, height, x, y, half, -1))
        if p[1] < own.rows:
            largest = wp.max(largest, flat_base_error(h, measured, width, height, x, y, half, 1))
    else:
        if x > 0:
            largest = wp.max(largest, upright_base_error(h, measured, width, height, x, y, half, -1))
        if p[0] < own.columns:
            largest = wp.max(largest, upright_base_error(h, measured, width, height, x, y, half, 1))
    errors[entry(own, p[0], p[1])] = wp.max(round_up(largest), largest_below(errors, finer, own, p))


@wp.kernel
def twists(offset: int, h: wp.array(dtype=wp.float32), width: int, cells: Depth, errors: wp.array(dtype=wp.float32)):
    """Row `offset + tid` of the raster's cells: a quarter of each twist, 0 where a sample is NaN."""
    cy = offset + wp.tid()
    for cx in range(width - 1):
        at = cy * width + cx
        near = wp.float64(h[at]) - wp.float64(h[at + 1])
        far = wp.float64(h[at + width + 1]) - wp.float64(h[at + width])
        twist = wp.abs(near + far) * wp.float64(0.25)
        errors[entry(cells, cx, cy)] = wp.where(twist > wp.float64(0.0), round_up(twist), wp.float32(0.0))


@wp.kernel
def saturate_rows(offset: int, part: wp.float32, cells: Depth, errors: wp.array(dtype=wp.float32)):
    """Row `offset + tid` of cells: each to at least `part` of its western and eastern neighbours."""
    cy = offset + wp.tid()
    last = wp.float32(0.0)
    for cx in range(cells.columns):
        cell = entry(cells, cx, cy)
        last = wp.max(errors[cell], last * part)
        errors[cell] = last
    for i in range(cells.columns):
        cell = entry(cells, cells.columns - 1 - i, cy)
        last = wp.max(errors[cell], last * part)
        errors[cell] = last


@wp.kernel
def saturate_columns(offset: int, block: int, part: wp.float32, cells: Depth, errors: wp.array(dtype=wp.float32)):
    """Block `offset + tid` of columns: each cell to at least `part` of its southern and northern neighbours."""
    x0 = (offset + wp.tid()) * block
    x1 = wp.min(x0 + block, cells.columns)
    for i in range(cells.rows - 1):
        for x in range(x0, x1):
            cell = entry(cells, x, i + 1)
            errors[cell] = wp.max(errors[cell], errors[entry(cells, x, i)] * part)
    for i in range(cells.rows - 1):
        cy = cells.rows - 2 - i
        for x in range(x0, x1):
            cell = entry(cells, x, cy)
            errors[cell] = wp.max(errors[cell], errors[entry(cells, x, cy + 1)] * part)
