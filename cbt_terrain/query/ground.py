# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights, `height * vertical_scale + vertical_offset`, normals and slopes at points, and along a line."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import warp as wp

from ...kernels.query import ground as kernels
from ..errors import TerrainError
from ..field.heightfield import HeightField, check_field
from ..plain_numbers import plain_number, vectors
from ..run import launch
from ..run.buffers import shared
from .surface import pack_surface

COST = 3.0  # times dearer than a lookup
MAX_PLACES = 50_000_000
FARTHEST = 1e100  # metres; squares of lengths are numbers still


class GroundSamples(NamedTuple):
    """Heights, normals and slopes of the ground at n points.

    `heights` float64 [n] metres, unit `normals` float64 [n, 3], `slopes` float64 [n] radians, `inside` bool [n]. Where
    there is no ground, in holes and beyond the raster, `inside` is False and the others are NaN.

    Normals and slopes are those of the mesh's vertices there: of a bilinear surface central differences, bilinear in
    between.
    """

    heights: np.ndarray
    normals: np.ndarray
    slopes: np.ndarray
    inside: np.ndarray


class Profile(NamedTuple):
    """Points along a line and their heights.

    `along` float64 [n] metres of the plan from its begin, `heights` float64 [n] metres, NaN where there is no ground,
    `places` float64 [n, 2] metres.
    """

    along: np.ndarray
    heights: np.ndarray
    places: np.ndarray


def ground_at(
    field: HeightField,
    places: np.ndarray,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    threads: int | None = None,
) -> GroundSamples:
    """Return the ground at points: heights, normals, slopes and whether there is ground. Raises TerrainError.

    places: float64 [n, 2], x and y in metres in the terrain's own space. A point on the border of a hole or of the
    raster is inside; so is one that float32 has rounded off the border. O(1) each.
    """
    surface, places = pack_surface(field, vertical_scale, vertical_offset), vectors(places, 2, "places")
    count = len(places)
    samples = GroundSamples(np.empty(count), np.empty((count, 3)), np.empty(count), np.empty(count, bool))
    kinds = wp.float64, wp.vec3d, wp.float64, wp.bool
    outputs = [shared(array, kind) for array, kind in zip(samples, kinds, strict=True)]
    inputs = [count, surface, shared(places, wp.vec2d), *outputs]
    blocks = -(-count // int(kernels.BLOCK))
    launch.spread(kernels.ground_at, blocks, inputs, step="query", threads=threads, cost=COST * int(kernels.BLOCK))
    return samples


def profile(
    field: HeightField,
    line: np.ndarray,
    spacing: float | None = None,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
) -> Profile:
    """Return heights along a line through the points `line`, float64 [m, 2] metres, m at least 2. Raises TerrainError.

    Without a spacing, they are at its points and wherever it crosses a line of samples, finer tiles' too; between two
    of these a bilinear surface is a parabola. With a spacing, they are every `spacing` metres from its beginning, and
    at its end; other points of `line` are then left out. Some points may come twice.
    """
    check_field(field)
    line = vectors(line, 2, "points of the line")
    if len(line) < 2:
        raise TerrainError(f"The line has {len(line)} points", expected="2 at least")
    if np.abs(line).max() > FARTHEST:
        what = f"The line goes {np.abs(line).max():g} m from the terrain's middle"
        raise TerrainError(what, expected=f"{FARTHEST:g} m at most")
    x, y = np.diff(line, axis=0).T
    lengths = np.sqrt(x * x + y * y)
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    spacing = plain_number(spacing, float | None, "The spacing of the profile")
    along, places = _crossings(field, line, ends) if spacing is None else _space_evenly(line, ends, spacing)
    return Profile(along, ground_at(field, places, vertical_scale, vertical_offset).heights, places)


def _check_count(count: float) -> None:
    """Raise TerrainError if a profile has more than MAX_PLACES points."""
    if count > MAX_PLACES:
        raise TerrainError(
            f"The profile would have {count:,.0f} places",
            expected=f"at most {MAX_PLACES:,}",
            fix="make the line shorter or give a larger spacing",
        )


def _space_evenly(line: np.ndarray, ends: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points every `spacing` metres, and the last point: metres along the line, [k], and x and y, [k, 2].

    line: float64 [m, 2], metres. ends: metres along the line at its points. Raises TerrainError for too many points and
    a spacing that is not positive.
    """
    if not (np.isfinite(spacing) and spacing > 0):
        raise TerrainError(f"The spacing of the profile is {spacing} metres", expected="a positive number")
    _check_count(ends[-1] / spacing)
    along = np.arange(0.0, ends[-1], spacing)
    along = np.append(along, ends[-1])
    return along, np.stack([np.interp(along, ends, line[:, axis]) for axis in (0, 1)], axis=1)


def _crossings(field: HeightField, line: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of a line and its crossings with lines of samples, in order along the line.

    The results are metres along the line, float64 [k], and x and y, float64 [k, 2], metres. A crossing at a sample,
    where two such lines meet, may come twice. line: float64 [n, 2], metres. ends: metres along the line at its n
    points. Raises TerrainError for too many points.
    """
    lattice = field.lattice
    finer = field.raster.finer
    parts = 1 << finer.bits if finer is not None else 1  # finer cells along the side of a raster cell
    corner, steps = np.array(lattice.rectangle()[:2]), np.array([lattice.step_x, lattice.step_y]) / parts
    # the points in finer cells from the raster's corner; those beyond the raster are moved onto its border
    cells = np.clip((line - corner) / steps, 0.0, (lattice.cells_x * parts, lattice.cells_y * parts))
    _check_count(float(np.abs(np.diff(cells, axis=0)).sum()) + len(line))
    along, places = [], []
    for segment, (a, b) in enumerate(pairwise(line)):
        fractions_by_axis, points_by_axis = [np.array([0.0])], [a[None]]
        for axis in (0, 1):
            low, high = sorted(cells[segment : segment + 2, axis])
            line_numbers = np.arange(np.ceil(low), np.floor(high) + 1)
            if a[axis] == b[axis] or not len(line_numbers):
                continue
            line_positions = corner[axis] + line_numbers * steps[axis]
            fractions = (line_positions - a[axis]) / (b[axis] - a[axis])
            points = a + fractions[:, None] * (b - a)
            points[:, axis] = line_positions  # to the last bit on the line of samples
            inner = (fractions > 0.0) & (fractions < 1.0)
            fractions_by_axis.append(fractions[inner])
            points_by_axis.append(points[inner])
        fractions, points = np.concatenate(fractions_by_axis), np.concatenate(points_by_axis)
        order = np.argsort(fractions, kind="stable")
        along.append(ends[segment] + fractions[order] * (ends[segment + 1] - ends[segment]))
        places.append(points[order])
    return np.append(np.concatenate(along), ends[-1]), np.concatenate([*places, line[-1:]])
