# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement below the raster's cells: octaves of noise or an image.

Positions are metres from the terrain's middle in float64, so precision does not depend on the distance.
kernels/accuracy/detail.py evaluates the same surface with other arithmetic.
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
def noise_detail(d: PackedDetail, x: wp.float64, y: wp.float64):
    """Return the height of all octaves of noise at (x, y) metres, with its slopes: (height, along x, along y)."""
    found = wp.vec3d()
    a = d.amplitude
    c = d.frequency
    s = wp.float64(0.0)
    for k in range(d.octaves):
        shift = wp.float64(k + 1)
        n = value_noise(c * x - s * y + shift * SHIFT_X, s * x + c * y + shift * SHIFT_Y, d.seed)
        d.seed = d.seed + wp.uint32(-0x61C88647)
        found += a * wp.vec3d(n[2], n[0] * c + n[1] * s, n[1] * c - n[0] * s)
        turned = wp.float64(1.6) * c - wp.float64(1.2) * s
        s = wp.float64(1.6) * s + wp.float64(1.2) * c
        c = turned
        a = a * d.gain
    return found


@wp.func
def basis(t: wp.float64) -> wp.vec4d:
    """Return the uniform cubic B-spline weights of four control heights; t is from the second to the third."""
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
def image_detail(c: PackedLayers, d: PackedDetail, x: wp.float64, y: wp.float64):
    """Return the height of a periodic image at (x, y) metres, and its slopes, as `noise_detail` does.

    The pixels around are control heights of a bicubic B-spline.
    """
    u = x * d.frequency
    v = y * d.frequency
    fu = wp.floor(u)
    fv = wp.floor(v)
    i = wp.int32(wp.int64(fu) % wp.int64(d.columns))
    j = wp.int32(wp.int64(fv) % wp.int64(d.rows))
    across = basis(u - fu)
    across1 = slope_basis(u - fu)
    up = basis(v - fv)
    up1 = slope_basis(v - fv)
    found = wp.vec3d()
    for b in range(4):
        row = d.pixel + wp.int64((j + b + wp.int32(2) * d.rows - wp.int32(1)) % d.rows) * wp.int64(d.columns)
        z = wp.float64(0.0)
        z1 = wp.float64(0.0)
        for a in range(4):
            column = (i + a + wp.int32(2) * d.columns - wp.int32(1)) % d.columns
            h = wp.float64(c.pixels[row + wp.int64(column)])
            z += across[a] * h
            z1 += across1[a] * h
        found += wp.vec3d(up[b] * z, up[b] * z1 * d.frequency, up1[b] * z * d.frequency)
    return d.amplitude * found


@wp.func
def mask_at(c: PackedLayers, first: wp.int64, x: wp.float64, y: wp.float64):
    """Return the mask of a layer at (x, y) metres, 0 .. 1, with its slopes: (mask, 1/m along x, 1/m along y).

    first: index of the mask's first byte.
    """
    s = wp.clamp((x - c.west) * c.per_x, wp.float64(0.0), wp.float64(c.columns - 1))
    t = wp.clamp((y - c.south) * c.per_y, wp.float64(0.0), wp.float64(c.rows - 1))
    i = wp.min(wp.int32(s), c.columns - 2)
    j = wp.min(wp.int32(t), c.rows - 2)
    s -= wp.float64(i)
    t -= wp.float64(j)
    south = first + wp.int64(j) * wp.int64(c.columns) + wp.int64(i)
    north = south + wp.int64(c.columns)
    a = wp.float64(item_at(c.masks, south))
    b = wp.float64(item_at(c.masks, south + wp.int64(1))) - a
    e = wp.float64(item_at(c.masks, north))
    f = wp.float64(item_at(c.masks, north + wp.int64(1))) - e
    low = a + b * s
    rise = e + f * s - low
    return BYTE * wp.vec3d(low + rise * t, (b + (f - b) * t) * c.per_x, rise * c.per_y)


@wp.func
def detail_at(c: PackedLayers, x: wp.float64, y: wp.float64):
    """Return the height of all displacement layers at (x, y) metres, with its slopes: (height, along x, along y).

    Layers do not depend on the anchor.
    """
    found = wp.vec3d()
    x += c.anchor_x
    y += c.anchor_y
    for k in range(c.count):
        d = c.layer[k]
        m = wp.vec3d(wp.float64(1.0), wp.float64(0.0), wp.float64(0.0))
        if d.masked == 1:
            m = mask_at(c, d.mask, x, y)
        if m[0] > wp.float64(0.0):
            h = wp.vec3d()
            if d.columns > 0:
                h = image_detail(c, d, x, y)
            else:
                h = noise_detail(d, x, y)
            found += wp.vec3d(m[0] * h[0], m[0] * h[1] + m[1] * h[0], m[0] * h[2] + m[2] * h[0])
    return found
