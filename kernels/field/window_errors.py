# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of a window of the raster: of its cells, and over it of triangles that are larger.

The plane of such a triangle is evaluated with the same operations as in `hierarchy.py`, so the largest result of all
windows is the result for the whole raster, bit by bit. So are the twists of cells. Heights and errors are metres before
vertical scaling. Errors of cells are saturated: each is at least `part`, a quarter, of those of the four neighbours, so
that it also bounds diamonds that extend from the cell into the next one. The *twist* of a cell is the sum of two
opposite corners' heights minus that of the other two; a quarter of its magnitude is the largest distance of the
bilinear cell from its two triangles.
"""

import warp as wp

from ..unchecked import item_at, put
from .codes import Samples
from .layout import Depth, entry

ROWS = wp.constant(8)  # of cells that are saturated together; a snippet of C depends on it


@wp.struct
class Corner:
    """A right triangle with the corner (x, y), in samples, and legs of `legs` samples.

    The legs run east (`right` 1) or west (-1), and north (`up` 1) or south (-1). The plane has the height `plane` at
    the corner, and slopes in metres a sample.
    """

    x: wp.int32
    y: wp.int32
    right: wp.int32
    up: wp.int32
    legs: wp.int32
    plane: wp.float64
    slope_x: wp.float64
    slope_y: wp.float64


@wp.func_native("""
#pragma clang fp contract(off)
    typedef double lanes __attribute__((vector_size(64)));
    typedef float heights __attribute__((vector_size(32)));
    const float* row = measured.data + first;
    const lanes numbers = {0, 1, 2, 3, 4, 5, 6, 7};
    lanes largest = lanes{} + known;
    int i = 0;
    for (; i + 8 <= count; i += 8) {
        heights z;
        __builtin_memcpy(&z, row + i, sizeof(z));
        const lanes over = __builtin_convertvector(z, lanes) - (plane + slope * (numbers + (steps + i)));
        const lanes distance = over < 0 ? -over : over;
        largest = distance > largest ? distance : largest;
    }
    double result = known;
    for (int k = 0; k < 8; ++k)
        result = wp::max(result, largest[k]);
    for (; i < count; ++i) {
        const double distance = wp::abs(row[i] - (plane + slope * (steps + i)));
        result = distance > result ? distance : result;
    }
    return result;
""")
def distance_of_row(
    measured: wp.array(dtype=wp.float32),
    first: int,
    count: int,
    plane: wp.float64,
    slope: wp.float64,
    steps: wp.float64,
    known: wp.float64,
) -> wp.float64:
    """Return the largest distance, metres, of `count` samples of a row from a plane, or `known` if it is less.

    first: index of the first sample. The plane has the height `plane` in the row's column that is `steps` samples
    before it, and the slope `slope`, metres a sample. Samples that are NaN do not count.
    """
    ...


@wp.kernel
def window_errors(
    offset: int, measured: Samples, west: int, south: int, corner: Corner, largest: wp.array(dtype=wp.float64)
):
    """Raise `largest` of row `offset + tid` to the largest distance, metres, of the surface from a triangle's plane.

    measured: a window of the raster, NaN where samples do not count. (west, south): its first sample. corner: the
    triangle, which may extend beyond the window: its right angle (x, y) in samples of the raster, legs of `legs`
    samples in the directions `right` and `up` (1 or -1), and its plane, of height `plane` there. A cell that the
    longest edge crosses counts only if the window has all four of its samples.
    """
    row = offset + wp.tid()
    c = corner
    h = measured.floats
    width = measured.columns
    start = row * width
    j = c.up * (south + row - c.y)  # rows from the corner along its leg
    max_distance = largest[row]
    if j >= 0 and j < c.legs:  # the row meets the triangle
        plane = c.plane + c.slope_y * wp.float64(c.up * j)
        first = c.x + wp.min(c.right, 0) * (c.legs - j)
        begin = wp.max(first, west)
        end = wp.min(first + c.legs + 1 - j, west + width)
        steps = wp.float64(begin - c.x)  # from the corner
        max_distance = distance_of_row(h, start + begin - west, end - begin, plane, c.slope_x, steps, max_distance)
    # The longest edge runs from (x, y + up * legs) along (right, -up); cell i of it is between its rows i and i + 1.
    i = c.legs - c.up * (south + row - c.y)
    if c.up > 0:  # the edge begins in the north: the cell above this row comes before it
        i = i - 1
    edge_x = c.x + c.right * i
    cell_x = wp.min(edge_x, edge_x + c.right)
    # The window has all four samples of the cell.
    if i >= 0 and i < c.legs and cell_x >= west and cell_x + 1 < west + width and row + 1 < measured.rows:
        top = c.plane + c.slope_y * wp.float64(c.up * c.legs)
        edge_slope = c.slope_x * wp.float64(c.right) - c.slope_y * wp.float64(c.up)
        # The cell's samples: `index` and `far_index`, on the edge, and the other two.
        index = start + edge_x - west
        if c.up > 0:
            index = index + width
        aside_index = index + c.right
        below_index = index - c.up * width
        far_index = below_index + c.right
        e0 = wp.float64(h[index]) - (top + edge_slope * wp.float64(i))
        e1 = wp.float64(h[far_index]) - (top + edge_slope * wp.float64(i + 1))
        twist = (
            wp.float64(h[index]) + wp.float64(h[far_index]) - wp.float64(h[aside_index]) - wp.float64(h[below_index])
        )
        # Between the samples the distance is the parabola e0 - fall t + twist t^2; it counts if it turns there.
        if wp.abs(e1 - e0) < wp.abs(twist):
            fall = twist - (e1 - e0)
            max_distance = wp.max(max_distance, wp.abs(e0 - fall * fall / (wp.float64(4.0) * twist)))
    largest[row] = max_distance


@wp.func_native("""
#pragma clang fp contract(off)
    const float *south = measured.floats.data + (long long)y * measured.columns, *north = south + measured.columns;
    float* __restrict to = rows.data + (long long)y * columns;
#pragma clang loop vectorize(enable)
    for (int x = 0; x < measured.columns - 1; ++x) {
        const double south_difference = (double)south[x] - (double)south[x + 1];
        const double north_difference = (double)north[x + 1] - (double)north[x];
        const double quarter_twist = wp::abs(south_difference + north_difference) * 0.25;
        const float single = (float)quarter_twist;
        int bits;
        __builtin_memcpy(&bits, &single, sizeof(bits));
        bits = quarter_twist > 0.0 ? bits + ((double)single < quarter_twist) : 0;  // rounded up; NaN is 0
        __builtin_memcpy(to + x, &bits, sizeof(bits));
    }
""")
def twist_row(measured: Samples, y: int, columns: int, rows: wp.array(dtype=wp.float32)):
    """Write a quarter of the twist, metres, of each cell of row y to `rows`, which has `columns` cells in a row.

    measured: samples of the window, NaN where they do not count; such a cell gets 0.
    """
    ...


@wp.func_native("""
    float* first = rows.data + (long long)y * columns;
    const int from[] = {0, columns - 1}, step[] = {1, -1};
    for (int pass = 0; pass < 2; ++pass) {
        float last[8] = {};  // one value of each row: they do not wait for each other
        float* cell = first + from[pass];
        for (int x = 0; x < columns; ++x, cell += step[pass])
            for (int j = 0; j < 8; ++j) {
                last[j] = wp::max(cell[(long long)j * columns], last[j] * part);
                cell[(long long)j * columns] = last[j];
            }
    }
""")
def saturate_eight_rows(y: int, part: wp.float32, columns: int, rows: wp.array(dtype=wp.float32)):
    """Raise each cell of ROWS rows from row y on to at least `part` of its western and eastern neighbours.

    rows: errors of the window's cells, metres, with `columns` cells in a row.
    """
    ...


@wp.func_native("""
    const float* neighbour = rows.data + (long long)from_row * columns;
    float* __restrict row = rows.data + (long long)to * columns;
#pragma clang loop vectorize(enable)
    for (int x = begin; x < end; ++x)
        row[x] = wp::max(row[x], neighbour[x] * part);
""")
def raise_row(
    from_row: int, to: int, begin: int, end: int, part: wp.float32, columns: int, rows: wp.array(dtype=wp.float32)
):
    """Raise the cells `begin` to `end` of row `to` to at least `part` of those in row `from_row`.

    rows: errors of the window's cells, metres, with `columns` cells in a row.
    """
    ...


@wp.kernel
def window_twists(offset: int, measured: Samples, columns: int, rows: wp.array(dtype=wp.float32)):
    """Write to `rows` a quarter of the twist, metres, of each cell of row `offset + tid`; 0 if a sample is NaN.

    measured: samples of the window, NaN where they do not count. columns: cells in a row of `rows`.
    """
    twist_row(measured, offset + wp.tid(), columns, rows)


@wp.kernel
def saturate_window_rows(offset: int, part: wp.float32, columns: int, rows: wp.array(dtype=wp.float32)):
    """Raise each cell of ROWS rows from row `(offset + tid) * ROWS` on to at least `part` of its neighbours in the row.

    columns: cells in a row of `rows`, which has a multiple of ROWS of them.
    """
    saturate_eight_rows((offset + wp.tid()) * ROWS, part, columns, rows)


@wp.kernel
def saturate_window_columns(
    offset: int, block: int, part: wp.float32, columns: int, count: int, rows: wp.array(dtype=wp.float32)
):
    """Raise each cell to at least `part` of its southern and northern neighbours, in block `offset + tid` of columns.

    block: columns of a block. columns, count: cells in a row of `rows`, and rows.
    """
    begin = (offset + wp.tid()) * block
    end = wp.min(begin + block, columns)
    for y in range(1, count):
        raise_row(y - 1, y, begin, end, part, columns, rows)
    for i in range(1, count):
        raise_row(count - i, count - 1 - i, begin, end, part, columns, rows)


@wp.kernel
def store_cells(
    offset: int,
    columns: int,
    west: int,
    south: int,
    cells: Depth,
    rows: wp.array(dtype=wp.float32),
    errors: wp.array(dtype=wp.float32),
):
    """Copy row `offset + tid` of a tile's cells from `rows`, with `columns` cells in a row, to `errors`.

    west, south: columns and rows of `rows` before the tile. cells: layout of its cells in `errors`.
    """
    y = offset + wp.tid()
    first = wp.int64(south + y) * wp.int64(columns) + wp.int64(west)
    for x in range(cells.columns):
        put(errors, entry(cells, x, y), item_at(rows, first + wp.int64(x)))
