# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the error hierarchy of a raster; cbt_terrain/field describes the method.

Heights are read as floats, row 0 south. Errors are one array in the order of `cbt_terrain/field/lattice.py`; a kernel
processes one depth of it. All arithmetic on heights is float64, so planes through float32 samples at power-of-two
distances are exact, and a flat or planar map has an error of exactly zero. Heights and errors are metres
before vertical scaling.
"""

import warp as wp

from ..unchecked import item_at, put
from .codes import Samples, sample_index
from .layout import Depth, child, diamond, entry, holds


@wp.func
def round_up(value: wp.float64):
    """Return the smallest float32 that is not below a non-negative float64."""
    single = wp.float32(value)
    if wp.float64(single) < value:
        single = wp.cast(wp.cast(single, wp.int32) + 1, wp.float32)
    return single


@wp.func
def row_error(
    h: wp.array(dtype=wp.float32), first: wp.int64, count: int, plane: wp.float64, slope: wp.float64
) -> wp.float64:
    """Return the largest distance, metres, of `count` samples in a row from a plane.

    first: index of the first sample. plane: height of the plane there. slope: its metres a sample along the row. NaN
    samples do not count.
    """
    largest = wp.float64(0.0)
    for i in range(count):
        distance = wp.abs(wp.float64(item_at(h, first + wp.int64(i))) - (plane + slope * wp.float64(i)))
        largest = wp.where(distance > largest, distance, largest)
    return largest


@wp.func
def vertex_height(raster: Samples, x: int, y: int) -> wp.float64:
    """Return the height, metres, at sample (x, y); beyond the eastern or northern border that of the nearest sample."""
    at = sample_index(raster, wp.min(x, raster.columns - 1), wp.min(y, raster.rows - 1))
    return wp.float64(item_at(raster.floats, at))


@wp.func
def row_inside(raster: Samples, x: int, y: int, count: int, plane: wp.float64, slope: wp.float64) -> wp.float64:
    """Return the largest distance of the samples (x, y) .. (x + count - 1, y) from a line, metres; 0 if none is inside.

    The line has the height `plane` at the first sample and rises by `slope` a sample. Samples outside the raster do not
    count.
    """
    inside = wp.min(count, raster.columns - x)
    largest = wp.float64(0.0)
    if inside > 0 and y < raster.rows:
        largest = row_error(raster.floats, sample_index(raster, x, y), inside, plane, slope)
    return largest


@wp.func
def diagonal_inside(
    raster: Samples, x: int, y: int, right: int, up: int, cells: int, plane: wp.float64, slope: wp.float64
) -> wp.float64:
    """Return the largest distance of the bilinear surface from a plane, between samples on diagonals of `cells` cells.

    The diagonals start at (x, y) and run east (`right` 1) or west (-1), north (`up` 1) or south (-1). Those beyond the
    border do not count. plane: height of the plane at (x, y); slope: its metres a cell along the diagonal. In a cell
    the distance is e(t) = e0 (1-t) + e1 t - c t (1-t), c the cell's twist. Only a turning point counts, so that the
    result is 0 without one: `row_inside` measures at the samples.
    """
    h = raster.floats
    to_side = wp.int64(right)  # to the next sample in a row, and in a column
    to_row = wp.int64(up) * wp.int64(raster.columns)
    first = wp.int32(0)
    end = cells
    if right > 0:
        end = wp.min(end, raster.columns - 1 - x)
    else:
        first = wp.max(first, x - (raster.columns - 1))
    if up > 0:
        end = wp.min(end, raster.rows - 1 - y)
    else:
        first = wp.max(first, y - (raster.rows - 1))
    largest = wp.float64(0.0)
    if first < end:
        at = sample_index(raster, x + right * first, y + up * first)
        z0 = wp.float64(item_at(h, at))
        e0 = z0 - (plane + slope * wp.float64(first))
        for i in range(first, end):
            far = at + to_side + to_row
            z1 = wp.float64(item_at(h, far))
            e1 = z1 - (plane + slope * wp.float64(i + 1))
            twist = z0 + z1 - wp.float64(item_at(h, at + to_side)) - wp.float64(item_at(h, at + to_row))
            if wp.abs(e1 - e0) < wp.abs(twist):
                rest = twist - (e1 - e0)
                largest = wp.max(largest, wp.abs(e0 - rest * rest / (wp.float64(4.0) * twist)))
            z0 = z1
            e0 = e1
            at = far
    return largest


@wp.func
def largest_below(values: wp.array(dtype=wp.float32), finer: Depth, coarser: Depth, p: wp.vec2i) -> wp.float32:
    """Return the largest of the `values` of the up to four children of diamond p; 0 without any.

    finer, coarser: layouts of the depths of the children and of p.
    """
    largest = wp.float32(0.0)
    for k in range(4):
        c = child(coarser, p, k)
        if holds(finer, c):
            largest = wp.max(largest, item_at(values, entry(finer, c[0], c[1])))
    return largest


@wp.func
def corner_error(
    raster: Samples, x: int, y: int, right: int, up: int, legs: int, plane: wp.float64, slope: wp.vec2d
) -> wp.float64:
    """Return the largest distance, metres, of the surface over a right triangle from a plane.

    It is measured at the samples and along the longest edge. The plane has the height `plane` at the triangle's corner
    (x, y) with the right angle. From there legs of `legs` steps between samples run east (`right` 1) or west (-1), and
    north (`up` 1) or south (-1). slope: metres a sample along x and y.
    """
    largest = wp.float64(0.0)
    for j in range(legs):  # the last row would be a vertex, which is on the plane
        first = wp.min(right, 0) * (legs - j)
        start = plane + slope[0] * wp.float64(first) + slope[1] * wp.float64(up * j)
        largest = wp.max(largest, row_inside(raster, x + first, y + up * j, legs + 1 - j, start, slope[0]))
    start = plane + slope[1] * wp.float64(up * legs)
    across = slope[0] * wp.float64(right) - slope[1] * wp.float64(up)
    return wp.max(largest, diagonal_inside(raster, x, y + up * legs, right, -up, legs, start, across))


@wp.kernel
def centre_errors(
    offset: wp.int64,
    raster: Samples,
    measured: Samples,
    side: int,
    root: int,
    finer: Depth,
    coarser: Depth,
    errors: wp.array(dtype=wp.float32),
):
    """Compute the errors of diamonds at the centres of cells of `side` samples (at least 2).

    The error of diamond `offset + tid` becomes the largest distance of the surface from its two triangles, or the
    largest of its children's errors if that is more. finer, coarser: layouts of the children's depth and of this one.
    root: 1 if these cells are the root squares. measured: samples, NaN where they do not count.
    """
    p = diamond(coarser, offset + wp.int64(wp.tid()))
    is_northeast = root == 1 or ((p[0] + p[1]) & 1) == 1  # direction of the diagonal with the triangles' corners
    n = wp.float64(side)
    largest = wp.float64(0.0)
    for k in range(2):
        right = 1 - 2 * k
        up = wp.where(is_northeast, right, -right)
        x = (p[0] + k) * side
        y = (p[1] + wp.where(up > 0, 0, 1)) * side
        z = vertex_height(raster, x, y)
        slope_x = wp.float64(right) * (vertex_height(raster, x + right * side, y) - z) / n
        slope_y = wp.float64(up) * (vertex_height(raster, x, y + up * side) - z) / n
        slope = wp.vec2d(slope_x, slope_y)
        largest = wp.max(largest, corner_error(measured, x, y, right, up, side, z, slope))
    put(errors, entry(coarser, p[0], p[1]), wp.max(round_up(largest), largest_below(errors, finer, coarser, p)))


@wp.kernel
def side_errors(
    offset: wp.int64,
    raster: Samples,
    measured: Samples,
    half: int,
    finer: Depth,
    coarser: Depth,
    errors: wp.array(dtype=wp.float32),
):
    """Compute the errors of diamonds at the middles of cells' sides, `half` samples from the side's ends.

    The error of diamond `offset + tid` becomes the largest distance of the surface from its two triangles, each of two
    right ones with their corners in the middle, or the largest of its children's errors if that is more. At the border
    there is one triangle. finer, coarser: layouts as in `centre_errors`. measured: samples, NaN where they do not
    count.
    """
    p = diamond(coarser, offset + wp.int64(wp.tid()))
    if not holds(coarser, p):
        return
    x = p[0] * half
    y = p[1] * half
    flat = p[0] & 1  # 1: the side runs from west to east
    along = wp.vec2i(flat, 1 - flat)
    begin = vertex_height(raster, x - along[0] * half, y - along[1] * half)
    end = vertex_height(raster, x + along[0] * half, y + along[1] * half)
    middle = wp.float64(0.5) * (begin + end)
    n = wp.float64(half)
    largest = wp.float64(0.0)
    if half == 1:
        # Only the sample in the middle is not a corner, and along a leg the distance is a quarter of a cell's twist,
        # which the children hold already.
        largest = row_inside(measured, x, y, 1, middle, wp.float64(0.0))
    else:
        slope = (end - begin) / (wp.float64(2.0) * n)
        for k in range(4):
            right = 1 - 2 * (k & 1)
            up = 1 - (k & 2)
            across = wp.where(flat == 1, up, right)
            apex = wp.vec2i(p[0] + across * along[1], p[1] + across * along[0])
            if holds(coarser, apex):
                z = vertex_height(raster, apex[0] * half, apex[1] * half)
                rise = wp.float64(across) * (z - middle) / n
                slopes = wp.where(flat == 1, wp.vec2d(slope, rise), wp.vec2d(rise, slope))
                largest = wp.max(largest, corner_error(measured, x, y, right, up, half, middle, slopes))
    put(errors, entry(coarser, p[0], p[1]), wp.max(round_up(largest), largest_below(errors, finer, coarser, p)))


@wp.kernel
def twists(offset: int, measured: Samples, cells: Depth, errors: wp.array(dtype=wp.float32)):
    """Write to `errors` a quarter of the twist, metres, of each cell of row `offset + tid`; 0 if a sample is NaN.

    It is the largest distance of the bilinear cell from its two triangles.
    """
    h = measured.floats
    cy = offset + wp.tid()
    for cx in range(measured.columns - 1):
        south = sample_index(measured, cx, cy)
        north = south + wp.int64(measured.columns)
        east = wp.int64(1)
        near = wp.float64(item_at(h, south)) - wp.float64(item_at(h, south + east))
        far = wp.float64(item_at(h, north + east)) - wp.float64(item_at(h, north))
        twist = wp.abs(near + far) * wp.float64(0.25)
        put(errors, entry(cells, cx, cy), wp.where(twist > wp.float64(0.0), round_up(twist), wp.float32(0.0)))


@wp.kernel
def saturate_rows(offset: int, part: wp.float32, cells: Depth, errors: wp.array(dtype=wp.float32)):
    """Raise each cell of row `offset + tid` in `errors` to at least `part` of its western and eastern neighbours.

    One pass goes east, one back west, so a value reaches all cells, times `part` for each step.
    """
    cy = offset + wp.tid()
    last = wp.float32(0.0)
    for cx in range(cells.columns):
        cell = entry(cells, cx, cy)
        last = wp.max(item_at(errors, cell), last * part)
        put(errors, cell, last)
    for i in range(cells.columns):
        cell = entry(cells, cells.columns - 1 - i, cy)
        last = wp.max(item_at(errors, cell), last * part)
        put(errors, cell, last)


@wp.kernel
def saturate_columns(offset: int, block: int, part: wp.float32, cells: Depth, errors: wp.array(dtype=wp.float32)):
    """Raise each cell's error to at least `part` of that of its southern and northern neighbours.

    The thread works on block `offset + tid` of `block` columns, from south to north and back.
    """
    x0 = (offset + wp.tid()) * block
    x1 = wp.min(x0 + block, cells.columns)
    for i in range(cells.rows - 1):
        for x in range(x0, x1):
            cell = entry(cells, x, i + 1)
            put(errors, cell, wp.max(item_at(errors, cell), item_at(errors, entry(cells, x, i)) * part))
    for i in range(cells.rows - 1):
        cy = cells.rows - 2 - i
        for x in range(x0, x1):
            cell = entry(cells, x, cy)
            put(errors, cell, wp.max(item_at(errors, cell), item_at(errors, entry(cells, x, cy + 1)) * part))
