# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth and speed of steady water from the discharge of each sample.

    h = (n Q / (w S^(1/2)))^(3/5), w = WIDTH Q^(1/2), v = Q / (w h)

h: depth, n: Manning's coefficient, Q: discharge, S: slope, w: width of the stream (Leopold and Maddock 1953).

`rain`: the raster, its drainage and the results. `rain.heights`: of the ground, `rain.filled`: with filled depressions,
metres; `rain.area`: samples that drain through each one; `rain.runoff`: m3/s from one sample; `rain.normal`: depth of
uniform flow, metres.
"""

import warp as wp

from ..effects.logarithm import exponential, natural_log

# Width of a stream in metres over the square root of its discharge in m^3/s.
WIDTH = wp.constant(wp.float64(3.0))
# Uniform flow without a slope would be infinitely deep.
MIN_SLOPE = wp.constant(wp.float64(1.0e-3))
MIN_DISCHARGE = wp.constant(wp.float64(1.0e-12))


@wp.struct
class SteadyRain:
    """A raster, its drainage, and the water that steady rain makes."""

    width: wp.int32
    height: wp.int32
    step_x: wp.float64  # metres between samples
    step_y: wp.float64
    runoff: wp.float64  # of a sample, m^3/s
    rough: wp.float64  # Manning's coefficient
    sea: wp.float32  # height of the sea, metres
    heights: wp.array(dtype=wp.float32)  # metres
    filled: wp.array(dtype=wp.float32)  # surface with filled depressions, metres
    dry: wp.array(dtype=wp.uint8)  # not 0: a sample without water
    area: wp.array(dtype=wp.float64)  # samples that drain through each
    normal: wp.array(dtype=wp.float32)  # metres, depth of uniform flow
    surface: wp.array(dtype=wp.float32)  # of the water, metres; `measure_water` replaces it by the depth
    speed: wp.array(dtype=wp.float32)  # m/s
    discharge: wp.array(dtype=wp.float32)  # m^3/s


@wp.func
def slope(rain: SteadyRain, x: wp.int32, y: wp.int32) -> wp.float64:
    """Return the slope of the filled surface at sample (x, y), metres a metre.

    It is by central differences, one-sided at the border.
    """
    west = wp.max(x - 1, 0)
    east = wp.min(x + 1, rain.width - 1)
    south = wp.max(y - 1, 0)
    north = wp.min(y + 1, rain.height - 1)
    to_east = wp.float64(rain.filled[y * rain.width + east]) - wp.float64(rain.filled[y * rain.width + west])
    to_north = wp.float64(rain.filled[north * rain.width + x]) - wp.float64(rain.filled[south * rain.width + x])
    to_east /= wp.float64(east - west) * rain.step_x
    to_north /= wp.float64(north - south) * rain.step_y
    return wp.sqrt(to_east * to_east + to_north * to_north)


@wp.kernel
def flow_uniformly(offset: int, rain: SteadyRain):
    """Write the depth of uniform flow in row `offset + tid` to `normal`, and the water's surface to `surface`.

    The surface, metres, is that of the sea, the bed of a lake, or that of the flow. The caller then fills its hollows:
    water that flows towards higher water is dammed, and lakes rise to the flow at their outlets. A discharge up to
    MIN_DISCHARGE has depth 0.
    """
    y = offset + wp.tid()
    for x in range(rain.width):
        i = y * rain.width + x
        discharge = rain.area[i] * rain.runoff
        depth = wp.float64(0.0)
        if discharge > MIN_DISCHARGE:
            root_slope = wp.sqrt(wp.max(slope(rain, x, y), MIN_SLOPE))
            # h^(5/3) = n Q / (w S^(1/2)). The width w is not the spacing, so the depth is the same at every level.
            depth_power = rain.rough * wp.sqrt(discharge) / (WIDTH * root_slope)
            depth = exponential(wp.float64(0.6) * natural_log(depth_power))
        rain.normal[i] = wp.float32(depth)
        rain.surface[i] = rain.heights[i]
        if rain.heights[i] <= rain.sea:
            rain.surface[i] = rain.sea
        elif rain.filled[i] <= rain.heights[i]:  # not in a lake
            rain.surface[i] = wp.float32(wp.float64(rain.heights[i]) + depth)


@wp.kernel
def measure_water(offset: int, rain: SteadyRain):
    """Write depth (to `surface`), speed and discharge of the water at sample `offset + tid`; 0 where `dry`.

    Before, `surface` is the height of the water's surface, whose hollows are filled. Water that is deeper than uniform
    flow (dammed) is slower by the ratio of the depths, and so is the shallow border of a lake, which carries hardly any
    of its water.
    """
    i = offset + wp.tid()
    discharge = rain.area[i] * rain.runoff
    depth = rain.surface[i] - rain.heights[i]
    if rain.heights[i] > rain.sea and rain.filled[i] <= rain.heights[i]:  # neither in the sea nor in a lake
        if rain.surface[i] <= wp.float32(wp.float64(rain.heights[i]) + wp.float64(rain.normal[i])):
            depth = rain.normal[i]  # without the rounding of the height
    speed = wp.float64(0.0)
    if discharge > MIN_DISCHARGE and depth > 0.0:
        ratio = wp.float64(rain.normal[i]) / wp.float64(depth)
        speed = wp.sqrt(discharge) / (WIDTH * wp.float64(rain.normal[i])) * wp.min(ratio, wp.float64(1.0) / ratio)
    if rain.dry[i] != wp.uint8(0):
        discharge = wp.float64(0.0)
        speed = wp.float64(0.0)
        depth = wp.float32(0.0)
    rain.surface[i] = depth
    rain.speed[i] = wp.float32(speed)
    rain.discharge[i] = wp.float32(discharge)
