# SPDX-License-Identifier: GPL-3.0-or-later
"""Angles between the normals of a mesh and of the reference surface at every sample.

`ground` is the reference surface. A triangle f (MeasuredFacet) of the mesh has its corners (x, y) in lattice units, of
which a cell has 2^bits a side, and the slopes of its plane in metres a cell.
"""

import warp as wp

from ..field.cells import on_sample
from ..field.codes import sample_index
from ..field.detail import detail_at
from ..field.finer import finer_at, tile_at
from ..unchecked import put
from .facets import DeliveredMesh, MeasuredFacet, Reference, facet_of, owns, sample_box

DEGREES = wp.constant(wp.float64(57.29577951308232))


@wp.func
def angle_deg(a: wp.vec3d, b: wp.vec3d) -> wp.float32:
    """Return the angle between two directions in degrees; precise also if they are nearly equal."""
    return wp.float32(wp.atan2(wp.length(wp.cross(a, b)), wp.dot(a, b)) * DEGREES)


@wp.func
def normal_at(mesh: DeliveredMesh, f: MeasuredFacet, t: wp.int32, x: wp.int64, y: wp.int64) -> wp.vec3d:
    """Return the vertex normals of triangle t interpolated at lattice point (x, y); not of unit length."""
    n = wp.vec3d()
    for k in range(3):
        a = (k + 1) % 3
        b = (k + 2) % 3
        weight = (f.x[b] - f.x[a]) * (y - f.y[a]) - (f.y[b] - f.y[a]) * (x - f.x[a])
        vertex = mesh.normals[mesh.corners[3 * t + k]]
        vertex_d = wp.vec3d(wp.float64(vertex[0]), wp.float64(vertex[1]), wp.float64(vertex[2]))
        n += vertex_d * (wp.float64(weight) / wp.float64(f.area2))
    return n


@wp.kernel
def angles(
    first: wp.int32,
    end: wp.int32,
    ground: Reference,
    mesh: DeliveredMesh,
    facet_deg: wp.array(dtype=wp.float32),
    shading_deg: wp.array(dtype=wp.float32),
):
    """Write angles to the reference's normal at every sample that triangles first .. end - 1 own, degrees.

    facet_deg: angles of the triangle's plane. shading_deg: angles of the interpolated vertex normals, which are
    rendered. The reference's normal is by central differences of samples, or of a finer tile's, plus the displacement.
    """
    per_x = ground.scale / ground.step_x
    per_y = ground.scale / ground.step_y
    up = wp.float64(1.0)
    for t in range(first, end):
        f = facet_of(ground, mesh, t)
        facet = wp.vec3d(-f.slope_u / ground.step_x, -f.slope_v / ground.step_y, up)
        box = sample_box(ground, f)
        for j in range(box[2], box[3] + 1):
            for i in range(box[0], box[1] + 1):
                if owns(ground, f, i, j):
                    surface = on_sample(ground.samples, i, j)  # height and slopes, metres a cell
                    if ground.has_finer == 1:
                        finer_i = i << ground.finer[0].bits
                        finer_j = j << ground.finer[0].bits
                        tile = tile_at(ground.finer[0], finer_i, finer_j)
                        if tile >= 0:
                            zero = wp.float64(0.0)
                            surface = finer_at(ground.finer[0], tile, finer_i, finer_j, zero, zero)
                    truth = wp.vec3d(-surface[1] * per_x, -surface[2] * per_y, up)
                    if ground.layers.count > 0:
                        x = ground.west + wp.float64(i) * ground.step_x
                        y = ground.south + wp.float64(j) * ground.step_y
                        detail = detail_at(ground.layers, x, y)
                        truth = truth - wp.vec3d(detail[1], detail[2], wp.float64(0.0)) * ground.scale
                    bits = wp.int64(ground.bits)
                    shading = normal_at(mesh, f, t, wp.int64(i) << bits, wp.int64(j) << bits)
                    index = sample_index(ground.samples, i, j)
                    put(facet_deg, index, angle_deg(facet, truth))
                    put(shading_deg, index, angle_deg(shading, truth))
