# SPDX-License-Identifier: GPL-3.0-or-later
"""Compact storage of heights as a source's 16-bit numbers, and of errors as bytes of a table.

A sample is a float or, if the samples are `coded`, a number of the source: (number + first) * scale + offset metres. An
error is a byte, the entry of a table of 256 errors in metres, of which each group of depths has one.
"""

import warp as wp

from ..unchecked import item_at, prefetch, put

CODE_BITS = wp.constant(17)  # lowest bits of a float32, which do not choose a `first_codes` entry: 64 an octave


@wp.struct
class Samples:
    """The raster's heights in rows, metres before vertical scaling.

    They are floats, or if `coded` numbers, each (number + first) * scale + offset.
    """

    floats: wp.array(dtype=wp.float32)  # this array or `numbers` is unused, with one entry
    numbers: wp.array(dtype=wp.uint16)
    coded: wp.int32
    first: wp.int32
    scale: wp.float64
    offset: wp.float64
    columns: wp.int32  # samples in a row
    rows: wp.int32


@wp.func
def sample_at(s: Samples, i: wp.int64) -> wp.float32:
    """Return sample `i`, metres before vertical scaling. All kernels of a frame read samples with this function."""
    h = wp.float32(0.0)
    if s.coded == 0:
        h = item_at(s.floats, i)
    else:
        h = wp.float32(wp.float64(wp.int32(item_at(s.numbers, i)) + s.first) * s.scale + s.offset)
    return h


@wp.func
def sample_index(s: Samples, i: wp.int32, j: wp.int32) -> wp.int64:
    """Return the index of the sample in column i of row j."""
    return wp.int64(j) * wp.int64(s.columns) + wp.int64(i)


@wp.func
def height_at(s: Samples, i: wp.int64) -> wp.float64:
    """Return sample i, metres before vertical scaling, as float64."""
    return wp.float64(sample_at(s, i))


@wp.func
def corners_of(s: Samples, i: wp.int32, j: wp.int32) -> wp.vec4d:
    """Return the heights at the corners of cell (i, j): south-west, south-east, north-west, north-east.

    They are metres before vertical scaling.
    """
    south = wp.int64(j) * wp.int64(s.columns) + wp.int64(i)
    north = south + wp.int64(s.columns)
    one = wp.int64(1)
    return wp.vec4d(height_at(s, south), height_at(s, south + one), height_at(s, north), height_at(s, north + one))


@wp.func
def twist_of(corners: wp.vec4d) -> wp.float64:
    """Return the twist of a bilinear patch, |h00 + h11 - h10 - h01| metres: 4 times its distance from a plane.

    corners: heights in the order south-west, south-east, north-west, north-east.
    """
    return wp.abs((corners[0] - corners[1]) + (corners[3] - corners[2]))


@wp.func
def bilinear(corners: wp.vec4d, s: wp.float64, t: wp.float64) -> wp.float64:
    """Return the height of the bilinear patch s cells east and t cells north of its south-west corner, metres.

    corners: heights in the order south-west, south-east, north-west, north-east.
    """
    one = wp.float64(1.0)
    south = corners[0] * (one - s) + corners[1] * s
    north = corners[2] * (one - s) + corners[3] * s
    return south * (one - t) + north * t


@wp.func
def prefetch_sample(s: Samples, i: wp.int64):
    """Start loading sample i into the processor's cache, for a later `sample_at`."""
    if s.coded == 0:
        prefetch(s.floats, i)
    else:
        prefetch(s.numbers, i)


@wp.func
def error_of(
    table: wp.array(dtype=wp.float32), group: wp.int32, codes: wp.array(dtype=wp.uint8), i: wp.int64
) -> wp.float32:
    """Return the metres that code `i` stands for.

    table: 256 values for each group of depths of the hierarchy, one after the other. group: that of the code. codes:
    one byte each.
    """
    return item_at(table, wp.int64((group << 8) + wp.int32(item_at(codes, i))))


@wp.func
def code_of(table: wp.array(dtype=wp.float32), group: wp.int32, error: wp.float32) -> wp.uint8:
    """Return the first code of a group's table that is not below an error in metres, 255 if none is.

    The values of a table rise.
    """
    code = wp.int32(0)
    step = wp.int32(128)
    while step > 0:
        is_below = item_at(table, (group << 8) + code + step - 1) < error
        code += wp.where(is_below, step, 0)
        step = step >> 1
    return wp.uint8(code)


@wp.kernel
def encode_errors(
    offset: int,
    block: int,
    end: wp.int64,
    table: wp.array(dtype=wp.float32),
    first_codes: wp.array(dtype=wp.uint8),
    errors: wp.array(dtype=wp.float32),
    codes: wp.array(dtype=wp.uint8),
):
    """Encode block `offset + tid` of `block` errors, metres, of one group of depths: the first code not below each.

    end: number of errors. table: errors of the group's codes, metres. first_codes: for each value of a float's bits
    above the lowest CODE_BITS, the code of the smallest such float. An error above the table gets the last code. Zeros
    are not written: `codes` are zero, and holes of a sparse file stay.
    """
    begin = wp.int64(offset + wp.tid()) * wp.int64(block)
    for k in range(wp.int32(wp.min(wp.int64(block), end - begin))):
        i = begin + wp.int64(k)
        error = item_at(errors, i)
        if error > wp.float32(0.0):
            code = wp.int32(item_at(first_codes, wp.int64(wp.cast(error, wp.int32) >> CODE_BITS)))
            # without a branch, which would often be predicted wrongly: many errors have the next code
            code = wp.min(code + wp.where(item_at(table, wp.int64(code)) < error, 1, 0), 255)
            while code < 255 and item_at(table, wp.int64(code)) < error:
                code += 1
            put(codes, i, wp.uint8(code))
