# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles on a picture: which one is nearest at each pixel."""

import warp as wp

BAND = wp.constant(32)  # rows of pixels that one thread draws


@wp.kernel
def draw_triangles(
    first: wp.int32,
    corners: wp.array(dtype=wp.int32),
    projected: wp.array(dtype=wp.vec3d),
    width: wp.int32,
    height: wp.int32,
    depth_key: wp.array(dtype=wp.float64),
    shown: wp.array(dtype=wp.int32),
):
    """Write to `shown` the number of the nearest triangle at the middle of each pixel in a band of BAND rows.

    The thread draws band `first + tid`. Pixels without a triangle stay as they are. Triangles count from both sides; of
    equally near ones the first is shown. corners: three entries of `projected` for each triangle. projected: pixels
    from the left and from below, and a depth key, which is linear over the picture and larger for nearer points.
    depth_key [height * width]: that of the triangle shown so far, -inf at first.
    """
    bottom = (first + wp.tid()) * BAND
    top = wp.min(bottom + BAND, height) - 1
    half = wp.float64(0.5)
    for t in range(corners.shape[0] // 3):
        a = projected[corners[3 * t]]
        b = projected[corners[3 * t + 1]]
        c = projected[corners[3 * t + 2]]
        first_row = wp.max(wp.int32(wp.ceil(wp.min(a[1], wp.min(b[1], c[1])) - half)), bottom)
        last_row = wp.min(wp.int32(wp.floor(wp.max(a[1], wp.max(b[1], c[1])) - half)), top)
        first_column = wp.max(wp.int32(wp.ceil(wp.min(a[0], wp.min(b[0], c[0])) - half)), 0)
        last_column = wp.min(wp.int32(wp.floor(wp.max(a[0], wp.max(b[0], c[0])) - half)), width - 1)
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == wp.float64(0.0):
            last_row = first_row - 1  # seen from its edge
        for y in range(first_row, last_row + 1):
            for x in range(first_column, last_column + 1):
                px = wp.float64(x) + half
                py = wp.float64(y) + half
                # Weights of the corners a, b and c at the pixel's middle; one is negative outside the triangle.
                u = ((c[0] - b[0]) * (py - b[1]) - (c[1] - b[1]) * (px - b[0])) / area
                v = ((a[0] - c[0]) * (py - c[1]) - (a[1] - c[1]) * (px - c[0])) / area
                w = wp.float64(1.0) - u - v
                key = u * a[2] + v * b[2] + w * c[2]
                # The pixel is in the triangle, which is nearer here than the one shown.
                if wp.min(u, wp.min(v, w)) >= wp.float64(0.0) and key > depth_key[y * width + x]:
                    depth_key[y * width + x] = key
                    shown[y * width + x] = t
