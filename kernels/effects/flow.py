# SPDX-License-Identifier: GPL-3.0-or-later
"""Drainage areas, wetness and layers at points. `positions` are the points, metres.

A pyramid has values on a raster, its level 0, and at halved resolutions, levels 1 and more.
"""

import warp as wp

from .logarithm import exponential, natural_log
from .pyramid import Pyramid, filtered_height


@wp.func
def bilinear(pyramid: Pyramid, level: wp.int32, x: wp.float64, y: wp.float64) -> wp.float64:
    """Interpolate a level of a pyramid at (x, y) cells from its first sample; in the unit of the pyramid's values."""
    columns = pyramid.columns[level]
    i = wp.min(wp.int32(x), columns - 2)
    j = wp.min(wp.int32(y), pyramid.rows[level] - 2)
    u = x - wp.float64(i)
    v = y - wp.float64(j)
    index = wp.int64(j) * wp.int64(columns) + wp.int64(i)
    above = index + wp.int64(columns)
    a = filtered_height(pyramid, level, index)
    b = filtered_height(pyramid, level, index + wp.int64(1))
    c = filtered_height(pyramid, level, above)
    d = filtered_height(pyramid, level, above + wp.int64(1))
    low = a + (b - a) * u
    return low + (c + (d - c) * u - low) * v


@wp.func
def value_at(pyramid: Pyramid, coarser_by: wp.float32, p: wp.vec3f, level: wp.float32) -> wp.float64:
    """Return a pyramid's value at a point (metres), interpolated between its samples and between its levels.

    level: level of the raster, also fractional: log2 of the samples that a pixel covers. coarser_by: level of the
    raster that is level 0 of this pyramid. Points and levels beyond the pyramid get its border, its first or last
    level.
    """
    last_x = wp.float64(pyramid.columns[0] - 1)
    last_y = wp.float64(pyramid.rows[0] - 1)
    x = wp.clamp((wp.float64(p[0]) - pyramid.west) / pyramid.step_x, wp.float64(0.0), last_x)
    y = wp.clamp((wp.float64(p[1]) - pyramid.south) / pyramid.step_y, wp.float64(0.0), last_y)
    pyramid_level = wp.clamp(level - coarser_by, wp.float32(0.0), wp.float32(pyramid.levels - 1))
    lower_level = wp.int32(pyramid_level)
    fraction = wp.float64(pyramid_level) - wp.float64(lower_level)
    cells_factor = wp.float64(1.0) / wp.float64(wp.int32(1) << lower_level)
    value = bilinear(pyramid, lower_level, x * cells_factor, y * cells_factor)
    if fraction > wp.float64(0.0):
        cells_factor *= wp.float64(0.5)
        value += (bilinear(pyramid, lower_level + 1, x * cells_factor, y * cells_factor) - value) * fraction
    return value


@wp.kernel
def flow_at(
    offset: int,
    pyramid: Pyramid,
    coarser_by: wp.float32,
    positions: wp.array(dtype=wp.vec3f),
    levels: wp.array(dtype=wp.float32),
    out: wp.array(dtype=wp.float32),
):
    """Write to out[offset + tid] the drainage area at a point, m2.

    pyramid: the area's natural logarithm at halved resolutions. coarser_by: levels by which its first level is coarser
    than the raster. levels: log2 of the samples that a pixel covers at each point.
    """
    v = offset + wp.tid()
    out[v] = wp.float32(exponential(value_at(pyramid, coarser_by, positions[v], levels[v])))


@wp.kernel
def layer_at(
    offset: int,
    pyramid: Pyramid,
    positions: wp.array(dtype=wp.vec3f),
    levels: wp.array(dtype=wp.float32),
    out: wp.array(dtype=wp.float32),
):
    """Write to out[offset + tid] the value of a layer (a raster of one value) at a point.

    pyramid: the layer at halved resolutions. levels: log2 of the samples that a pixel covers at each point.
    """
    v = offset + wp.tid()
    out[v] = wp.float32(value_at(pyramid, wp.float32(0.0), positions[v], levels[v]))


@wp.kernel
def wetness_at(
    offset: int,
    width: wp.float64,
    min_tangent: wp.float64,
    flow: wp.array(dtype=wp.float32),
    normal: wp.array(dtype=wp.vec3f),
    out: wp.array(dtype=wp.float32),
):
    """Write to out[offset + tid] the wetness index ln(a / tan slope) of a point (Beven and Kirkby 1979).

    a: drainage area `flow` (m2) over the contour length `width`, metres. min_tangent: lower limit of tan slope. normal:
    unit normals, which give the slope.
    """
    v = offset + wp.tid()
    n = normal[v]
    x = wp.float64(n[0])
    y = wp.float64(n[1])
    tangent = wp.sqrt(x * x + y * y) / wp.max(wp.float64(n[2]), wp.float64(1e-30))
    out[v] = wp.float32(natural_log(wp.float64(flow[v]) / (width * wp.max(tangent, min_tangent))))
