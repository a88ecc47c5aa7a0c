# SPDX-License-Identifier: GPL-3.0-or-later
"""The C1 bicubic surface as Bezier patches, one a cell of the raster: bounds of heights, slopes and curvature.

A patch and its derivatives are weighted means of their control values, so the largest control value bounds them.
Control values are differences of samples, in each direction of four samples p0 .. p3 in a row; the patch is between p1
and p2. field/bicubic.py uses these bounds. Beyond the border h(-1) = 2 h(0) - h(1). Exact differences of float32
samples stay exact: a planar map has a curvature of exactly zero. Heights are metres before vertical scaling.

A `column` has the control values along one column of samples between two rows: heights 0 .. 3, slopes to the north
4 .. 6, second derivatives 7, 8, and the inner two heights off the chord 9, 10. A patch takes four columns a .. d from
west to east, and is between b and c: p0 .. p3 are then one value of each (`across`), so that `control_heights` of such
values may be slopes or second derivatives.
"""

import warp as wp

from ..field.codes import Samples, height_at
from ..field.hierarchy import round_up
from ..field.holes import is_whole
from ..field.layout import Depth, entry
from ..field.ranges import quantise_down, quantise_up
from ..unchecked import put

# Far more than the rounding of the sums below.
OUTWARD = wp.constant(wp.float64(1.0 + 1e-12))
vec12d = wp.types.vector(length=12, dtype=wp.float64)
mat24d = wp.types.matrix(shape=(2, 4), dtype=wp.float64)


@wp.func
def control_heights(p: wp.vec4d) -> wp.vec4d:
    """Return the four Bezier control heights of the cubic between samples p1 and p2. p: four samples in a row."""
    sixth = wp.float64(1.0) / wp.float64(6.0)
    return wp.vec4d(p[1], p[1] + (p[2] - p[0]) * sixth, p[2] - (p[3] - p[1]) * sixth, p[2])


@wp.func
def chord(p: wp.vec4d) -> wp.vec4d:
    """Return the line from sample p1 to p2 as the four control heights of a cubic. p: four samples in a row."""
    third = (p[2] - p[1]) / wp.float64(3.0)
    return wp.vec4d(p[1], p[1] + third, p[2] - third, p[2])


@wp.func
def off_chord(p: wp.vec4d) -> wp.vec2d:
    """Return the two inner control heights of the cubic minus its chord from p1 to p2; the outer two are 0.

    p: four samples in a row.
    """
    two = wp.float64(2.0)
    sixth = wp.float64(1.0) / wp.float64(6.0)
    return wp.vec2d((two * p[1] - p[0] - p[2]) * sixth, (two * p[2] - p[1] - p[3]) * sixth)


@wp.func
def slopes(p: wp.vec4d) -> wp.vec3d:
    """Return the three control values of the cubic's first derivative between p1 and p2, metres a cell.

    p: four samples in a row.
    """
    half = wp.float64(0.5)
    middle = wp.float64(2.0) * (p[2] - p[1]) - half * (p[1] - p[0]) - half * (p[3] - p[2])
    return wp.vec3d(half * (p[2] - p[0]), middle, half * (p[3] - p[1]))


@wp.func
def second_derivatives(p: wp.vec4d) -> wp.vec2d:
    """Return the two control values of the cubic's second derivative between p1 and p2, metres a square cell.

    p: four samples in a row.
    """
    near = (p[1] - p[0]) - (p[2] - p[1])
    far = (p[2] - p[1]) - (p[3] - p[2])
    two = wp.float64(2.0)
    return wp.vec2d(far - two * near, near - two * far)


@wp.func
def samples_of_column(raster: Samples, x: int, cy: int) -> wp.vec4d:
    """Return the samples of column x in the four rows around row `cy` of cells, extrapolated beyond the border."""
    row = wp.int64(raster.columns)
    index = wp.int64(cy) * row + wp.int64(x)
    p1 = height_at(raster, index)
    p2 = height_at(raster, index + row)
    p0 = wp.float64(2.0) * p1 - p2
    p3 = wp.float64(2.0) * p2 - p1
    if cy > 0:
        p0 = height_at(raster, index - row)
    if cy < raster.rows - 2:
        p3 = height_at(raster, index + row + row)
    return wp.vec4d(p0, p1, p2, p3)


@wp.func
def column(raster: Samples, x: int, cy: int):
    """Return the control values of column x (-1 .. columns) between the sample rows cy and cy + 1, and a 0.

    All are in metres and cells. Columns -1 and `columns` are extrapolated.
    """
    p = wp.vec4d()
    if x < 0:
        p = wp.float64(2.0) * samples_of_column(raster, 0, cy) - samples_of_column(raster, 1, cy)
    elif x == raster.columns:
        p = wp.float64(2.0) * samples_of_column(raster, x - 1, cy) - samples_of_column(raster, x - 2, cy)
    else:
        p = samples_of_column(raster, x, cy)
    b = control_heights(p)
    d = slopes(p)
    c = second_derivatives(p)
    o = off_chord(p)
    return vec12d(b[0], b[1], b[2], b[3], d[0], d[1], d[2], c[0], c[1], o[0], o[1], wp.float64(0.0))


@wp.func
def max_of_4(known: wp.float64, v: wp.vec4d) -> wp.float64:
    """Return the larger of `known` and the largest magnitude of the four values of v."""
    return wp.max(known, wp.max(wp.max(wp.abs(v[0]), wp.abs(v[1])), wp.max(wp.abs(v[2]), wp.abs(v[3]))))


@wp.func
def max_of_3(known: wp.float64, v: wp.vec3d) -> wp.float64:
    """Return the larger of `known` and the largest magnitude of the three values of v."""
    return wp.max(known, wp.max(wp.abs(v[0]), wp.max(wp.abs(v[1]), wp.abs(v[2]))))


@wp.func
def across(a: vec12d, b: vec12d, c: vec12d, d: vec12d, k: int) -> wp.vec4d:
    """Return value k of four neighbouring columns from west to east."""
    return wp.vec4d(a[k], b[k], c[k], d[k])


@wp.func
def patch_range(a: vec12d, b: vec12d, c: vec12d, d: vec12d) -> wp.vec2d:
    """Return the lowest and highest control height of the patch between columns b and c: a bound of its heights."""
    low = wp.float64(wp.inf)
    high = -wp.float64(wp.inf)
    for k in range(4):
        v = control_heights(across(a, b, c, d, k))
        low = wp.min(low, wp.min(wp.min(v[0], v[1]), wp.min(v[2], v[3])))
        high = wp.max(high, wp.max(wp.max(v[0], v[1]), wp.max(v[2], v[3])))
    return wp.vec2d(low, high)


@wp.kernel
def extents(
    offset: int, raster: Samples, holed: int, valid: wp.array(dtype=wp.uint8), limits: wp.array(dtype=wp.vec4d)
):
    """Write to limits[offset + tid] the limits of a row of cells, which bound the bicubic surface there.

    They are the lowest and highest control height outside of holes, metres, and the steepest slopes east and north,
    metres a cell. holed: 0 without holes. valid: 0 at missing samples; unused without holes.
    """
    cy = offset + wp.tid()
    low = wp.float64(wp.inf)
    high = -wp.float64(wp.inf)
    steep_x = wp.float64(0.0)
    steep_y = wp.float64(0.0)
    a = column(raster, -1, cy)
    b = column(raster, 0, cy)
    c = column(raster, 1, cy)
    for cx in range(raster.columns - 1):
        d = column(raster, cx + 2, cy)
        is_ground = holed == 0
        if not is_ground:
            is_ground = is_whole(valid, raster.columns, cx, cy)
        if is_ground:
            z = patch_range(a, b, c, d)
            low = wp.min(low, z[0])
            high = wp.max(high, z[1])
        for k in range(4):  # heights
            steep_x = max_of_3(steep_x, slopes(across(a, b, c, d, k)))
        for k in range(4, 7):  # slopes to the north
            steep_y = max_of_4(steep_y, control_heights(across(a, b, c, d, k)))
        a = b
        b = c
        c = d
    limits[cy] = wp.vec4d(low, high, steep_x, steep_y)


@wp.func
def curvature_of(a: vec12d, b: vec12d, c: vec12d, d: vec12d) -> wp.float64:
    """Bound a quarter of the largest norm of the second derivatives of the patch between columns b and c, metres.

    That quarter bounds the distance of the patch from the two triangles of its cell. The derivatives xx, xy and yy are
    raised to the degree 3 x 3, so that the norm, which is convex, is bounded by its values at the control points.
    """
    third = wp.float64(1.0) / wp.float64(3.0)
    half = wp.float64(0.5)
    two = wp.float64(2.0)
    yy0 = control_heights(across(a, b, c, d, 7))
    yy1 = control_heights(across(a, b, c, d, 8))
    xy0 = elevate_degree(slopes(across(a, b, c, d, 4)))
    xy1 = elevate_degree(slopes(across(a, b, c, d, 5)))
    xy2 = elevate_degree(slopes(across(a, b, c, d, 6)))
    largest = wp.float64(0.0)
    for k in range(4):
        ends = second_derivatives(across(a, b, c, d, k))
        step = (ends[1] - ends[0]) * third
        xx = wp.vec4d(ends[0], ends[0] + step, ends[1] - step, ends[1])
        yy = yy0 + (yy1 - yy0) * (third * wp.float64(k))
        xy = xy0
        if k == 1:
            xy = (xy0 + two * xy1) * third
        if k == 2:
            xy = (two * xy1 + xy2) * third
        if k == 3:
            xy = xy2
        for i in range(4):
            # the larger magnitude of the eigenvalues of the matrix of xx, xy, xy and yy
            mean = half * (xx[i] + yy[i])
            apart = half * (xx[i] - yy[i])
            largest = wp.max(largest, wp.abs(mean) + wp.sqrt(apart * apart + xy[i] * xy[i]))
    return wp.float64(0.25) * largest


@wp.func
def elevate_degree(q: wp.vec3d) -> wp.vec4d:
    """Return the three control values of a quadratic as the four of the same curve as a cubic."""
    two = wp.float64(2.0)
    third = wp.float64(1.0) / wp.float64(3.0)
    return wp.vec4d(q[0], (q[0] + two * q[1]) * third, (two * q[1] + q[2]) * third, q[2])


@wp.func
def off_bilinear(a: vec12d, b: vec12d, c: vec12d, d: vec12d) -> wp.float64:
    """Return a bound of the distance between the bicubic and the bilinear patch between columns b and c, metres."""
    zero = wp.float64(0.0)
    # Largest control heights of the difference: off the chord along rows, along columns, and both where they meet.
    east = zero
    north = zero
    both = zero
    off_columns = mat24d()
    for k in range(2):  # the inner two heights off the columns' chords, linear from b to c
        v = chord(across(a, b, c, d, 9 + k))
        north = max_of_4(north, v)
        for i in range(4):
            off_columns[k, i] = v[i]
    for k in range(4):
        w = off_chord(across(a, b, c, d, k))
        east = wp.max(east, wp.max(wp.abs(w[0]), wp.abs(w[1])))
        if k == 1 or k == 2:
            both = wp.max(both, wp.max(wp.abs(w[0] + off_columns[k - 1, 1]), wp.abs(w[1] + off_columns[k - 1, 2])))
    # The two inner control values of a row have 3/4 of the weight together, the twelve outside the corners 15/16.
    separate = wp.float64(0.75) * (east + north)
    return wp.min(separate, wp.float64(0.9375) * wp.max(both, wp.max(east, north)))


@wp.kernel
def patch_errors(
    offset: int,
    raster: Samples,
    corner: wp.vec2i,
    columns: int,
    cells: Depth,
    distance: wp.array(dtype=wp.float32),
    errors: wp.array(dtype=wp.float32),
    curvatures: wp.array(dtype=wp.float32),
):
    """Compute bounds, metres, for row `offset + tid` of the cells of a window of the raster.

    distance: that of the bicubic patch from the bilinear one. errors: that of the surface from the cell's two
    triangles, the smaller one of a bound by twist and distance and one by curvature. curvatures: a quarter of the
    largest second derivative. corner: column and row of the window's first cell. columns: cells in its rows. cells:
    layout of these three arrays by cells of the window.
    """
    y = offset + wp.tid()
    cy = corner[1] + y
    a = column(raster, corner[0] - 1, cy)
    b = column(raster, corner[0], cy)
    c = column(raster, corner[0] + 1, cy)
    for x in range(columns):
        d = column(raster, corner[0] + x + 2, cy)
        curvature = round_up(curvature_of(a, b, c, d) * OUTWARD)
        apart = round_up(off_bilinear(a, b, c, d) * OUTWARD)
        # the heights of two opposite corners minus those of the other two
        twist = wp.abs((b[0] - c[0]) + (c[3] - b[3]))
        index = entry(cells, x, y)
        put(distance, index, apart)
        by_twist = round_up((twist * wp.float64(0.25) + wp.float64(apart)) * OUTWARD)
        put(errors, index, wp.min(by_twist, curvature))
        put(curvatures, index, curvature)
        a = b
        b = c
        c = d


@wp.kernel
def patch_ranges(
    offset: int,
    raster: Samples,
    base: wp.float64,
    step: wp.float64,
    cells: Depth,
    ranges: wp.array(dtype=wp.uint16),
):
    """Write the lowest and highest control height of each cell of row `offset + tid` to `ranges`, as 16-bit codes.

    Code q is the height base + q step, metres; the range is rounded outwards. cells: layout of `ranges` by cells.
    """
    cy = offset + wp.tid()
    per_step = wp.float64(1.0) / step
    a = column(raster, -1, cy)
    b = column(raster, 0, cy)
    c = column(raster, 1, cy)
    for cx in range(raster.columns - 1):
        d = column(raster, cx + 2, cy)
        z = patch_range(a, b, c, d)
        lower_index = wp.int64(2) * entry(cells, cx, cy)
        put(ranges, lower_index, quantise_down(z[0], base, step, per_step))
        put(ranges, lower_index + wp.int64(1), quantise_up(z[1], base, step, per_step))
        a = b
        b = c
        c = d
