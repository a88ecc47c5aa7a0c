# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement: lattice points to positions, normals and texture coordinates by the height field at full resolution.

The walk has written points in slices, one for each of its threads. A run is a sequence of points that is contiguous in
this frame and in the last one; its vertices are copied. `points.reused` has a list of `room` runs for each slice: entry
of the first point in this frame (`first`) and in the last one (`before`), and `count`. Finer tiles replace the raster's
samples in places.
"""

import warp as wp

from ..bicubic.surface import in_patch, off_corners
from ..field.cells import in_cell, on_sample
from ..field.codes import prefetch_sample
from ..field.domain import Domain
from ..field.finer import finer_at, tile_at
from ..refine.runs import Runs
from ..unchecked import copy_items, item_at, put

AHEAD = wp.constant(32)  # vertices, from the one whose samples are prefetched to the one in use
HIGHEST = wp.constant(wp.float64(3.4028235677973366e38))  # from here on float32 is infinite


@wp.struct
class DisplacedPoints:
    """Lattice points, their vertices, and the vertices of the last frame that are reused."""

    point: wp.array(dtype=wp.vec2i)  # lattice units; each slice has its entries
    positions: wp.array(dtype=wp.vec3f)
    normals: wp.array(dtype=wp.vec3f)
    uv: wp.array(dtype=wp.vec2f)
    not_finite: wp.array(dtype=wp.int32)  # [1]: set to 1 where a position or a normal is not finite
    # The last frame's points and vertices.
    reused: Runs  # points that both frames have
    last_base: wp.array(dtype=wp.int64)  # per slice of the last frame: entry of its first point
    last_vertex: wp.array(dtype=wp.int64)  # ... and the number of that point's vertex
    last_slices: wp.int32
    last_positions: wp.array(dtype=wp.vec3f)
    last_normals: wp.array(dtype=wp.vec3f)
    last_uv: wp.array(dtype=wp.vec2f)


@wp.func
def normal_of(domain: Domain, g: wp.vec3d) -> wp.vec3f:
    """Return the unit normal of the scaled surface.

    g: height there, metres before scaling, and slopes, metres a cell.
    """
    units_a_cell = wp.float64(wp.int32(1) << (domain.unit_bits - domain.levels))
    nx = -g[1] * (domain.height_scale / (domain.unit_x * units_a_cell))
    ny = -g[2] * (domain.height_scale / (domain.unit_y * units_a_cell))
    nz = wp.float64(1.0) / wp.sqrt(nx * nx + ny * ny + wp.float64(1.0))
    return wp.vec3f(wp.float32(nx * nz), wp.float32(ny * nz), wp.float32(nz))


@wp.func
def put_vertex(points: DisplacedPoints, o: wp.int32, domain: Domain, p: wp.vec2i, g: wp.vec3d):
    """Write position (metres), unit normal and UV of vertex o, which is at lattice point p.

    g: height (metres before scaling) and slopes (metres a cell) there. UV are fractions of the raster's sides, from its
    south-west corner. float64 is cast to float32 last. A value that is not finite sets `not_finite`.
    """
    units_a_cell = wp.float64(wp.int32(1) << (domain.unit_bits - domain.levels))
    cells_per_unit = wp.float64(1.0) / units_a_cell  # exact: a power of two
    slope_scale_x = domain.height_scale / (domain.unit_x * units_a_cell)
    slope_scale_y = domain.height_scale / (domain.unit_y * units_a_cell)
    per_width = cells_per_unit / wp.float64(domain.samples.columns - 1)
    per_height = cells_per_unit / wp.float64(domain.samples.rows - 1)
    px = domain.west + wp.float64(p[0]) * domain.unit_x
    py = domain.south + wp.float64(p[1]) * domain.unit_y
    pz = g[0] * domain.height_scale + domain.height_offset
    nx = -g[1] * slope_scale_x
    ny = -g[2] * slope_scale_y
    nz = wp.float64(1.0) / wp.sqrt(nx * nx + ny * ny + wp.float64(1.0))
    # A damaged store may hold any samples; one value that is not finite makes the sum not finite.
    if not (wp.abs(pz + (nx + ny) * nz) < HIGHEST):
        points.not_finite[0] = 1
    put(points.positions, o, wp.vec3f(wp.float32(px), wp.float32(py), wp.float32(pz)))
    put(points.normals, o, wp.vec3f(wp.float32(nx * nz), wp.float32(ny * nz), wp.float32(nz)))
    u = wp.float32(wp.float64(p[0]) * per_width)
    put(points.uv, o, wp.vec2f(u, wp.float32(wp.float64(p[1]) * per_height)))


@wp.func
def runs_of(points: DisplacedPoints, slot: wp.int32):
    """Return first and end index of the runs of points that slice `slot` reuses from the last frame.

    They are equal without runs, as for a slot without a list.
    """
    run = wp.int64(slot) * points.reused.room
    run_end = run
    if slot < points.reused.lists:
        run_end = run + points.reused.counts[slot]
    return run, run_end


@wp.func
def find_run(
    points: DisplacedPoints, run: wp.int64, run_end: wp.int64, v: wp.int32, end: wp.int32, point_base: wp.int64
):
    """Return (begin, stop, last_first): the points begin .. stop - 1 that a run copies from the last frame.

    Points are counted in the slice, and only those from v to `end` - 1 count; without any, begin and stop are `end`.
    last_first: number of the first one's vertex in the last frame. run, run_end: the run's entry in the list, and the
    end of the list. point_base: entry of the slice's point 0 in `points.point`. points.last_base, last_vertex: first
    entry and first vertex of each slice of the last frame.
    """
    begin = end
    stop = end
    last_first = wp.int64(0)
    if run < run_end:
        reused = points.reused.runs[run]
        first = reused.first - point_base
        begin = wp.clamp(wp.int32(first), v, end)
        stop = wp.clamp(wp.int32(first + reused.count), v, end)
        if stop > begin:
            last_slice = wp.int32(0)  # slice of the last frame that has the run
            while last_slice + 1 < points.last_slices and reused.before >= points.last_base[last_slice + 1]:
                last_slice += 1
            last_first = (
                points.last_vertex[last_slice] + reused.before - points.last_base[last_slice] + wp.int64(begin) - first
            )
    return begin, stop, last_first


@wp.func
def next_new(
    points: DisplacedPoints, run: wp.int64, run_end: wp.int64, stop: wp.int32, end: wp.int32, point_base: wp.int64
):
    """Return the end of the points to prefetch from `stop` on: at most AHEAD further, and before the next copied run.

    Points are counted in the slice. run, run_end: the next entry of the list of runs and its end. end: end of the
    points that this call displaces. point_base: entry of the slice's point 0 in `points.point`.
    """
    fetch_end = wp.min(stop + AHEAD, end)
    if run < run_end:
        fetch_end = wp.min(fetch_end, wp.int32(points.reused.runs[run].first - point_base))
    return fetch_end


@wp.func
def copy_run(points: DisplacedPoints, last_first: wp.int64, begin: wp.int32, stop: wp.int32, vertex_base: wp.int32):
    """Copy the vertices of points begin .. stop - 1 from the last frame, where they start at vertex `last_first`.

    vertex_base: number of the vertex of the slice's point 0.
    """
    if stop > begin:
        count = stop - begin
        to = vertex_base + begin
        copy_items(points.last_positions, last_first, count, points.positions, to)
        copy_items(points.last_normals, last_first, count, points.normals, to)
        copy_items(points.last_uv, last_first, count, points.uv, to)


@wp.func
def fetch_samples(domain: Domain, q: wp.vec2i):
    """Prefetch the sample south-west of lattice point q, and those a row before and after it, into the cache."""
    bits = domain.unit_bits - domain.levels
    index = wp.int64(q[1] >> bits) * wp.int64(domain.samples.columns) + wp.int64(q[0] >> bits)
    prefetch_sample(domain.samples, index)
    prefetch_sample(domain.samples, index - wp.int64(domain.samples.columns))
    prefetch_sample(domain.samples, index + wp.int64(domain.samples.columns))


@wp.func
def surface_at(domain: Domain, p: wp.vec2i) -> wp.vec3d:
    """Return height (metres before scaling) and slopes (metres a cell) at lattice point p, without displacement layers.

    Slopes are those for shading, without steps between cells. Beyond the border the result is that of the nearest point
    on the border.
    """
    bits = domain.unit_bits - domain.levels
    cell = wp.int32(1) << bits
    x = wp.min(p[0], domain.east)
    y = wp.min(p[1], domain.north)
    g = wp.vec3d()
    shift = wp.int32(0)
    tile = wp.int32(-1)
    if domain.has_finer == 1:
        shift = bits - domain.finer[0].bits
        tile = tile_at(domain.finer[0], x >> shift, y >> shift)
    if tile >= 0:
        i = x >> shift
        j = y >> shift
        per_unit = wp.float64(1.0) / wp.float64(wp.int32(1) << shift)  # exact: a power of two
        s = wp.float64(x - (i << shift)) * per_unit
        t = wp.float64(y - (j << shift)) * per_unit
        g = finer_at(domain.finer[0], tile, i, j, s, t)
        if domain.bicubic == 1:  # plus the bicubic surface minus the bilinear one
            difference = off_corners(domain.samples, domain.finer[0].bits, i, j, s, t)
            g = wp.vec3d(g[0] + difference[0], g[1], g[2])  # shading keeps slopes interpolated between samples
    elif ((x | y) & (cell - 1)) == 0:  # a sample
        g = on_sample(domain.samples, x >> bits, y >> bits)
    else:
        per_unit = wp.float64(1.0) / wp.float64(cell)  # exact: a power of two
        i = wp.min(x >> bits, domain.samples.columns - 2)
        j = wp.min(y >> bits, domain.samples.rows - 2)
        s = wp.float64(x - (i << bits)) * per_unit
        t = wp.float64(y - (j << bits)) * per_unit
        if domain.bicubic == 1:
            g = in_patch(domain.samples, i, j, s, t)
        else:
            g = in_cell(domain.samples, i, j, s, t)
    return g


@wp.kernel
def displace(
    first: wp.int32,
    end: wp.int32,
    point_base: wp.int64,
    vertex_base: wp.int32,
    slot: wp.int32,
    domain: Domain,
    points: DisplacedPoints,
):
    """Write positions (metres from the local origin), normals and texture coordinates of points first .. end - 1.

    One thread computes all of them. It is for surfaces without displacement layers (those: kernels/detail/displace.py)
    and without geomorphing. `points.not_finite` is set if a value is not finite. Points are counted in the slice: point
    0 is entry `point_base` of `points.point`, and vertex `vertex_base` of the mesh. slot: number of the list of runs
    that are copied from the last frame; all other points are computed.
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
            put_vertex(points, vertex_base + u, domain, p, surface_at(domain, p))
        v = stop
