# SPDX-License-Identifier: GPL-3.0-or-later
"""A height below the raster's cells: octaves of noise, as the displacement adds them to the surface.

Places are metres from the terrain's middle in float64, so what is far away is as exact as what is near.
kernels/accuracy/detail.py evaluates the same surface with other arithmetic.
"""

import warp as wp

from .noise import value_noise

wp.set_module_options({"enable_backward": False})

# Octaves have hashes of their own, lie at other places and are turned by the angle of (3, 4, 5): no lattice shows.
SHIFT_X = wp.constant(wp.float64(0.37109375))
SHIFT_Y = wp.constant(wp.float64(0.71484375))


@wp.struct
class Detail:
    """Octave k has the amplitude `amplitude * gain^k` and `frequency * 2^k` lattice points a metre."""

    octaves: wp.int32  # 0: there is no detail
    seed: wp.uint32
    amplitude: wp.float64  # metres
    gain: wp.float64
    frequency: wp.float64  # 1 / metre


@wp.func
def detail_at(d: Detail, x: wp.float64, y: wp.float64):
    """Metres of height at (x, y) metres, and its slopes: (height, metres a metre along x, along y)."""
    found = wp.vec3d()
    a = d.amplitude
    c = d.frequency
    s = wp.float64(0.0)
    for k in range(d.octaves):
        shift = wp.float64(k + 1)
        n = value_noise(c * x - s * y + shift * SHIFT_X, s * x + c * y + shift * SHIFT_Y, d.seed)
        d.seed = d.seed + wp.uint32(-0x61C88647)
        found += a * wp.vec3d(n[2], n[0] * c + n[1] * s, n[1] * c - n[0] * s)
        turned = wp.float64(1.6) * c - wp.float64(1.2) * s
        s = wp.float64(1.6) * s + wp.float64(1.2) * c
        c = turned
        a = a * d.gain
    return found
