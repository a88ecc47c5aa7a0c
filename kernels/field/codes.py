# SPDX-License-Identifier: GPL-3.0-or-later
"""What a store holds in place of floats: heights as a source's own 16-bit numbers, errors as bytes of a table."""

import warp as wp

from ..unchecked import item_at, prefetch


@wp.struct
class Samples:
    """The raster's heights in rows, metres: floats, or if `coded` numbers, each (number + first) * scale + offset."""

    floats: wp.array(dtype=wp.float32)  # one entry of the two has no use
    numbers: wp.array(dtype=wp.uint16)
    coded: wp.int32
    first: wp.int32
    scale: wp.float64
    offset: wp.float64
    columns: wp.int32  # samples in a row
    rows: wp.int32


@wp.func
def sample_at(s: Samples, i: wp.int64) -> wp.float32:
    """Sample `i`, metres: a frame's kernels read none in another way."""
    h = wp.float32(0.0)
    if s.coded == 0:
        h = item_at(s.floats, i)
    else:
        h = wp.float32(wp.float64(wp.int32(item_at(s.numbers, i)) + s.first) * s.scale + s.offset)
    return h


@wp.func
def height(s: Samples, i: wp.int64) -> wp.float64:
    """Sample `i`, metres."""
    return wp.float64(sample_at(s, i))


@wp.func
def corners_of(s: Samples, i: wp.int32, j: wp.int32) -> wp.vec4d:
    """Metres at the corners of cell (i, j): south-west, south-east, north-west, north-east."""
    south = wp.int64(j) * wp.int64(s.columns) + wp.int64(i)
    north = south + wp.int64(s.columns)
    one = wp.int64(1)
    return wp.vec4d(height(s, south), height(s, south + one), height(s, north), height(s, north + one))


@wp.func
def twist_of(corners: wp.vec4d) -> wp.float64:
    """Return how far the bilinear patch with such corners is from a plane: |h00 + h11 - h10 - h01|, metres."""
    return wp.abs((corners[0] - corners[1]) + (corners[3] - corners[2]))


@wp.func
def bilinear(corners: wp.vec4d, s: wp.float64, t: wp.float64) -> wp.float64:
    """Height of the bilinear patch with such corners, s cells east and t cells north of the first."""
    one = wp.float64(1.0)
    south = corners[0] * (one - s) + corners[1] * s
    north = corners[2] * (one - s) + corners[3] * s
    return south * (one - t) + north * t


@wp.func
def prefetch_sample(s: Samples, i: wp.int64):
    """Bring sample `i` into the cache; nothing is read."""
    if s.coded == 0:
        prefetch(s.floats, i)
    else:
        prefetch(s.numbers, i)


@wp.func
def error_of(
    table: wp.array(dtype=wp.float32), group: wp.int32, codes: wp.array(dtype=wp.uint8), i: wp.int64
) -> wp.float32:
    """Metres that code `i` of a group of depths stands for."""
    return item_at(table, wp.int64((group << 8) + wp.int32(item_at(codes, i))))


@wp.kernel
def encode_errors(
    offset: int,
    block: int,
    first: wp.int64,
    end: wp.int64,
    row: int,
    table: wp.array(dtype=wp.float32),
    errors: wp.array(dtype=wp.float32),
    codes: wp.array(dtype=wp.uint8),
):
    """Block `offset + tid` of the entries `first` .. `end`: the first code, from `row` of `table` on, that is no less.

    Zeros are not written: `codes` are zero, and where they are holes of a file they stay so.
    """
    begin = first + wp.int64(offset + wp.tid()) * wp.int64(block)
    for k in range(wp.int32(wp.min(wp.int64(block), end - begin))):
        i = begin + wp.int64(k)
        error = errors[i]
        if error > wp.float32(0.0):
            code = wp.int32(0)
            step = wp.int32(128)
            while step > 0:
                if table[row + code + step - 1] < error:
                    code += step
                step = step >> 1
            codes[i] = wp.uint8(code)
