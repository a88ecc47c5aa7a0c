# SPDX-License-Identifier: GPL-3.0-or-later
"""The displacement of the terrain's outline in a frame, in pixels.

The outline is where coverage flips between the rays of two pixels that are neighbours in a row or a column; the
crossing between their middles is found to 2^-11 px. The mesh's crossings are joined to lines through the squares
between four pixels (marching squares). The error of a crossing of the reference is its distance to the nearest of these
lines, searched in the frame and MARGIN pixels around it; where none is nearer than the border of that area, the
distance to the border counts, so that the error of a missing outline is understated. Rays are a pixel apart: narrower
parts of an outline may be missed, in the mesh or in the reference. An outline is wherever terrain ends: against the
sky, at the raster's border or at the clip end. The frame of a panorama is assumed to be equirectangular; across, its
distances are those on the sphere.
"""

from collections.abc import Callable

import numpy as np
import warp as wp

from ...kernels.accuracy import outline as kernels
from ..run import launch
from ..run.buffers import shared
from ..view.linear import length
from .mesh import Errors, MeasuredMesh, Progress, errors_of
from .screen import Sight, pixel_blocks

MARGIN = 16
HALVINGS = 10  # of a pixel, to find a crossing
# Boxes grow by this part of the mesh's size: a float32 ray through it strays by less.
PAD = 1e-6


class _Rays:
    """A mesh ready for rays; holds the memory that the hierarchy refers to."""

    def __init__(self, sight: Sight, mesh: MeasuredMesh, positions: np.ndarray) -> None:
        """Build a BVH of the mesh's triangles for rays from the camera.

        Boxes are padded by more than float32 rays stray. positions: float32 [V, 3], the mesh's vertices.
        """
        low, high = (reduce(positions, axis=0).astype(np.float64) for reduce in (np.min, np.max))
        pad = PAD * length(high - low) + 1e-6 * float(np.abs(positions).max())
        corners = positions[mesh.packed.corners.numpy().reshape(-1, 3)]
        ends = corners.min(axis=1) - np.float32(pad), corners.max(axis=1) + np.float32(pad)
        self.bvh = wp.Bvh(*(shared(end, wp.vec3f) for end in ends))
        b = kernels.Boxes()
        b.bvh, b.low, b.high = self.bvh.id, low - pad, high + pad
        self.inputs = [sight.ground.packed, mesh.packed, b, sight.eye]
        self.threads = mesh.ground.threads

    def meet(self, places: np.ndarray) -> np.ndarray:
        """Return whether the rays through points of the frame meet the mesh, bool [n].

        places: these points, float64 [n, 2] pixels from the frame's middle.
        """
        cover = np.zeros(len(places), bool)
        inputs = [*self.inputs, shared(places, wp.vec2d), shared(cover, wp.bool)]
        launch.spread(kernels.mesh_cover, len(cover), inputs, step="measure", threads=self.threads, cost=100)
        return cover


def silhouette(sight: Sight, mesh: MeasuredMesh, positions: np.ndarray, on_progress: Progress) -> Errors | None:
    """Return errors of the reference's outline in the frame, pixels; None where it has none.

    sight: the view's sight of the reference. positions: float32 [V, 3], the mesh's. on_progress: gets the fraction
    done.
    """
    threads = mesh.ground.threads
    # Where the reference's coverage flips, from the points that the sight already has; bisection casts more rays.
    flips = _flips(sight.covered(), sight, margin=0)
    if not sum(len(places) for places in flips):
        return None
    crossings = _crossings(flips, lambda places: sight.points_at(places)[:, 0] >= 0)  # x is -1 in the sky
    # The same of the mesh, in an area that is larger by MARGIN pixels on each side.
    rays = _Rays(sight, mesh, positions)
    columns, rows = sight.columns + 2 * MARGIN, sight.rows + 2 * MARGIN
    cover = np.zeros(rows * columns, bool)
    for row, places in pixel_blocks(columns, rows):
        cover[row * columns :][: len(places)] = rays.meet(places)
        on_progress((row * columns + len(places)) / len(cover))
    cover = cover.reshape(rows, columns)
    mesh_crossings = _crossings(_flips(cover, sight, MARGIN), rays.meet)
    # For each crossing of the reference the distance to the nearest line. `segment`: the two crossings of the mesh that
    # each line joins; `first`: the first line in each square between four pixels.
    first, segment = _lines(cover)
    points = np.concatenate(crossings)
    distance = np.zeros(len(points))
    # size of the area that is searched, and the middle of its first pixel, pixels from the frame's middle
    inputs = [columns, rows, 0.5 - columns / 2, 0.5 - rows / 2, sight.eye, shared(first, wp.int32)]
    inputs += [shared(segment, wp.vec2i), shared(np.concatenate(mesh_crossings), wp.vec2d)]
    inputs += [shared(points, wp.vec2d), shared(distance, wp.float64)]
    launch.spread(kernels.nearest, len(points), inputs, step="measure", threads=threads, cost=50)
    return errors_of(distance)


def _flips(cover: np.ndarray, sight: Sight, margin: int) -> list[np.ndarray]:
    """Return the first pixels of pairs of neighbours of which one is covered: pairs in rows, and pairs in columns.

    Both are float64 [n, 2], in pixels from the frame's middle. cover: bool [rows, columns] of the frame and `margin`
    pixels around it.
    """
    corner = np.array([0.5 - margin - sight.columns / 2, 0.5 - margin - sight.rows / 2])
    pairs = (cover[:, 1:] != cover[:, :-1]), (cover[1:] != cover[:-1])
    return [np.ascontiguousarray(np.argwhere(differ)[:, ::-1] + corner) for differ in pairs]


def _crossings(flips: list[np.ndarray], covers: Callable[[np.ndarray], np.ndarray]) -> list[np.ndarray]:
    """Return where between two neighbouring pixels the coverage flips, for pairs in rows and in columns.

    Both are float64 [n, 2] in pixels. flips: the first pixel of each pair. covers: returns for positions in the frame
    whether a ray there hits the surface; it is called for the first pixels, and HALVINGS times (bisection).
    """
    crossings = []
    for places, step in zip(flips, np.eye(2), strict=True):
        # `along`: how far from the first pixel, in pixels, coverage is surely that of the first pixel.
        is_first_covered, along, half = covers(places), np.zeros((len(places), 1)), 0.5
        for _ in range(HALVINGS):
            along[covers(places + (along + half) * step) == is_first_covered] += half  # it flips in the second half
            half /= 2
        crossings.append(places + (along + half) * step)
    return crossings


def _lines(cover: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Join the places where coverage flips by a line through each square between the middles of four pixels.

    Returns int32 [rows * columns + 1], the first line of each square (numbered by its south-west pixel), and int32 [n,
    2], lines from flip to flip, by their numbers in the order of `_flips`. A square with four flips has two lines,
    which always join the southern flip with the western one.
    """
    row_flips, column_flips = cover[:, 1:] != cover[:, :-1], cover[1:] != cover[:-1]
    # Number of each flip in the order of `_flips`: those in rows first.
    flip_numbers = [
        np.cumsum(row_flips).reshape(row_flips.shape) - 1,
        np.cumsum(column_flips).reshape(column_flips.shape) - 1 + row_flips.sum(),
    ]
    sides = row_flips[:-1], column_flips[:, :-1], row_flips[1:], column_flips[:, 1:]  # south, west, north, east
    side_numbers = flip_numbers[0][:-1], flip_numbers[1][:, :-1], flip_numbers[0][1:], flip_numbers[1][:, 1:]
    mixed = np.argwhere(sides[0] | sides[1] | sides[2] | sides[3])  # row and column of squares with a flip
    squares = mixed[:, 0], mixed[:, 1]
    # Of each such square, whether coverage flips on its four sides, and the numbers of these flips.
    crossed = np.stack([side[squares] for side in sides], axis=1)
    crossing = np.stack([numbers[squares] for numbers in side_numbers], axis=1)
    # crossed sides first, in their order
    crossing = np.take_along_axis(crossing, np.argsort(~crossed, axis=1, kind="stable"), axis=1)
    doubled = crossed.all(axis=1)  # squares with two lines
    square = mixed[:, 0] * cover.shape[1] + mixed[:, 1]
    square, segment = np.r_[square, square[doubled]], np.r_[crossing[:, :2], crossing[doubled, 2:]]
    order = np.argsort(square, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(square, minlength=cover.size))])
    return first.astype(np.int32), np.ascontiguousarray(segment[order], np.int32)
