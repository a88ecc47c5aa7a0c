# SPDX-License-Identifier: GPL-3.0-or-later
"""Relief finer than the data: octaves of noise controlled by the slope and curvature of the ground, and beds of rock.

It is a function of the position and the ground around it, by + - * /, square roots and integer hashes: the same bits on
every machine. Positions are float64 and offsets from a lattice point float32, so that noise is as exact far from the
raster's first sample as near it.

`noise`: the longest `wave`, metres; the amplitude over half of it where the slope is 1 (`rough`) and on level ground
(`plain`), which each octave multiplies by `gain`; `ridge`, 0 round to 1 sharp on convex ground; thickness of beds
(`bed`), how far hard ones stand out (`ledge`), and their slopes to the east and north (`dip`).
"""

import warp as wp

from ..field.noise import scramble

# 2^32 over the golden ratio; it gives each octave another seed.
NEXT_SEED = wp.constant(wp.uint32(-0x61C88647))
FOLD_SEED, BED_SEED, LENGTH_SEED = wp.constant(wp.uint32(101)), wp.constant(wp.uint32(102)), wp.constant(wp.uint32(103))
# Slopes above this count as this.
STEEPEST = wp.constant(wp.float32(1.5))
# Damping: finer octaves are divided by 1 + DAMP * slope^2 of the coarser ones.
DAMP = wp.constant(wp.float32(6.0))
# Lengths in metres of the folds of beds and of ledges.
FOLD_LENGTH, LEDGE_LENGTH = wp.constant(wp.float64(900.0)), wp.constant(wp.float64(700.0))


@wp.struct
class ReliefNoise:
    """Parameters of the noise; an octave has half the wavelength and `gain` times the amplitude of the one before."""

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
    """Samples in rows, a part of a level."""

    width: wp.int32
    height: wp.int32
    row: wp.int32  # of the first sample in the whole level
    column: wp.int32
    step_x: wp.float64  # metres between samples
    step_y: wp.float64
    reach_x: wp.int32  # samples over which slope and curvature are measured
    reach_y: wp.int32


@wp.func
def gradient_at(row: wp.uint32, i: wp.uint32, u: wp.float32, v: wp.float32) -> wp.vec3f:
    """Return the random gradient (x, y) at lattice point i of a row, and the height of its plane at the offset (u, v).

    row: hash of the row's number.
    """
    h = scramble(row + i)  # two numbers of 16 bits; times 2^-15 minus 1 they are -1 .. 1
    gx = wp.float32(h & wp.uint32(0xFFFF)) * wp.float32(3.0517578125e-05) - wp.float32(1.0)
    gy = wp.float32(h >> wp.uint32(16)) * wp.float32(3.0517578125e-05) - wp.float32(1.0)
    return wp.vec3f(gx, gy, gx * u + gy * v)


@wp.func
def gradient_noise(x: wp.float64, y: wp.float64, seed: wp.uint32) -> wp.vec3f:
    """Return Perlin's noise ("Improving noise", 2002) of lattice spacing 1: (slope x, slope y, value within +-1)."""
    fx = wp.floor(x)
    fy = wp.floor(y)
    i = wp.uint32(wp.int64(fx))
    j = wp.uint32(wp.int64(fy))
    u = wp.float32(x - fx)
    v = wp.float32(y - fy)
    one = wp.float32(1.0)
    south = scramble(j + seed)
    north = scramble(j + wp.uint32(1) + seed)
    a = gradient_at(south, i, u, v)
    b = gradient_at(south, i + wp.uint32(1), u - one, v)
    c = gradient_at(north, i, u, v - one)
    d = gradient_at(north, i + wp.uint32(1), u - one, v - one)
    fu = u * u * u * (u * (u * 6.0 - 15.0) + 10.0)
    fv = v * v * v * (v * (v * 6.0 - 15.0) + 10.0)
    su = 30.0 * u * u * (u * (u - 2.0) + 1.0)
    sv = 30.0 * v * v * (v * (v - 2.0) + 1.0)
    # Interpolate gradients and values; the slope is the gradient plus the value's change with the weights fu and fv.
    low = a + (b - a) * fu
    high = c + (d - c) * fu
    mixed = low + (high - low) * fv
    fade_slope_x = su * ((b[2] - a[2]) * (one - fv) + (d[2] - c[2]) * fv)
    return wp.vec3f(mixed[0] + fade_slope_x, mixed[1] + sv * (high[2] - low[2]), mixed[2])


@wp.func
def slope_and_curvature(w: Window, h: wp.array(dtype=wp.float32), row: wp.int32, column: wp.int32) -> wp.vec2f:
    """Return slope (metres a metre) and curvature (1/m, above 0 where convex) of the ground at sample (row, column).

    h: heights of window w, metres. The slope is Horn's (1981) with the eight neighbours `reach` samples away, at most
    STEEPEST; the curvature is minus the Laplacian. Boundary: the last samples continue beyond the window.
    """
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
    curvature = (z - hw + z - he) / (dx * dx) + (z - hs + z - hn) / (dy * dy)
    return wp.vec2f(wp.min(wp.sqrt(gx * gx + gy * gy), STEEPEST), curvature)


@wp.func
def ledges(noise: ReliefNoise, x: wp.float64, y: wp.float64, z: wp.float32, slope: wp.float32) -> wp.float32:
    """Return the metres by which beds of rock raise or lower the ground at (x, y, z), metres.

    noise: its parameters. slope: the ground's, metres a metre. Foot and head of a bed stay in place, and a hard bed is
    steeper in between. Beds are folded and differ in hardness, and ledges end, so that they do not look like contour
    lines.
    """
    fold = gradient_noise(x / FOLD_LENGTH, y / FOLD_LENGTH, noise.seed + FOLD_SEED)
    t = (wp.float64(z) - x * noise.dip[0] - y * noise.dip[1]) / wp.float64(noise.bed) + wp.float64(0.8 * fold[2])
    foot = wp.floor(t)  # number of the bed
    f = wp.float32(t - foot)  # how far up in it, 0 .. 1
    bed_hash = scramble(wp.uint32(wp.int64(foot)) + noise.seed + BED_SEED)
    # The hard bed's cliff is at the fraction `middle` of its height.
    middle = 0.2 + 0.6 * wp.float32(bed_hash & wp.uint32(0xFFFF)) / 65535.0
    hard = wp.float32(bed_hash >> wp.uint32(16)) / 32767.5 - 1.0
    if hard <= 0.0:
        return wp.float32(0.0)
    below = f / middle
    above = (1.0 - f) / (1.0 - middle)
    stepped = wp.where(f < middle, middle * below * below * below, 1.0 - (1.0 - middle) * above * above * above)
    extent = gradient_noise(x / LEDGE_LENGTH, y / LEDGE_LENGTH, bed_hash + LENGTH_SEED)[2]
    strength = noise.ledge * wp.min(2.0 * hard, 1.0) * wp.clamp(0.7 + 2.5 * extent, 0.0, 1.0)
    return (stepped - f) * noise.bed * strength * wp.clamp(2.0 * slope - 0.3, 0.0, 1.0)


@wp.func
def sum_octaves(
    noise: ReliefNoise, x: wp.float64, y: wp.float64, spacing: wp.float32, slope: wp.float32, curvature: wp.float32
) -> wp.float32:
    """Return the sum of all octaves of noise at (x, y) metres, in metres.

    noise: its parameters. spacing: metres between samples; waves fade out from three spacings to two. slope,
    curvature: of the ground (metres a metre, 1/m). Steep detail damps finer octaves (Quilez, "more noise", 2008); on
    convex ground they are folded into crests.
    """
    total = wp.float32(0.0)
    gx = wp.float32(0.0)
    gy = wp.float32(0.0)
    convexity = 3.0 * noise.wave * curvature
    crest = noise.ridge * (0.5 + 0.5 * convexity / (1.0 + wp.abs(convexity)))  # rises with convexity
    wave = noise.wave
    amplitude = 0.5 * noise.wave * (noise.plain + (noise.rough - noise.plain) * slope)
    px = x / wp.float64(wave)
    py = y / wp.float64(wave)
    seed = noise.seed
    for _octave in range(noise.octaves):
        fade = wp.clamp(wave / spacing - 2.0, 0.0, 1.0)
        if fade > 0.0:
            n = gradient_noise(px, py, seed)
            # The slope of -|n| without its jump, which damping would transfer to the ground.
            folded = wp.clamp(-8.0 * n[2], -1.0, 1.0) * crest
            value = n[2] * (1.0 - crest) + crest * (0.35 - wp.abs(n[2]))  # round and sharp forms, mixed
            total += fade * amplitude * value / (1.0 + DAMP * (gx * gx + gy * gy))
            gx += amplitude / wave * n[0] * (1.0 - crest + folded)
            gy += amplitude / wave * n[1] * (1.0 - crest + folded)
            amplitude *= noise.gain
            wave *= 0.5
            # Twice a rotation by the angle of the triangle (3, 4, 5), which hides the lattice, and a shift.
            turned = wp.float64(1.6) * px - wp.float64(1.2) * py + wp.float64(0.37109375)
            py = wp.float64(1.2) * px + wp.float64(1.6) * py + wp.float64(0.71484375)
            px = turned
            seed += NEXT_SEED
    return total


@wp.kernel
def add_relief(
    offset: int,
    first: int,
    w: Window,
    noise: ReliefNoise,
    h: wp.array(dtype=wp.float32),
    out: wp.array(dtype=wp.float32),
):
    """Write to `out` the metres that relief adds to the heights `h` of window w, in row first + offset + tid.

    noise: its parameters.
    """
    row = first + offset + wp.tid()
    spacing = wp.float32(wp.max(w.step_x, w.step_y))
    y = wp.float64(w.row + row) * w.step_y
    for column in range(w.width):
        x = wp.float64(w.column + column) * w.step_x
        form = slope_and_curvature(w, h, row, column)
        entry = row * w.width + column
        added = sum_octaves(noise, x, y, spacing, form[0], form[1])
        if noise.bed > 0.0:
            added += ledges(noise, x, y, h[entry], form[0])
        out[entry] = added
