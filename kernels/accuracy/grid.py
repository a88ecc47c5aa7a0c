# SPDX-License-Identifier: GPL-3.0-or-later
"""The difference of a mesh and a bicubic reference, or one with detail, inside triangles.

No closed form gives its maximum, so it is evaluated on a grid of points. `ground` is the reference surface; the box of
a triangle f (west, south, east, north) is in lattice units.
"""

import warp as wp

from .edges import difference_at
from .facets import DeliveredMesh, Reference, covers, facet_of, shift_of

PLACES_BITS = wp.constant(wp.int64(2))  # 4 x 4 places a cell, or in the box of a smaller triangle


@wp.kernel
def grid_extremes(
    first: wp.int32, end: wp.int32, ground: Reference, mesh: DeliveredMesh, worst: wp.array(dtype=wp.float64)
):
    """Raise worst[t] of triangles first .. end - 1 to the largest |mesh - reference|, metres, on a grid of points.

    A cell, or the box of a smaller triangle, has about 2^PLACES_BITS points along each side. They are computed in
    lattice units, 2^ground.bits a cell; `covers` gives a point on a shared edge to one triangle.
    """
    one = wp.int64(1)
    bits = wp.int64(ground.bits)
    end_x = wp.int64(ground.samples.columns - 1) << bits
    end_y = wp.int64(ground.samples.rows - 1) << bits
    per_unit = wp.float64(1.0) / wp.float64(one << bits)
    for t in range(first, end):
        f = facet_of(ground, mesh, t)
        if f.area2 > wp.int64(0):
            largest = worst[t]
            extent = wp.max(f.east - f.west, f.north - f.south)
            side_bits = bits
            while (one << side_bits) > extent:
                side_bits -= one
            spacing = one << wp.max(side_bits - PLACES_BITS, wp.int64(0))
            y = (f.south + spacing - one) / spacing * spacing
            while y <= f.north:
                x = (f.west + spacing - one) / spacing * spacing
                while x <= f.east:
                    # one: x and y are in lattice units, too
                    if covers(f, one, x, y, shift_of(x, end_x), shift_of(y, end_y)):
                        u = wp.float64(x) * per_unit
                        v = wp.float64(y) * per_unit
                        largest = wp.max(largest, wp.abs(difference_at(ground, f, u, v)))
                    x += spacing
                y += spacing
            worst[t] = largest
