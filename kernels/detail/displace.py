# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement of points of a mesh to the surface with detail, which is the sum of all displacement layers.

Of the domain: a root square has 2^levels cells and 2^unit_bits lattice units a side; the raster ends at the units
`east` and `north`, beyond which the lattice has only padding.
"""

import warp as wp

from ..field.detail import PackedLayers, detail_at
from ..field.domain import Domain
from ..mesh.displace import AHEAD, DisplacedPoints, copy_run, fetch_samples, find_run, put_vertex, runs_of, surface_at
from ..unchecked import item_at


@wp.func
def with_detail(domain: Domain, layers: PackedLayers, p: wp.vec2i, g: wp.vec3d) -> wp.vec3d:
    """Return height and gradient `g` of the surface at lattice point p with those of the displacement layers added.

    g: metres before scaling, and metres a cell. Beyond the raster's border displacement continues level.
    """
    units_a_cell = wp.float64(wp.int32(1) << (domain.unit_bits - domain.levels))
    slope_factor_x = wp.where(p[0] > domain.east, wp.float64(0.0), wp.float64(1.0))  # padding has no slope
    slope_factor_y = wp.where(p[1] > domain.north, wp.float64(0.0), wp.float64(1.0))
    x = domain.west + wp.float64(wp.min(p[0], domain.east)) * domain.unit_x
    y = domain.south + wp.float64(wp.min(p[1], domain.north)) * domain.unit_y
    d = detail_at(layers, x, y)
    return g + wp.vec3d(
        d[0], d[1] * slope_factor_x * domain.unit_x * units_a_cell, d[2] * slope_factor_y * domain.unit_y * units_a_cell
    )


@wp.kernel
def displace_detail(
    first: wp.int32,
    end: wp.int32,
    point_base: wp.int64,
    vertex_base: wp.int32,
    slot: wp.int32,
    domain: Domain,
    points: DisplacedPoints,
    layers: PackedLayers,
):
    """Write positions, normals and UV of points first .. end - 1, on the surface with all displacement layers.

    Like `displace` (kernels/mesh/displace.py), it copies runs of points that the last mesh had. Points are counted in
    the slice: point 0 is entry `point_base` of `points.point`, lattice units, and vertex `vertex_base` of the mesh.
    slot: number of the thread's list of runs. Samples of the point AHEAD entries further on are fetched into the cache.
    """
    last = point_base + wp.int64(end - 1)
    run, run_end = runs_of(points, slot)
    v = first
    while v < end:
        # Points v .. begin - 1 are new; those from there to stop - 1 are copied from vertex `last_first` on.
        begin, stop, last_first = find_run(points, run, run_end, v, end, point_base)
        copy_run(points, last_first, begin, stop, vertex_base)
        run += wp.int64(1)
        for u in range(v, begin):
            k = point_base + wp.int64(u)
            fetch_samples(domain, item_at(points.point, wp.min(k + wp.int64(AHEAD), last)))
            p = item_at(points.point, k)
            put_vertex(points, vertex_base + u, domain, p, with_detail(domain, layers, p, surface_at(domain, p)))
        v = stop
