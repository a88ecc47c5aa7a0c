# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that sample one raster bilinearly at the points of another one over the same rectangle."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def bilinear(h: wp.array(dtype=wp.float32), width: int, height: int, x: wp.float64, y: wp.float64):
    """Height at column x and row y, both inside the raster."""
    i = wp.clamp(wp.int32(wp.floor(x)), 0, width - 2)
    j = wp.clamp(wp.int32(wp.floor(y)), 0, height - 2)
    u = x - wp.float64(i)
    v = y - wp.float64(j)
    at = j * width + i
    h00 = wp.float64(h[at])
    h10 = wp.float64(h[at + 1])
    h01 = wp.float64(h[at + width])
    h11 = wp.float64(h[at + width + 1])
    south = h00 + (h10 - h00) * u
    north = h01 + (h11 - h01) * u
    return south + (north - south) * v


@wp.func
def place(i: int, count: int, other: int):
    """Where sample i of `count` lies among `other` samples that span the same distance."""
    return wp.float64(i) * wp.float64(other - 1) / wp.float64(count - 1)


@wp.kernel
def resample(
    offset: int,
    h: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    new_width: int,
    new_height: int,
    resampled: wp.array(dtype=wp.float32),
):
    """Row `offset + tid` of the new raster."""
    j = offset + wp.tid()
    y = place(j, new_height, height)
    for i in range(new_width):
        z = wp.float32(bilinear(h, width, height, place(i, new_width, width), y))
        resampled[j * new_width + i] = z + wp.float32(0.0)  # -0 becomes +0


@wp.kernel
def measure_change(
    offset: int,
    h: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    resampled: wp.array(dtype=wp.float32),
    new_width: int,
    new_height: int,
    largest: wp.array(dtype=wp.float64),
    squares: wp.array(dtype=wp.float64),
):
    """Row `offset + tid` of the old raster: largest change in metres and sum of squared changes at its samples."""
    j = offset + wp.tid()
    y = place(j, height, new_height)
    most = wp.float64(0.0)
    total = wp.float64(0.0)
    for i in range(width):
        x = place(i, width, new_width)
        change = wp.abs(bilinear(resampled, new_width, new_height, x, y) - wp.float64(h[j * width + i]))
        most = wp.max(most, change)
        total = total + change * change
    largest[j] = most
    squares[j] = total
