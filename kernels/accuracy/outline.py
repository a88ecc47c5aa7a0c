# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays against a mesh, and distances to its outline in a frame. Points are in pixels from the frame's middle.

`ground` is the reference surface, which gives the raster's position and steps; `eye` is the view. A ray has the points
(u, v, z) + t * (du, dv, dz), in cells of the raster and metres.
"""

import warp as wp

from ..query.rays import within
from ..refine.local_view import PANORAMIC
from .facets import DeliveredMesh, Reference
from .rays import NOWHERE, SightRay
from .screen import Eye, ray_through


@wp.struct
class Boxes:
    """A mesh for rays: a hierarchy of its triangles' float32 boxes, enlarged by more than a ray's float32 rounding."""

    bvh: wp.uint64
    low: wp.vec3d  # of the whole mesh, metres
    high: wp.vec3d


@wp.func
def vector_from(p: wp.vec3f, origin: wp.vec3d) -> wp.vec3d:
    """Return the vector from `origin` to p as float64."""
    return wp.vec3d(wp.float64(p[0]), wp.float64(p[1]), wp.float64(p[2])) - origin


@wp.func
def through_triangle(mesh: DeliveredMesh, t: wp.int32, origin: wp.vec3d, along: wp.vec3d) -> wp.float64:
    """Return s where the line origin + s * along passes through triangle t of the mesh; infinite if it does not.

    s is negative behind the origin. Both triangles at an edge compute the same number for that edge except for the
    sign, so no line passes between them (Woop, Benthin and Wald 2013).
    """
    a = vector_from(mesh.positions[mesh.corners[3 * t]], origin)
    b = vector_from(mesh.positions[mesh.corners[3 * t + 1]], origin)
    c = vector_from(mesh.positions[mesh.corners[3 * t + 2]], origin)
    zero = wp.float64(0.0)
    u = wp.dot(wp.cross(b, c), along)
    v = wp.dot(wp.cross(c, a), along)
    w = wp.dot(wp.cross(a, b), along)
    s = NOWHERE
    if (u >= zero and v >= zero and w >= zero) or (u <= zero and v <= zero and w <= zero):  # on one side of all edges
        total = u + v + w
        if total != zero:
            s = wp.dot((a * u + b * v + c * w) / total, along) / wp.dot(along, along)
    return s


@wp.func
def meets_mesh(
    ground: Reference, mesh: DeliveredMesh, boxes: Boxes, ray: SightRay, start: wp.float64, end: wp.float64
) -> wp.bool:
    """Return whether a ray meets the mesh between t = start and t = end along the ray.

    boxes: a hierarchy, which gives candidates in float32; each triangle is then tested in float64. The interval of t is
    first cut down to the mesh's box, axis by axis (`within`).
    """
    x = ground.west + ray.u * ground.step_x
    y = ground.south + ray.v * ground.step_y
    along = wp.vec3d(ray.du * ground.step_x, ray.dv * ground.step_y, ray.dz)
    first, last = within(start, end, x, along[0], boxes.low[0], boxes.high[0])
    first, last = within(first, last, y, along[1], boxes.low[1], boxes.high[1])
    first, last = within(first, last, ray.z, along[2], boxes.low[2], boxes.high[2])
    is_hit = wp.bool(False)
    if first <= last:
        origin = wp.vec3d(x + first * along[0], y + first * along[1], ray.z + first * along[2])
        unit = wp.normalize(along)
        query = wp.bvh_query_ray(
            boxes.bvh,
            wp.vec3f(wp.float32(origin[0]), wp.float32(origin[1]), wp.float32(origin[2])),
            wp.vec3f(wp.float32(unit[0]), wp.float32(unit[1]), wp.float32(unit[2])),
        )
        triangle = wp.int32(0)
        while wp.bvh_query_next(query, triangle):
            s = through_triangle(mesh, triangle, origin, along)
            if s >= wp.float64(0.0) and s <= last - first:
                is_hit = True
                break
    return is_hit


@wp.kernel
def mesh_cover(
    offset: wp.int32,
    ground: Reference,
    mesh: DeliveredMesh,
    boxes: Boxes,
    eye: Eye,
    frame_point: wp.array(dtype=wp.vec2d),
    cover: wp.array(dtype=wp.bool),
):
    """Write cover[p]: whether the ray through point p = offset + tid of the frame meets the mesh in the clip range.

    frame_point: pixels from the frame's middle. boxes: bounding boxes of the mesh's triangles, as a hierarchy.
    """
    p = offset + wp.tid()
    cover[p] = meets_mesh(
        ground, mesh, boxes, ray_through(eye, frame_point[p][0], frame_point[p][1]), eye.start, eye.end
    )


@wp.func
def distance_to_segment(p: wp.vec2d, a: wp.vec2d, b: wp.vec2d, x_scale: wp.float64) -> wp.float64:
    """Return the distance of p from the segment a b, pixels. x_scale: factor on horizontal lengths, for panoramas."""
    px = (p[0] - a[0]) * x_scale
    py = p[1] - a[1]
    dx = (b[0] - a[0]) * x_scale
    dy = b[1] - a[1]
    length2 = dx * dx + dy * dy
    along = wp.float64(0.0)
    if length2 > wp.float64(0.0):
        along = wp.clamp((px * dx + py * dy) / length2, wp.float64(0.0), wp.float64(1.0))
    px -= along * dx
    py -= along * dy
    return wp.sqrt(px * px + py * py)


@wp.kernel
def nearest(
    offset: wp.int32,
    columns: wp.int32,
    rows: wp.int32,
    west: wp.float64,
    south: wp.float64,
    eye: Eye,
    first: wp.array(dtype=wp.int32),
    segment: wp.array(dtype=wp.vec2i),
    crossing: wp.array(dtype=wp.vec2d),
    frame_point: wp.array(dtype=wp.vec2d),
    distance: wp.array(dtype=wp.float64),
):
    """Write the distance in pixels from point p = offset + tid to the nearest segment of the outline.

    If the border of the searched area is nearer, that distance is written. frame_point: pixels from the frame's middle.
    columns, rows: size of the area in pixels. west, south: middle of its south-west pixel. segment: pairs of entries of
    `crossing`; those of first[n] .. first[n + 1] are in the square between the middles of pixel n and of the next to
    the north-east. Rings of pixels are searched from the inside out.
    """
    p = offset + wp.tid()
    one = wp.float64(1.0)
    x = frame_point[p][0]
    y = frame_point[p][1]
    x_scale = one
    if eye.kind == PANORAMIC:
        x_scale = wp.abs(wp.cos(y / eye.pixels_per_radian))  # a pixel's width shrinks with the latitude
    i = wp.int32(wp.floor(x - west))
    j = wp.int32(wp.floor(y - south))
    border = wp.min(x - west, west + wp.float64(columns - 1) - x) * x_scale
    best = wp.min(border, wp.min(y - south, south + wp.float64(rows - 1) - y))
    ring = wp.int32(0)
    while best > (wp.float64(ring) - one) * x_scale and ring <= columns + rows:  # the next ring may be nearer
        for b in range(wp.max(j - ring, 0), wp.min(j + ring, rows - 1) + 1):
            # All pixels of the ring's first and last row, the two ends of the others.
            step = wp.where(b == j - ring or b == j + ring, 1, wp.max(2 * ring, 1))
            for a in range(i - ring, i + ring + 1, step):
                if a >= 0 and a < columns:
                    n = b * columns + a
                    for k in range(first[n], first[n + 1]):
                        ends = segment[k]
                        best = wp.min(
                            best, distance_to_segment(frame_point[p], crossing[ends[0]], crossing[ends[1]], x_scale)
                        )
        ring += 1
    distance[p] = best
