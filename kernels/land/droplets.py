# SPDX-License-Identifier: GPL-3.0-or-later
"""Droplets: each runs down from where it fell, loads what the slope allows and lays down what is too much.

Tiles of the ground have one of four colours. Those of one colour run side by side, the droplets of each one after the
other; none reaches as far as half a tile beyond its own, so no two tiles meet and threads change nothing.

`ground` is float32 [rows * columns] metres, NaN where nothing may change; `change` is float64 and added to it, so that
no grain is lost; what leaves over the rim is `carried`, cubic metres. Places are in samples of the whole level, so that
a tile of it has the same bits.
"""

import warp as wp

from ..field.noise import scramble


@wp.struct
class Rain:
    """What a droplet does; lengths in metres.

    `first_row`, `first_column`: of sample [0, 0] in the whole level. `rows`, `columns`: of a tile, samples. `across`:
    tiles from west to east of the whole level. `drops`: a tile. `stride`: of a droplet, metres, `steps` at most.
    `brush_x`, `brush_y`: samples around a droplet that it changes. `capacity`: m3 that one carries on a slope of 1.
    `keep`: of its direction, a step. `load`: the part of what it lacks, or has too much, that it takes up or lays down,
    a step. `dry`: of its water that is lost, a step. `sea`: where it ends. `mask`: times what it takes up.
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
    keep: wp.float64
    load: wp.float64
    dry: wp.float64
    sea: wp.float64
    ground: wp.array(dtype=wp.float32)
    mask: wp.array(dtype=wp.float32)
    change: wp.array(dtype=wp.float64)


@wp.func
def height_at(rain: Rain, i: wp.int32) -> wp.float64:
    return wp.float64(rain.ground[i]) + rain.change[i]


@wp.func
def patch(rain: Rain, x: wp.float64, y: wp.float64) -> wp.vec3d:
    """The bilinear surface at (x, y): its slope to the east and north, metres a metre, and its height."""
    one = wp.float64(1.0)
    i = wp.int32(x)
    j = wp.int32(y)
    u = x - wp.float64(i)
    v = y - wp.float64(j)
    at = (j - rain.first_row) * rain.width + i - rain.first_column
    a = height_at(rain, at)
    b = height_at(rain, at + 1) - a
    c = height_at(rain, at + rain.width)
    d = height_at(rain, at + rain.width + 1) - c
    low = a + b * u
    rise = c + d * u - low
    return wp.vec3d((b * (one - v) + d * v) / rain.step_x, rise / rain.step_y, low + rise * v)


@wp.func
def lay(rain: Rain, x: wp.float64, y: wp.float64, volume: wp.float64, more: wp.int32):
    """Lay down `volume` m3 around (x, y), under a round brush, `more` samples wider; less than 0: take up."""
    middle_x = wp.int32(x + wp.float64(0.5)) - rain.first_column
    middle_y = wp.int32(y + wp.float64(0.5)) - rain.first_row
    west = wp.max(middle_x - rain.brush_x - more, 0)
    east = wp.min(middle_x + rain.brush_x + more, rain.width - 1) + 1
    south = wp.max(middle_y - rain.brush_y - more, 0)
    north = wp.min(middle_y + rain.brush_y + more, rain.height - 1) + 1
    none = wp.float64(0.0)
    per_x = wp.float64(1.0) / wp.float64(rain.brush_x + more + 1)
    per_y = wp.float64(1.0) / wp.float64(rain.brush_y + more + 1)
    total = wp.float64(0.0)
    for row in range(south, north):
        v = (y - wp.float64(rain.first_row + row)) * per_y
        rest = wp.float64(1.0) - v * v
        for column in range(west, east):
            i = row * rain.width + column
            u = (x - wp.float64(rain.first_column + column)) * per_x
            if rain.ground[i] == rain.ground[i]:
                total += wp.max(rest - u * u, none)
    part = volume / (rain.step_x * rain.step_y * total)
    for row in range(south, north):
        v = (y - wp.float64(rain.first_row + row)) * per_y
        rest = wp.float64(1.0) - v * v
        for column in range(west, east):
            i = row * rain.width + column
            u = (x - wp.float64(rain.first_column + column)) * per_x
            if rain.ground[i] == rain.ground[i]:
                rain.change[i] = rain.change[i] + part * wp.max(rest - u * u, none)


@wp.func
def run_droplet(rain: Rain, x: wp.float64, y: wp.float64) -> wp.float64:
    """From (x, y) until it is dry, in the sea, in a hole or over the rim; there, the m3 that it carries."""
    none = wp.float64(0.0)
    one = wp.float64(1.0)
    cell = rain.step_x * rain.step_y
    least_x = wp.float64(rain.first_column)
    least_y = wp.float64(rain.first_row)
    most_x = wp.float64(rain.first_column + rain.width - 1)
    most_y = wp.float64(rain.first_row + rain.height - 1)
    go_x = wp.float64(0.0)
    go_y = wp.float64(0.0)
    water = wp.float64(1.0)
    held = wp.float64(0.0)
    carried = wp.float64(0.0)
    step = wp.int32(0)
    here = patch(rain, x, y)
    while step < rain.steps and here[2] > rain.sea:
        step += 1
        steepness = wp.sqrt(here[0] * here[0] + here[1] * here[1])
        if steepness > none:
            go_x = rain.keep * go_x - (one - rain.keep) * here[0] / steepness
            go_y = rain.keep * go_y - (one - rain.keep) * here[1] / steepness
        length = wp.sqrt(go_x * go_x + go_y * go_y)
        if length == none:
            step = rain.steps  # on a plain nothing is nearer than anything else
        else:
            go_x = go_x / length
            go_y = go_y / length
            u = x + go_x * rain.stride / rain.step_x
            v = y + go_y * rain.stride / rain.step_y
            if u < least_x or v < least_y or u >= most_x or v >= most_y:
                carried = held
                held = none
                step = rain.steps
            else:
                there = patch(rain, u, v)
                if there[2] == there[2]:
                    fall = here[2] - there[2]
                    room = rain.capacity * water * wp.max(fall, none) / rain.stride
                    volume = none
                    if fall < none:
                        volume = wp.min(-fall * cell, held)  # fills the hollow, at most to the next place
                    elif held > room:
                        volume = (held - room) * rain.load
                    else:
                        row = wp.int32(y + wp.float64(0.5)) - rain.first_row
                        near = row * rain.width + wp.int32(x + wp.float64(0.5)) - rain.first_column
                        volume = -wp.min((room - held) * rain.load, fall * cell) * wp.float64(rain.mask[near])
                    held -= volume
                    lay(rain, x, y, volume, 0)
                    water *= one - rain.dry
                    x = u
                    y = v
                    here = patch(rain, x, y)
                else:
                    step = rain.steps
    if held > none:
        lay(rain, x, y, held, 1)
    return carried


@wp.kernel
def rain_on_tiles(offset: int, tiles: wp.array(dtype=wp.int32), rain: Rain, carried: wp.array(dtype=wp.float64)):
    """All droplets of the tile with the number `tiles[offset + tid]` in the whole level, those from beyond this ground
    left out."""
    slot = offset + wp.tid()
    tile = tiles[slot]
    per_unit = wp.float64(1.0 / 65536.0)
    lost = wp.float64(0.0)
    for drop in range(rain.drops):
        bits = scramble(scramble(scramble(wp.uint32(tile) + rain.seed) + wp.uint32(drop)))
        part_x = wp.float64(bits & wp.uint32(0xFFFF)) * per_unit
        part_y = wp.float64(bits >> wp.uint32(16)) * per_unit
        x = wp.float64((tile % rain.across) * rain.columns) + part_x * wp.float64(rain.columns)
        y = wp.float64((tile / rain.across) * rain.rows) + part_y * wp.float64(rain.rows)
        if x >= wp.float64(rain.first_column) and y >= wp.float64(rain.first_row):
            if x < wp.float64(rain.first_column + rain.width - 1) and y < wp.float64(rain.first_row + rain.height - 1):
                lost += run_droplet(rain, x, y)
    carried[slot] = lost
