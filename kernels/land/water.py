# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth and speed of water that flows steadily, from what drains through each sample (Manning's formula)."""

import warp as wp

from ..effects.logarithm import exponential, natural_log

# Metres of a stream's width for the square root of its discharge in m^3/s (Leopold and Maddock 1953).
WIDTH = wp.constant(wp.float64(3.0))
# Metres a metre: water that stands would be infinitely deep.
LEAST_SLOPE = wp.constant(wp.float64(1.0e-3))
LEAST_DISCHARGE = wp.constant(wp.float64(1.0e-12))


@wp.struct
class Rain:
    """A raster of `width` x `height` samples, `step_x`, `step_y` metres apart, each giving `runoff` m^3/s to its
    `rough` rivers (s / m^(1/3)); below `sea` metres is sea."""

    width: wp.int32
    height: wp.int32
    step_x: wp.float64
    step_y: wp.float64
    runoff: wp.float64
    rough: wp.float64
    sea: wp.float32
    heights: wp.array(dtype=wp.float32)
    filled: wp.array(dtype=wp.float32)  # the surface from which all drains
    dry: wp.array(dtype=wp.uint8)
    area: wp.array(dtype=wp.float64)  # samples that drain through each
    normal: wp.array(dtype=wp.float32)  # metres, depth of uniform flow
    surface: wp.array(dtype=wp.float32)
    speed: wp.array(dtype=wp.float32)
    discharge: wp.array(dtype=wp.float32)


@wp.func
def slope(rain: Rain, x: wp.int32, y: wp.int32) -> wp.float64:
    """Of the filled surface, by central differences, one-sided at the rim."""
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
def flow_uniformly(offset: int, rain: Rain):
    """Row `offset + tid`: the depth of uniform flow, and the water's surface as if nothing dammed it: that of the sea,
    the bed of a lake, and elsewhere the flow's."""
    y = offset + wp.tid()
    for x in range(rain.width):
        i = y * rain.width + x
        discharge = rain.area[i] * rain.runoff
        deep = wp.float64(0.0)
        if discharge > LEAST_DISCHARGE:
            steep = wp.sqrt(wp.max(slope(rain, x, y), LEAST_SLOPE))
            # A stream has its own width, however wide samples are: its depth is the same at every level.
            sheet = rain.rough * wp.sqrt(discharge) / (WIDTH * steep)
            deep = exponential(wp.float64(0.6) * natural_log(sheet))
        rain.normal[i] = wp.float32(deep)
        rain.surface[i] = rain.heights[i]
        if rain.heights[i] <= rain.sea:
            rain.surface[i] = rain.sea
        elif rain.filled[i] <= rain.heights[i]:
            rain.surface[i] = wp.float32(wp.float64(rain.heights[i]) + deep)


@wp.kernel
def measure_water(offset: int, rain: Rain):
    """Sample `offset + tid`: its depth (into `surface`, whose water no longer rises downstream), its speed and its
    discharge; 0 where `dry`.

    Water that is dammed flows slower than uniformly by as much as it is deeper; the shallow rim of a lake, where hardly
    any of the lake's water passes, likewise."""
    i = offset + wp.tid()
    through = rain.area[i] * rain.runoff
    deep = rain.surface[i] - rain.heights[i]
    if rain.heights[i] > rain.sea and rain.filled[i] <= rain.heights[i]:
        if rain.surface[i] <= wp.float32(wp.float64(rain.heights[i]) + wp.float64(rain.normal[i])):
            deep = rain.normal[i]  # without the rounding of the height
    fast = wp.float64(0.0)
    if through > LEAST_DISCHARGE and deep > 0.0:
        ratio = wp.float64(rain.normal[i]) / wp.float64(deep)
        fast = wp.sqrt(through) / (WIDTH * wp.float64(rain.normal[i])) * wp.min(ratio, wp.float64(1.0) / ratio)
    if rain.dry[i] != wp.uint8(0):
        through = wp.float64(0.0)
        fast = wp.float64(0.0)
        deep = wp.float32(0.0)
    rain.surface[i] = deep
    rain.speed[i] = wp.float32(fast)
    rain.discharge[i] = wp.float32(through)
