# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh against the reference surface in metres: at every sample, along every edge, at any points.

Vertices have integer coordinates, in units of 2^-bits of a sample's spacing (`MeshGround.bits`), and so have points, in
units of 2^-(bits + POINT_BITS). The origin is the domain's south-west corner; `point_ends` is its north-east corner.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import warp as wp

from ...kernels.accuracy import edges as edge_kernels
from ...kernels.accuracy import facets as kernels
from ...kernels.accuracy import grid as grid_kernels
from ...kernels.accuracy import points as point_kernels
from ..errors import TerrainError
from ..field import codes, displacement_layers
from ..field.heightfield import PLANE_BITS, HeightField, check_field
from ..mesh.surface import Surface, check_surface
from ..plain_numbers import vertical
from ..run import launch
from ..run.buffers import shared
from ..view.linear import add_up, lengths

POINT_BITS = int(point_kernels.POINT_BITS)
ROWS = 256  # rows of samples that are looked at together
BLOCK = 1 << 20  # values that are squared together, so that temporary arrays stay small

Progress = Callable[[float], None]


def ignore_progress(_fraction: float) -> None:
    """Do nothing; the default where progress is reported."""


@dataclass(frozen=True)
class Errors:
    """One distribution of errors, none negative: all 0 where `count` is 0.

    `p95`, `p999`: 95 % and 99.9 % are at most this.
    """

    count: int
    max: float
    p95: float
    p999: float
    mean: float
    rms: float


NONE = Errors(0, 0.0, 0.0, 0.0, 0.0, 0.0)


def errors_of(values: np.ndarray) -> Errors:
    """Return the distribution (count, largest, quantiles, mean, root mean square) of the magnitudes of `values`.

    values: float32 or float64, changed in place: they become their magnitudes, in another order.
    """
    values = values.reshape(-1)
    if not values.size:
        return NONE
    np.abs(values, out=values)
    p95_index = -(-values.size * 95 // 100) - 1  # in ascending order
    values.partition(p95_index)
    highest = np.sort(values[p95_index:])
    p999_index = -(-values.size * 999 // 1000) - 1 - p95_index  # among the highest
    mean = float(np.sum(values, dtype=np.float64)) / values.size
    blocks = (values[first : first + BLOCK] for first in range(0, values.size, BLOCK))
    squares = add_up(float(np.sum(np.square(block, dtype=np.float64))) for block in blocks)
    quantiles = float(highest[-1]), float(highest[0]), float(highest[p999_index])
    return Errors(values.size, *quantiles, mean, float(np.sqrt(squares / values.size)))


def _ground_in(valid: np.ndarray, rows: slice) -> np.ndarray:
    """Return which samples of some rows are ground: those of a cell without a missing corner, bool [rows, columns].

    valid: uint8 [height, width], 0 where a sample is missing. rows: may end beyond the last row.
    """
    below = max(rows.start - 1, 0)  # first row of the cells that these rows are corners of
    corners = np.lib.stride_tricks.sliding_window_view(valid[below : rows.stop + 1], (2, 2))
    is_whole_cell = np.pad(corners.all(axis=(2, 3)), 1)
    is_ground = np.lib.stride_tricks.sliding_window_view(is_whole_cell, (2, 2)).any(axis=(2, 3))
    return is_ground[rows.start - below :][: rows.stop - rows.start]


class MeshGround:
    """The reference surface of a height field as the kernels of the measurement read it; its samples are not copied.

    `key`: equal for equal surfaces. `bits`: coordinates of vertices are multiples of 2^-bits of a sample's spacing.
    """

    def __init__(self, field: HeightField, vertical_scale: float, vertical_offset: float, threads: int) -> None:
        """Pack the reference surface of a height field for kernels, at a vertical scale and offset (metres).

        threads: their number for the launches of the measurement.
        """
        check_field(field)
        lattice = field.lattice
        self.field, self.threads = field, threads
        self.scale, self.offset = vertical(vertical_scale, vertical_offset)
        self.key = (field.key, self.scale, self.offset)
        # Coordinates of the finest mesh that a terrain may have, which needs PLANE_BITS bits for the whole raster.
        self.bits = PLANE_BITS - lattice.side_bits - lattice.levels
        packed = self.packed = kernels.Reference()
        packed.bits = self.bits
        packed.bicubic = int(field.interpolation == "bicubic")
        finer = field.finer
        # Curved: extrema have no closed form. `parts` are the terms of the displacement.
        packed.curved = int(packed.bicubic or bool(field.parts) or finer is not None)
        packed.max_detail = field.max_change
        if finer is not None:
            packed.has_finer, packed.finer = 1, finer.packed
        packed.layers = displacement_layers.pack_layers(field.detail, field.finest_edge, lattice)
        packed.step_x, packed.step_y = lattice.step_x, lattice.step_y
        packed.west, packed.south, _, _ = lattice.rectangle()
        packed.scale, packed.offset = self.scale, self.offset
        packed.samples = codes.pack_samples(field.samples, field.steps)

    @property
    def point_ends(self) -> tuple[int, int]:
        """Return the coordinates of the domain's north-east corner, in the integer units of points.

        A unit is 2^-(bits + POINT_BITS) of a sample's spacing.
        """
        lattice = self.field.lattice
        return (lattice.width - 1) << self.bits + POINT_BITS, (lattice.height - 1) << self.bits + POINT_BITS

    def random_points(self, count: int, seed: int) -> np.ndarray:
        """Return int64 [count, 2]: random points of the domain, borders included, in the units of `point_ends`."""
        return np.random.default_rng(seed).integers(0, np.array(self.point_ends) + 1, (count, 2))


class MeasuredMesh:
    """A surface as delivered, ready to be walked over a ground.

    `triangles`: their number. `covered`: samples that the mesh covers, bool [height, width], once `differences` has
    found holes; None for all of them.
    """

    def __init__(self, ground: MeshGround, surface: Surface) -> None:
        """Pack a surface for kernels. Raises TerrainError for an empty mesh or one that is not finite."""
        check_surface(surface)
        self.ground, self.triangles = ground, len(surface.corner_verts) // 3
        if not len(surface.positions) or not np.isfinite(surface.positions).all():
            raise TerrainError("The mesh has no vertices or positions that are not finite", expected="a finite mesh")
        self.covered: np.ndarray | None = None
        m = self.packed = kernels.DeliveredMesh()
        m.positions, m.normals = shared(surface.positions, wp.vec3f), shared(surface.normals, wp.vec3f)
        m.corners = shared(surface.corner_verts, wp.int32)
        self._surface = surface
        self._cuts = self._even_cuts(surface)

    def _even_cuts(self, surface: Surface) -> list[int]:
        """Return the cuts of the list of triangles between threads, from 0 to the number of triangles.

        They are even by the number of samples in the triangles' boxes; equal cuts are listed once.
        """
        threads = self.ground.threads if self.triangles >= 2 else 1
        low = high = surface.positions[surface.corner_verts[::3], :2]
        for corner in (1, 2):
            positions = surface.positions[surface.corner_verts[corner::3], :2]
            low, high = np.minimum(low, positions), np.maximum(high, positions)
        lattice = self.ground.field.lattice
        extent = (high - low) / np.array([lattice.step_x, lattice.step_y], np.float32)  # in spacings of samples
        # At most extent + 1 samples are in a side of the box; the rest stands for the triangle's own cost.
        work = np.cumsum((extent[:, 0] + 2) * (extent[:, 1] + 2), dtype=np.float64)
        inner = np.searchsorted(work, work[-1] * np.arange(1, threads) / threads)
        return sorted({0, *inner.tolist(), self.triangles})

    def walk(self, kernel: wp.Kernel, arrays: list) -> None:
        """Launch `kernel` over all triangles, divided among threads.

        It takes the first and the end of the triangles, ground, mesh and `arrays`.
        """
        inputs = self.ground.packed, self.packed, *arrays
        launch.slices(kernel, [[*piece, *inputs] for piece in pairwise(self._cuts)], step="measure")

    def differences(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mesh minus reference at every sample, float32 [height, width] metres, rounded toward zero.

        Also return the largest magnitude at the samples of each triangle, float64 [T]. Raises TerrainError where the
        mesh does not cover every sample. With holes it sets `covered` instead, and samples that the mesh does not cover
        or that are no ground are 0.
        """
        difference = np.full(self.ground.field.samples.shape, np.nan, np.float32)
        worst = np.zeros(self.triangles)
        self.walk(kernels.differences, [shared(difference.reshape(-1), wp.float32), shared(worst, wp.float64)])
        valid = self.ground.field.valid
        if valid is not None:
            self.covered = np.empty(valid.shape, bool)
            for first in range(0, len(valid), ROWS):
                rows = slice(first, first + ROWS)
                self.covered[rows] = _ground_in(valid, rows) & ~np.isnan(difference[rows])
                difference[rows][~self.covered[rows]] = 0.0
        # a sum is not a number as soon as one part is not, and takes no memory
        if np.isnan(np.sum(difference, dtype=np.float64)):
            missing = int(np.isnan(difference).sum())
            raise TerrainError(
                f"The mesh does not cover {missing} samples of the terrain",
                expected="all covered",
                fix="measure the whole mesh of this terrain",
            )
        return difference, worst

    def raise_to_maxima(self, worst: np.ndarray) -> np.ndarray:
        """Raise `worst` (float64 [T], metres) from that at samples to the maximum over each triangle.

        Returns float64 [T]: metres of height by which float32 may have moved a corner of each. Over a cell a bilinear
        reference is a saddle, so mesh minus reference has its extrema at samples and on the triangles' edges, where it
        is a parabola in each cell: the maximum is exact. For a bicubic reference, or one with detail, it is the largest
        at the samples, at 8 points of each edge in each cell and at 4 x 4 points of each cell, or of the box of a
        triangle that is smaller.
        """
        rounding = np.zeros(self.triangles)
        self.walk(edge_kernels.raise_to_maxima, [shared(worst, wp.float64), shared(rounding, wp.float64)])
        if self.ground.packed.curved:
            self.walk(grid_kernels.grid_extremes, [shared(worst, wp.float64)])
        return rounding

    def differences_at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return mesh minus reference at points, float64 [n] metres, and the triangle that covers each.

        The former is 0 and the latter, int32 [n], -1 where none does. points: int64 [n, 2], integer coordinates.
        """
        g, count = self.ground, len(points)
        difference, owner = np.zeros(count), np.full(count, -1, np.int32)
        x, y = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
        key = np.zeros(count, np.int64)
        inputs = [*g.point_ends, *(shared(a, wp.int64) for a in (x, y, key))]
        launch.spread(point_kernels.compute_morton_keys, count, inputs, step="measure", threads=g.threads)
        order = np.argsort(key)  # the points of a square are contiguous, so a triangle looks at few others
        key = key[order]
        p = point_kernels.MeasuredPoints()
        p.count, p.difference, p.owner = count, shared(difference, wp.float64), shared(owner, wp.int32)
        p.x, p.y, p.key, p.order = (shared(a, wp.int64) for a in (x, y, key, order))
        self.walk(point_kernels.locate, [p])
        return difference, owner

    def normals_at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the unit vertex normals interpolated at points, float64 [n, 3], and the triangle that covers each.

        The latter is int32 [n], -1 where none does; the normal there has no meaning. points: int64 [n, 2], in units of
        2^-(ground.bits + POINT_BITS) samples from the south-west corner.
        """
        _, owner = self.differences_at(points)
        packed, s = self.ground.packed, self._surface
        corners = s.triangles[np.maximum(owner, 0)]
        metres = points * (np.array([packed.step_x, packed.step_y]) / 2.0 ** (self.ground.bits + POINT_BITS))
        ends = s.positions[corners, :2] - (metres + [packed.west, packed.south])[:, None]
        (ax, ay), (bx, by), (cx, cy) = (ends[:, k].T for k in range(3))
        # The weight of a corner is the area between the point and the other two corners.
        areas = np.stack([bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx], axis=1)
        normals = (s.normals[corners] * areas[..., None]).sum(axis=1)
        return normals / lengths(normals.T)[:, None], owner
