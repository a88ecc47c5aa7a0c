# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernel of the built-in dunes: crests across the wind that branch and end, gentle to windward, slip faces to lee.

The position of crests is phasor noise (Tricard, Efremov, Zanni, Neyret, Martinez and Lefebvre, "Procedural phasor
noise", 2019): the phase of a sum of wave patches of one wavelength. Heights are functions of the position by arithmetic
alone: the same bits on every machine, and the same height at every resolution. Lengths, heights and other numbers are
chosen by their looks. `seed`: selects other noise.
"""

import warp as wp

from ..field.island import noise, smooth
from ..field.noise import scramble

# Unrolled loops over patches would take minutes to compile.
wp.set_module_options({"max_unroll": 0})

# tan 32 degrees, the angle of repose of sand.
REPOSE = wp.constant(wp.float64(0.625))
# Patches of waves a cell, and 1 / 2^16.
PATCHES = wp.constant(2)
PART = wp.constant(wp.float32(1.52587890625e-05))


@wp.func
def fast_sine(turn: wp.float32) -> wp.float32:
    """Return sin(2 pi turn) within 0.2 %, by parabolas."""
    t = turn - wp.floor(turn) - 0.5
    p = -16.0 * t * (0.5 - wp.abs(t))
    return p * (0.775 + 0.225 * wp.abs(p))


@wp.func
def fast_angle(c: wp.float32, s: wp.float32) -> wp.float32:
    """Return the angle of the vector (c, s) in turns, 0 .. 1, within 2e-4."""
    # The arc tangent of the smaller over the larger coordinate by a polynomial, then put into its octant.
    a = wp.abs(c)
    b = wp.abs(s)
    t = wp.min(a, b) / (wp.max(a, b) + 1e-20)
    q = t * t
    angle = t * (0.159 + q * (-0.0509 + q * 0.0169))
    angle = wp.where(b > a, 0.25 - angle, angle)
    angle = wp.where(c < 0.0, 0.5 - angle, angle)
    return wp.where(s < 0.0, 1.0 - angle, angle)


@wp.func
def crests(x: wp.float64, y: wp.float64, seed: wp.uint32) -> wp.vec2d:
    """Return phase (turns, 0 .. 1) and coherence (0 .. 1) of phasor noise at (x, y): waves of length 1 along x."""
    # Cells of 2 by 3 waves; a patch reaches one cell from its middle, so those of 3 by 3 cells are summed.
    u = x * wp.float64(0.5)
    v = y * wp.float64(0.33)
    i = wp.floor(u)
    j = wp.floor(v)
    fu = wp.float32(u - i)
    fv = wp.float32(v - j)
    c = wp.float32(0.0)  # the sum of waves is the vector (c, s): its angle is the phase
    s = wp.float32(0.0)
    sum = wp.float32(1e-9)
    for dj in range(-1, 2):
        row = scramble(wp.uint32(wp.int32(j)) + wp.uint32(dj) + seed)
        for di in range(-1, 2):
            h = scramble(row + wp.uint32(wp.int32(i)) + wp.uint32(di))
            # Times PART, 16 random bits are a number 0 .. 1: a patch's place in the cell, its tilt and its phase.
            for _patch in range(PATCHES):
                h = scramble(h + wp.uint32(1))
                px = fu - wp.float32(di) - wp.float32(h & wp.uint32(0xFFFF)) * PART
                py = fv - wp.float32(dj) - wp.float32(h >> wp.uint32(16)) * PART
                falloff = 1.0 - px * px - py * py
                if falloff > 0.0:
                    g = scramble(h)
                    tilt = wp.float32(g & wp.uint32(0xFFFF)) * PART - 0.5
                    # Two waves a cell along x, tilted a little, with a random phase.
                    phase = 2.0 * px + 1.5 * tilt * py + wp.float32(g >> wp.uint32(16)) * PART
                    weight = falloff * falloff
                    c += weight * fast_sine(phase + 0.25)
                    s += weight * fast_sine(phase)
                    sum += weight
    return wp.vec2d(wp.float64(fast_angle(c, s)), wp.float64(wp.sqrt(c * c + s * s) / sum))


@wp.func
def ridge_of_sand(phase: wp.float64, high: wp.float64, length: wp.float64) -> wp.vec2d:
    """Return (height, lee) of a dune `high` metres in waves of `length` metres; its lee is at the angle of repose.

    phase: position in the wave, 0 .. 1 downwind. lee: 1 behind the brink, else 0. high: below REPOSE * length.
    """
    one = wp.float64(1.0)
    brink = one - high / (REPOSE * length)
    if phase < brink:
        u = phase / brink
        smooth_step = u * u * (wp.float64(3.0) - wp.float64(2.0) * u)
        return wp.vec2d(high * (wp.float64(0.45) * u + wp.float64(0.55) * smooth_step), wp.float64(0.0))
    return wp.vec2d(high * (one - phase) / (one - brink), one)


@wp.func
def dunes_height(x: wp.float64, y: wp.float64, seed: wp.uint32) -> wp.float64:
    """Return the height of the dunes at (x, y), metres; the wind blows to the east."""
    one = wp.float64(1.0)
    # Index 2 of a noise is its value; indices 0 and 1 are its slopes.
    wide = noise(x / wp.float64(2900.0), y / wp.float64(2900.0), seed + wp.uint32(11))
    medium = noise(x / wp.float64(1100.0), y / wp.float64(700.0), seed + wp.uint32(12))
    curl = noise(x / wp.float64(420.0), y / wp.float64(300.0), seed + wp.uint32(13))
    ground = wp.float64(28.0) * wide[2] + wp.float64(6.0) * medium[2]

    length = wp.float64(430.0)
    # Horns, which point downwind, are sharper than the bays between them.
    horn = noise(x / wp.float64(1300.0), y / wp.float64(330.0), seed + wp.uint32(14))[2]
    bays = wp.float64(220.0) * wp.sqrt(horn * horn + wp.float64(0.004))
    wx = x + wp.float64(150.0) * medium[2] + wp.float64(30.0) * curl[2] + wp.float64(220.0) * wide[2] + bays
    large = crests(wx / length, y / length, seed)  # phase, and coherence of the waves
    supply = smooth(wp.float64(-0.55), wp.float64(0.35), wide[2] + wp.float64(0.35) * medium[2])
    coherent = smooth(wp.float64(0.05), wp.float64(0.55), large[1])
    height = wp.float64(62.0) * (wp.float64(0.25) + wp.float64(0.75) * supply) * coherent
    dune = ridge_of_sand(large[0], height, length)  # its height, and 1 in its lee

    # Small dunes are on the gentle side of large ones and in the pans between them.
    length = wp.float64(58.0)
    across = y + wp.float64(0.35) * x + wp.float64(9.0) * curl[0]
    along = x - wp.float64(0.35) * y + wp.float64(0.35) * dune[0] + wp.float64(22.0) * curl[2]
    small = crests(along / length, across / length, seed + wp.uint32(21))
    height_fraction = dune[0] / wp.float64(62.0)
    small_fraction = (one - dune[1]) * (one - wp.float64(0.8) * height_fraction)
    # None near the brink, which stays sharp.
    small_fraction = small_fraction * smooth(wp.float64(0.0), wp.float64(0.12), large[0])
    patchy = smooth(wp.float64(-0.3), wp.float64(0.3), curl[2] - wp.float64(0.5) * medium[2])
    small_height = wp.float64(3.6) * smooth(wp.float64(0.1), wp.float64(0.7), small[1]) * (wp.float64(0.15) + patchy)
    ripple = ridge_of_sand(small[0], small_height, length)
    return ground + dune[0] + small_fraction * ripple[0]


@wp.kernel
def raise_dunes(
    offset: int,
    size: int,
    first_row: int,
    half_side: wp.float64,
    seed: wp.uint32,
    samples: wp.array(dtype=wp.float32),
):
    """Write the heights of the dunes, metres, in row first_row + offset + tid to row offset + tid of `samples`.

    size: samples a side. half_side: half of the square's side, metres.
    """
    row = offset + wp.tid()
    cells = wp.float64(size - 1)
    y = half_side * wp.float64(2 * (first_row + row) - (size - 1)) / cells
    for i in range(size):
        x = half_side * wp.float64(2 * i - (size - 1)) / cells
        samples[row * size + i] = wp.float32(dunes_height(x, y, seed)) + wp.float32(0.0)  # not -0
