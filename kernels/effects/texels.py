# SPDX-License-Identifier: GPL-3.0-or-later
"""Positions of the texels of maps on the ground."""

import warp as wp

from ..field.codes import bilinear, corners_of
from .pyramid import Pyramid


@wp.struct
class Texels:
    """An image over the ground: the centre of its first, north-western texel, and its steps, metres."""

    columns: wp.int32
    west: wp.float64
    north: wp.float64
    step_x: wp.float64
    step_y: wp.float64


@wp.kernel
def texel_places(offset: int, first: int, ground: Pyramid, texels: Texels, out: wp.array(dtype=wp.vec3f)):
    """Write to out[offset + tid] the position on the ground, metres, of texel `first + offset + tid` of an image.

    Heights are bilinear between samples, scaled and without displacement; texels beyond the raster get its border.
    Texels are numbered row by row from the north-west; (texels.west, texels.north) is the centre of the first one.
    """
    i = offset + wp.tid()
    texel = first + i
    columns = ground.columns[0]
    rows = ground.rows[0]
    x = texels.west + wp.float64(texel % texels.columns) * texels.step_x
    y = texels.north - wp.float64(texel / texels.columns) * texels.step_y
    cell_x = wp.clamp((x - ground.west) * ground.per_x, wp.float64(0.0), wp.float64(columns - 1))
    cell_y = wp.clamp((y - ground.south) * ground.per_y, wp.float64(0.0), wp.float64(rows - 1))
    column = wp.min(wp.int32(cell_x), columns - 2)
    row = wp.min(wp.int32(cell_y), rows - 2)
    corners = corners_of(ground.samples, column, row)
    height = bilinear(corners, cell_x - wp.float64(column), cell_y - wp.float64(row))
    out[i] = wp.vec3f(
        wp.float32(ground.west + cell_x * ground.step_x),
        wp.float32(ground.south + cell_y * ground.step_y),
        wp.float32(height * ground.height_scale + ground.height_offset),
    )
