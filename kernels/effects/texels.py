# SPDX-License-Identifier: GPL-3.0-or-later
"""Texels of maps: where on the ground they are, and their values as the bytes of an image."""

import warp as wp

from ..field.codes import Samples, sample_at


@wp.struct
class Raster:
    """A terrain's samples, and where they are: metres in the terrain's own space."""

    samples: Samples
    columns: wp.int32
    rows: wp.int32
    step_x: wp.float64
    step_y: wp.float64
    per_x: wp.float64  # samples in a metre
    per_y: wp.float64
    west: wp.float64
    south: wp.float64
    height_scale: wp.float64
    height_offset: wp.float64


@wp.struct
class Texels:
    """An image over the ground: the centre of its first texel, which is the north-western one, and its steps."""

    columns: wp.int32
    west: wp.float64
    north: wp.float64
    step_x: wp.float64
    step_y: wp.float64


@wp.kernel
def texel_places(offset: int, first: int, raster: Raster, texels: Texels, out: wp.array(dtype=wp.vec3f)):
    """The ground under texel `first + offset + tid`, bilinear between samples; of one beyond the raster, at its rim."""
    i = offset + wp.tid()
    texel = first + i
    last_x = wp.float64(raster.columns - 1)
    last_y = wp.float64(raster.rows - 1)
    x = texels.west + wp.float64(texel % texels.columns) * texels.step_x
    y = texels.north - wp.float64(texel / texels.columns) * texels.step_y
    cell_x = wp.clamp((x - raster.west) * raster.per_x, wp.float64(0.0), last_x)
    cell_y = wp.clamp((y - raster.south) * raster.per_y, wp.float64(0.0), last_y)
    column = wp.min(wp.int32(cell_x), raster.columns - 2)
    row = wp.min(wp.int32(cell_y), raster.rows - 2)
    at = wp.int64(row) * wp.int64(raster.columns) + wp.int64(column)
    up = at + wp.int64(raster.columns)
    u = cell_x - wp.float64(column)
    v = cell_y - wp.float64(row)
    one = wp.int64(1)
    south = wp.lerp(wp.float64(sample_at(raster.samples, at)), wp.float64(sample_at(raster.samples, at + one)), u)
    north = wp.lerp(wp.float64(sample_at(raster.samples, up)), wp.float64(sample_at(raster.samples, up + one)), u)
    out[i] = wp.vec3f(
        wp.float32(raster.west + cell_x * raster.step_x),
        wp.float32(raster.south + cell_y * raster.step_y),
        wp.float32(wp.lerp(south, north, v) * raster.height_scale + raster.height_offset),
    )


@wp.kernel
def encode(
    offset: int,
    values: wp.array(dtype=wp.float32),
    width: int,
    channels: int,
    low: float,
    per_step: float,
    deep: int,
    out: wp.array(dtype=wp.uint8),
):
    """Texel `offset + tid`: each of its `width` values in steps from `low`, `per_step` of them a unit, to the nearest;
    channels without a value are 0. A byte each or, where `deep` is 1, two, the higher one first."""
    v = offset + wp.tid()
    most = 255.0
    if deep == 1:
        most = 65535.0
    for c in range(channels):
        q = 0
        if c < width:
            q = int(wp.clamp((values[v * width + c] - low) * per_step, 0.0, most) + 0.5)
        if deep == 1:
            out[2 * (v * channels + c)] = wp.uint8(q >> 8)
            out[2 * (v * channels + c) + 1] = wp.uint8(q & 255)
        else:
            out[v * channels + c] = wp.uint8(q)
