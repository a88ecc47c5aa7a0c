# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise of the plane: value noise on the integers with a quintic fade, twice differentiable.

It uses only additions, multiplications and hashes of integers, so a position has the same bits on every machine. Seeds
of octaves are `seed + octave * 0x9E3779B9`.
"""

import warp as wp


@wp.func
def scramble(value: wp.uint32):
    """Return an integer hash of `value` (lowbias32 of Wellons, "Prospecting for hash functions", 2018)."""
    x = value
    x = (x ^ (x >> wp.uint32(16))) * wp.uint32(0x7FEB352D)
    x = (x ^ (x >> wp.uint32(15))) * wp.uint32(-0x7B935975)  # 0x846CA68B: literals are int32
    return x ^ (x >> wp.uint32(16))


@wp.func
def lattice_value(row: wp.uint32, i: wp.uint32):
    """Return the random value of lattice point i of a row, a multiple of 2^-31 in [-1, 1).

    row: hash of the row's number.
    """
    return wp.float64(wp.int32(scramble(row + i))) * wp.float64(4.656612873077393e-10)


@wp.func
def value_noise(x: wp.float64, y: wp.float64, seed: wp.uint32):
    """Return value noise at (x, y), lattice points one apart: (slope x, slope y, value), |value| <= 1.

    It uses Perlin's quintic fade ("Improving noise", 2002) between the hashed values of the four lattice points around.
    """
    fx = wp.floor(x)
    fy = wp.floor(y)
    i = wp.uint32(wp.int64(fx))
    j = wp.uint32(wp.int64(fy))
    u = x - fx
    v = y - fy
    one = wp.float64(1.0)
    south = scramble(j + seed)
    north = scramble(j + wp.uint32(1) + seed)
    south_west = lattice_value(south, i)
    south_rise = lattice_value(south, i + wp.uint32(1)) - south_west
    north_west = lattice_value(north, i)
    north_rise = lattice_value(north, i + wp.uint32(1)) - north_west
    # Quintic fade and its slope.
    fu = u * u * u * (u * (u * wp.float64(6.0) - wp.float64(15.0)) + wp.float64(10.0))
    fv = v * v * v * (v * (v * wp.float64(6.0) - wp.float64(15.0)) + wp.float64(10.0))
    su = wp.float64(30.0) * u * u * (u * (u - wp.float64(2.0)) + one)
    sv = wp.float64(30.0) * v * v * (v * (v - wp.float64(2.0)) + one)
    low = south_west + south_rise * fu
    rise = north_west + north_rise * fu - low
    return wp.vec3d(su * (south_rise + (north_rise - south_rise) * fv), sv * rise, low + rise * fv)
