# SPDX-License-Identifier: GPL-3.0-or-later
"""The error hierarchy of the bicubic surface, depth by depth, in windows of the raster: see field/bicubic.py.

A window has arrays for itself, with layouts (`Depth`) by diamonds of the window. `corner` is the window's first
diamond of a depth in the whole raster. Errors are metres before vertical scaling.
"""

import warp as wp

from ..field.codes import code_of, error_of
from ..field.hierarchy import largest_below, round_up
from ..field.layout import Depth, diamond, entry, holds, stored_entry
from ..unchecked import put


@wp.kernel
def cover_sides(
    offset: wp.int64, cells: Depth, curvatures: wp.array(dtype=wp.float32), errors: wp.array(dtype=wp.float32)
):
    """Raise the error of cell `offset + tid` to half the largest curvature of the cell and its four neighbours, metres.

    So the error also bounds triangles whose longest edge is a side of the cell, and which extend into the next one. A
    side is shorter than a cell's diagonal by the root of two, which halves the bound by curvature. errors: metres.
    curvatures: bounds of a quarter of the second derivatives, metres, from `patch_errors`. cells: layout of both.
    """
    p = diamond(cells, offset + wp.int64(wp.tid()))
    index = entry(cells, p[0], p[1])
    largest = curvatures[index]
    for k in range(4):
        step = 2 * (k & 1) - 1
        q = wp.vec2i(p[0] + wp.where(k < 2, step, 0), p[1] + wp.where(k < 2, 0, step))
        if holds(cells, q):
            largest = wp.max(largest, curvatures[entry(cells, q[0], q[1])])
    errors[index] = wp.max(errors[index], largest * wp.float32(0.5))


@wp.kernel
def add_errors(
    offset: wp.int64,
    finer: Depth,
    coarser: Depth,
    whole: Depth,
    corner: wp.vec2i,
    table: wp.array(dtype=wp.float32),
    group: int,
    codes: wp.array(dtype=wp.uint8),
    places: wp.array(dtype=wp.int32),
    distance: wp.array(dtype=wp.float32),
    errors: wp.array(dtype=wp.float32),
):
    """Compute the error of diamond `offset + tid` on the bicubic surface, metres: never less than that of its children.

    It is the stored error on the bilinear surface plus the largest distance between both surfaces. finer, coarser:
    layouts of `distance` and `errors` for the children and the diamond. distance: that distance, metres; the diamond's
    becomes the largest of its children. whole: layout of `codes`, the bilinear errors of the whole raster, whose metres
    are in group `group` of `table`. places: of their pages, see `stored_entry`. corner: the window's first diamond in
    the raster.
    """
    p = diamond(coarser, offset + wp.int64(wp.tid()))
    if holds(coarser, p):  # the last number of a row of sides may be beyond the east end
        index = entry(coarser, p[0], p[1])
        code_index = stored_entry(places, entry(whole, p[0] + corner[0], p[1] + corner[1]))
        bilinear_error = error_of(table, group, codes, code_index)
        distance[index] = largest_below(distance, finer, coarser, p)
        raised = round_up(wp.float64(bilinear_error) + wp.float64(distance[index]))
        errors[index] = wp.max(raised, largest_below(errors, finer, coarser, p))


@wp.kernel
def keep_rows(
    offset: int,
    first: wp.vec2i,
    columns: int,
    part: Depth,
    whole: Depth,
    corner: wp.vec2i,
    values: wp.array(dtype=wp.float32),
    out: wp.array(dtype=wp.float32),
):
    """Copy row `first[1] + offset + tid` of a window's diamonds, `columns` from first[0] on, to the raster's `out`.

    At depths whose diamonds are centred on sides of cells only every other place of a row has a diamond. values, out:
    errors or distances, metres. part: layout of `values`. whole: layout of `out`, by diamonds of the raster. corner:
    the window's first diamond there.
    """
    y = first[1] + offset + wp.tid()
    for k in range(columns):
        x = first[0] + k
        if part.sides == 0 or (x + y) & 1 == 1:
            out[entry(whole, x + corner[0], y + corner[1])] = values[entry(part, x, y)]


@wp.kernel
def encode_rows(
    offset: int,
    first: wp.vec2i,
    columns: int,
    part: Depth,
    whole: Depth,
    corner: wp.vec2i,
    values: wp.array(dtype=wp.float32),
    table: wp.array(dtype=wp.float32),
    group: int,
    codes: wp.array(dtype=wp.uint8),
):
    """Encode the diamonds of row `first[1] + offset + tid` of a window, `columns` from first[0] on, for the raster.

    At depths whose diamonds are centred on sides of cells only every other place of a row has a diamond. values: errors
    in metres, with the layout `part`. codes: those of the raster, with the layout `whole`. corner: the window's first
    diamond in the raster. table, group: metres of the codes, and the group of this depth.
    """
    y = first[1] + offset + wp.tid()
    for k in range(columns):
        x = first[0] + k
        if part.sides == 0 or (x + y) & 1 == 1:
            code = code_of(table, group, values[entry(part, x, y)])
            put(codes, entry(whole, x + corner[0], y + corner[1]), code)
