# SPDX-License-Identifier: GPL-3.0-or-later
"""Droplets: each runs downhill from its start, erodes up to its capacity and deposits the surplus (Beyer 2015).

Tiles of the ground have one of four colours. Tiles of one colour run in parallel, the droplets of a tile one after the
other. A droplet reaches less than half a tile beyond its own, so tiles of one colour never meet and the result does not
depend on threads.

`ground` is float32 [rows * columns] metres, NaN where it must not change; `change` is float64 and added to it, which
conserves mass. `rain`: these arrays and the parameters. The load that leaves at the border of the samples is `carried`,
m3. Positions are in samples of the whole level, so that a tile has the same bits.
"""

import warp as wp

from ..field.noise import scramble

# Samples by which the brush is wider than `brush_x`, `brush_y`: on the way, and for the rest of a load, which a droplet
# drops in one place.
ON_THE_WAY, AT_THE_END = wp.constant(0), wp.constant(1)


@wp.struct
class DropletRain:
    """Parameters of droplets; lengths in metres.

    `first_row`, `first_column`: position of sample [0, 0] in the whole level. `rows`, `columns`: samples of a tile.
    `across`: tiles from west to east of the whole level. `drops`: droplets of a tile. `stride`: length of a step, of
    which a droplet takes at most `steps`. `brush_x`, `brush_y`: radius of the brush in samples. `capacity`: m3 on a
    slope of 1. Fractions in a step: `inertia` of the old direction, `load` of the difference to the capacity that is
    eroded or deposited, `dry` of the water that is lost. `sea`: height where droplets end. Of each sample, `ground`:
    height, NaN where it must not change; `mask`: factor on erosion; `change`: of the height, by droplets so far.
    """

    width: wp.int32
    height: wp.int32
    first_row: wp.int32
    first_column: wp.int32
    rows: wp.int32
    columns: wp.int32
    across: wp.int32
    drops: wp.int32
    steps: wp.int32
    brush_x: wp.int32
    brush_y: wp.int32
    seed: wp.uint32
    step_x: wp.float64
    step_y: wp.float64
    stride: wp.float64
    capacity: wp.float64
    inertia: wp.float64
    load: wp.float64
    dry: wp.float64
    sea: wp.float64
    ground: wp.array(dtype=wp.float32)
    mask: wp.array(dtype=wp.float32)
    change: wp.array(dtype=wp.float64)


@wp.func
def height_at(rain: DropletRain, i: wp.int32) -> wp.float64:
    """Return the height of sample i with the change by droplets so far, metres."""
    return wp.float64(rain.ground[i]) + rain.change[i]


@wp.func
def slopes_and_height(rain: DropletRain, x: wp.float64, y: wp.float64) -> wp.vec3d:
    """Return slopes to the east and north (m/m) and the height (m) of the bilinear surface at (x, y).

    All are NaN if one of the four samples around must not change. x, y: samples of the whole level, inside the ground.
    """
    one = wp.float64(1.0)
    i = wp.int32(x)
    j = wp.int32(y)
    u = x - wp.float64(i)
    v = y - wp.float64(j)
    index = (j - rain.first_row) * rain.width + i - rain.first_column
    south_west = height_at(rain, index)
    south_rise = height_at(rain, index + 1) - south_west
    north_west = height_at(rain, index + rain.width)
    north_rise = height_at(rain, index + rain.width + 1) - north_west
    low = south_west + south_rise * u
    rise = north_west + north_rise * u - low
    return wp.vec3d((south_rise * (one - v) + north_rise * v) / rain.step_x, rise / rain.step_y, low + rise * v)


@wp.func
def deposit(rain: DropletRain, x: wp.float64, y: wp.float64, volume: wp.float64, wider_by: wp.int32):
    """Deposit `volume` m3, or erode a negative one, under a round brush at (x, y).

    x, y: samples of the whole level. wider_by: samples added to `brush_x`, `brush_y`. The weight falls from 1 in the
    middle to 0 one sample beyond the brush's radius. Samples that must not change get nothing, and the others all of
    the volume; there must be one.
    """
    middle_x = wp.int32(x + wp.float64(0.5)) - rain.first_column
    middle_y = wp.int32(y + wp.float64(0.5)) - rain.first_row
    west = wp.max(middle_x - rain.brush_x - wider_by, 0)
    east = wp.min(middle_x + rain.brush_x + wider_by, rain.width - 1) + 1
    south = wp.max(middle_y - rain.brush_y - wider_by, 0)
    north = wp.min(middle_y + rain.brush_y + wider_by, rain.height - 1) + 1
    zero = wp.float64(0.0)
    per_x = wp.float64(1.0) / wp.float64(rain.brush_x + wider_by + 1)
    per_y = wp.float64(1.0) / wp.float64(rain.brush_y + wider_by + 1)
    total = wp.float64(0.0)
    for row in range(south, north):
        v = (y - wp.float64(rain.first_row + row)) * per_y
        rest = wp.float64(1.0) - v * v
        for column in range(west, east):
            i = row * rain.width + column
            u = (x - wp.float64(rain.first_column + column)) * per_x
            if rain.ground[i] == rain.ground[i]:  # not NaN
                total += wp.max(rest - u * u, zero)
    metres_per_weight = volume / (rain.step_x * rain.step_y * total)
    for row in range(south, north):
        v = (y - wp.float64(rain.first_row + row)) * per_y
        rest = wp.float64(1.0) - v * v
        for column in range(west, east):
            i = row * rain.width + column
            u = (x - wp.float64(rain.first_column + column)) * per_x
            if rain.ground[i] == rain.ground[i]:  # not NaN
                rain.change[i] = rain.change[i] + metres_per_weight * wp.max(rest - u * u, zero)


@wp.func
def run_droplet(rain: DropletRain, x: wp.float64, y: wp.float64) -> wp.float64:
    """Run a droplet from (x, y) to its end; return the m3 that it carries over the border of these samples.

    Each step goes downhill with inertia; the droplet deposits where it climbs or has more than its capacity, else it
    erodes. It ends after `rain.steps`, at the sea, on a plain, before ground that must not change, or at the border of
    these samples; there it takes its load along, elsewhere it deposits the rest. x, y: samples of the whole level.
    Fractions a step: `rain.load` of the difference to the capacity, `rain.dry` of the water. `rain.mask` scales
    erosion.
    """
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    cell = rain.step_x * rain.step_y
    min_x = wp.float64(rain.first_column)
    min_y = wp.float64(rain.first_row)
    max_x = wp.float64(rain.first_column + rain.width - 1)
    max_y = wp.float64(rain.first_row + rain.height - 1)
    direction_x = wp.float64(0.0)
    direction_y = wp.float64(0.0)
    water = wp.float64(1.0)
    load = wp.float64(0.0)
    carried = wp.float64(0.0)
    step = wp.int32(0)
    here = slopes_and_height(rain, x, y)  # slopes to the east and north, height
    while step < rain.steps and here[2] > rain.sea:
        step += 1
        steepness = wp.sqrt(here[0] * here[0] + here[1] * here[1])
        if steepness > zero:
            direction_x = rain.inertia * direction_x - (one - rain.inertia) * here[0] / steepness
            direction_y = rain.inertia * direction_y - (one - rain.inertia) * here[1] / steepness
        length = wp.sqrt(direction_x * direction_x + direction_y * direction_y)
        if length == zero:
            step = rain.steps  # a plain has no downhill direction
        else:
            direction_x = direction_x / length
            direction_y = direction_y / length
            next_x = x + direction_x * rain.stride / rain.step_x
            next_y = y + direction_y * rain.stride / rain.step_y
            # beyond the border of these samples
            if next_x < min_x or next_y < min_y or next_x >= max_x or next_y >= max_y:
                carried = load
                load = zero
                step = rain.steps
            else:
                there = slopes_and_height(rain, next_x, next_y)
                if there[2] == there[2]:  # not NaN: all four samples around it may change
                    fall = here[2] - there[2]
                    capacity = rain.capacity * water * wp.max(fall, zero) / rain.stride
                    volume = zero
                    if fall < zero:
                        volume = wp.min(-fall * cell, load)  # fills the hollow up to the height of the next point
                    elif load > capacity:
                        volume = (load - capacity) * rain.load
                    else:  # it erodes
                        row = wp.int32(y + wp.float64(0.5)) - rain.first_row
                        nearest = row * rain.width + wp.int32(x + wp.float64(0.5)) - rain.first_column
                        volume = -wp.min((capacity - load) * rain.load, fall * cell) * wp.float64(rain.mask[nearest])
                    load -= volume
                    deposit(rain, x, y, volume, ON_THE_WAY)
                    water *= one - rain.dry
                    x = next_x
                    y = next_y
                    here = slopes_and_height(rain, x, y)
                else:
                    step = rain.steps
    if load > zero:
        deposit(rain, x, y, load, AT_THE_END)
    return carried


@wp.kernel
def rain_on_tiles(offset: int, tiles: wp.array(dtype=wp.int32), rain: DropletRain, carried: wp.array(dtype=wp.float64)):
    """Run all droplets of tile tiles[offset + tid] that start on this ground, one after the other.

    tiles: numbers of tiles of one colour, which are so far apart that their droplets never meet; a row has
    `rain.across` tiles of `rain.columns` by `rain.rows` samples. carried[offset + tid]: m3 of sediment that they carry
    over the border of these samples.
    """
    slot = offset + wp.tid()
    tile = tiles[slot]
    per_unit = wp.float64(1.0 / 65536.0)
    total = wp.float64(0.0)
    for drop in range(rain.drops):
        bits = scramble(scramble(scramble(wp.uint32(tile) + rain.seed) + wp.uint32(drop)))
        u = wp.float64(bits & wp.uint32(0xFFFF)) * per_unit
        v = wp.float64(bits >> wp.uint32(16)) * per_unit
        x = wp.float64((tile % rain.across) * rain.columns) + u * wp.float64(rain.columns)
        y = wp.float64((tile / rain.across) * rain.rows) + v * wp.float64(rain.rows)
        if x >= wp.float64(rain.first_column) and y >= wp.float64(rain.first_row):  # it starts on this ground
            if x < wp.float64(rain.first_column + rain.width - 1) and y < wp.float64(rain.first_row + rain.height - 1):
                total += run_droplet(rain, x, y)
    carried[slot] = total
