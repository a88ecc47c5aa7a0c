# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement by the bicubic surface; as kernels/mesh/displace.py in all else."""

import warp as wp

from ..field.codes import prefetch_sample
from ..mesh.displace import AHEAD, Points, on_sample, put_vertex, runs_of, take_run
from ..refine.diamond import Domain
from ..unchecked import pair_at
from .surface import in_patch

wp.set_module_options({"enable_backward": False})


@wp.kernel
def displace_bicubic(
    first: wp.int32,
    end: wp.int32,
    point_base: wp.int64,
    vertex_base: wp.int32,
    slot: wp.int32,
    domain: Domain,
    points: Points,
):
    """Positions, normals and texture coordinates on the bicubic surface; on samples it is the bilinear one."""
    bits = domain.unit_bits - domain.levels
    cell = wp.int32(1) << bits
    columns = domain.width
    rows = domain.height
    samples = domain.samples
    units = wp.float64(cell)
    part = wp.float64(1.0) / units
    slope_x = domain.height_scale / (domain.unit_x * units)
    slope_y = domain.height_scale / (domain.unit_y * units)
    per_width = part / wp.float64(columns - 1)
    per_height = part / wp.float64(rows - 1)
    last = wp.int64(end - 1)
    run, run_end = runs_of(points, slot)
    v = first
    while v < end:
        begin, stop = take_run(points, run, run_end, v, end, point_base, vertex_base)
        run += wp.int64(1)
        for u in range(v, begin):
            k = point_base + wp.int64(u)
            q = pair_at(points.point, wp.min(k + wp.int64(AHEAD), point_base + last))
            near = wp.int64(q[1] >> bits) * wp.int64(columns) + wp.int64(q[0] >> bits)
            for b in range(-1, 3):
                prefetch_sample(samples, near + wp.int64(b) * wp.int64(columns))
            p = pair_at(points.point, k)
            x = wp.min(p[0], domain.east)
            y = wp.min(p[1], domain.north)
            g = wp.vec3d()
            if ((x | y) & (cell - 1)) == 0:
                g = on_sample(samples, columns, rows, x >> bits, y >> bits)
            else:
                i = wp.min(x >> bits, columns - 2)
                j = wp.min(y >> bits, rows - 2)
                s = wp.float64(x - (i << bits)) * part
                t = wp.float64(y - (j << bits)) * part
                g = in_patch(samples, columns, rows, i, j, s, t)
            put_vertex(points, vertex_base + u, domain, p, g, slope_x, slope_y, per_width, per_height)
        v = stop
