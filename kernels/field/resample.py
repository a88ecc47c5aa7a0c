# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that bring a raster onto a lattice, at least as fine, over the same rectangle."""

import warp as wp

from .hierarchy import round_up
from .layout import Depth, entry

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
def misfits(
    offset: int,
    h: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    resampled: wp.array(dtype=wp.float32),
    new_width: int,
    new_height: int,
    misfit: wp.array(dtype=wp.float32),
):
    """Row `offset + tid` of the old raster: metres that the new one lacks at its samples."""
    j = offset + wp.tid()
    y = place(j, height, new_height)
    for i in range(width):
        z = bilinear(resampled, new_width, new_height, place(i, width, new_width), y)
        misfit[j * width + i] = wp.float32(wp.float64(h[j * width + i]) - z)


@wp.func
def first_near(i: int, count: int, other: int):
    """First of `count` samples that lies less than one step of the finer `other` ones from the other sample i."""
    return wp.max(wp.int32(wp.floor(place(i - 1, other, count))), 0)


@wp.kernel
def correct(
    offset: int,
    h: wp.array(dtype=wp.float32),
    misfit: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    new_width: int,
    new_height: int,
    resampled: wp.array(dtype=wp.float32),
):
    """Row `offset + tid` of the new raster: give each sample its share of the misfits of the old samples near it.

    It stays within the four old samples around it, so that a cliff gets no overshoot.
    """
    j = offset + wp.tid()
    one = wp.float64(1.0)
    y0 = wp.min(wp.int32(wp.floor(place(j, new_height, height))), height - 2)
    for i in range(new_width):
        total = wp.float64(0.0)
        weights = wp.float64(0.0)
        for b in range(4):
            old_y = first_near(j, height, new_height) + b
            near_y = one - wp.abs(place(old_y, height, new_height) - wp.float64(j))
            if old_y < height and near_y > wp.float64(0.0):
                for a in range(4):
                    old_x = first_near(i, width, new_width) + a
                    near_x = one - wp.abs(place(old_x, width, new_width) - wp.float64(i))
                    if old_x < width and near_x > wp.float64(0.0):
                        total = total + near_x * near_y * wp.float64(misfit[old_y * width + old_x])
                        weights = weights + near_x * near_y
        if weights > wp.float64(0.0):
            at = y0 * width + wp.min(wp.int32(wp.floor(place(i, new_width, width))), width - 2)
            south = wp.vec2(h[at], h[at + 1])
            north = wp.vec2(h[at + width], h[at + width + 1])
            low = wp.min(wp.min(south), wp.min(north))
            high = wp.max(wp.max(south), wp.max(north))
            new_at = j * new_width + i
            z = wp.float32(wp.float64(resampled[new_at]) + total / weights)
            resampled[new_at] = wp.clamp(z, low, high) + wp.float32(0.0)


@wp.kernel
def moved_in_cells(
    offset: int,
    h: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    resampled: wp.array(dtype=wp.float32),
    new_width: int,
    new_height: int,
    cells: Depth,
    moved: wp.array(dtype=wp.float32),
):
    """Row `offset + tid` of the new raster's cells: largest change in metres at the old samples in or on each."""
    j = offset + wp.tid()
    near = wp.float64(1e-6)  # far above rounding: a sample on the border of a cell counts on both sides
    first_y = wp.max(wp.int32(wp.ceil(place(j, new_height, height) - near)), 0)
    last_y = wp.min(wp.int32(wp.floor(place(j + 1, new_height, height) + near)), height - 1)
    for i in range(new_width - 1):
        first_x = wp.max(wp.int32(wp.ceil(place(i, new_width, width) - near)), 0)
        last_x = wp.min(wp.int32(wp.floor(place(i + 1, new_width, width) + near)), width - 1)
        most = wp.float64(0.0)
        for old_y in range(first_y, last_y + 1):
            y = place(old_y, height, new_height)
            for old_x in range(first_x, last_x + 1):
                z = bilinear(resampled, new_width, new_height, place(old_x, width, new_width), y)
                most = wp.max(most, wp.abs(z - wp.float64(h[old_y * width + old_x])))
        moved[entry(cells, i, j)] = round_up(most)


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
