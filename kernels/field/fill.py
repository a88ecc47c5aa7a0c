# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that find for each missing sample the nearest valid one, by exact Euclidean distance in samples.

Two sweeps after Felzenszwalb and Huttenlocher (2012), "Distance transforms of sampled functions": the nearest valid row
in each column, then in each row the lower envelope of the parabolas of these distances. They work on a few rows of the
raster, and know of all others only the nearest valid row of each column below and above.
"""

import warp as wp


@wp.kernel
def nearest_in_columns(
    offset: int,
    missing: wp.array(dtype=wp.uint8),
    width: int,
    height: int,
    first: int,
    below: wp.array(dtype=wp.int32),
    above: wp.array(dtype=wp.int32),
    block: int,
    nearest: wp.array(dtype=wp.int32),
):
    """Write to `nearest`, for every sample, the row of the nearest valid sample in its column; -1 without one.

    The thread works on block `offset + tid` of `block` columns. missing: 1 at missing samples of `height` rows of
    `width`, from row `first` of the raster on. below, above: nearest valid rows outside these rows, -1 for none. All
    row numbers are those of the raster. Of two rows as near the lower one counts.
    """
    x0 = (offset + wp.tid()) * block
    x1 = wp.min(x0 + block, width)
    for y in range(height):
        for x in range(x0, x1):
            index = y * width + x
            row = first + y
            if missing[index] > wp.uint8(0):
                row = below[x]
                if y > 0:
                    row = nearest[index - width]
            nearest[index] = row
    for i in range(height):
        y = height - 1 - i
        for x in range(x0, x1):
            index = y * width + x
            upper_row = above[x]
            if i > 0:
                upper_row = nearest[index + width]
            row = nearest[index]
            here = first + y
            # The sample is missing, and the valid row above it is nearer.
            if row != here and upper_row > here and (row < 0 or upper_row - here < here - row):
                nearest[index] = upper_row


@wp.kernel
def nearest_columns(
    missing: wp.array(dtype=wp.uint8),
    width: int,
    first: int,
    begin: int,
    end: int,
    nearest: wp.array(dtype=wp.int32),
    apex: wp.array(dtype=wp.int32),
    start: wp.array(dtype=wp.float64),
    column: wp.array(dtype=wp.int32),
):
    """Write the column of the nearest valid sample to `column` for each missing one of rows begin .. end - 1.

    The rows are those of the arrays, whose row 0 is row `first` of the raster. nearest: from `nearest_in_columns`: the
    row of the nearest valid sample in each column; one column must have one. missing: 1 at missing samples. A row's
    lower envelope of parabolas has their apexes in the columns `apex`, and each is the lowest from `start` on; both
    [width] are scratch of this thread.
    """
    for y in range(begin, end):
        # The parabolas of the row's lower envelope, from west to east.
        count = wp.int32(0)
        for x in range(width):
            row = nearest[y * width + x]
            if row >= 0:
                distance = wp.float64(row - first - y)
                sum2 = distance * distance + wp.float64(x) * wp.float64(x)
                from_x = wp.float64(-1.0e300)
                searching = wp.int32(1)
                while searching == 1:
                    searching = wp.int32(0)
                    if count > 0:
                        last_x = apex[count - 1]
                        last_distance = wp.float64(nearest[y * width + last_x] - first - y)
                        last_sum2 = last_distance * last_distance + wp.float64(last_x) * wp.float64(last_x)
                        # From this x on the new parabola is below the last one.
                        from_x = (sum2 - last_sum2) / (wp.float64(2.0) * wp.float64(x - last_x))
                        if from_x <= start[count - 1]:  # the last parabola is nowhere the lowest
                            count = count - 1
                            searching = wp.int32(1)
                            from_x = wp.float64(-1.0e300)
                apex[count] = x
                start[count] = from_x
                count = count + 1
        # Each missing sample takes the apex of the parabola that is the lowest at it.
        k = wp.int32(0)
        for x in range(width):
            if missing[y * width + x] > wp.uint8(0):
                while k + 1 < count and start[k + 1] < wp.float64(x):
                    k = k + 1
                column[y * width + x] = apex[k]
