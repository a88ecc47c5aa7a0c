# SPDX-License-Identifier: GPL-3.0-or-later
"""A detail below the raster's cells, evaluated in numpy from nothing but its description."""

import numpy as np

MASK = np.uint64(0xFFFFFFFF)


def scrambled(x):
    """The integer hash, of whole numbers modulo 2^32."""
    x = np.asarray(x % 2**32, np.uint64)
    x = ((x ^ (x >> np.uint64(16))) * np.uint64(0x7FEB352D)) & MASK
    x = ((x ^ (x >> np.uint64(15))) * np.uint64(0x846CA68B)) & MASK
    return (x ^ (x >> np.uint64(16))).astype(np.int64)


def lattice_values(i, j, seed):
    """Values in [-1, 1) of lattice points."""
    h = scrambled(scrambled(j + seed) + i)
    return np.where(h >= 2**31, h - 2**32, h) / 2.0**31


def value_noise(x, y, seed):
    """Quintic value noise at float64 arrays."""
    i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    u, v = (t**3 * (10 + t * (6 * t - 15)) for t in (x - i, y - j))
    south = lattice_values(i, j, seed) * (1 - u) + lattice_values(i + 1, j, seed) * u
    north = lattice_values(i, j + 1, seed) * (1 - u) + lattice_values(i + 1, j + 1, seed) * u
    return south * (1 - v) + north * v


def detail_heights(detail, count, plane):
    """Metres at points [n, 2] of `count` octaves."""
    z, p = np.zeros(len(plane)), np.array(plane, np.float64) / detail.wavelength
    longest = detail.amplitude / sum(detail.roughness**k for k in range(count))
    for k in range(count):
        x, y = (p + (k + 1) * np.array([0.37109375, 0.71484375])).T
        z += longest * detail.roughness**k * value_noise(x, y, detail.seed + k * 0x9E3779B9)
        p = 2 * np.stack([0.8 * p[:, 0] - 0.6 * p[:, 1], 0.6 * p[:, 0] + 0.8 * p[:, 1]], 1)
    return z
