# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement of points that rise to their places. Normals are those of the surface."""

import warp as wp

from ..field.domain import Domain
from ..mesh.displace import AHEAD, HIGHEST, Points, fetch_samples, put_vertex, runs_of, take_run
from ..refine.pixels import Asked
from ..unchecked import pair_at
from .residual import NOWHERE, REMEMBERED, Memory, Ramp, residual_at, surface_of

wp.set_module_options({"enable_backward": False})


@wp.func
def put_height(points: Points, o: wp.int32, domain: Domain, height: wp.float64):
    """The height of vertex `o`, of which all else is there: as `put_vertex` in kernels/mesh/displace.py."""
    z = height * domain.height_scale + domain.height_offset
    if not (wp.abs(z) < HIGHEST):
        points.not_finite[0] = 1
    points.positions[o][2] = wp.float32(z)


@wp.kernel
def displace_rising(
    first: wp.int32,
    end: wp.int32,
    point_base: wp.int64,
    vertex_base: wp.int32,
    slot: wp.int32,
    domain: Domain,
    points: Points,
    asked: Asked,
    ramp: Ramp,
    memory: Memory,
):
    """As `displace` in kernels/mesh/displace.py; of points that were in the last frame the heights are new."""
    for entry in range(REMEMBERED):
        memory.points[memory.slot * REMEMBERED + entry] = wp.vec2i(NOWHERE, NOWHERE)
    last = point_base + wp.int64(end - 1)
    run, run_end = runs_of(points, slot)
    v = first
    while v < end:
        begin, stop = take_run(points, run, run_end, v, end, point_base, vertex_base)
        run += wp.int64(1)
        for u in range(v, stop):
            k = point_base + wp.int64(u)
            fetch_samples(domain, pair_at(points.point, wp.min(k + wp.int64(AHEAD), last)))
            p = pair_at(points.point, k)
            residual = residual_at(domain, asked, ramp, memory, p)
            g = surface_of(domain, ramp.coats, p)
            if u < begin:
                put_vertex(points, vertex_base + u, domain, p, wp.vec3d(g[0] - residual, g[1], g[2]))
            else:
                put_height(points, vertex_base + u, domain, g[0] - residual)
        v = stop
