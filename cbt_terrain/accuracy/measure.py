# SPDX-License-Identifier: GPL-3.0-or-later
"""The accuracy of a delivered mesh, measured without the tree or the code that makes bounds.

The measured mesh is the one that Blender gets: the float32 arrays of a Surface, also after expansion to meshlets and
after a fit has moved its heights. The truth is the reference surface: bilinear or bicubic between a field's samples, as
the field says, and its detail. Bicubic surfaces and detail are evaluated by the measurement's independent code, which
takes the largest of many points for the maximum (`MeasuredMesh.raise_to_maxima`, kernels/accuracy/rays.py).

A Sight casts its rays when they are first needed, so making one costs little.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...kernels.accuracy import normals as normal_kernels
from ...kernels.accuracy import screen as screen_kernels
from ..errors import TerrainError, check_function, check_kind, check_number, check_seed
from ..field.heightfield import HeightField
from ..mesh.surface import Surface
from ..plain_numbers import plain_number
from ..run.buffers import shared
from ..run.launch import checked_threads
from ..view.linear import lengths
from ..view.view import View, listed_views
from .mesh import Errors, MeasuredMesh, MeshGround, Progress, errors_of, ignore_progress
from .outline import silhouette
from .screen import Sight

MAX_POINTS = 1 << 28  # at random: 24 GB


@dataclass(frozen=True)
class Measurement:
    """Errors of a mesh.

    Percentiles and means are by area: of the ground in plan without its holes, on screen of the picture.

    `vertical_m`: |mesh - reference| at every raster sample and at random points between. `vertical_max_m`: the maximum
    over the continuous surface, exact for a bilinear reference. `rounding_m`: largest height by which float32 positions
    have moved the mesh, over all of it: the delivered triangles against the same with float64 corners on the reference,
    rounding of plane coordinates included; a fitted corner is not on the reference, there half a unit in the last place
    of its height stands for the rounding of z. `facet_deg`, `shading_deg`: the triangles' normals and the interpolated
    vertex normals against the reference's (central differences, which are also the normals of a bicubic surface) at
    every sample. `screen_px`, `hidden_px`: distances on screen between points of the reference and the mesh's points
    above or below them, of visible and of hidden points (screen.py). `silhouette_px`: distances of the reference's
    outline from the mesh's (outline.py). All three are None without a view, the last also where no outline is in the
    frame.
    """

    vertical_m: Errors
    vertical_max_m: float
    rounding_m: float
    facet_deg: Errors
    shading_deg: Errors
    screen_px: Errors | None
    hidden_px: Errors | None
    silhouette_px: Errors | None


def measure(
    field: HeightField,
    surface: Surface,
    view: View | None = None,
    placement: np.ndarray | None = None,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    *,
    random_points: int = 100_000,
    seed: int = 0,
    threads: int | None = None,
    sight: Sight | None = None,
    on_progress: Progress = ignore_progress,
) -> Measurement:
    """Measure a whole mesh of `field` against the reference surface, and as `view` sees both.

    placement, vertical_scale and vertical_offset are those of the update that made the mesh. `random_points` are drawn
    with `seed`. The result does not depend on `threads`. `sight`: from `look` with the same arguments, where several
    meshes are measured under one view: most of the time goes into its rays. `on_progress` receives the fraction done;
    an exception that it raises ends the measurement. Raises TerrainError where the mesh does not cover the terrain, for
    another `sight`, and for a view or placement that cannot be inverted.
    """
    random_points = plain_number(random_points, int, "The number of random points")
    check_number("The number of random points", random_points, 0, MAX_POINTS, "points")
    seed = plain_number(seed, int, "The seed")
    check_seed("The seed", seed)
    check_kind(sight, (Sight, type(None)), "The sight", "one that `look` returns, or None")
    check_function(on_progress, "on_progress")
    if view is None:
        sight = None
    else:
        new_sight = look(field, view, placement, vertical_scale, vertical_offset, threads=threads)
        if sight is not None and sight.key != new_sight.key:
            raise TerrainError(
                "The sight is of another view or terrain",
                expected="that of the mesh",
                fix="make it by `look` with the same arguments",
            )
        sight = sight or new_sight
    ground = MeshGround(field, vertical_scale, vertical_offset, checked_threads(threads))
    mesh = MeasuredMesh(ground, surface)
    # Mesh minus reference in metres: at every sample, and the largest size over the samples that each triangle covers.
    difference, worst = mesh.differences()
    on_progress(0.1)
    # Raise `worst` to the maximum between the samples. `corner_shifts`: by how many metres of height rounding to
    # float32 moved the corners of each triangle.
    corner_shifts = mesh.raise_to_maxima(worst)
    # The same at random points. `owner`: the triangle at each point, -1 for a point in a hole of the mesh.
    between, owner = mesh.differences_at(ground.random_points(random_points, seed))
    covered = slice(None) if mesh.covered is None else mesh.covered.reshape(-1)
    vertical = errors_of(np.concatenate([difference.reshape(-1)[covered], between[owner >= 0]]))
    on_progress(0.2)
    facet_deg, shading_deg = _angles(mesh, covered)
    on_progress(0.3)
    screen = hidden = outline = None
    if sight is not None:
        # Fill the sight's caches, with progress: the points seen in pixels, and which samples are visible.
        sight.pixel_points(_part_of_progress(on_progress, 0.3, 0.4))
        sight.states(_part_of_progress(on_progress, 0.4, 0.7))
        # The reference's differences from itself are 0; `np.zeros` takes no memory until it is written.
        seen_differences, _ = mesh.differences_at(sight.visible_points())
        zeros, seen_zeros = (np.zeros(d.shape, d.dtype) for d in (difference, seen_differences))
        # Errors in pixels of the visible points and of the hidden samples, as differences on screen of two surfaces.
        screen, hidden = sight.errors(zeros, difference, (seen_zeros, seen_differences))
        on_progress(0.8)
        outline = silhouette(sight, mesh, surface.positions, _part_of_progress(on_progress, 0.8, 1.0))
    on_progress(1.0)
    largest = max(float(worst.max()), vertical.max)
    return Measurement(vertical, largest, float(corner_shifts.max()), facet_deg, shading_deg, screen, hidden, outline)


def _angles(mesh: MeasuredMesh, covered: np.ndarray | slice) -> tuple[Errors, Errors]:
    """Return the errors of the triangles' normals and of the vertex normals in degrees at the covered samples."""
    facet, shading = (np.zeros(mesh.ground.field.samples.size, np.float32) for _ in range(2))
    mesh.walk(normal_kernels.angles, [shared(facet, wp.float32), shared(shading, wp.float32)])
    return errors_of(facet[covered]), errors_of(shading[covered])


def look(
    field: HeightField,
    view: View,
    placement: np.ndarray | None = None,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    *,
    threads: int | None = None,
) -> Sight:
    """Return a view's sight of the reference surface, for `measure` to use with every mesh that is seen from there.

    Rays are cast when they are first needed, and cached: 16 bytes a pixel and 1 byte a sample. field: the terrain.
    placement, vertical_scale and vertical_offset are those of the updates that make the meshes. threads: None for the
    default; the result does not depend on it.
    """
    return Sight(MeshGround(field, vertical_scale, vertical_offset, checked_threads(threads)), view, placement)


def triangle_errors(
    field: HeightField,
    surface: Surface,
    views: Iterable[View],
    placement: np.ndarray | None = None,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    *,
    threads: int | None = None,
) -> np.ndarray:
    """Return the largest error that each triangle covers, in pixels, the largest over the views: float32 [T].

    The error is evaluated at its samples and, along its edges, where it is vertically furthest from the reference in
    each cell (8 points there for a bicubic reference), if these are in the frame, hidden or not; and at the point seen
    in each pixel. 0 for triangles with no part in any frame. Without views: metres, the maximum over the triangle; then
    TerrainError is raised where the mesh does not cover the terrain. surface: the mesh of `field`. placement,
    vertical_scale and vertical_offset are those of the update that made it.
    """
    ground = MeshGround(field, vertical_scale, vertical_offset, checked_threads(threads))
    mesh, views = MeasuredMesh(ground, surface), listed_views(views)
    if not views:
        _, worst = mesh.differences()
        mesh.raise_to_maxima(worst)
        return worst.astype(np.float32)
    worst = np.zeros(mesh.triangles)
    for view in views:
        sight = Sight(ground, view, placement)
        # Raise `worst` to the errors at the samples and edges of each triangle, then at the point seen in each pixel,
        # where the surfaces to compare are the reference (differences 0) and the mesh.
        mesh.walk(screen_kernels.triangle_px, [sight.eye, shared(worst, wp.float64)])
        differences, owner = mesh.differences_at(sight.visible_points())
        on_mesh = owner >= 0
        np.maximum.at(worst, owner[on_mesh], sight.point_errors(np.zeros_like(differences), differences)[on_mesh])
    return worst.astype(np.float32)


def popping(before: Surface, after: Surface, sight: Sight) -> Errors:
    """Return by how many pixels visible points jump where mesh `after` takes the place of `before` under one view.

    Points are those of the screen error: the visible samples and the point of the reference in each pixel, each moving
    from the height that one mesh has there to that of the other. `sight`: from `look` for the view.
    """
    meshes = [MeasuredMesh(sight.ground, surface) for surface in (before, after)]
    samples = [mesh.differences()[0] for mesh in meshes]
    seen_differences = [mesh.differences_at(sight.visible_points())[0] for mesh in meshes]
    return sight.errors(samples[0], samples[1], seen_differences)[0]  # of visible points


def shading_change(before: Surface, after: Surface, sight: Sight) -> Errors:
    """Return by how much the shading of pixels changes where mesh `after` takes the place of `before`, in 255ths.

    The change at the point of the reference in each pixel is 255 times the distance between the two unit normals that
    the meshes have there; a point in a hole of either does not count. No light changes Lambert's shading of white
    ground by more. `sight`: from `look` for the view.
    """
    points = sight.visible_points()
    results = [MeasuredMesh(sight.ground, surface).normals_at(points) for surface in (before, after)]
    (first, in_first), (second, in_second) = results
    change = 255.0 * lengths((first - second).T)
    return errors_of(change[(in_first >= 0) & (in_second >= 0)])


def _part_of_progress(on_progress: Progress, start: float, end: float) -> Progress:
    """Return a function that reports progress of one part of the work, 0 to 1, as `start` to `end` of the whole."""
    return lambda fraction: on_progress(start + (end - start) * fraction)
