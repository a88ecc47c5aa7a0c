# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh against the reference surface in pixels of a view.

The error of a reference point in the frame is the distance between its projection and that of the mesh's point above or
below it; of a panorama the angle between the two over `radians_per_pixel`. Points are every raster sample in the frame
and the point seen in the middle of each pixel. A point is in the frame if it is between its borders and inside the clip
range (depth; distance of a panorama); a range that is upside down cuts nothing off in front of the eye. A panorama is
assumed to see all around, and its pixels to be equirectangular.

A sample is hidden where the reference surface between the clip start and it rises above its ray, or falls below where
the eye is underneath, by more than 1e-9 of the surface's range of heights (1e-12 of the heights themselves). A mesh
point of a perspective nearer than half the clip start, where the criterion bounds no error, counts at the point where
the vertical way to it reaches that depth: the error stays finite, and understated. Where the reference itself is nearer
than 1e-9 of the terrain's size, the error counts as 0; no error counts as more than 1e30, the largest bound.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import warp as wp

from ...kernels.accuracy import rays as ray_kernels
from ...kernels.accuracy import screen as screen_kernels
from ..errors import TerrainError, check_kind
from ..field.blocks import concatenate_levels, halvings, over_cells
from ..plain_numbers import matrix
from ..run import launch
from ..run.buffers import shared
from ..view.linear import inverse, length, lengths, product
from ..view.view import KINDS, ORTHOGRAPHIC, PANORAMIC, View
from .mesh import POINT_BITS, Errors, MeshGround, Progress, errors_of, ignore_progress

# Samples between two calls of on_progress, and pixels.
BLOCK = 1 << 20


def pack_blocks(ground: MeshGround) -> ray_kernels.HeightBlocks:
    """Return the lowest and highest heights of blocks of 4 x 4 cells, of 8 x 8 and so on up to one block.

    Bilinear heights are between the samples of a cell. Bicubic ones are beyond those around it by at most 9/32 of their
    range, the sum of the samples' negative weights. ground: the reference surface.
    """
    # `around`: 1 where bicubic heights also depend on the samples around a cell, 0 for bilinear ones.
    around, heights = int(ground.packed.bicubic), ground.field.heights()
    low, high = (over_cells(heights, side=4, reduce=reduce, around=around) for reduce in (np.minimum, np.maximum))
    if ground.packed.curved:  # between its samples a surface may be higher or lower than all of them
        margin = ground.packed.max_detail + around * 0.28125 * (high.astype(np.float64) - low)  # 9/32
        low = np.nextafter((low - margin).astype(np.float32), np.float32(-np.inf))
        high = np.nextafter((high + margin).astype(np.float32), np.float32(np.inf))
    # `base`, `width`: first block and number of columns of each level, the same in both pyramids. Level 1 is the
    # blocks of 4 x 4 cells; level 0, single cells, has no blocks, and its entries are 0.
    lows, base, width = concatenate_levels(halvings(low, np.minimum), below=1)
    highs, _, _ = concatenate_levels(halvings(high, np.maximum), below=1)
    z_range = sorted(float(h[-1]) * ground.scale + ground.offset for h in (lows, highs))
    b = ray_kernels.HeightBlocks()
    b.levels, b.low_z, b.high_z = len(base) - 1, *z_range
    # A ray is blocked only by ground higher than it by more than this, metres.
    b.tolerance = max(1e-9 * (z_range[1] - z_range[0]), 1e-12 * max(abs(z) for z in z_range))
    b.base, b.width = shared(base, wp.int64), shared(width, wp.int32)
    b.low, b.high = shared(lows, wp.float32), shared(highs, wp.float32)
    return b


def pack_eye(view: View, placement: np.ndarray, ground: MeshGround) -> screen_kernels.Eye:
    """Return the view for the kernels of the measurement: from cells and metres of height to the camera and back.

    placement: float64 [4, 4], terrain to world. ground: the terrain, which gives the size of cells and the range of
    heights. Raises TerrainError if the camera or the terrain cannot be inverted.
    """
    g = ground.packed
    from_cells = np.diag([g.step_x, g.step_y, 1.0, 1.0])
    from_cells[:2, 3] = g.west, g.south
    to_view = product(product(view.world_to_camera, placement), from_cells)
    try:
        from_view = inverse(to_view)
    except np.linalg.LinAlgError:
        from_view = np.full((4, 4), np.inf)
    if not np.isfinite(to_view).all() or not np.isfinite(from_view).all():
        raise TerrainError(
            "The camera or the terrain cannot be inverted",
            expected="finite scales other than 0",
            fix="change their scale",
        )
    culls = view.clip[0] < view.clip[1]
    start = view.clip[0] if culls else (-np.inf if view.kind == ORTHOGRAPHIC else 0.0)
    relief = (ground.field.max_height - ground.field.min_height) * ground.scale
    size = np.array([g.samples.columns - 1, g.samples.rows - 1, relief])
    e = screen_kernels.Eye()
    e.kind = KINDS.index(view.kind)
    e.right, e.up, e.back = to_view[:3]
    e.half_width, e.half_height = view.resolution[0] / 2, view.resolution[1] / 2
    e.start, e.end = start, view.clip[1] if culls else np.inf
    # Nearer than half the clip start, or than 1e-9 of the terrain's size (the box diagonal in camera space), the
    # criterion bounds no error, so none is measured there; 1e-150 keeps the depth above 0.
    e.near = max(start / 2, 1e-9 * length(lengths(to_view[:3, :3]) * size), 1e-150)
    # The eye's position, and the direction from the ground to an orthographic eye, in cells and metres of height.
    e.eye, e.toward = from_view[:3, 3], from_view[:3, 2]
    # The ray through (x, y), -1 .. 1 in the frame: its origin and direction are 3 x 3 matrices times (1, x, y). Only a
    # panorama has `axes`, the camera's axes as columns: its directions follow from angles.
    e.direction, e.axes = (np.zeros((3, 3)) for _ in range(2))
    origin = np.c_[from_view[:3, 3], np.zeros((3, 2))]  # the eye for all x and y
    e.origin = origin
    if view.kind == PANORAMIC:
        e.pixels_per_radian, e.axes = 1.0 / view.radians_per_pixel, from_view[:3, :3]
        return e
    assert view.projection is not None  # only a panorama has none
    p = view.projection
    e.to_x, e.to_y, e.to_w = p[0], p[1], p[3]  # rows of the projection: x and y of the frame are x / w and y / w
    # A lens shift moves the middle of the frame by a constant (column 3) if orthographic, else by a multiple of the
    # depth, which is -z (column 2).
    column = 3 if view.kind == ORTHOGRAPHIC else 2
    sign = -1.0 if view.kind == ORTHOGRAPHIC else 1.0
    shift = sign * p[0, column] / p[0, 0], sign * p[1, column] / p[1, 1]
    # A point (1, x, y) of the frame to camera space at depth 1, or to metres across and up.
    to_camera = np.array([[shift[0], 1 / p[0, 0], 0], [shift[1], 0, 1 / p[1, 1]]])
    sideways = product(from_view[:3, :2], to_camera)
    ahead = np.c_[-from_view[:3, 2], np.zeros((3, 2))]
    if view.kind == ORTHOGRAPHIC:
        e.origin, e.direction = origin + sideways, ahead
    else:
        e.direction = ahead + sideways
    return e


def pixel_grid(view: View) -> tuple[int, int]:
    """Return columns and rows of pixels: those of the frame; of a panorama at most all directions."""
    columns, rows = (max(1, int(np.floor(pixels))) for pixels in view.resolution)
    if view.kind == PANORAMIC:
        columns = min(columns, int(np.ceil(2 * np.pi / view.radians_per_pixel)))
        rows = min(rows, int(np.ceil(np.pi / view.radians_per_pixel)))
    return columns, rows


class Sight:
    """A view's sight of the reference surface, independent of a mesh: one serves all meshes of a view."""

    def __init__(self, ground: MeshGround, view: View, placement: np.ndarray | None) -> None:
        """Prepare measurements in the pixels of a view; `placement`: terrain to world, None for identity."""
        check_kind(view, View, "The view", "a View or None")
        placement = np.eye(4) if placement is None else matrix(placement, "placement")
        self.key = (ground.key, view.key(), placement.tobytes())
        self.ground, self.eye = ground, pack_eye(view, placement, ground)
        self.columns, self.rows = pixel_grid(view)
        self._pixels: np.ndarray | None = None  # result of `pixel_points`
        self._state: np.ndarray | None = None  # result of `states`

    @cached_property
    def blocks(self) -> ray_kernels.HeightBlocks:
        """Return the lowest and highest heights of blocks of the surface, by which rays skip empty space."""
        return pack_blocks(self.ground)

    def points_at(self, places: np.ndarray) -> np.ndarray:
        """Return the point of the surface seen at each point of the frame: int64 [n, 2], -1 in the sky.

        Points are integers in units of 2^-(ground.bits + POINT_BITS) of a sample's spacing, from the south-west corner.
        places: float64 [n, 2], pixels from the frame's middle.
        """
        x, y = np.zeros(len(places), np.int64), np.zeros(len(places), np.int64)
        inputs = [self.ground.packed, self.blocks, self.eye, shared(places, wp.vec2d)]
        self._launch(screen_kernels.seen_points, len(x), [*inputs, shared(x, wp.int64), shared(y, wp.int64)], cost=50.0)
        return np.stack([x, y], axis=1)

    def pixel_points(self, on_progress: Progress = ignore_progress) -> np.ndarray:
        """Return the point of the surface seen in the middle of each pixel, int64 [rows * columns, 2], row 0 below.

        Units are 2^-(ground.bits + POINT_BITS) of a sample's spacing; x is -1 in the sky. Computed on first use.
        """
        if self._pixels is None:
            points = np.zeros((self.rows * self.columns, 2), np.int64)
            for row, places in pixel_blocks(self.columns, self.rows):
                points[row * self.columns :][: len(places)] = self.points_at(places)
                on_progress((row * self.columns + len(places)) / len(points))
            self._pixels = points
        return self._pixels

    def visible_points(self) -> np.ndarray:
        """Return the surface's point behind each pixel that sees the surface, int64 [n, 2] as of `points_at`."""
        points = self.pixel_points()
        return points[points[:, 0] >= 0]

    def covered(self) -> np.ndarray:
        """Return whether each pixel sees the surface and not the sky, bool [rows, columns]."""
        return (self.pixel_points()[:, 0] >= 0).reshape(self.rows, self.columns)

    def states(self, on_progress: Progress = ignore_progress) -> np.ndarray:
        """Return OUTSIDE (the frame), VISIBLE or HIDDEN for each sample, uint8 [height * width]; cached."""
        if self._state is None:
            height, width = self.ground.field.samples.shape
            state = np.zeros(height * width, np.uint8)
            for row, rows in _row_blocks(height, width):
                inputs = [row, self.ground.packed, self.blocks, self.eye, shared(state, wp.uint8)]
                self._launch(screen_kernels.visibility, rows, inputs, cost=20.0 * width)
                on_progress((row + rows) / height)
            self._state = state
        return self._state

    def errors(self, before: np.ndarray, after: np.ndarray, at_visible: Sequence[np.ndarray]) -> tuple[Errors, Errors]:
        """Return how far points move on screen, in pixels, between two heights: visible points, and hidden ones.

        The maximum of the visible ones is over samples and the points seen in pixels. The other figures are over the
        latter, if any, so by area on the screen: samples are dense far away. Hidden points are samples, so by area on
        the ground.

        before, after: float32 [height, width], metres above the reference at every sample. at_visible: both again, at
        `visible_points`, float64 [n] each.
        """
        visible, hidden, states = [], [], self.states()
        (height, width), bits = before.shape, self.ground.bits + POINT_BITS
        for row, rows in _row_blocks(height, width):
            start, end = row * width, (row + rows) * width
            indices = start + np.flatnonzero(states[start:end] != int(screen_kernels.OUTSIDE))
            # Columns and rows of samples, as integers in units of 2^-bits of a sample's spacing.
            points = np.stack([indices % width, indices // width], axis=1) << bits
            pixels = self._pixels_between(points, *(a.reshape(-1)[indices].astype(np.float64) for a in (before, after)))
            visible.append(pixels[states[indices] == int(screen_kernels.VISIBLE)])
            hidden.append(pixels[states[indices] == int(screen_kernels.HIDDEN)])
        seen, samples = errors_of(self.point_errors(*at_visible)), errors_of(np.concatenate(visible))
        of_visible = seen if seen.count else samples
        of_visible = replace(of_visible, count=seen.count + samples.count, max=max(seen.max, samples.max))
        return of_visible, errors_of(np.concatenate(hidden))

    def point_errors(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Return pixels between two displaced copies of each visible point, float32 [n].

        before, after: heights of the copies, float64 [n] metres above the reference.
        """
        return self._pixels_between(self.visible_points(), before, after)

    def _pixels_between(self, points: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Return by how many pixels points move on screen if their heights change, float32 [n].

        points: int64 [n, 2], in units of 2^-(ground.bits + POINT_BITS) of a sample's spacing, anywhere in the frame.
        before, after: float64 [n], metres above the reference.
        """
        pixels = np.zeros(len(points), np.float32)
        inputs = [self.ground.packed, self.eye]
        inputs += [shared(np.ascontiguousarray(points[:, k]), wp.int64) for k in (0, 1)]
        inputs += [shared(a, wp.float64) for a in (before, after)] + [shared(pixels, wp.float32)]
        self._launch(screen_kernels.point_errors, len(points), inputs, cost=4.0)
        return pixels

    def _launch(self, kernel: wp.Kernel, count: int, inputs: list, cost: float) -> None:
        """Launch a kernel over `count` items on the ground's threads.

        cost: of an item, relative to a lookup and a few operations; small jobs stay on one thread.
        """
        launch.spread(kernel, count, inputs, step="measure", threads=self.ground.threads, cost=cost)


def pixel_blocks(columns: int, rows: int) -> Iterator[tuple[int, np.ndarray]]:
    """Yield blocks of whole rows, of at most BLOCK pixels or one row: the first row, and the pixels' middles.

    The middles are float64 [n, 2], in pixels from the frame's middle.
    """
    for row, num_rows in _row_blocks(rows, columns):
        places = np.empty((num_rows, columns, 2))
        places[..., 0] = np.arange(columns) + (0.5 - columns / 2)
        places[..., 1] = np.arange(row, row + num_rows)[:, None] + (0.5 - rows / 2)
        yield row, places.reshape(-1, 2)


def _row_blocks(rows: int, columns: int) -> Iterator[tuple[int, int]]:
    """Yield first row and number of rows of blocks of at most BLOCK items, or of one row if that has more."""
    at_once = max(1, BLOCK // columns)
    return ((row, min(at_once, rows - row)) for row in range(0, rows, at_once))
