# SPDX-License-Identifier: GPL-3.0-or-later
"""Detail below the raster's cells as the measurement evaluates it: kernels/field/detail.py has other arithmetic.

Both share only the definition of the surface: the numbers of `Detail`, the pixels, the masks and the hash.
"""

import warp as wp

from ..field.detail import SHIFT_X, SHIFT_Y, PackedDetail, PackedLayers
from ..field.noise import scramble


@wp.func
def fade(t: wp.float64) -> wp.float64:
    """Return the quintic fade of t (0 .. 1), which is 0 at 0 and 1 at 1; computed as 1 minus its mirror image."""
    r = wp.float64(1.0) - t
    return wp.float64(1.0) - r * r * r * (wp.float64(1.0) + wp.float64(3.0) * t + wp.float64(6.0) * t * t)


@wp.func
def noise_at(x: wp.float64, y: wp.float64, seed: wp.uint32) -> wp.float64:
    """Return value noise at (x, y), -1 .. 1: the mean of the four lattice values around, weighted by the fade."""
    column = wp.int64(wp.floor(x))
    row = wp.int64(wp.floor(y))
    east = fade(x - wp.float64(column))
    north = fade(y - wp.float64(row))
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
def octaves_height(d: PackedDetail, x: wp.float64, y: wp.float64) -> wp.float64:
    """Return the height of all octaves of noise at (x, y) metres.

    Each octave rotates the domain of the one before and doubles its frequency.
    """
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


@wp.func
def lerp(a: wp.float64, b: wp.float64, part: wp.float64) -> wp.float64:
    """Return a (1 - part) + b part."""
    return a * (wp.float64(1.0) - part) + b * part


@wp.func
def de_boor(p: wp.vec4d, t: wp.float64) -> wp.float64:
    """Evaluate a uniform cubic B-spline of four control heights, t from the second to the third (de Boor, 1972)."""
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    three = wp.float64(3.0)
    a = lerp(p[0], p[1], (t + two) / three)
    b = lerp(p[1], p[2], (t + one) / three)
    c = lerp(p[2], p[3], t / three)
    a = lerp(a, b, (t + one) / two)
    b = lerp(b, c, t / two)
    return lerp(a, b, t)


@wp.func
def image_height(c: PackedLayers, d: PackedDetail, x: wp.float64, y: wp.float64) -> wp.float64:
    """Return the height of a displacement image at (x, y) metres: a B-spline along four rows, then across them."""
    u = x * d.frequency
    v = y * d.frequency
    rows = wp.vec4d()
    for b in range(4):
        j = wp.float64(b - 1) + wp.floor(v)
        j -= wp.floor(j / wp.float64(d.rows)) * wp.float64(d.rows)
        row = wp.vec4d()
        for a in range(4):
            i = wp.float64(a - 1) + wp.floor(u)
            i -= wp.floor(i / wp.float64(d.columns)) * wp.float64(d.columns)
            at = d.pixel + wp.int64(j) * wp.int64(d.columns) + wp.int64(i)
            row[a] = wp.float64(c.pixels[at])
        rows[b] = de_boor(row, u - wp.floor(u))
    return d.amplitude * de_boor(rows, v - wp.floor(v))


@wp.func
def mask_height(c: PackedLayers, first: wp.int64, x: wp.float64, y: wp.float64) -> wp.float64:
    """Return the weight of a displacement layer at (x, y) metres, 0 .. 1.

    It is interpolated between four samples of the layer's mask.
    """
    s = wp.clamp((x - c.west) * c.per_x, wp.float64(0.0), wp.float64(c.columns - 1))
    t = wp.clamp((y - c.south) * c.per_y, wp.float64(0.0), wp.float64(c.rows - 1))
    found = wp.float64(0.0)
    for k in range(4):
        i = wp.min(wp.int32(wp.floor(s)), c.columns - 2) + (k & 1)
        j = wp.min(wp.int32(wp.floor(t)), c.rows - 2) + (k >> 1)
        across = wp.float64(1.0) - wp.abs(s - wp.float64(i))
        byte = wp.float64(c.masks[first + wp.int64(j) * wp.int64(c.columns) + wp.int64(i)])
        found += byte * across * (wp.float64(1.0) - wp.abs(t - wp.float64(j)))
    return found / wp.float64(255.0)


@wp.func
def detail_height(c: PackedLayers, x: wp.float64, y: wp.float64) -> wp.float64:
    """Return the height in metres of all displacement layers at (x, y) metres."""
    found = wp.float64(0.0)
    x += c.anchor_x
    y += c.anchor_y
    for k in range(c.count):
        d = c.layer[k]
        z = wp.float64(0.0)
        if d.columns > 0:
            z = image_height(c, d, x, y)
        else:
            z = octaves_height(d, x, y)
        if d.masked == 1:
            z = z * mask_height(c, d.mask, x, y)
        found += z
    return found
