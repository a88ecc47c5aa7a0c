# SPDX-License-Identifier: GPL-3.0-or-later
"""One part of a frame drawn at several errors, with the cost of each."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...kernels.accuracy import drawing as kernels
from ..mesh.surface import Surface
from ..run import launch
from ..run.buffers import shared
from ..terrain import Terrain
from ..view.criterion import Criterion
from ..view.linear import product
from ..view.view import PANORAMIC, PERSPECTIVE, View
from .sweep_settings import Setting
from .timed_runs import TimedFrame

# Pixels of the frame that a crop shows each way; samples in one of them, each way; pixels in one of the small pictures
# that tell where to look.
SIDE, SAMPLES, SMALL = 256, 2, 4
# The light of shaded maps, from the north-west, and colours; linear.
SUN = np.array([-0.71, 0.45, 0.54])
SUNLIGHT, SKYLIGHT, GROUND, SKY, INK = np.array(
    [(0.85, 0.79, 0.70), (0.16, 0.19, 0.25), (0.80, 0.76, 0.70), (0.61, 0.70, 0.79), (0.02, 0.06, 0.07)]
)
LINE_PX, OPACITY = 0.65, 0.75


@dataclass(frozen=True)
class Crop:
    """A part of a frame at one error, uint8 [side, side, 3] from the top; `triangles` of the whole mesh."""

    error_px: float
    triangles: int
    pixels: np.ndarray


def crops(terrain: Terrain, frame: TimedFrame, errors_px: Sequence[float], base: Criterion | None = None) -> list[Crop]:
    """Return a crop of the picture at each error, pixels, through the frame's first view.

    [] for a panorama, and without errors or views. The part, SIDE pixels a side or those of a smaller frame, is the one
    in which the first and the last error differ most. Each crop shows the edges of triangles in its lower left half.
    terrain: updated for each error. frame: views, and the placement and vertical scale of the terrain. base: criterion
    whose error is replaced; None for the default.
    """
    if not errors_px or not frame.views or frame.views[0].kind == PANORAMIC:
        return []
    [view, *_] = frame.views
    surfaces = []
    for error in errors_px:
        update = terrain.update(
            Setting("px", error).criterion(base or Criterion()), [view], *frame.placement_and_heights
        )
        surfaces.append(update.surface)
    drawn = [_ProjectedSurface(surface, view, frame.placement) for surface in surfaces]
    width, height = (int(pixels) // SMALL for pixels in view.resolution)
    side = min(SIDE // SMALL, width, height)
    # The first and the last picture, SMALL times smaller, show where to look.
    whole = [picture.shade(0, 0, width, height, scale=1 / SMALL, lines=False) for picture in (drawn[0], drawn[-1])]
    x, y = _max_square(np.abs(whole[0] - whole[1]).sum(axis=2), side)
    box = SMALL * x, SMALL * y, SMALL * side, SMALL * side  # x, y, width and height in the frame, pixels
    results = []
    for error, picture in zip(errors_px, drawn, strict=True):
        left, bottom, wide, high = (SAMPLES * pixels for pixels in box)
        samples = picture.shade(left, bottom, wide, high, scale=SAMPLES, lines=True)
        # A pixel is the mean of SAMPLES x SAMPLES of the larger picture, against aliasing.
        colours = samples.reshape(high // SAMPLES, SAMPLES, -1, SAMPLES, 3).mean(axis=(1, 3))
        encoded = np.clip(colours, 0, 1) ** (1 / 2.2)  # for a display
        results.append(Crop(error, picture.triangles, np.round(255 * encoded[::-1]).astype(np.uint8)))
    return results


def _max_square(values: np.ndarray, side: int) -> tuple[int, int]:
    """Return column and row of the first pixel of the square of `side` x `side` pixels with the largest sum.

    values: float64 [rows, columns], row 0 below.
    """
    sums = np.pad(values.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))  # of all values below and to the left
    square_sums = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    row, column = np.unravel_index(square_sums.argmax(), square_sums.shape)
    return int(column), int(row)


class _ProjectedSurface:
    """A surface as a view sees it, in pixels. A triangle that reaches behind the eye is left out.

    `triangles`: number of all triangles, those left out included.
    """

    def __init__(self, surface: Surface, view: View, placement: np.ndarray | None) -> None:
        """Project a surface into the pixels of a view, not a panorama.

        placement: float64 [4, 4], terrain to world, None for identity.
        """
        camera = view.world_to_camera if placement is None else product(view.world_to_camera, placement)
        points = product(np.c_[surface.positions, np.ones(len(surface.positions))], camera.T)
        assert view.projection is not None  # a panorama has no crops
        clip = product(points, view.projection.T)
        perspective = view.kind == PERSPECTIVE
        ahead = clip[:, 3] > 0
        w = np.where(ahead, clip[:, 3], 1.0)  # depth of a perspective; 1 for an orthographic view
        self._pixels = (clip[:, :2] / w[:, None] + 1) / 2 * np.array(view.resolution)
        self._weight = 1 / w  # of values interpolated over a triangle
        self._depth_keys = 1 / w if perspective else points[:, 2]  # larger for nearer points
        self._normals = surface.normals
        self._corners = surface.triangles[ahead[surface.triangles].all(axis=1)]
        self.triangles = len(surface.triangles)

    def shade(self, x: int, y: int, width: int, height: int, scale: float, lines: bool) -> np.ndarray:
        """Return the pixels of one part of the frame, drawn `scale` times larger: the shaded surface below a plain sky.

        x, y: lower left corner of the part in the scaled frame, pixels. lines: whether to draw the edges of triangles,
        in the lower left half of the part; the other half shows the shading alone. The result is float64 [height,
        width, 3], linear, row 0 below.
        """
        vertices = np.c_[self._pixels * scale - (x, y), self._depth_keys]  # pixels of the part; a number, larger nearer
        ends = vertices[self._corners]
        low, high = ends.min(axis=1), ends.max(axis=1)
        is_in_part = (high[:, :2] > 0).all(axis=1) & (low[:, 0] < width) & (low[:, 1] < height)
        corners = np.ascontiguousarray(self._corners[is_in_part])
        # The triangle in each pixel, index of `corners`; -1 for the sky.
        shown_triangle = np.full(height * width, -1, np.int32)
        depth_keys = np.full(height * width, -np.inf)
        arrays = [shared(corners.reshape(-1), wp.int32), shared(vertices, wp.vec3d), width, height]
        arrays += [shared(depth_keys, wp.float64), shared(shown_triangle, wp.int32)]
        # The triangle with the largest depth key is shown. A thread draws a band of BAND rows.
        bands, threads = -(-height // int(kernels.BAND)), launch.default_threads()
        launch.spread(kernels.draw_triangles, bands, arrays, step="draw", threads=threads, cost=1e4)
        colours = np.broadcast_to(SKY, (height, width, 3)).copy()
        # Shade the pixels with ground: interpolate normals between a triangle's corners, then light them.
        rows, columns = np.divmod(np.flatnonzero(shown_triangle >= 0), width)
        hit_corners = corners[shown_triangle[shown_triangle >= 0]]
        weights, edge_px = _barycentric(vertices[hit_corners], columns + 0.5, rows + 0.5)
        weights = weights * self._weight[hit_corners]  # of the corners in space, not on screen
        normals = (self._normals[hit_corners] * weights[..., None]).sum(axis=1)
        normals /= np.sqrt((normals**2).sum(axis=1, keepdims=True))
        light = np.maximum(product(normals, SUN), 0)[:, None] * SUNLIGHT + (0.5 + 0.5 * normals[:, 2:]) * SKYLIGHT
        ground = light * GROUND
        if lines:
            is_lower_left = columns / width + rows / height < 1
            # Lines fade to 0 at 1.5 LINE_PX from an edge, over about one pixel, against aliasing.
            opacity = OPACITY * np.clip(1.5 * LINE_PX - edge_px, 0, 1) * is_lower_left
            ground += opacity[:, None] * (INK - ground)
        colours[rows, columns] = ground
        return colours


def _barycentric(ends: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return for points in triangles the weights of the corners, [n, 3], and the pixels to the nearest edge, [n].

    ends: corners of each point's triangle, [n, 3, >= 2], x and y first. x, y: the points, [n]. All in pixels.
    """
    corners, points = ends[..., :2], np.stack([x, y], axis=1)[:, None]
    from_, to = corners[:, (1, 2, 0)], corners[:, (2, 0, 1)]  # the edge across from each corner
    along, to_point = to - from_, points - from_
    # Twice the signed areas of the triangles of the point and an edge.
    twice_areas = along[..., 0] * to_point[..., 1] - along[..., 1] * to_point[..., 0]
    lengths = np.sqrt((along**2).sum(axis=2))
    return twice_areas / twice_areas.sum(axis=1, keepdims=True), np.abs(twice_areas / lengths).min(axis=1)
