# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement below the raster's cells: octaves of noise or an image.

Positions are metres from the raster's middle in float64, so precision does not depend on the distance. Heights are
metres before vertical scaling. kernels/accuracy/detail.py evaluates the same surface with other arithmetic.

The numbers of a layer: `frequency`, lattice points or pixels a metre of the first octave or the image; `amplitude`,
metres; `gain`, factor on the amplitude from an octave to the next.
"""

import warp as wp

from ..unchecked import item_at
from .noise import value_noise

# Octaves have different hashes and offsets and are turned by the angle of (3, 4, 5), so that no lattice shows.
SHIFT_X = wp.constant(wp.float64(0.37109375))
SHIFT_Y = wp.constant(wp.float64(0.71484375))
SIXTH = wp.constant(wp.float64(1.0 / 6.0))
BYTE = wp.constant(wp.float64(1.0 / 255.0))


@wp.struct
class PackedDetail:
    """One displacement layer.

    Noise: octave k has the amplitude `amplitude * gain^k` and `frequency * 2^k` lattice points a metre. An image, if
    there are columns: `frequency` control heights a metre, for an amplitude of 1.
    """

    octaves: wp.int32
    seed: wp.uint32
    amplitude: wp.float64  # metres
    gain: wp.float64
    frequency: wp.float64  # 1 / metre
    columns: wp.int32  # of an image; 0 without one
    rows: wp.int32
    pixel: wp.int64  # first of its control heights
    masked: wp.int32  # 1 with a mask
    mask: wp.int64  # first byte of the mask


@wp.struct
class PackedLayers:
    """The displacement layers of a surface, which are added, with their images and masks."""

    count: wp.int32
    layer: wp.array(dtype=PackedDetail)
    pixels: wp.array(dtype=wp.float32)
    masks: wp.array(dtype=wp.uint8)  # a byte for each sample of the raster; 255 is the full height
    columns: wp.int32  # samples in a row of the raster
    rows: wp.int32
    west: wp.float64  # metres from the raster's middle, as all positions below
    south: wp.float64
    anchor_x: wp.float64  # origin of the terrain's space
    anchor_y: wp.float64
    per_x: wp.float64  # samples a metre
    per_y: wp.float64


@wp.func
def noise_detail(layer: PackedDetail, x: wp.float64, y: wp.float64):
    """Return height (metres) and slopes along x and y (metres a metre) of all octaves of a layer's noise.

    x, y: metres from the raster's middle. c, s: cosine and sine of each octave's rotation, times its
    frequency.
    """
    total = wp.vec3d()
    amplitude = layer.amplitude
    c = layer.frequency
    s = wp.float64(0.0)
    for k in range(layer.octaves):
        shift = wp.float64(k + 1)
        noise = value_noise(c * x - s * y + shift * SHIFT_X, s * x + c * y + shift * SHIFT_Y, layer.seed)
        layer.seed = layer.seed + wp.uint32(-0x61C88647)  # 0x9E3779B9, for the next octave
        total += amplitude * wp.vec3d(noise[2], noise[0] * c + noise[1] * s, noise[1] * c - noise[0] * s)
        # twice the frequency, turned by the angle of the triangle (3, 4, 5)
        turned_c = wp.float64(1.6) * c - wp.float64(1.2) * s
        s = wp.float64(1.6) * s + wp.float64(1.2) * c
        c = turned_c
        amplitude = amplitude * layer.gain
    return total


@wp.func
def basis(t: wp.float64) -> wp.vec4d:
    """Return the weights of four control heights in a uniform cubic B-spline.

    t: position between the second and the third, 0 .. 1.
    """
    one = wp.float64(1.0)
    r = one - t
    second = SIXTH * (wp.float64(4.0) + t * t * (wp.float64(3.0) * t - wp.float64(6.0)))
    third = SIXTH * (wp.float64(4.0) + r * r * (wp.float64(3.0) * r - wp.float64(6.0)))
    return wp.vec4d(SIXTH * r * r * r, second, third, SIXTH * t * t * t)


@wp.func
def slope_basis(t: wp.float64) -> wp.vec4d:
    """Return the derivatives of the B-spline weights of `basis` by t."""
    half = wp.float64(0.5)
    r = wp.float64(1.0) - t
    second = t * (wp.float64(1.5) * t - wp.float64(2.0))
    third = r * (wp.float64(2.0) - wp.float64(1.5) * r)
    return wp.vec4d(-half * r * r, second, third, half * t * t)


@wp.func
def image_detail(layers: PackedLayers, layer: PackedDetail, x: wp.float64, y: wp.float64):
    """Return height (metres) and slopes along x and y (metres a metre) of a layer's image.

    x, y: metres from the raster's middle. The image repeats; its pixels are control heights of a bicubic B-spline.
    """
    u = x * layer.frequency
    v = y * layer.frequency
    fu = wp.floor(u)
    fv = wp.floor(v)
    i = wp.int32(wp.int64(fu) % wp.int64(layer.columns))
    j = wp.int32(wp.int64(fv) % wp.int64(layer.rows))
    weights_x = basis(u - fu)
    slopes_x = slope_basis(u - fu)
    weights_y = basis(v - fv)
    slopes_y = slope_basis(v - fv)
    total = wp.vec3d()
    for b in range(4):
        # Remainders have the sign of the dividend, and j is above -rows.
        row = layer.pixel + wp.int64((j + b + wp.int32(2) * layer.rows - wp.int32(1)) % layer.rows) * wp.int64(
            layer.columns
        )
        z = wp.float64(0.0)
        z_slope = wp.float64(0.0)
        for a in range(4):
            column = (i + a + wp.int32(2) * layer.columns - wp.int32(1)) % layer.columns
            h = wp.float64(layers.pixels[row + wp.int64(column)])
            z += weights_x[a] * h
            z_slope += slopes_x[a] * h
        total += wp.vec3d(weights_y[b] * z, weights_y[b] * z_slope * layer.frequency, slopes_y[b] * z * layer.frequency)
    return layer.amplitude * total


@wp.func
def mask_at(layers: PackedLayers, first: wp.int64, x: wp.float64, y: wp.float64):
    """Return the weight of a mask, 0 .. 1, and its slopes along x and y, 1/m, (x, y) metres from the raster's middle.

    Beyond the raster they are those of its border. first: index of the mask's first byte in `layers.masks`.
    """
    s = wp.clamp((x - layers.west) * layers.per_x, wp.float64(0.0), wp.float64(layers.columns - 1))
    t = wp.clamp((y - layers.south) * layers.per_y, wp.float64(0.0), wp.float64(layers.rows - 1))
    i = wp.min(wp.int32(s), layers.columns - 2)
    j = wp.min(wp.int32(t), layers.rows - 2)
    s -= wp.float64(i)
    t -= wp.float64(j)
    south = first + wp.int64(j) * wp.int64(layers.columns) + wp.int64(i)
    north = south + wp.int64(layers.columns)
    south_west = wp.float64(item_at(layers.masks, south))
    south_rise = wp.float64(item_at(layers.masks, south + wp.int64(1))) - south_west
    north_west = wp.float64(item_at(layers.masks, north))
    north_rise = wp.float64(item_at(layers.masks, north + wp.int64(1))) - north_west
    low = south_west + south_rise * s
    rise = north_west + north_rise * s - low
    return BYTE * wp.vec3d(
        low + rise * t, (south_rise + (north_rise - south_rise) * t) * layers.per_x, rise * layers.per_y
    )


@wp.func
def detail_at(layers: PackedLayers, x: wp.float64, y: wp.float64):
    """Return height and slopes along x and y of all displacement layers at (x, y) metres in terrain space.

    Height: metres before vertical scaling; slopes: metres a metre. A layer adds nothing where its mask is 0, nor the
    mask's slope there. Layers begin at the raster's middle, so the result does not depend on the anchor, the origin of
    the terrain's space.
    """
    total = wp.vec3d()
    x += layers.anchor_x
    y += layers.anchor_y
    for k in range(layers.count):
        layer = layers.layer[k]
        mask = wp.vec3d(wp.float64(1.0), wp.float64(0.0), wp.float64(0.0))
        if layer.masked == 1:
            mask = mask_at(layers, layer.mask, x, y)
        if mask[0] > wp.float64(0.0):
            h = wp.vec3d()
            if layer.columns > 0:
                h = image_detail(layers, layer, x, y)
            else:
                h = noise_detail(layer, x, y)
            total += wp.vec3d(mask[0] * h[0], mask[0] * h[1] + mask[1] * h[0], mask[0] * h[2] + mask[2] * h[0])
    return total
