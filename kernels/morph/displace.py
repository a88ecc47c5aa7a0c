# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement of points that rise to their places, with normals that turn to those of the surface."""

import warp as wp

from ..field.domain import Domain
from ..mesh.displace import AHEAD, HIGHEST, Points, fetch_samples, find_run, put_vertex, runs_of, take_run
from ..unchecked import item_at, put
from .residual import Memory, Rising, forget_all, has_settled, risen, settled_from


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
    rising: Rising,
    memory: Memory,
):
    """As `displace` in kernels/mesh/displace.py. Points of the last frame get new heights and normals, but for those
    that were in their places and are."""
    forget_all(memory)
    last = point_base + wp.int64(end - 1)
    run, run_end = runs_of(points, slot)
    v = first
    while v < end:
        begin, stop, at = find_run(points, run, run_end, v, end, point_base)
        take_run(points, at, begin, stop, vertex_base)
        settled = wp.float64(wp.inf)
        if stop > begin:
            settled = settled_from(rising, points.taken.runs[run].coarse)
        run += wp.int64(1)
        for u in range(v, stop):
            k = point_base + wp.int64(u)
            p = item_at(points.point, k)
            last_vertex = wp.int64(-1)
            rises = wp.bool(True)
            if u >= begin:
                last_vertex = at + wp.int64(u - begin)
                rises = not has_settled(rising, memory, p, vertex_base + u, last_vertex, settled)
            else:
                fetch_samples(domain, item_at(points.point, wp.min(k + wp.int64(AHEAD), last)))
            if rises:
                there, surface = risen(domain, rising, memory, p, vertex_base + u, last_vertex)
                if u < begin:
                    put_vertex(points, vertex_base + u, domain, p, wp.vec3d(there.z, surface[1], surface[2]))
                else:
                    put_height(points, vertex_base + u, domain, there.z)
                put(points.normals, vertex_base + u, there.normal)
        v = stop
