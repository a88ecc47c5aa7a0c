# SPDX-License-Identifier: GPL-3.0-or-later
"""A progressive blue-noise set on a torus: the points up to any rank are evenly spaced.

Mitchell's best candidate ("Spectrally optimal sampling for distribution ray tracing", 1991): each point is the one of
many random candidates that is farthest from all points so far. A map of squared distances, in whole pixels, gives this
distance in one read, which allows thousands of candidates. (Always the farthest position would give a lattice.)
"""

import warp as wp

from ..field.noise import scramble

BITS = wp.constant(10)  # a side of the map has 2^10 pixels
FINE_BITS = wp.constant(6)  # further bits of a point's position
CANDIDATES, MAX_CANDIDATES = wp.constant(8), wp.constant(2000)  # candidates for each point so far, and their limit


@wp.kernel
def best_candidates(count: wp.int32, near: wp.array(dtype=wp.int32), points: wp.array(dtype=wp.vec2i)):
    """Fill `points` with `count` positions in 2^-16 of the side: each the farthest of many random candidates.

    near [2^(2 BITS)]: scratch, squared distance of each pixel of the map to the nearest point, in pixels; at first
    more than any. One thread; the result is always the same.
    """
    side = wp.int32(1) << BITS
    p = wp.vec2i(0, 0)  # pixel of point k
    draw = wp.uint32(0)  # candidates so far
    for k in range(count):
        # Random bits put the point anywhere in its pixel.
        fine = wp.int32(scramble(wp.uint32(k) + wp.uint32(0x40000000)))
        fine_mask = (wp.int32(1) << FINE_BITS) - 1
        points[k] = wp.vec2i((p[0] << FINE_BITS) + (fine & fine_mask), (p[1] << FINE_BITS) + ((fine >> 8) & fine_mask))
        # No pixel is farther from all points than 1.5 of their mean distance; farther pixels keep their nearest point.
        radius = wp.min(wp.int32(1.5 * wp.float32(side) / wp.sqrt(wp.float32(k + 1))) + 2, side / 2)
        for dy in range(-radius, radius + 1):
            row = ((p[1] + dy) & (side - 1)) << BITS
            for dx in range(-radius, radius + 1):
                i = row + ((p[0] + dx) & (side - 1))
                near[i] = wp.min(near[i], dx * dx + dy * dy)
        best = wp.int32(-1)
        best_pixel = wp.int32(0)
        for _ in range(wp.min(CANDIDATES * (k + 1), MAX_CANDIDATES)):
            i = wp.int32(scramble(draw) >> wp.uint32(32 - 2 * BITS))
            draw += wp.uint32(1)
            if near[i] > best:
                best = near[i]
                best_pixel = i
        p = wp.vec2i(best_pixel & (side - 1), best_pixel >> BITS)
