# SPDX-License-Identifier: GPL-3.0-or-later
"""A detail below the raster's cells, evaluated in numpy from nothing but its description."""

import numpy as np
import own_surface
from adaptive_terrain.cbt_terrain.field.displacement_layers import DisplacementLayers
from adaptive_terrain.cbt_terrain.field.tiled import Tiled


def scrambled(x):
    """Hash uint32 integers: sums and products are modulo 2^32."""
    x = (x ^ (x >> np.uint32(16))) * np.uint32(0x7FEB352D)
    x = (x ^ (x >> np.uint32(15))) * np.uint32(0x846CA68B)
    return x ^ (x >> np.uint32(16))


def lattice_values(i, row):
    """Return values in [-1, 1) of lattice points from their columns and the hashes of their rows."""
    return scrambled(row + i).view(np.int32) / 2.0**31


def value_noise(x, y, seed):
    """Quintic value noise at float64 arrays."""
    left, below = np.floor(x), np.floor(y)
    u, v = (t * t * t * (10 + t * (6 * t - 15)) for t in (x - left, y - below))
    i, j = (whole.astype(np.int64).astype(np.uint32) for whole in (left, below + float(seed)))
    one = np.uint32(1)
    south, north = (
        lattice_values(i, row) * (1 - u) + lattice_values(i + one, row) * u
        for row in (scrambled(j), scrambled(j + one))
    )
    return south * (1 - v) + north * v


def detail_heights(detail, count, plane):
    """Return the metres of `count` octaves at points [n, 2]."""
    z, p = np.zeros(len(plane)), np.array(plane, np.float64) / detail.wavelength
    longest = detail.amplitude / sum(detail.roughness**k for k in range(count))
    for k in range(count):
        x, y = (p + (k + 1) * np.array([0.37109375, 0.71484375])).T
        z += longest * detail.roughness**k * value_noise(x, y, detail.seed + k * 0x9E3779B9)
        p = 2 * np.stack([0.8 * p[:, 0] - 0.6 * p[:, 1], 0.6 * p[:, 0] + 0.8 * p[:, 1]], 1)
    return z


def image_heights(tiled, plane):
    """Return the metres of a repeated image at points [n, 2]; each pixel is a cubic B-spline."""
    net = 2.0 * tiled.image.values.astype(np.float64) - 1.0
    rows, columns = net.shape
    (i, across), (j, up) = (_bumps(plane[:, axis] * columns / tiled.size) for axis in (0, 1))
    heights = net[j[:, :, None] % rows, i[:, None, :] % columns]
    return tiled.amplitude * np.einsum("nji,ni,nj->n", heights, across, up)


def _bumps(place):
    """Return the numbers [n, 4] of the pixels around points, and the weights of their B-splines."""
    numbers = np.floor(place).astype(np.int64)[:, None] + np.arange(-1, 3)
    off = np.abs(place[:, None] - numbers)
    return numbers, np.where(off < 1, (4 - 6 * off**2 + 3 * off**3) / 6, np.maximum(2 - off, 0) ** 3 / 6)


def bilinear(lattice, values: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """Interpolate values of a raster's samples at points [n, 2]."""
    s = np.clip(plane[:, 0] / lattice.step_x + (lattice.width - 1) / 2, 0, lattice.width - 1)
    t = np.clip(plane[:, 1] / lattice.step_y + (lattice.height - 1) / 2, 0, lattice.height - 1)
    return own_surface.bilinear(values, s, t)


def mask_values(mask, lattice, plane):
    """Return the value of a mask at points [n, 2]."""
    return bilinear(lattice, mask.values / 255.0, plane)


def ground_heights(field, plane):
    """Return the metres that all layers add to a field's surface at points [n, 2]."""
    ground = field.detail
    if isinstance(ground, DisplacementLayers):
        whole = np.zeros(len(plane))
        for coat in ground.layers:
            own = one_height(coat.detail, field.finest_edge, plane)
            whole += own if coat.mask is None else own * mask_values(coat.mask, field.lattice, plane)
        return whole
    return one_height(ground, field.finest_edge, plane)


def one_height(detail, finest, plane):
    if isinstance(detail, Tiled):
        return image_heights(detail, plane)
    return detail_heights(detail, len(detail.parts(finest)), plane)
