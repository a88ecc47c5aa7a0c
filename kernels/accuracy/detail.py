# SPDX-License-Identifier: GPL-3.0-or-later
"""Detail below the raster's cells as the measurement evaluates it: kernels/field/detail.py has other arithmetic.

Both share only the definition of the surface: the numbers of `Detail`, the pixels, the masks and the hash. Positions
are metres from the raster's middle, heights metres before vertical scaling.

The numbers of a layer: `frequency`, lattice points or pixels a metre of the first octave or the image; `amplitude`,
metres; `gain`, factor on the amplitude from an octave to the next.
"""

import warp as wp

from ..field.detail import SHIFT_X, SHIFT_Y, PackedDetail, PackedLayers
from ..field.noise import scramble


@wp.func
def fade(t: wp.float64) -> wp.float64:
    """Return Perlin's quintic fade of t (0 .. 1), which rises from 0 to 1; computed as 1 minus its mirror image."""
    r = wp.float64(1.0) - t
    return wp.float64(1.0) - r * r * r * (wp.float64(1.0) + wp.float64(3.0) * t + wp.float64(6.0) * t * t)


@wp.func
def noise_at(x: wp.float64, y: wp.float64, seed: wp.uint32) -> wp.float64:
    """Return value noise at (x, y), -1 .. 1: the mean of the four lattice values around, weighted by the fade.

    x, y: cells of the noise's lattice.
    """
    column = wp.int64(wp.floor(x))
    row = wp.int64(wp.floor(y))
    east = fade(x - wp.float64(column))
    north = fade(y - wp.float64(row))
    total = wp.float64(0.0)
    for k in range(4):
        i = wp.int64(k & 1)
        j = wp.int64(k >> 1)
        h = scramble(scramble(wp.uint32(row + j) + seed) + wp.uint32(column + i))
        value = wp.float64(h) / wp.float64(2147483648.0)
        # a hash of 2^31 or more stands for a negative number
        if value >= wp.float64(1.0):
            value -= wp.float64(2.0)
        weight_x = wp.where(i == wp.int64(1), east, wp.float64(1.0) - east)
        total += value * weight_x * wp.where(j == wp.int64(1), north, wp.float64(1.0) - north)
    return total


@wp.func
def octaves_height(layer: PackedDetail, x: wp.float64, y: wp.float64) -> wp.float64:
    """Return the height, metres, of all octaves of a layer's noise at (x, y) metres from the raster's middle.

    Each octave rotates the domain of the one before by the angle of the triangle (3, 4, 5), doubles its frequency, and
    has another shift and seed, so that no lattice shows.
    """
    total = wp.float64(0.0)
    u = x * layer.frequency
    v = y * layer.frequency
    for k in range(layer.octaves):
        number = wp.float64(k + 1)
        seed = layer.seed + wp.uint32(k) * wp.uint32(-0x61C88647)  # 0x9E3779B9
        total += wp.pow(layer.gain, wp.float64(k)) * noise_at(u + number * SHIFT_X, v + number * SHIFT_Y, seed)
        turned_u = wp.float64(2.0) * (wp.float64(0.8) * u - wp.float64(0.6) * v)
        v = wp.float64(2.0) * (wp.float64(0.6) * u + wp.float64(0.8) * v)
        u = turned_u
    return total * layer.amplitude


@wp.func
def lerp(a: wp.float64, b: wp.float64, weight: wp.float64) -> wp.float64:
    """Return a (1 - weight) + b weight."""
    return a * (wp.float64(1.0) - weight) + b * weight


@wp.func
def de_boor(p: wp.vec4d, t: wp.float64) -> wp.float64:
    """Return the value of a uniform cubic B-spline (de Boor 1972).

    p: four control heights in a row. t: position between the second and the third, 0 .. 1.
    """
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
def image_height(layers: PackedLayers, layer: PackedDetail, x: wp.float64, y: wp.float64) -> wp.float64:
    """Return the height, metres, of a displacement layer's image, (x, y) metres from the raster's middle.

    The image repeats. Its pixels, from index `layer.pixel` on, are control heights of a bicubic B-spline, evaluated
    along four rows and then across them.
    """
    u = x * layer.frequency  # pixels
    v = y * layer.frequency
    rows = wp.vec4d()
    for b in range(4):
        j = wp.float64(b - 1) + wp.floor(v)
        j -= wp.floor(j / wp.float64(layer.rows)) * wp.float64(layer.rows)
        row = wp.vec4d()
        for a in range(4):
            i = wp.float64(a - 1) + wp.floor(u)
            i -= wp.floor(i / wp.float64(layer.columns)) * wp.float64(layer.columns)
            index = layer.pixel + wp.int64(j) * wp.int64(layer.columns) + wp.int64(i)
            row[a] = wp.float64(layers.pixels[index])
        rows[b] = de_boor(row, u - wp.floor(u))
    return layer.amplitude * de_boor(rows, v - wp.floor(v))


@wp.func
def mask_weight(layers: PackedLayers, first: wp.int64, x: wp.float64, y: wp.float64) -> wp.float64:
    """Return the weight of a displacement layer's mask, 0 .. 1, (x, y) metres from the raster's middle.

    It is interpolated between four samples; beyond the raster it is that of the border. first: index of the mask's
    first byte in `layers.masks`.
    """
    # samples from the south-west one
    s = wp.clamp((x - layers.west) * layers.per_x, wp.float64(0.0), wp.float64(layers.columns - 1))
    t = wp.clamp((y - layers.south) * layers.per_y, wp.float64(0.0), wp.float64(layers.rows - 1))
    total = wp.float64(0.0)
    for k in range(4):
        i = wp.min(wp.int32(wp.floor(s)), layers.columns - 2) + (k & 1)
        j = wp.min(wp.int32(wp.floor(t)), layers.rows - 2) + (k >> 1)
        across = wp.float64(1.0) - wp.abs(s - wp.float64(i))
        byte = wp.float64(layers.masks[first + wp.int64(j) * wp.int64(layers.columns) + wp.int64(i)])
        total += byte * across * (wp.float64(1.0) - wp.abs(t - wp.float64(j)))
    return total / wp.float64(255.0)


@wp.func
def detail_height(layers: PackedLayers, x: wp.float64, y: wp.float64) -> wp.float64:
    """Return the sum of all displacement layers, metres before vertical scaling, at (x, y) metres from the anchor.

    The anchor is the origin of the terrain's space.
    """
    total = wp.float64(0.0)
    x += layers.anchor_x  # from the middle
    y += layers.anchor_y
    for k in range(layers.count):
        layer = layers.layer[k]
        z = wp.float64(0.0)
        if layer.columns > 0:  # an image
            z = image_height(layers, layer, x, y)
        else:
            z = octaves_height(layer, x, y)
        if layer.masked == 1:
            z = z * mask_weight(layers, layer.mask, x, y)
        total += z
    return total
