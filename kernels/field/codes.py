# SPDX-License-Identifier: GPL-3.0-or-later
"""What a store holds in place of floats: heights as a source's own 16-bit numbers, errors as bytes of a table."""

import warp as wp

from ..unchecked import item_at, prefetch


@wp.struct
class Samples:
    """The raster's heights, metres: floats, or if `coded` numbers, each of them (number + first) * scale + offset."""

    floats: wp.array(dtype=wp.float32)  # one entry of the two has no use
    numbers: wp.array(dtype=wp.uint16)
    coded: wp.int32
    first: wp.int32
    scale: wp.float64
    offset: wp.float64


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
