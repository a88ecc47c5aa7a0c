# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement of geomorphing points, with normals that turn to those of the surface.

A point has settled once it is on the surface, with the surface's normal. Its record, which the next frame reads, holds
the surface there and the error of its diamond. A run is a sequence of points that this frame and the last one share.
"""

import warp as wp

from ..field.domain import INLINED, Domain
from ..mesh.displace import (
    AHEAD,
    HIGHEST,
    DisplacedPoints,
    copy_run,
    fetch_samples,
    find_run,
    next_new,
    put_vertex,
    runs_of,
)
from ..refine.diamond import fetch_range
from ..refine.runs import NOT_CLEAR
from ..refine.stored_errors import fetch_ahead
from ..unchecked import item_at, put
from .lattice import depth_of
from .residual import forget_all, has_settled, morphed_point, settled_above
from .state import Memory, Morphing, fetch_records

RECORDS_AHEAD = wp.constant(wp.int64(8))  # vertices, from the one whose record is prefetched to the one in use

wp.set_module_options(INLINED)


@wp.func
def put_height(points: DisplacedPoints, o: wp.int32, domain: Domain, height: wp.float64):
    """Write the height of vertex o, whose other values are complete. height: metres before vertical scaling."""
    z = height * domain.height_scale + domain.height_offset
    if not (wp.abs(z) < HIGHEST):  # infinite or NaN
        points.not_finite[0] = 1
    points.positions[o][2] = wp.float32(z)


@wp.func
def fetch_point(domain: Domain, p: wp.vec2i):
    """Prefetch the samples around lattice point p, and error and range of its diamond where they are stored."""
    fetch_samples(domain, p)
    depth = depth_of(domain.unit_bits, p)
    if depth > 0 and depth < 2 * domain.levels - 1:  # deeper diamonds have no stored range
        fetch_ahead(domain, p[0], p[1], depth)  # the error
        fetch_range(domain, p[0], p[1], depth)


@wp.kernel
def displace_morphing(
    first: wp.int32,
    end: wp.int32,
    point_base: wp.int64,
    vertex_base: wp.int32,
    slot: wp.int32,
    domain: Domain,
    points: DisplacedPoints,
    morphing: Morphing,
    memory: Memory,
):
    """Write positions, normals and UV of points first .. end - 1, moved by the geomorph.

    Records for the next frame are written, too. Points of the last frame are copied in runs; they get new heights and
    normals unless they were settled (at their final height) and still are. Points are counted in the slice: point 0 is
    entry `point_base` of `points.point`, and vertex `vertex_base` of the mesh. slot: number of the thread's list of
    runs. memory: the thread's scratch, emptied at first. Calls of `fetch_...` only prefetch into the processor's cache
    what points a few places ahead will read.
    """
    forget_all(memory)
    run, run_end = runs_of(points, slot)
    v = first  # first point that is not written yet
    while v < end:
        # Points v .. begin - 1 are new; those from there to stop - 1 are copied from vertex `last_first` on.
        begin, stop, last_first = find_run(points, run, run_end, v, end, point_base)
        copy_run(points, last_first, begin, stop, vertex_base)
        # Above `settled_above2` squared metres of error, points of the run have settled. All frustums contain those
        # diamonds of its points that are deeper than `run_clear_below`.
        settled_above2 = wp.float64(wp.inf)
        run_clear_below = NOT_CLEAR
        if stop > begin:
            reused = points.reused.runs[run]
            settled_above2 = settled_above(morphing, reused.coarse * reused.coarse)  # its coarsest pixel, metres
            run_clear_below = reused.clear_below
        run += wp.int64(1)
        next_end = next_new(points, run, run_end, stop, end, point_base)
        for ahead in range(stop, next_end):
            fetch_point(domain, item_at(points.point, point_base + wp.int64(ahead)))
        gap_end = point_base + wp.int64(begin)  # entry after the new points
        for u in range(v, stop):
            k = point_base + wp.int64(u)
            p = item_at(points.point, k)
            last_vertex = wp.int64(-1)
            morphs = wp.bool(True)
            clear_below = NOT_CLEAR
            if u >= begin:
                clear_below = run_clear_below
                last_vertex = last_first + wp.int64(u - begin)
                fetch_records(morphing, last_vertex + RECORDS_AHEAD)
                morphs = not has_settled(morphing, memory, p, vertex_base + u, last_vertex, settled_above2)
            elif k + wp.int64(AHEAD) < gap_end:
                fetch_point(domain, item_at(points.point, k + wp.int64(AHEAD)))
            if morphs:
                morphed, surface = morphed_point(domain, morphing, memory, p, vertex_base + u, last_vertex, clear_below)
                if u < begin:
                    put_vertex(points, vertex_base + u, domain, p, wp.vec3d(morphed.z, surface[1], surface[2]))
                else:  # it is copied, and keeps its x, y and UV
                    put_height(points, vertex_base + u, domain, morphed.z)
                put(points.normals, vertex_base + u, morphed.normal)
        v = stop
