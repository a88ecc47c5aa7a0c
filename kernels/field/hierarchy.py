# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the error hierarchy and of the height ranges of a raster; the method is in cbt_terrain/field.

Heights `h` are one flat array, row 0 south, `width` samples a row. Errors are one array in the order of
`cbt_terrain/field/lattice.py`; kernels work on one depth of it at a time.
All arithmetic on heights is float64: planes through float32 samples at power-of-two distances are then exact, so that a
flat or planar map has an error of exactly zero.
"""

import warp as wp

from .layout import Depth, entry

wp.set_module_options({"enable_backward": False})


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
def diagonal_error(
    h: wp.array(dtype=wp.float32),
    first: int,
    side_x: int,
    side_y: int,
    cells: int,
    plane: wp.float64,
    slope: wp.float64,
    known: wp.float64,
):
    """`known`, or more where the bilinear surface over `cells` cells along their diagonals is farther from the plane.

    The diagonals start at index `first`; `side_x` and `side_y` lead to the two other corners of a cell, their sum to
    its far corner. Along a diagonal the distance is e(t) = e0 (1-t) + e1 t - c t (1-t), c the cell's twist.
    """
    largest = known
    at = first
    e0 = wp.float64(h[at]) - plane
    for i in range(cells):
        far = at + side_x + side_y
        e1 = wp.float64(h[far]) - (plane + slope * wp.float64(i + 1))
        twist = wp.float64(h[at]) + wp.float64(h[far]) - wp.float64(h[at + side_x]) - wp.float64(h[at + side_y])
        if wp.abs(e1 - e0) < wp.abs(twist):
            rest = twist - (e1 - e0)
            largest = wp.max(largest, wp.abs(e0 - rest * rest / (wp.float64(4.0) * twist)))
        e0 = e1
        at = far
    return largest


@wp.func
def beside(errors: wp.array(dtype=wp.float32), sides: Depth, cx: int, cy: int):
    """Largest value of the middles of the four sides of a cell."""
    across = wp.max(errors[entry(sides, 2 * cx + 1, 2 * cy)], errors[entry(sides, 2 * cx + 1, 2 * cy + 2)])
    return wp.max(
        across, wp.max(errors[entry(sides, 2 * cx, 2 * cy + 1)], errors[entry(sides, 2 * cx + 2, 2 * cy + 1)])
    )


@wp.kernel
def centre_errors(
    offset: int,
    h: wp.array(dtype=wp.float32),
    width: int,
    columns: int,
    side: int,
    root: int,
    finer: Depth,
    own: Depth,
    errors: wp.array(dtype=wp.float32),
):
    """Diamonds at the centres of cells of `side` samples (at least 2), `columns` cells a row.

    `root` is 1 where these cells are the root squares.
    `finer` holds the diamonds at the middles of the cells' sides: the children.
    """
    t = offset + wp.tid()
    cy = t / columns
    cx = t - cy * columns
    south = cy * side * width + cx * side
    north = south + side * width
    h00 = wp.float64(h[south])
    h10 = wp.float64(h[south + side])
    h01 = wp.float64(h[north])
    h11 = wp.float64(h[north + side])
    n = wp.float64(side)
    largest = wp.float64(0.0)
    if root == 1 or ((cx + cy) & 1) == 1:
        # Anti-diagonal: triangles at the south-west and at the north-east corner.
        for j in range(side + 1):
            row = south + j * width
            v = wp.float64(j)
            low = h00 + (h01 - h00) / n * v
            largest = wp.max(largest, row_error(h, row, side + 1 - j, low, (h10 - h00) / n))
            high = h10 + (h11 - h10) / n * v
            slope = (h11 - h01) / n
            largest = wp.max(largest, row_error(h, row + side - j, j + 1, high - slope * v, slope))
        largest = diagonal_error(h, north, 1, -width, side, h01, (h10 - h01) / n, largest)
    else:
        for j in range(side + 1):
            row = south + j * width
            v = wp.float64(j)
            left = h00 + (h01 - h00) / n * v
            largest = wp.max(largest, row_error(h, row, j + 1, left, (h11 - h01) / n))
            slope = (h10 - h00) / n
            middle = h00 + (h11 - h10) / n * v + slope * v
            largest = wp.max(largest, row_error(h, row + j, side + 1 - j, middle, slope))
        largest = diagonal_error(h, south, 1, width, side, h00, (h11 - h00) / n, largest)
    errors[entry(own, cx, cy)] = wp.max(round_up(largest), beside(errors, finer, cx, cy))


@wp.func
def flat_base_error(h: wp.array(dtype=wp.float32), width: int, centre: int, half: int, up: int):
    """Error of the triangle with a west-east longest edge at `centre`, apex `half` rows north (up 1) or south (-1)."""
    west = wp.float64(h[centre - half])
    east = wp.float64(h[centre + half])
    apex = wp.float64(h[centre + up * half * width])
    n = wp.float64(half)
    slope = (east - west) / (wp.float64(2.0) * n)
    rise = (apex - wp.float64(0.5) * (west + east)) / n
    largest = wp.float64(0.0)
    for i in range(half + 1):
        plane = west + (slope + rise) * wp.float64(i)
        first = centre + up * i * width - half + i
        largest = wp.max(largest, row_error(h, first, 2 * (half - i) + 1, plane, slope))
    step = up * width
    largest = diagonal_error(h, centre - half, 1, step, half, west, slope + rise, largest)
    return diagonal_error(h, centre + half, -1, step, half, east, rise - slope, largest)


@wp.func
def upright_base_error(h: wp.array(dtype=wp.float32), width: int, centre: int, half: int, right: int):
    """Error of the triangle with a south-north longest edge at `centre`, apex `half` columns east (right 1) or west."""
    south = wp.float64(h[centre - half * width])
    north = wp.float64(h[centre + half * width])
    apex = wp.float64(h[centre + right * half])
    n = wp.float64(half)
    middle = wp.float64(0.5) * (south + north)
    slope = (north - south) / (wp.float64(2.0) * n)
    rise = (apex - middle) / n
    largest = wp.float64(0.0)
    for i in range(2 * half + 1):
        v = i - half
        reach = half - wp.abs(v)
        plane = middle + slope * wp.float64(v)
        first = centre + v * width
        if right == 1:
            largest = wp.max(largest, row_error(h, first, reach + 1, plane, rise))
        else:
            west = plane + rise * wp.float64(reach)
            largest = wp.max(largest, row_error(h, first - reach, reach + 1, west, -rise))
    largest = diagonal_error(h, centre - half * width, right, width, half, south, slope + rise, largest)
    return diagonal_error(h, centre + half * width, right, -width, half, north, rise - slope, largest)


@wp.func
def around(errors: wp.array(dtype=wp.float32), centres: Depth, x: int, y: int, columns: int, rows: int):
    """Largest value of the up to four cells that meet in the lattice point (x, y)."""
    largest = wp.float32(0.0)
    for j in range(2):
        for i in range(2):
            cx = x - i
            cy = y - j
            if cx >= 0 and cx < columns and cy >= 0 and cy < rows:
                largest = wp.max(largest, errors[entry(centres, cx, cy)])
    return largest


@wp.func
def side_point(t: int, stride: int):
    """Lattice point (x, y), x + y odd, of number `t` of the middles of sides, `stride` a row.

    A row between cells has one more than a row through centres, where the last number is beyond the east end.
    """
    y = t / stride
    return wp.vec2i(2 * (t - y * stride) + ((y + 1) & 1), y)


@wp.kernel
def side_errors(
    offset: int,
    h: wp.array(dtype=wp.float32),
    width: int,
    columns: int,
    rows: int,
    half: int,
    finer: Depth,
    own: Depth,
    errors: wp.array(dtype=wp.float32),
):
    """Diamonds at the middles of cells' sides, `half` samples from the ends of the side.

    `finer` holds the diamonds at the centres of the `columns` x `rows` cells of `half` the side: the children.
    """
    t = offset + wp.tid()
    p = side_point(t, columns / 2 + 1)
    x = p[0]
    y = p[1]
    if x > columns:
        return
    centre = y * half * width + x * half
    largest = wp.float64(0.0)
    if half == 1:
        # Only the sample in the middle is not a corner, and along a leg the distance is a quarter of a cell's twist,
        # which the children hold already.
        reach = wp.where((x & 1) == 1, 1, width)
        ends = wp.float64(h[centre - reach]) + wp.float64(h[centre + reach])
        largest = wp.abs(wp.float64(h[centre]) - wp.float64(0.5) * ends)
    elif (x & 1) == 1:
        if y > 0:
            largest = wp.max(largest, flat_base_error(h, width, centre, half, -1))
        if y < rows:
            largest = wp.max(largest, flat_base_error(h, width, centre, half, 1))
    else:
        if x > 0:
            largest = wp.max(largest, upright_base_error(h, width, centre, half, -1))
        if x < columns:
            largest = wp.max(largest, upright_base_error(h, width, centre, half, 1))
    errors[entry(own, x, y)] = wp.max(round_up(largest), around(errors, finer, x, y, columns, rows))


@wp.kernel
def twists(offset: int, h: wp.array(dtype=wp.float32), width: int, cells: Depth, errors: wp.array(dtype=wp.float32)):
    """Row `offset + tid` of cells: a quarter of each twist, saturated along the row to a quarter of its neighbours'."""
    cy = offset + wp.tid()
    columns = width - 1
    last = wp.float32(0.0)
    for cx in range(columns):
        at = cy * width + cx
        near = wp.float64(h[at]) - wp.float64(h[at + 1])
        far = wp.float64(h[at + width + 1]) - wp.float64(h[at + width])
        last = wp.max(round_up(wp.abs(near + far) * wp.float64(0.25)), last * wp.float32(0.25))
        errors[entry(cells, cx, cy)] = last
    for i in range(columns):
        cell = entry(cells, columns - 1 - i, cy)
        last = wp.max(errors[cell], last * wp.float32(0.25))
        errors[cell] = last


@wp.kernel
def saturate_columns(
    offset: int,
    columns: int,
    rows: int,
    block: int,
    part: wp.float32,
    cells: Depth,
    errors: wp.array(dtype=wp.float32),
):
    """Block `offset + tid` of columns: each cell to at least `part` of its southern and northern neighbours."""
    x0 = (offset + wp.tid()) * block
    x1 = wp.min(x0 + block, columns)
    for i in range(rows - 1):
        for x in range(x0, x1):
            cell = entry(cells, x, i + 1)
            errors[cell] = wp.max(errors[cell], errors[entry(cells, x, i)] * part)
    for i in range(rows - 1):
        cy = rows - 2 - i
        for x in range(x0, x1):
            cell = entry(cells, x, cy)
            errors[cell] = wp.max(errors[cell], errors[entry(cells, x, cy + 1)] * part)
