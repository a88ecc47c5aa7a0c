# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels for test_hiding.py: which boxes are hidden, and how far they are covered."""

import warp as wp

from .hiding import Rings, covered, is_hidden


@wp.kernel
def hidden_of_boxes(
    rings: Rings, slopes: wp.array(dtype=wp.float32), boxes: wp.array(dtype=wp.vec3d), found: wp.array(dtype=wp.int32)
):
    """Write whether boxes are hidden. boxes: lowest and highest corner in turns, metres from the eye."""
    for k in range(found.shape[0]):
        found[k] = wp.int32(is_hidden(rings, slopes, boxes[2 * k], boxes[2 * k + 1]))


@wp.kernel
def covers_of_boxes(
    rings: Rings,
    ramp: wp.float64,
    slopes: wp.array(dtype=wp.float32),
    boxes: wp.array(dtype=wp.vec3d),
    found: wp.array(dtype=wp.float64),
):
    """Write how far boxes are hidden, 0 .. 1. boxes: lowest and highest corner in turns, metres from the eye."""
    for k in range(found.shape[0]):
        found[k] = covered(rings, ramp, slopes, boxes[2 * k], boxes[2 * k + 1])
