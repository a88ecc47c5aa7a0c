# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of built-in lands for height operators: mountains, a canyon, an archipelago.

Heights are functions of the position by arithmetic alone: a seed gives the same bits on every machine, and a point has
the same height at every resolution. `x`, `y`: metres from the centre of the square, to the east and north. `wx`, `wy`:
the position moved by noise, so that forms are not straight. Indices 0 and 1 of a noise are its slopes, 2 is its value.
Lengths, heights and other numbers are chosen by their looks. `seed`: selects other noise.
"""

import warp as wp

from ..field.island import gullies, noise, relief, smooth
from ..field.noise import scramble

wp.set_module_options({"max_unroll": 0})

MOUNTAINS, CANYON, ARCHIPELAGO = wp.constant(0), wp.constant(1), wp.constant(2)


@wp.func
def mountains_height(x: wp.float64, y: wp.float64, half_side: wp.float64, seed: wp.uint32) -> wp.float64:
    """Return the height, metres and above 0, of a mountain range from west to east with forelands on both sides.

    x, y: metres from the middle of the square. half_side: half of the square's side, metres.
    """
    one = wp.float64(1.0)
    # Noise moves the points at which the range is evaluated, so that its ridges bend.
    coarse_warp = noise(x / wp.float64(13000.0), y / wp.float64(13000.0), seed + wp.uint32(31))
    fine_warp = noise(x / wp.float64(4700.0), y / wp.float64(4700.0), seed + wp.uint32(32))
    wx = x + wp.float64(1500.0) * coarse_warp[0] + wp.float64(350.0) * fine_warp[0]
    wy = y + wp.float64(3800.0) * coarse_warp[2] + wp.float64(700.0) * fine_warp[2]
    across = wp.abs(wy) / half_side
    inland = one - smooth(wp.float64(0.2), wp.float64(0.95), across)
    rough = relief(wx / wp.float64(5200.0), wy / wp.float64(5200.0), wp.float64(0.55) + wp.float64(0.45) * inland, seed)
    chain = smooth(wp.float64(-0.5), wp.float64(0.5), noise(wx / wp.float64(5200.0), wy / wp.float64(3600.0), seed)[2])
    high = wp.float64(420.0) + wp.float64(850.0) * chain
    foot = wp.float64(430.0) - wp.float64(180.0) * across
    high += (wp.float64(500.0) + wp.float64(500.0) * chain) * rough
    return foot + inland * high + wp.float64(150.0) * rough * (one - inland)


@wp.func
def walls(d: wp.float64) -> wp.float64:
    """Return the height of a canyon's wall d metres from the river, as a fraction of the depth: cliffs and slopes."""
    high = wp.float64(0.24) * smooth(wp.float64(40.0), wp.float64(330.0), d)
    high += wp.float64(0.09) * wp.clamp((d - wp.float64(330.0)) / wp.float64(650.0), wp.float64(0.0), wp.float64(1.0))
    high += wp.float64(0.20) * smooth(wp.float64(980.0), wp.float64(1120.0), d)
    high += wp.float64(0.10) * wp.clamp((d - wp.float64(1120.0)) / wp.float64(420.0), wp.float64(0.0), wp.float64(1.0))
    high += wp.float64(0.06) * smooth(wp.float64(1540.0), wp.float64(1590.0), d)
    high += wp.float64(0.09) * wp.clamp((d - wp.float64(1590.0)) / wp.float64(330.0), wp.float64(0.0), wp.float64(1.0))
    high += wp.float64(0.14) * smooth(wp.float64(1920.0), wp.float64(2010.0), d)
    high += wp.float64(0.08) * wp.clamp((d - wp.float64(2010.0)) / wp.float64(500.0), wp.float64(0.0), wp.float64(1.0))
    return high


@wp.func
def ravine(x: wp.float64, y: wp.float64, length: wp.float64, seed: wp.uint32) -> wp.float64:
    """Return 1 in the bed of side valleys about `length` metres apart, 0 on the spurs between them. x, y: metres."""
    n = noise(x / length, y / length, seed)[2]
    bed = wp.max(wp.float64(1.0) - wp.float64(2.2) * wp.abs(n), wp.float64(0.0))
    return bed * bed * (wp.float64(3.0) - wp.float64(2.0) * bed)


@wp.func
def canyon_height(x: wp.float64, y: wp.float64, half_side: wp.float64, seed: wp.uint32) -> wp.float64:
    """Return the height, metres and above 0, of a plateau with a canyon from east to west and side canyons.

    x, y: metres from the middle of the square. half_side: half of the square's side, metres. The distance from the
    river, which is made shorter in side canyons, gives the height in the canyon's walls.
    """
    one = wp.float64(1.0)
    wide = noise(x / wp.float64(9000.0), y / wp.float64(9000.0), seed + wp.uint32(41))[2]
    fine = noise(x / wp.float64(310.0), y / wp.float64(310.0), seed + wp.uint32(42))
    rough = noise(x / wp.float64(90.0), y / wp.float64(90.0), seed + wp.uint32(43))[2]
    # The river's course is a function of x, so it never meets itself; its noise has any fixed second coordinate.
    fixed_y = wp.float64(0.5)
    course = wp.float64(2600.0) * noise(x / wp.float64(7300.0), fixed_y, seed + wp.uint32(44))[2]
    course += wp.float64(800.0) * noise(x / wp.float64(2300.0), fixed_y, seed + wp.uint32(45))[2]
    d = wp.abs(y - course)
    wx = x + wp.float64(420.0) * noise(x / wp.float64(1900.0), y / wp.float64(1900.0), seed + wp.uint32(46))[2]
    wy = y + wp.float64(420.0) * noise(x / wp.float64(1900.0), y / wp.float64(1900.0), seed + wp.uint32(47))[2]
    side = wp.float64(0.87) * ravine(wx, wp.float64(0.22) * wy, wp.float64(1900.0), seed + wp.uint32(48))
    side = wp.max(side, wp.float64(0.68) * ravine(wx, wp.float64(0.4) * wy, wp.float64(850.0), seed + wp.uint32(49)))
    side = wp.max(side, wp.float64(0.45) * ravine(wx, wp.float64(0.7) * wy, wp.float64(400.0), seed + wp.uint32(50)))
    # A side canyon ends some way into the plateau.
    side = side * (one - smooth(wp.float64(2600.0), wp.float64(6800.0), d + wp.float64(900.0) * wide))
    reach = d * (one - side) + wp.float64(70.0) * fine[2] + wp.float64(16.0) * rough
    # Beside the river, noise raises no wall.
    reach = wp.where(d < wp.float64(60.0), wp.min(reach, d), reach)
    plateau = wp.float64(1950.0) + wp.float64(140.0) * wide + wp.float64(5.0) * fine[2] + wp.float64(1.2) * rough
    floor = wp.float64(700.0) + wp.float64(60.0) * x / half_side
    wall_height = walls(wp.max(reach, wp.float64(0.0)))
    loose = wp.float64(9.0) * rough * wall_height * (one - wall_height)
    return floor + (plateau - floor) * wall_height + loose


@wp.func
def volcano(
    x: wp.float64, y: wp.float64, reach: wp.float64, height: wp.float64, rough: wp.float64, seed: wp.uint32
) -> wp.float64:
    """Return the height, metres, of a cone with gullies and a crater, (x, y) metres from its centre; 0 beyond `reach`.

    reach: radius, metres. height: the cone's height without noise, metres. rough: noise that shifts the gullies and
    raises the cone.
    """
    one = wp.float64(1.0)
    u = x / reach
    v = y / reach
    away = wp.sqrt(u * u + v * v)
    cone = wp.max(one - away, wp.float64(0.0))
    if cone <= wp.float64(0.0):
        return wp.float64(0.0)
    bed = gullies(u + wp.float64(0.04) * rough, v - wp.float64(0.04) * rough, wp.float64(3.1), seed)
    bed = wp.max(bed, wp.float64(0.5) * gullies(u, v + wp.float64(0.03) * rough, wp.float64(6.7), seed + wp.uint32(1)))
    carved = bed * cone * (one - cone) * wp.float64(4.0) * smooth(wp.float64(0.04), wp.float64(0.2), away)
    rise = cone * (wp.float64(0.35) + wp.float64(0.65) * cone) * (one + wp.float64(0.22) * rough)
    crater = smooth(wp.float64(0.085), wp.float64(0.035), away)
    return height * (rise * (one - wp.float64(0.35) * carved) - wp.float64(0.16) * crater)


@wp.func
def archipelago_height(x: wp.float64, y: wp.float64, half_side: wp.float64, seed: wp.uint32) -> wp.float64:
    """Return the height, metres, of islands and volcanoes in a sea at 0 m that is deep at the square's border.

    x, y: metres from the middle of the square. half_side: half of the square's side, metres.
    """
    one = wp.float64(1.0)
    coarse_warp = noise(x / wp.float64(5200.0), y / wp.float64(5200.0), seed + wp.uint32(61))
    fine_warp = noise(x / wp.float64(1500.0), y / wp.float64(1500.0), seed + wp.uint32(62))
    wx = x + wp.float64(900.0) * coarse_warp[0] + wp.float64(200.0) * fine_warp[0]
    wy = y + wp.float64(900.0) * coarse_warp[2] + wp.float64(200.0) * fine_warp[2]
    arc = noise(wx / wp.float64(9500.0), wy / wp.float64(5600.0), seed + wp.uint32(63))[2]
    from_centre = wp.max(wp.abs(x), wp.abs(y)) / half_side
    open_sea = smooth(wp.float64(0.6), wp.float64(1.0), from_centre + wp.float64(0.1) * coarse_warp[2])
    land = (
        wp.float64(0.75) * arc + wp.float64(0.45) * coarse_warp[2] + wp.float64(0.16) * fine_warp[2] - wp.float64(0.12)
    )
    land = land - wp.float64(1.2) * open_sea
    dry = smooth(wp.float64(-0.12), wp.float64(0.05), land)
    rough = relief(wx / wp.float64(2600.0), wy / wp.float64(2600.0), dry, seed)  # no fine octaves on the sea bed
    inland = land + wp.float64(0.06) * rough
    hills = smooth(wp.float64(0.0), wp.float64(0.5), inland)
    height = wp.float64(420.0) * inland + hills * (wp.float64(420.0) + wp.float64(380.0) * rough) - wp.float64(14.0)
    # Some cells have a volcano that rises from the sea floor.
    cell = wp.float64(7000.0)
    i = wp.floor(x / cell)
    j = wp.floor(y / cell)
    volcanoes = wp.float64(0.0)
    for dj in range(-1, 2):
        for di in range(-1, 2):
            ci = i + wp.float64(di)
            cj = j + wp.float64(dj)
            # Noise at another point for each cell: its slopes place the volcano, its value gives the strength.
            px = ci * wp.float64(0.731) + wp.float64(0.41)
            py = cj * wp.float64(0.617) + wp.float64(0.27)
            pick = noise(px, py, seed + wp.uint32(64))
            vx = (ci + wp.float64(0.5) + wp.float64(0.3) * pick[0]) * cell
            vy = (cj + wp.float64(0.5) + wp.float64(0.3) * pick[1]) * cell
            inside = wp.max(wp.abs(vx), wp.abs(vy)) < wp.float64(0.72) * half_side
            if inside and pick[2] > wp.float64(0.08):
                strength = wp.min(pick[2] * wp.float64(2.2), one)
                reach = wp.float64(1900.0) + wp.float64(3300.0) * strength
                high = wp.float64(450.0) + wp.float64(1650.0) * strength
                cell_seed = scramble(wp.uint32(wp.int32(ci)) + scramble(wp.uint32(wp.int32(cj)) + seed + wp.uint32(65)))
                volcanoes = wp.max(volcanoes, volcano(wx - vx, wy - vy, reach, high, rough, cell_seed))
    # Depths shrink to 35 %.
    height = wp.max(height, wp.float64(0.35) * height) + volcanoes * wp.float64(0.9)
    beach = wp.float64(12.0)
    if height > -beach and height < beach:
        t = height / beach
        height = height * (wp.float64(0.3) + wp.float64(0.7) * t * t)
    return height


@wp.kernel
def raise_land(
    offset: int,
    land: int,
    size: int,
    first_row: int,
    half_side: wp.float64,
    seed: wp.uint32,
    samples: wp.array(dtype=wp.float32),
):
    """Write the heights of a built-in land, metres, in row first_row + offset + tid to row offset + tid of `samples`.

    land: MOUNTAINS, CANYON or ARCHIPELAGO. size: samples a side. half_side: half of the square's side, metres.
    """
    row = offset + wp.tid()
    cells = wp.float64(size - 1)
    y = half_side * wp.float64(2 * (first_row + row) - (size - 1)) / cells
    for i in range(size):
        x = half_side * wp.float64(2 * i - (size - 1)) / cells
        height = wp.float64(0.0)
        if land == MOUNTAINS:
            height = mountains_height(x, y, half_side, seed)
        elif land == CANYON:
            height = canyon_height(x, y, half_side, seed)
        else:
            height = archipelago_height(x, y, half_side, seed)
        samples[row * size + i] = wp.float32(height) + wp.float32(0.0)  # not -0
