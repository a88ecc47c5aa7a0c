# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that fill each missing (NaN) sample with the nearest valid one, by exact Euclidean distance in samples.

Two passes after Felzenszwalb and Huttenlocher (2012), "Distance transforms of sampled functions": the nearest valid row
in each column, then in each row the lower envelope of the parabolas of these distances.
"""

import warp as wp


@wp.kernel
def nearest_in_columns(
    offset: int,
    h: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    block: int,
    nearest: wp.array(dtype=wp.int32),
):
    """Write the row of the nearest valid sample in the same column, -1 if the column has none.

    The thread works on block `offset + tid` of `block` columns. h: heights, NaN if missing.
    """
    x0 = (offset + wp.tid()) * block
    x1 = wp.min(x0 + block, width)
    for y in range(height):
        for x in range(x0, x1):
            at = y * width + x
            row = wp.int32(-1)
            if not wp.isnan(h[at]):
                row = y
            elif y > 0:
                row = nearest[at - width]
            nearest[at] = row
    for i in range(height - 1):
        y = height - 2 - i
        for x in range(x0, x1):
            at = y * width + x
            above = nearest[at + width]
            row = nearest[at]
            if row != y and above > y and (row < 0 or above - y < y - row):
                nearest[at] = above


@wp.kernel
def fill_rows(
    h: wp.array(dtype=wp.float32),
    width: int,
    first_row: int,
    end_row: int,
    nearest: wp.array(dtype=wp.int32),
    apex: wp.array(dtype=wp.int32),
    start: wp.array(dtype=wp.float64),
):
    """Fill rows first_row .. end_row in place; `apex` [width] and `start` [width] are this thread's scratch.

    nearest: from `nearest_in_columns`. The parabolas of a row's lower envelope have their apex in the columns `apex`,
    and each is the lowest from `start` on. Only missing samples are written and only valid ones are copied, so threads
    do not disturb each other.
    """
    for y in range(first_row, end_row):
        count = wp.int32(0)
        for x in range(width):
            row = nearest[y * width + x]
            if row >= 0:
                distance = wp.float64(row - y)
                sum_squares = distance * distance + wp.float64(x) * wp.float64(x)
                from_x = wp.float64(-1.0e300)
                searching = wp.int32(1)
                while searching == 1:
                    searching = wp.int32(0)
                    if count > 0:
                        last_x = apex[count - 1]
                        last_distance = wp.float64(nearest[y * width + last_x] - y)
                        last_sum_squares = last_distance * last_distance + wp.float64(last_x) * wp.float64(last_x)
                        from_x = (sum_squares - last_sum_squares) / (wp.float64(2.0) * wp.float64(x - last_x))
                        if from_x <= start[count - 1]:
                            count = count - 1
                            searching = wp.int32(1)
                            from_x = wp.float64(-1.0e300)
                apex[count] = x
                start[count] = from_x
                count = count + 1
        k = wp.int32(0)
        for x in range(width):
            at = y * width + x
            if wp.isnan(h[at]):
                while k + 1 < count and start[k + 1] < wp.float64(x):
                    k = k + 1
                source = apex[k]
                h[at] = h[nearest[y * width + source] * width + source]
