# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the error hierarchy of a raster; cbt_terrain/field describes the method.

A *diamond* is the pair of triangles that share a longest edge. Its *error* is the largest distance of the surface from
these triangles, and not less than those of its children, the diamonds on their other edges.

Branch and bound finds the largest distance of a surface from a triangle: a block of samples is read only if it may be
farther away than the diamond's children and the blocks that were read before.

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
        single = wp.cast(wp.cast(single, wp.int32) + 1, wp.float32)  # the next float32: its bits as a number, plus 1
    return single


@wp.func
def vertex_height(raster: Samples, x: int, y: int) -> wp.float64:
    """Return the height, metres, at sample (x, y); beyond the eastern or northern border that of the nearest sample."""
    index = sample_index(raster, wp.min(x, raster.columns - 1), wp.min(y, raster.rows - 1))
    return wp.float64(item_at(raster.floats, index))


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


BLOCK = wp.constant(8)  # cells of a block's side; a snippet of C and a factor below depend on it


@wp.struct
class PatchDistances:
    """How far the surface is from bilinear patches over blocks of BLOCK x BLOCK cells, each through its corners.

    The patch's largest difference from a plane is at one of its corners. That and this distance together bound the
    surface's difference from the plane over the block.
    """

    metres: wp.array(dtype=wp.float32)  # in rows
    columns: wp.int32  # blocks in a row


@wp.kernel
def patch_distances(offset: int, measured: Samples, patches: PatchDistances):
    """Compute the largest distance of the samples in each whole block of row `offset + tid` from the block's patch.

    The patch is the bilinear surface through the block's corners. Distances are metres, rounded up. measured: samples,
    NaN where they do not count. A block with a corner that is NaN gets any number. patches.metres: a distance for each
    block of BLOCK x BLOCK cells, patches.columns in a row.
    """
    row = offset + wp.tid()
    h = measured.floats
    per_cell = wp.float64(0.125)  # 1 / BLOCK
    for column in range(patches.columns):
        x = column * BLOCK
        y = row * BLOCK
        west = wp.float64(item_at(h, sample_index(measured, x, y)))
        east = wp.float64(item_at(h, sample_index(measured, x + BLOCK, y)))
        west_slope = (wp.float64(item_at(h, sample_index(measured, x, y + BLOCK))) - west) * per_cell
        east_slope = (wp.float64(item_at(h, sample_index(measured, x + BLOCK, y + BLOCK))) - east) * per_cell
        largest = wp.float64(0.0)
        for j in range(BLOCK + 1):
            begin = west + west_slope * wp.float64(j)
            slope = (east + east_slope * wp.float64(j) - begin) * per_cell
            first = sample_index(measured, x, y + j)
            for i in range(BLOCK + 1):
                distance = wp.abs(wp.float64(item_at(h, first + wp.int64(i))) - (begin + slope * wp.float64(i)))
                largest = wp.where(distance > largest, distance, largest)
        put(patches.metres, wp.int64(row * patches.columns + column), round_up(largest))


@wp.func_native("""
#pragma clang fp contract(off)
    const float* corner = measured.floats.data + (long long)y * measured.columns + x;
    const long long step_x = right, step_y = (long long)up * measured.columns;
    // The steps along the legs that are inside the raster.
    const int east = measured.columns - 1 - x, north = measured.rows - 1 - y;
    const int begin_x = right > 0 ? 0 : wp::max(0, -east), end_x = right > 0 ? east : x;
    const int begin_y = up > 0 ? 0 : wp::max(0, -north), end_y = up > 0 ? north : y;
    double largest = known;
    // Raise `largest` by the samples of a rectangle or, if it is_half, of the half below its diagonal.
    const auto measure = [&](int first_x, int first_y, int rows, int columns, bool is_half) {
        for (int j = wp::max(first_y, begin_y); j < first_y + rows && j <= end_y; ++j) {
            const float* row = corner + j * step_y;
            const double start = plane + slope[1] * j;
            const int end = wp::min(is_half ? first_x + columns - (j - first_y) : first_x + columns - 1, end_x);
            for (int i = wp::max(first_x, begin_x); i <= end; ++i) {
                const double distance = wp::abs(row[i * step_x] - (start + slope[0] * i));
                largest = distance > largest ? distance : largest;
            }
        }
    };
    const auto measure_edge = [&](int legs, int first, int end) __attribute__((always_inline)) {
        const double top = plane + slope[1] * legs, across = slope[0] - slope[1];
        const float* near = corner + first * step_x + (legs - first) * step_y;
        double e0 = *near - (top + across * first);
        for (int i = first; i < end; ++i) {
            const float* far = near + step_x - step_y;
            const double e1 = *far - (top + across * (i + 1));
            const double twist = (double)*near + *far - near[step_x] - near[-step_y];
            // Between the two samples the distance is the parabola e0 - fall t + twist t^2, t = 0 .. 1. Where it turns,
            // at t = fall / (2 twist), it counts.
            const double fall = twist - (e1 - e0), turned = wp::abs(e0 - fall * fall / (4.0 * twist));
            const bool turns = wp::abs(e1 - e0) < wp::abs(twist);  // a jump would often be predicted wrongly
            largest = (turns & (turned > largest)) ? turned : largest;
            near = far;
            e0 = e1;
        }
    };
    if (legs == 2 && begin_x == 0 && begin_y == 0 && end_x >= 2 && end_y >= 2) {  // most triangles: fixed loops
        for (int j = 0; j < 2; ++j)
            for (int i = 0; i <= 2 - j; ++i) {
                const double on_plane = plane + slope[1] * j + slope[0] * i;
                const double distance = wp::abs(corner[j * step_y + i * step_x] - on_plane);
                largest = distance > largest ? distance : largest;
            }
        measure_edge(2, 0, 2);
        return largest;
    }
    const int size = 8, blocks = legs / size;
    if (blocks < 2)
        measure(0, 0, legs, legs, true);
    else
        for (int block_y = 0; block_y < blocks; ++block_y)
            for (int block_x = 0; block_x < blocks - block_y; ++block_x) {
                const int i = block_x * size, j = block_y * size;
                if (i > end_x || j > end_y)
                    continue;
                bool must_measure = i < begin_x || i + size > end_x || j < begin_y || j + size > end_y;
                if (!must_measure) {
                    // To the west or south of the corner the first block is the one before it.
                    const long long block_column = x / size + (right > 0 ? block_x : -1 - block_x);
                    const long long block_row = y / size + (up > 0 ? block_y : -1 - block_y);
                    const double off_patch = patches.metres.data[block_row * patches.columns + block_column];
                    // Skip the block if the bounds at its corners, see PatchDistances, are not above `largest`.
                    for (int k = 0; k < 4; ++k) {
                        const int corner_x = i + (k & 1) * size, corner_y = j + (k >> 1) * size;
                        const double on_plane = plane + slope[1] * corner_y + slope[0] * corner_x;
                        const double at_corner = wp::abs(corner[corner_y * step_y + corner_x * step_x] - on_plane);
                        must_measure |= !(at_corner + off_patch <= largest);  // NaN, too
                    }
                }
                if (must_measure)
                    measure(i, j, size, size, block_x + block_y == blocks - 1);
            }
    // Along the longest edge.
    const int first = wp::max(begin_x, legs - end_y), end = wp::min(legs - begin_y, end_x);
    if (first < end)
        measure_edge(legs, first, end);
    return largest;
""")
def corner_error(
    measured: Samples,
    patches: PatchDistances,
    x: int,
    y: int,
    right: int,
    up: int,
    legs: int,
    plane: wp.float64,
    slope: wp.vec2d,
    known: wp.float64,
) -> wp.float64:
    """Return the largest distance, metres, of the surface over a right triangle from a plane, or `known` if it is less.

    It is measured at the samples and along the longest edge. The plane has the height `plane` at the triangle's corner
    (x, y) with the right angle, from which legs of `legs` steps between samples run east (`right` 1) or west (-1), and
    north (`up` 1) or south (-1). slope: metres a sample along the two legs. measured: samples, NaN where they do not
    count. patches: distances of its blocks; a block that cannot raise the result is skipped.
    """
    ...


@wp.kernel
def centre_errors(
    offset: wp.int64,
    raster: Samples,
    measured: Samples,
    patches: PatchDistances,
    side: int,
    root: int,
    finer: Depth,
    coarser: Depth,
    errors: wp.array(dtype=wp.float32),
):
    """Compute the errors, metres, of diamonds at the centres of cells of `side` samples (at least 2).

    The error of diamond `offset + tid` becomes the largest distance of the surface from its two triangles, or the
    largest of its children's errors if that is more. finer, coarser: layouts of the children's depth and of the
    diamonds' own. root: 1 if these cells are the root squares. raster: heights of the triangles' corners. measured:
    samples, NaN where they do not count. patches: bounds by block of samples.
    """
    p = diamond(coarser, offset + wp.int64(wp.tid()))
    # Direction of the diagonal with the two right angles. Below the roots it alternates from cell to cell.
    is_northeast = root == 1 or ((p[0] + p[1]) & 1) == 1
    n = wp.float64(side)
    largest = wp.float64(largest_below(errors, finer, coarser, p))
    for k in range(2):
        # the triangle's right angle is at (x, y); its legs run `right` and `up`
        right = 1 - 2 * k
        up = wp.where(is_northeast, right, -right)
        x = (p[0] + k) * side
        y = (p[1] + wp.where(up > 0, 0, 1)) * side
        z = vertex_height(raster, x, y)
        slope_x = (vertex_height(raster, x + right * side, y) - z) / n
        slope_y = (vertex_height(raster, x, y + up * side) - z) / n
        slope = wp.vec2d(slope_x, slope_y)
        largest = corner_error(measured, patches, x, y, right, up, side, z, slope, largest)
    put(errors, entry(coarser, p[0], p[1]), round_up(largest))


@wp.kernel
def side_errors(
    offset: wp.int64,
    raster: Samples,
    measured: Samples,
    patches: PatchDistances,
    half: int,
    finer: Depth,
    coarser: Depth,
    errors: wp.array(dtype=wp.float32),
):
    """Compute the errors, metres, of diamonds at the middles of cells' sides, `half` samples from the side's ends.

    The error of diamond `offset + tid` becomes the largest distance of the surface from its two triangles, or the
    largest of its children's errors if that is more. The side's middle splits each triangle into two with their right
    angles there; at the border there is one triangle. finer, coarser: layouts of the children's depth and of the
    diamonds' own. raster: heights of corners. measured: samples, NaN where they do not count. patches: bounds by block.
    """
    p = diamond(coarser, offset + wp.int64(wp.tid()))
    if not holds(coarser, p):
        return
    x = p[0] * half
    y = p[1] * half
    runs_east = p[0] & 1  # 1: the side runs from west to east
    along = wp.vec2i(runs_east, 1 - runs_east)
    begin = vertex_height(raster, x - along[0] * half, y - along[1] * half)
    end = vertex_height(raster, x + along[0] * half, y + along[1] * half)
    middle = wp.float64(0.5) * (begin + end)
    n = wp.float64(half)
    largest = wp.float64(largest_below(errors, finer, coarser, p))
    if half == 1:
        # Only the sample in the middle is not a corner, and along a leg the distance is a quarter of a cell's twist,
        # which the children hold already.
        if x < measured.columns and y < measured.rows:
            distance = wp.abs(wp.float64(item_at(measured.floats, sample_index(measured, x, y))) - middle)
            largest = wp.where(distance > largest, distance, largest)
    else:
        slope = (end - begin) / (wp.float64(2.0) * n)
        for k in range(4):
            right = 1 - 2 * (k & 1)  # the four right triangles with a corner in the middle
            up = 1 - (k & 2)
            across = wp.where(runs_east == 1, up, right)
            apex = wp.vec2i(p[0] + across * along[1], p[1] + across * along[0])
            if holds(coarser, apex):  # the triangle is inside the border
                z = vertex_height(raster, apex[0] * half, apex[1] * half)
                rise = (z - middle) / n
                along_side = wp.float64(wp.where(runs_east == 1, right, up)) * slope
                slopes = wp.where(runs_east == 1, wp.vec2d(along_side, rise), wp.vec2d(rise, along_side))
                largest = corner_error(measured, patches, x, y, right, up, half, middle, slopes, largest)
    put(errors, entry(coarser, p[0], p[1]), round_up(largest))


@wp.kernel
def twists(offset: int, measured: Samples, cells: Depth, errors: wp.array(dtype=wp.float32)):
    """Write to `errors` a quarter of the twist, metres, of each cell of row `offset + tid`; 0 if a sample is NaN.

    It is the largest distance of the bilinear cell from its two triangles. measured: samples, NaN where they do not
    count. cells: layout of `errors`.
    """
    h = measured.floats
    cy = offset + wp.tid()
    for cx in range(measured.columns - 1):
        south = sample_index(measured, cx, cy)
        north = south + wp.int64(measured.columns)
        east = wp.int64(1)
        south_difference = wp.float64(item_at(h, south)) - wp.float64(item_at(h, south + east))
        north_difference = wp.float64(item_at(h, north + east)) - wp.float64(item_at(h, north))
        quarter_twist = wp.abs(south_difference + north_difference) * wp.float64(0.25)
        put(
            errors,
            entry(cells, cx, cy),
            wp.where(quarter_twist > wp.float64(0.0), round_up(quarter_twist), wp.float32(0.0)),
        )


@wp.kernel
def saturate_rows(offset: int, part: wp.float32, cells: Depth, errors: wp.array(dtype=wp.float32)):
    """Raise each cell of row `offset + tid` in `errors` to at least `part` of its western and eastern neighbours.

    So a cell's error also bounds diamonds that extend from it into the next cell. One pass goes east, one back west, so
    a value reaches all cells, times `part` for each step. part: 1/4, or 1/2 for curvatures. errors: metres.
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
    """Raise each cell's error to at least `part` of that of its southern and northern neighbours, as `saturate_rows`.

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
