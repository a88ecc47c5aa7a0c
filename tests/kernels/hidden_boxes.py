# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels for test_hiding.py: which boxes are hidden, have nothing hidden in them, are covered how far."""

import warp as wp

from .hiding import Rings, covered, is_bare, is_hidden


@wp.kernel
def veils_of_boxes(
    rings: Rings, slopes: wp.array(dtype=wp.float32), boxes: wp.array(dtype=wp.vec3d), found: wp.array(dtype=wp.vec2i)
):
    """boxes: lowest and highest corner in turns, metres from the eye. found: hidden, bare."""
    for k in range(found.shape[0]):
        low = boxes[2 * k]
        high = boxes[2 * k + 1]
        hidden = wp.int32(is_hidden(rings, slopes, low, high))
        bare = wp.int32(is_bare(rings, slopes, low, high))
        found[k] = wp.vec2i(hidden, bare)


@wp.kernel
def covers_of_boxes(
    rings: Rings,
    ramp: wp.float64,
    slopes: wp.array(dtype=wp.float32),
    boxes: wp.array(dtype=wp.vec3d),
    found: wp.array(dtype=wp.float64),
):
    """boxes: as above."""
    for k in range(found.shape[0]):
        found[k] = covered(rings, ramp, slopes, boxes[2 * k], boxes[2 * k + 1])
