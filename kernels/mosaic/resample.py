# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernel that resamples the tiles of one lattice onto rows of the target grid.

A *lattice* is the grid that source tiles of one coordinate system and spacing have in common. The target grid is
divided into *blocks*; in each the columns and rows of the lattice are known at *nodes*, every `spacing` samples, and
interpolated between them.

A sample's result depends on its position alone: nodes have fixed positions, and the fraction inside a source cell is
computed before the origin of the buffer is subtracted. So windows of any size have the same bits.
"""

import warp as wp

# Fractions of a source cell that count as a sample itself, so that a raster on the grid is copied exactly.
SNAP = wp.constant(wp.float64(1e-6))
# Source samples; a column or row beyond has no int32.
FAR = wp.constant(wp.float64(2.0**30))
# Ranks of a sample without a value: no tile covers it, or a tile does and has no data there.
UNCOVERED = wp.constant(wp.int32(-1))
NO_DATA = wp.constant(wp.int32(-2))


@wp.func
def between(a: wp.float64, b: wp.float64, t: wp.float64) -> wp.float64:
    """Return the value at t (0 .. 1) on the line from a to b; at t = 0 it is a, even if b is NaN."""
    if t == wp.float64(0.0):
        return a
    return a * (wp.float64(1.0) - t) + b * t


@wp.func
def at_node(
    nodes: wp.array(dtype=wp.float64), stride: int, column: int, row: int, s: wp.float64, t: wp.float64
) -> wp.float64:
    """Return the value between four nodes, bilinearly: s columns and t rows (0 .. 1) beyond node (column, row).

    nodes: values row by row. stride: nodes a row.
    """
    k = row * stride + column
    low = nodes[k] * (wp.float64(1.0) - s) + nodes[k + 1] * s
    high = nodes[k + stride] * (wp.float64(1.0) - s) + nodes[k + stride + 1] * s
    return low * (wp.float64(1.0) - t) + high * t


@wp.func
def split_position(u: wp.float64) -> wp.vec2d:
    """Return the source sample before position u, and the fraction of the cell behind it: 0 within SNAP of a sample."""
    before = wp.floor(u)
    fraction = u - before
    if fraction < SNAP:
        fraction = wp.float64(0.0)
    if fraction > wp.float64(1.0) - SNAP:
        fraction = wp.float64(0.0)
        before += wp.float64(1.0)
    return wp.vec2d(before, fraction)


@wp.func
def max_difference(values: wp.array(dtype=wp.float64), at: int, along: int, across: int) -> wp.float64:
    """Return the largest difference between neighbours along one axis in the 4 x 4 samples around a cell.

    It is the most by which a value in the cell changes, in units of `values`, if its position is wrong by one sample
    along that axis. NaN is ignored. at: index of the cell's sample with the lowest column and row. along, across: steps
    of the index along the axis and along the other one.
    """
    largest = wp.float64(0.0)
    for j in range(-1, 3):
        for i in range(-1, 2):
            k = at + j * across + i * along
            difference = wp.abs(values[k + along] - values[k])
            if difference > largest:
                largest = difference
    return largest


@wp.kernel
def resample_rows(
    offset: int,
    columns: int,
    first_column: int,
    first_row: int,
    spacing: int,
    nodes_u: wp.array(dtype=wp.float64),
    nodes_v: wp.array(dtype=wp.float64),
    stride: int,
    error_u: wp.float64,
    error_v: wp.float64,
    values: wp.array(dtype=wp.float64),
    ranks: wp.array(dtype=wp.int32),
    width: int,
    height: int,
    left: int,
    top: int,
    out: wp.array(dtype=wp.float64),
    out_ranks: wp.array(dtype=wp.int32),
    moved: wp.array(dtype=wp.float64),
):
    """Write samples of row `offset + tid` of a window where this lattice has a source of higher rank than `out_ranks`.

    Where a tile of it has no data and `out_ranks` is UNCOVERED, that becomes NO_DATA. All else stays.

    Args:
        columns: columns of the window.
        first_column, first_row: first sample of the window, counted from the block's corner.
        spacing: samples between nodes.
        nodes_u, nodes_v: columns and rows of the lattice at the block's nodes.
        stride: nodes a row.
        error_u, error_v: largest errors of interpolated columns and rows, source samples.
        values: samples of the lattice, NaN where missing, with a margin of 3 around those that the window needs.
        ranks: number of each sample's tile in the order of priority, UNCOVERED or NO_DATA.
        width, height: shape of `values`.
        left, top: column and row of the lattice of its first sample.
        out, out_ranks: results. A value's rank is the lowest of those of the samples that it is interpolated from.
        moved: per sample, the largest difference that errors of the position make, in units of `values`.
    """
    y = offset + wp.tid()
    row = (first_row + y) / spacing
    t = wp.float64((first_row + y) % spacing) / wp.float64(spacing)
    for x in range(columns):
        column = (first_column + x) / spacing
        s = wp.float64((first_column + x) % spacing) / wp.float64(spacing)
        u = at_node(nodes_u, stride, column, row, s, t)
        v = at_node(nodes_v, stride, column, row, s, t)
        if not (wp.abs(u) < FAR and wp.abs(v) < FAR):  # nor NaN, where a system has no such position
            continue
        at_u = split_position(u)
        at_v = split_position(v)
        fraction_u = at_u[1]
        fraction_v = at_v[1]
        source_column = wp.int32(at_u[0]) - left
        source_row = wp.int32(at_v[0]) - top
        if source_column < 1 or source_row < 1 or source_column + 2 >= width or source_row + 2 >= height:
            continue  # the samples do not cover it
        k = source_row * width + source_column  # a fraction of 0 reads no sample beyond, which may be missing
        right = wp.int32(0)
        if fraction_u > wp.float64(0.0):
            right = wp.int32(1)
        down = wp.int32(0)
        if fraction_v > wp.float64(0.0):
            down = width
        rank = wp.min(wp.min(ranks[k], ranks[k + right]), wp.min(ranks[k + down], ranks[k + down + right]))
        entry = y * columns + x
        if rank < 0:
            if rank == NO_DATA and out_ranks[entry] == UNCOVERED:
                out_ranks[entry] = NO_DATA
            continue
        if rank <= out_ranks[entry]:  # another source has priority
            continue
        value = between(
            between(values[k], values[k + right], fraction_u),
            between(values[k + down], values[k + down + right], fraction_u),
            fraction_v,
        )
        error = wp.float64(0.0)
        if error_u > wp.float64(0.0) or error_v > wp.float64(0.0):  # positions are not exact
            error = error_u * max_difference(values, k, 1, width) + error_v * max_difference(values, k, width, 1)
        out[entry] = value
        out_ranks[entry] = rank
        moved[entry] = error
