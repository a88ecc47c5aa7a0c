# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernel of the built-in island: a volcano, eroded ridges, valleys, beaches and a shelf under the sea.

It uses only additions, multiplications, divisions, square roots and hashes of integers, so the same seed gives the same
bits on every machine, and a point of the plane has the same height at every resolution. Lengths, heights and other
numbers are chosen by their looks. Another `seed` gives another island.
"""

import warp as wp

from .noise import scramble

# Octaves of the eroded relief: the first is as long as half the island's side, the last 1 / 500 of that.
RELIEF_OCTAVES = wp.constant(9)


@wp.func
def gradient_at(row: wp.uint32, i: int, u: wp.float64, v: wp.float64):
    """Return the random gradient (x, y) at lattice point i of a row, and the height of its plane at the offset (u, v).

    row: hash of the row's number.
    """
    h = scramble(row + wp.uint32(i))
    gx = wp.float64(h & wp.uint32(0xFFFF)) / wp.float64(32767.5) - wp.float64(1.0)
    gy = wp.float64(h >> wp.uint32(16)) / wp.float64(32767.5) - wp.float64(1.0)
    return wp.vec3d(gx, gy, gx * u + gy * v)


@wp.func
def noise(x: wp.float64, y: wp.float64, seed: wp.uint32):
    """Return Perlin's gradient noise of lattice spacing 1: (slope x, slope y, value), mostly within +-0.7."""
    fx = wp.floor(x)
    fy = wp.floor(y)
    i = wp.int32(fx)
    j = wp.int32(fy)
    u = x - fx
    v = y - fy
    one = wp.float64(1.0)
    south = scramble(wp.uint32(j) + seed)
    north = scramble(wp.uint32(j + 1) + seed)
    a = gradient_at(south, i, u, v)
    b = gradient_at(south, i + 1, u - one, v)
    c = gradient_at(north, i, u, v - one)
    d = gradient_at(north, i + 1, u - one, v - one)
    # Quintic fade and its slope.
    fu = u * u * u * (u * (u * wp.float64(6.0) - wp.float64(15.0)) + wp.float64(10.0))
    fv = v * v * v * (v * (v * wp.float64(6.0) - wp.float64(15.0)) + wp.float64(10.0))
    su = wp.float64(30.0) * u * u * (u * (u - wp.float64(2.0)) + one)
    sv = wp.float64(30.0) * v * v * (v * (v - wp.float64(2.0)) + one)
    ab = a + (b - a) * fu
    cd = c + (d - c) * fu
    mixed = ab + (cd - ab) * fv
    slope_x = su * ((b[2] - a[2]) * (one - fv) + (d[2] - c[2]) * fv)
    slope_y = sv * (cd[2] - ab[2])
    return wp.vec3d(mixed[0] + slope_x, mixed[1] + slope_y, mixed[2])


@wp.func
def relief(x: wp.float64, y: wp.float64, detail: wp.float64, seed: wp.uint32):
    """Return a sum of octaves of noise at (x, y) with fewer fine ones on steep ground: sharp ridges, smooth valleys.

    x, y: in cells of the first octave's lattice. `detail` (0 .. 1) scales all octaves after the third, which cost most
    of the time and do not show on the sea bed. The damping by the summed slope is Quilez' ("more noise", 2008).
    """
    total = wp.float64(0.0)
    weight = wp.float64(1.0)
    sx = wp.float64(0.0)
    sy = wp.float64(0.0)
    px = x
    py = y
    octaves = wp.where(detail > wp.float64(0.0), RELIEF_OCTAVES, 3)
    for octave in range(octaves):
        if octave == 3:
            weight = weight * detail
        n = noise(px, py, seed + wp.uint32(octave) * wp.uint32(-0x61C88647))
        sx = sx + n[0] * wp.float64(0.75)
        sy = sy + n[1] * wp.float64(0.75)
        total = total + weight * n[2] / (wp.float64(1.0) + sx * sx + sy * sy)
        weight = weight * wp.float64(0.52)
        # A turn by the angle of (3, 4, 5) between octaves hides the lattice.
        turned = (px * wp.float64(0.8) - py * wp.float64(0.6)) * wp.float64(2.0)
        py = (px * wp.float64(0.6) + py * wp.float64(0.8)) * wp.float64(2.0)
        px = turned
    return total


@wp.func
def smooth(low: wp.float64, high: wp.float64, value: wp.float64):
    """Return the smoothstep of `value`: 0 below `low`, 1 above `high`."""
    t = wp.clamp((value - low) / (high - low), wp.float64(0.0), wp.float64(1.0))
    return t * t * (wp.float64(3.0) - wp.float64(2.0) * t)


@wp.func
def gullies(x: wp.float64, y: wp.float64, turns: wp.float64, seed: wp.uint32):
    """Return 0 on a ridge to 1 in the bed of a valley; about 6 * turns valleys run outward from (0, 0).

    x, y: position relative to that centre, in units of half the island's side.
    """
    distance = wp.sqrt(x * x + y * y) + wp.float64(1e-3)
    wander = wp.float64(1.2) * distance
    n = noise(x / distance * turns + wander, y / distance * turns - wander, seed)
    bed = wp.max(wp.float64(1.0) - wp.float64(2.6) * wp.abs(n[2]), wp.float64(0.0))
    return bed * (wp.float64(0.4) + wp.float64(0.6) * bed)


@wp.func
def island_height(x: wp.float64, y: wp.float64, seed: wp.uint32):
    """Return metres above the sea at (x, y), both in -1 .. 1 over the island's square.

    `inland` is negative in the sea and grows inland; ridges, valleys, the volcano and the coast follow from it and
    noise.
    """
    one = wp.float64(1.0)
    half = wp.float64(0.5)
    wide = noise(x * wp.float64(2.0), y * wp.float64(2.0), seed + wp.uint32(101))
    narrow = noise(x * wp.float64(6.0), y * wp.float64(6.0), seed + wp.uint32(102))
    # the position moved by noise, so that forms are not round; north by slopes, which serve as other noise
    wx = x + wp.float64(0.14) * wide[2] + wp.float64(0.04) * narrow[2]
    wy = y + wp.float64(0.07) * wide[0] + wp.float64(0.02) * narrow[0]
    bays = noise(x * wp.float64(3.1), y * wp.float64(3.1), seed + wp.uint32(103))
    from_middle = wp.sqrt(wx * wx + wp.float64(1.3) * wy * wy)
    inland = wp.float64(0.82) - from_middle - wp.float64(0.16) * bays[2]
    dry = smooth(wp.float64(-0.12), wp.float64(0.02), inland)  # 0 on the sea bed, 1 on land
    rough = relief(wx * wp.float64(2.2), wy * wp.float64(2.2), dry, seed)
    inland = inland + wp.float64(0.05) * rough

    # Ridges and peaks grow towards the middle; valleys run out of it to the coast.
    rise = smooth(wp.float64(-0.05), wp.float64(0.7), inland)
    land = (wp.float64(110.0) + wp.float64(750.0) * rise) * rough
    if rise > wp.float64(0.0):
        crest = noise(wx * wp.float64(2.7), wy * wp.float64(2.7), seed + wp.uint32(104))[2]
        crest = one - wp.float64(1.7) * wp.abs(crest)
        land = land + wp.float64(200.0) * rise + wp.float64(560.0) * rise * crest * crest
        bx = wx + wp.float64(0.06) * rough
        by = wy - wp.float64(0.06) * rough
        beds = gullies(bx, by, wp.float64(1.9), seed + wp.uint32(105))
        beds = wp.max(beds, half * gullies(bx, by, wp.float64(4.7), seed + wp.uint32(106)))
        spread = smooth(wp.float64(0.05), wp.float64(0.3), from_middle) * wp.min(rise * wp.float64(20.0), one)
        land = land * (one - wp.float64(0.6) * beds * spread)

    # The volcano: a cone that steepens towards its rim, with gullies and a crater.
    vx = wx - wp.float64(0.16)
    vy = wy - wp.float64(0.10)
    from_volcano = wp.sqrt(vx * vx + vy * vy)
    cone = wp.max(one - from_volcano / wp.float64(0.55), wp.float64(0.0))
    if cone > wp.float64(0.0):
        furrow = gullies(vx + wp.float64(0.03) * rough, vy, wp.float64(3.4), seed + wp.uint32(107))
        furrow = (
            furrow * cone * (one - cone) * wp.float64(4.0) * smooth(wp.float64(0.05), wp.float64(0.16), from_volcano)
        )
        cone = wp.float64(1800.0) * cone * cone * (half + half * cone)
        cone = cone * (one + wp.float64(0.25) * rough) * (one - wp.float64(0.22) * furrow)
    crater = smooth(wp.float64(0.1), wp.float64(0.03), from_volcano + wp.float64(0.01) * narrow[2])
    height = wp.max(land, wp.float64(0.55) * land + cone) - wp.float64(800.0) * crater

    # The coast: a shelf that falls off outside, and a strip of beach where land meets the sea.
    height = height + wp.float64(260.0) * wp.clamp(inland, wp.float64(-0.5), wp.float64(0.16)) - wp.float64(16.0)
    beach = wp.float64(16.0)
    if height > -beach and height < beach:
        t = height / beach
        height = height * (wp.float64(0.25) + wp.float64(0.75) * t * t)
    return height


@wp.kernel
def raise_island(offset: int, size: int, first_row: int, seed: wp.uint32, samples: wp.array(dtype=wp.float32)):
    """Compute the heights of the island in row first_row + offset + tid, of `size` x `size` samples.

    They are written to row offset + tid of `samples`.
    """
    row = offset + wp.tid()
    cells = wp.float64(size - 1)
    y = wp.float64(2 * (first_row + row) - (size - 1)) / cells
    for i in range(size):
        x = wp.float64(2 * i - (size - 1)) / cells
        samples[row * size + i] = wp.float32(island_height(x, y, seed)) + wp.float32(0.0)  # not -0
