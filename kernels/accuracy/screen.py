# SPDX-License-Identifier: GPL-3.0-or-later
"""What a view sees of the reference surface, and by how many pixels it sees the points of a mesh displaced.

A point has two heights besides the reference's, from and to, above the same (x, y): reference and mesh, or a mesh
before and after. Its error is the distance of their projections. Heights are metres after vertical scaling. `ground` is
the reference surface, `blocks` the heights of its blocks (for rays), f a triangle of the mesh.

Of an `eye`: start .. end is the clip range in metres of depth, or of distance in a panorama; half_width and half_height
are half of the frame in pixels.
"""

import warp as wp

from ..field.codes import sample_index
from ..refine.local_view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE
from ..unchecked import put
from .edges import empty_stretch, next_stretch, num_points, point_of_stretch
from .facets import (
    DeliveredMesh,
    MeasuredFacet,
    Reference,
    facet_of,
    owns,
    plane_at,
    reference_at,
    reference_sample,
    sample_box,
    toward_zero,
)
from .points import POINT_BITS
from .rays import NOWHERE, HeightBlocks, SightRay, first_crossing

OUTSIDE = wp.constant(wp.uint8(0))
VISIBLE = wp.constant(wp.uint8(1))
HIDDEN = wp.constant(wp.uint8(2))

# The bound where the mesh may reach the eye (criterion.LARGEST): no larger error is reported.
MAX_PX = wp.constant(wp.float64(1e30))


@wp.struct
class Eye:
    """A view from the terrain's own space in cells and metres, (u, v, z)."""

    kind: wp.int32
    right: wp.vec4d  # camera space = rows . (u, v, z, 1), metres
    up: wp.vec4d
    back: wp.vec4d
    to_x: wp.vec4d  # rows of the projection of camera space: across, up and w
    to_y: wp.vec4d
    to_w: wp.vec4d
    half_width: wp.float64  # pixels
    half_height: wp.float64
    start: wp.float64  # of the clip range: depth, or distance of a panorama
    end: wp.float64
    near: wp.float64  # nearer than this depth nothing is promised
    pixels_per_radian: wp.float64  # of a panorama
    eye: wp.vec3d  # of a view that is not orthographic
    toward: wp.vec3d  # of an orthographic view: the vector towards the eye along which depth falls by a metre
    # A pixel's ray: origin + x * across + y * along, and the same for directions; x, y are -1 .. 1 in the frame.
    origin: wp.mat33d
    direction: wp.mat33d
    axes: wp.mat33d  # of a panorama: columns are camera space's axes


@wp.func
def to_camera(eye: Eye, u: wp.float64, v: wp.float64, z: wp.float64) -> wp.vec3d:
    """Transform a point, u cells east, v cells north and z metres high, to camera space, metres."""
    p = wp.vec4d(u, v, z, wp.float64(1.0))
    return wp.vec3d(wp.dot(eye.right, p), wp.dot(eye.up, p), wp.dot(eye.back, p))


@wp.func
def to_frame(eye: Eye, camera: wp.vec3d) -> wp.vec2d:
    """Project a point of camera space (metres) to normalised device coordinates: -1 .. 1 in the frame. No panoramas."""
    p = wp.vec4d(camera[0], camera[1], camera[2], wp.float64(1.0))
    w = wp.dot(eye.to_w, p)
    return wp.vec2d(wp.dot(eye.to_x, p) / w, wp.dot(eye.to_y, p) / w)


@wp.func
def in_frame(eye: Eye, camera: wp.vec3d) -> wp.bool:
    """Return whether a point of camera space is inside the clip range and the frame; a panorama's is all around."""
    one = wp.float64(1.0)
    depth = -camera[2]
    if eye.kind == PANORAMIC:
        depth = wp.length(camera)
    is_inside = depth > eye.start and depth < eye.end
    if is_inside and eye.kind != PANORAMIC:
        p = to_frame(eye, camera)
        is_inside = wp.abs(p[0]) <= one and wp.abs(p[1]) <= one
    return is_inside


@wp.func
def move_ahead(eye: Eye, truth: wp.vec3d, point: wp.vec3d) -> wp.vec3d:
    """Return `point` or, if it is nearer to the eye than `eye.near`, that point moved towards `truth` to this depth.

    Both are points of camera space, metres. Nearer than that depth no error is bounded, so none is measured there.
    """
    moved = point
    if eye.kind == PERSPECTIVE and -point[2] < eye.near and -truth[2] > eye.near:
        moved = truth + (point - truth) * ((-truth[2] - eye.near) / (point[2] - truth[2]))
    return moved


@wp.func
def apart_px(eye: Eye, truth: wp.vec3d, a: wp.vec3d, b: wp.vec3d) -> wp.float64:
    """Return the distance in pixels between the projections of a and b, two displaced copies of the reference point.

    truth, a, b: points of camera space, metres; `truth` is the reference point. It is 0 if that is nearer than
    `eye.near`, where no error is bounded; an `a` or `b` nearer than that is moved towards it to that depth.
    """
    pixels = wp.float64(0.0)
    if eye.kind == PANORAMIC:
        pixels = wp.atan2(wp.length(wp.cross(a, b)), wp.dot(a, b)) * eye.pixels_per_radian
    elif eye.kind == ORTHOGRAPHIC or -truth[2] > eye.near:
        p = to_frame(eye, move_ahead(eye, truth, a))
        q = to_frame(eye, move_ahead(eye, truth, b))
        x = (p[0] - q[0]) * eye.half_width
        y = (p[1] - q[1]) * eye.half_height
        pixels = wp.sqrt(x * x + y * y)
    return wp.where(pixels < MAX_PX, pixels, MAX_PX)  # also where it is no number any more


@wp.func
def is_hidden(
    ground: Reference, blocks: HeightBlocks, eye: Eye, u: wp.float64, v: wp.float64, z: wp.float64, camera: wp.vec3d
):
    """Return whether the surface hides one of its points from the eye.

    The surface in front of the clip start hides nothing. (u, v, z): the point in cells and metres. camera: the same
    point in camera space.
    """
    ray = SightRay()
    ray.tolerance = blocks.tolerance
    ray.u = u
    ray.v = v
    ray.z = z
    end = wp.float64(1.0)  # t of the eye; of an orthographic view t is metres towards it
    if eye.kind == ORTHOGRAPHIC:
        ray.du = eye.toward[0]
        ray.dv = eye.toward[1]
        ray.dz = eye.toward[2]
        end = -camera[2] - eye.start
    else:
        ray.du = eye.eye[0] - u
        ray.dv = eye.eye[1] - v
        ray.dz = eye.eye[2] - z
        depth = -camera[2]
        if eye.kind == PANORAMIC:
            depth = wp.length(camera)
        end = wp.float64(1.0) - eye.start / depth
    start_level = 0  # the smallest blocks: the ray starts on the surface
    return first_crossing(ground, blocks, ray, wp.float64(0.0), end, start_level) < NOWHERE


@wp.kernel
def visibility(
    offset: wp.int32,
    first_row: wp.int32,
    ground: Reference,
    blocks: HeightBlocks,
    eye: Eye,
    state: wp.array(dtype=wp.uint8),
):
    """Write to `state` for each sample of a row whether it is OUTSIDE the frame, VISIBLE or HIDDEN.

    The thread works on row first_row + offset + tid.
    """
    j = first_row + offset + wp.tid()
    for i in range(ground.samples.columns):
        u = wp.float64(i)
        v = wp.float64(j)
        z = reference_sample(ground, i, j)
        camera = to_camera(eye, u, v, z)
        sample_state = OUTSIDE
        if in_frame(eye, camera):
            sample_state = wp.where(is_hidden(ground, blocks, eye, u, v, z, camera), HIDDEN, VISIBLE)
        put(state, sample_index(ground.samples, i, j), sample_state)


@wp.kernel
def point_errors(
    offset: wp.int32,
    ground: Reference,
    eye: Eye,
    x: wp.array(dtype=wp.int64),
    y: wp.array(dtype=wp.int64),
    before: wp.array(dtype=wp.float64),
    after: wp.array(dtype=wp.float64),
    pixels: wp.array(dtype=wp.float32),
):
    """Write the distance in pixels between the projections of two displaced copies of point offset + tid.

    It is 0 where the reference point is nearer than `eye.near`. x, y: the reference point, units of 2^-(bits + 7)
    cells. before, after: heights of the copies above the reference surface, metres.
    """
    p = offset + wp.tid()
    per_unit = wp.float64(1.0) / wp.float64(wp.int64(1) << (wp.int64(ground.bits) + wp.int64(POINT_BITS)))
    u = wp.float64(x[p]) * per_unit
    v = wp.float64(y[p]) * per_unit
    z = reference_at(ground, u, v)
    truth = to_camera(eye, u, v, z)
    a = to_camera(eye, u, v, z + before[p])
    b = to_camera(eye, u, v, z + after[p])
    pixels[p] = toward_zero(apart_px(eye, truth, a, b))


@wp.func
def ray_through(eye: Eye, x: wp.float64, y: wp.float64) -> SightRay:
    """Return the ray through point (x, y) of the frame, pixels from its middle; its t is depth, of a panorama distance.

    Its tolerance is 0. A panorama's frame is assumed to be equirectangular.
    """
    o = eye.origin * wp.vec3d(wp.float64(1.0), x / eye.half_width, y / eye.half_height)
    d = eye.direction * wp.vec3d(wp.float64(1.0), x / eye.half_width, y / eye.half_height)
    if eye.kind == PANORAMIC:
        longitude = x / eye.pixels_per_radian
        latitude = y / eye.pixels_per_radian
        level = wp.cos(latitude)
        d = eye.axes * wp.vec3d(wp.sin(longitude) * level, wp.sin(latitude), -wp.cos(longitude) * level)
    ray = SightRay()
    ray.u = o[0]
    ray.v = o[1]
    ray.z = o[2]
    ray.du = d[0]
    ray.dv = d[1]
    ray.dz = d[2]
    return ray


@wp.kernel
def seen_points(
    offset: wp.int32,
    ground: Reference,
    blocks: HeightBlocks,
    eye: Eye,
    frame_point: wp.array(dtype=wp.vec2d),
    x: wp.array(dtype=wp.int64),
    y: wp.array(dtype=wp.int64),
):
    """Write to (x, y) the point of the reference surface that is seen at point offset + tid of the frame.

    frame_point: pixels from the frame's middle. x, y: units of 2^-(bits + 7) cells; where no ground is seen x is -1 and
    y stays as it is.
    """
    p = offset + wp.tid()
    ray = ray_through(eye, frame_point[p][0], frame_point[p][1])
    start_level = blocks.levels  # the largest blocks: the eye may be far away
    t = first_crossing(ground, blocks, ray, eye.start, eye.end, start_level)
    x[p] = wp.int64(-1)
    if t < NOWHERE:
        units = wp.float64(wp.int64(1) << (wp.int64(ground.bits) + wp.int64(POINT_BITS)))
        u = wp.clamp(ray.u + t * ray.du, wp.float64(0.0), wp.float64(ground.samples.columns - 1))
        v = wp.clamp(ray.v + t * ray.dv, wp.float64(0.0), wp.float64(ground.samples.rows - 1))
        x[p] = wp.int64(wp.floor(u * units + wp.float64(0.5)))
        y[p] = wp.int64(wp.floor(v * units + wp.float64(0.5)))


@wp.func
def seen_px(ground: Reference, eye: Eye, f: MeasuredFacet, u: wp.float64, v: wp.float64) -> wp.float64:
    """Return the distance in pixels between the reference and a triangle at (u, v) cells; 0 outside the frame.

    Hidden points count as visible ones.
    """
    z = reference_at(ground, u, v)
    truth = to_camera(eye, u, v, z)
    pixels = wp.float64(0.0)
    if in_frame(eye, truth):
        pixels = apart_px(eye, truth, truth, to_camera(eye, u, v, plane_at(f, u, v)))
    return pixels


@wp.kernel
def triangle_px(
    first: wp.int32, end: wp.int32, ground: Reference, mesh: DeliveredMesh, eye: Eye, worst: wp.array(dtype=wp.float64)
):
    """Raise worst[t] of triangles first .. end - 1 to the largest error in pixels at samples and along edges.

    Each edge is cut by the raster's rows and columns into stretches, which are evaluated at `num_points` points. Only
    points in the frame count, hidden ones among them.
    """
    for t in range(first, end):
        f = facet_of(ground, mesh, t)
        largest = worst[t]
        box = sample_box(ground, f)
        for j in range(box[2], box[3] + 1):
            for i in range(box[0], box[1] + 1):
                if owns(ground, f, i, j):
                    largest = wp.max(largest, seen_px(ground, eye, f, wp.float64(i), wp.float64(j)))
        if f.area2 > wp.int64(0):
            for k in range(3):
                s = empty_stretch(ground, f, k)
                while s.to < wp.float64(1.0):
                    s = next_stretch(ground, f, k, s)
                    for q in range(1, num_points(ground) + 1):
                        u, v = point_of_stretch(ground, f, k, s, q)
                        largest = wp.max(largest, seen_px(ground, eye, f, u, v))
        worst[t] = largest
