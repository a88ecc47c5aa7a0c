# SPDX-License-Identifier: GPL-3.0-or-later
"""A detail below the raster's cells as the measurement evaluates it: kernels/field/detail.py has other arithmetic.

What the two share is what says which surface it is: the numbers of `Detail` and the hash.
"""

import warp as wp

from ..field.detail import SHIFT_X, SHIFT_Y, Detail
from ..field.noise import scramble

wp.set_module_options({"enable_backward": False})


@wp.func
def weight(t: wp.float64) -> wp.float64:
    """The quintic fade, as what is left of 1 at the other end."""
    r = wp.float64(1.0) - t
    return wp.float64(1.0) - r * r * r * (wp.float64(1.0) + wp.float64(3.0) * t + wp.float64(6.0) * t * t)


@wp.func
def noise_at(x: wp.float64, y: wp.float64, seed: wp.uint32) -> wp.float64:
    """Value noise: the four lattice values about (x, y) in the mean with their weights."""
    column = wp.int64(wp.floor(x))
    row = wp.int64(wp.floor(y))
    east = weight(x - wp.float64(column))
    north = weight(y - wp.float64(row))
    found = wp.float64(0.0)
    for k in range(4):
        i = wp.int64(k & 1)
        j = wp.int64(k >> 1)
        h = scramble(scramble(wp.uint32(row + j) + seed) + wp.uint32(column + i))
        value = wp.float64(h) / wp.float64(2147483648.0)
        if value >= wp.float64(1.0):
            value -= wp.float64(2.0)
        across = wp.where(i == wp.int64(1), east, wp.float64(1.0) - east)
        found += value * across * wp.where(j == wp.int64(1), north, wp.float64(1.0) - north)
    return found


@wp.func
def detail_height(d: Detail, x: wp.float64, y: wp.float64) -> wp.float64:
    """Metres of height of all octaves at (x, y) metres: each turns and halves the place of the one before."""
    found = wp.float64(0.0)
    u = x * d.frequency
    v = y * d.frequency
    for k in range(d.octaves):
        number = wp.float64(k + 1)
        seed = d.seed + wp.uint32(k) * wp.uint32(-0x61C88647)
        found += wp.pow(d.gain, wp.float64(k)) * noise_at(u + number * SHIFT_X, v + number * SHIFT_Y, seed)
        turned = wp.float64(2.0) * (wp.float64(0.8) * u - wp.float64(0.6) * v)
        v = wp.float64(2.0) * (wp.float64(0.6) * u + wp.float64(0.8) * v)
        u = turned
    return found * d.amplitude
