# SPDX-License-Identifier: GPL-3.0-or-later
"""Relief finer than the data's spacing: octaves of noise led by the slope and the bend of the ground, and beds of rock.

A function of the place and of the ground around it alone. Only additions, multiplications, divisions, square roots and
hashes of integers: the same bits on every machine. Places are float64, offsets from a lattice point float32: as exact
far from the raster's first sample as near it.
"""

import warp as wp

from ..field.noise import scramble

# Of one over the golden ratio: octaves have hashes of their own.
NEXT_SEED = wp.constant(wp.uint32(-0x61C88647))
BEND_SEED, BED_SEED, LENGTH_SEED = wp.constant(wp.uint32(101)), wp.constant(wp.uint32(102)), wp.constant(wp.uint32(103))
# The slope beyond which detail grows no more.
STEEPEST = wp.constant(wp.float32(1.5))
# Where the waves so far have a slope whose square is one over this, finer ones are halved.
DAMP = wp.constant(wp.float32(6.0))
# Metres: how far beds keep their height, and how long a ledge is.
BED_BEND, LEDGE_LENGTH = wp.constant(wp.float64(900.0)), wp.constant(wp.float64(700.0))


@wp.struct
class Look:
    """Octave k has half the wavelength and `gain` times the amplitude of the one before."""

    octaves: wp.int32
    seed: wp.uint32
    wave: wp.float32  # metres, the longest
    rough: wp.float32  # amplitude over half a wavelength where the slope is 1
    plain: wp.float32  # the same on level ground
    gain: wp.float32
    ridge: wp.float32  # 0: round everywhere, 1: sharp crests on convex ground
    bed: wp.float32  # metres, mean thickness of a bed; 0: none
    ledge: wp.float32  # 0 .. 1, how far hard beds stand out
    dip: wp.vec2d  # metres that beds rise a metre to the east and north


@wp.struct
class Window:
    """Samples in rows: their number, metres between them, the first one's row and column in the whole level."""

    width: wp.int32
    height: wp.int32
    row: wp.int32
    column: wp.int32
    step_x: wp.float64
    step_y: wp.float64
    reach_x: wp.int32  # samples over which slope and bend are taken
    reach_y: wp.int32


@wp.func
def corner(row: wp.uint32, i: wp.uint32, u: wp.float32, v: wp.float32) -> wp.vec3f:
    """Gradient (x, y) of the lattice point i of a hashed row, and its plane's value at the offset (u, v) from there."""
    h = scramble(row + i)
    gx = wp.float32(h & wp.uint32(0xFFFF)) * wp.float32(3.0517578125e-05) - wp.float32(1.0)
    gy = wp.float32(h >> wp.uint32(16)) * wp.float32(3.0517578125e-05) - wp.float32(1.0)
    return wp.vec3f(gx, gy, gx * u + gy * v)


@wp.func
def gradient_noise(x: wp.float64, y: wp.float64, seed: wp.uint32) -> wp.vec3f:
    """Perlin's noise ("Improving noise", 2002), lattice points one apart: (slope x, slope y, value within +-1)."""
    fx = wp.floor(x)
    fy = wp.floor(y)
    i = wp.uint32(wp.int64(fx))
    j = wp.uint32(wp.int64(fy))
    u = wp.float32(x - fx)
    v = wp.float32(y - fy)
    one = wp.float32(1.0)
    south = scramble(j + seed)
    north = scramble(j + wp.uint32(1) + seed)
    a = corner(south, i, u, v)
    b = corner(south, i + wp.uint32(1), u - one, v)
    c = corner(north, i, u, v - one)
    d = corner(north, i + wp.uint32(1), u - one, v - one)
    fu = u * u * u * (u * (u * 6.0 - 15.0) + 10.0)
    fv = v * v * v * (v * (v * 6.0 - 15.0) + 10.0)
    su = 30.0 * u * u * (u * (u - 2.0) + 1.0)
    sv = 30.0 * v * v * (v * (v - 2.0) + 1.0)
    low = a + (b - a) * fu
    high = c + (d - c) * fu
    mixed = low + (high - low) * fv
    along = su * ((b[2] - a[2]) * (one - fv) + (d[2] - c[2]) * fv)
    return wp.vec3f(mixed[0] + along, mixed[1] + sv * (high[2] - low[2]), mixed[2])


@wp.func
def lie_of(w: Window, h: wp.array(dtype=wp.float32), row: wp.int32, column: wp.int32) -> wp.vec2f:
    """Slope and bend (1 / m, convex above 0) of the ground over `reach`, by Horn's eight neighbours at that distance;
    beyond the window the ground is level."""
    west = wp.max(column - w.reach_x, 0)
    east = wp.min(column + w.reach_x, w.width - 1)
    south = wp.max(row - w.reach_y, 0) * w.width
    north = wp.min(row + w.reach_y, w.height - 1) * w.width
    here = row * w.width
    hw = h[here + west]
    he = h[here + east]
    hs = h[south + column]
    hn = h[north + column]
    sw = h[south + west]
    se = h[south + east]
    nw = h[north + west]
    ne = h[north + east]
    dx = wp.float32(w.step_x) * wp.float32(w.reach_x)
    dy = wp.float32(w.step_y) * wp.float32(w.reach_y)
    gx = (se - sw + 2.0 * (he - hw) + ne - nw) / (8.0 * dx)
    gy = (nw - sw + 2.0 * (hn - hs) + ne - se) / (8.0 * dy)
    z = h[here + column]
    bend = (z - hw + z - he) / (dx * dx) + (z - hs + z - hn) / (dy * dy)
    return wp.vec2f(wp.min(wp.sqrt(gx * gx + gy * gy), STEEPEST), bend)


@wp.func
def ledges(k: Look, x: wp.float64, y: wp.float64, z: wp.float32, slope: wp.float32) -> wp.float32:
    """Metres by which beds move the ground at (x, y, z): each keeps its foot and its head, and a hard one steepens in
    between. Beds are bent, of different hardness and their ledges end, so that they do not look like contour lines."""
    bent = gradient_noise(x / BED_BEND, y / BED_BEND, k.seed + BEND_SEED)
    t = (wp.float64(z) - x * k.dip[0] - y * k.dip[1]) / wp.float64(k.bed) + wp.float64(0.8 * bent[2])
    foot = wp.floor(t)
    f = wp.float32(t - foot)
    own = scramble(wp.uint32(wp.int64(foot)) + k.seed + BED_SEED)
    middle = 0.2 + 0.6 * wp.float32(own & wp.uint32(0xFFFF)) / 65535.0
    hard = wp.float32(own >> wp.uint32(16)) / 32767.5 - 1.0
    if hard <= 0.0:
        return wp.float32(0.0)
    below = f / middle
    above = (1.0 - f) / (1.0 - middle)
    stepped = wp.where(f < middle, middle * below * below * below, 1.0 - (1.0 - middle) * above * above * above)
    ends = gradient_noise(x / LEDGE_LENGTH, y / LEDGE_LENGTH, own + LENGTH_SEED)[2]
    hold = k.ledge * wp.min(2.0 * hard, 1.0) * wp.clamp(0.7 + 2.5 * ends, 0.0, 1.0)
    return (stepped - f) * k.bed * hold * wp.clamp(2.0 * slope - 0.3, 0.0, 1.0)


@wp.func
def octaves_at(
    k: Look, x: wp.float64, y: wp.float64, spacing: wp.float32, slope: wp.float32, bend: wp.float32
) -> wp.float32:
    """Metres of all octaves at (x, y): one whose wave is under two spacings is left out, under three it fades.

    Steep detail damps finer octaves (Quilez, "more noise", 2008); on convex ground they are folded into crests.
    """
    high = wp.float32(0.0)
    gx = wp.float32(0.0)
    gy = wp.float32(0.0)
    sharp = 3.0 * k.wave * bend
    crest = k.ridge * (0.5 + 0.5 * sharp / (1.0 + wp.abs(sharp)))
    wave = k.wave
    size = 0.5 * k.wave * (k.plain + (k.rough - k.plain) * slope)
    px = x / wp.float64(wave)
    py = y / wp.float64(wave)
    seed = k.seed
    for _octave in range(k.octaves):
        fade = wp.clamp(wave / spacing - 2.0, 0.0, 1.0)
        if fade > 0.0:
            n = gradient_noise(px, py, seed)
            # The slope of -|n|, but without its jump, which the damping would make one of the ground.
            folded = wp.clamp(-8.0 * n[2], -1.0, 1.0) * crest
            value = n[2] * (1.0 - crest) + crest * (0.35 - wp.abs(n[2]))
            high += fade * size * value / (1.0 + DAMP * (gx * gx + gy * gy))
            gx += size / wave * n[0] * (1.0 - crest + folded)
            gy += size / wave * n[1] * (1.0 - crest + folded)
            size *= k.gain
            wave *= 0.5
            # Turned by the angle of (3, 4, 5): no lattice shows.
            turned = wp.float64(1.6) * px - wp.float64(1.2) * py + wp.float64(0.37109375)
            py = wp.float64(1.2) * px + wp.float64(1.6) * py + wp.float64(0.71484375)
            px = turned
            seed += NEXT_SEED
    return high


@wp.kernel
def add_relief(
    offset: int,
    first: int,
    w: Window,
    k: Look,
    h: wp.array(dtype=wp.float32),
    out: wp.array(dtype=wp.float32),
):
    """Row `first + offset + tid`: metres that the relief adds to each sample."""
    row = first + offset + wp.tid()
    spacing = wp.float32(wp.max(w.step_x, w.step_y))
    y = wp.float64(w.row + row) * w.step_y
    for column in range(w.width):
        x = wp.float64(w.column + column) * w.step_x
        lie = lie_of(w, h, row, column)
        at = row * w.width + column
        added = octaves_at(k, x, y, spacing, lie[0], lie[1])
        if k.bed > 0.0:
            added += ledges(k, x, y, h[at], lie[0])
        out[at] = added
