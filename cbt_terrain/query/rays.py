# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays against a surface `height * vertical_scale + vertical_offset`: the first hit, and the nearest hit of a line."""

from typing import NamedTuple

import numpy as np
import warp as wp

from ...kernels.query import rays as kernels
from ..errors import TerrainError
from ..field.heightfield import HeightField
from ..plain_numbers import vectors
from ..run import launch
from ..run.buffers import shared
from .surface import height_ranges_of, pack_surface

COST = 50.0  # times dearer than a lookup
AT_ONCE = 1 << 18  # between two launches the work can be stopped


class Hits(NamedTuple):
    """Of n rays: `distance` float64 [n] metres, infinite without a hit; `points` float64 [n, 3] metres, NaN without."""

    distance: np.ndarray
    points: np.ndarray


def pick(
    field: HeightField,
    origins: np.ndarray,
    directions: np.ndarray,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    threads: int | None = None,
) -> Hits:
    """Return where rays first meet the surface, from above or from below. Raises TerrainError.

    origins, directions: float64 [n, 3] in the terrain's own space, metres; directions have any length but 0. A ray that
    begins on the surface hits it there. A ray that only touches it hits it, one through a hole does not. Hits are exact
    up to float64 rounding: on a bilinear surface a root is solved for, on others it is enclosed
    (kernels/query/crossing.py).
    """
    origins, directions = _check_rays(origins, directions)
    surface = pack_surface(field, vertical_scale, vertical_offset)
    distance = np.empty(len(origins))
    height_ranges = height_ranges_of(field, surface)
    for first in range(0, len(origins), AT_ONCE):
        block = slice(first, first + AT_ONCE)
        rays = [shared(array[block], wp.vec3d) for array in (origins, directions)]
        inputs = [surface, height_ranges, *rays, shared(distance[block], wp.float64)]
        launch.spread(kernels.pick, len(distance[block]), inputs, step="query", threads=threads, cost=COST)
    return _hits(origins, directions, distance)


def nearest(
    field: HeightField,
    points: np.ndarray,
    directions: np.ndarray,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    threads: int | None = None,
) -> Hits:
    """Return the nearest hit on the lines through points, ahead or behind.

    points, directions: float64 [n, 3] in the terrain's own space, metres; directions have any length but 0. `distance`
    is negative for a hit against the direction. Of two hits as near, the one ahead counts.
    """
    points, directions = _check_rays(points, directions)
    options = vertical_scale, vertical_offset, threads
    ahead = pick(field, points, directions, *options).distance
    behind = pick(field, points, -directions, *options).distance
    return _hits(points, directions, np.where(behind < ahead, -behind, ahead))


def _check_rays(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return origins and directions, float64 [n, 3], with directions of length 1.

    Raises TerrainError for other shapes or a direction of length 0.
    """
    origins, directions = vectors(origins, 3, "origins of rays"), vectors(directions, 3, "directions of rays")
    if len(origins) != len(directions):
        what = f"There are {len(origins)} origins of rays and {len(directions)} directions"
        raise TerrainError(what, expected="one each")
    largest = np.abs(directions).max(axis=1, initial=0.0)
    if not largest.all():
        zero = int(np.argmin(largest != 0.0))
        raise TerrainError(
            f"Number {zero} of the directions of rays is (0, 0, 0)", expected="a direction", fix="give it a length"
        )
    directions = directions / largest[:, None]  # squares neither overflow nor vanish
    x, y, z = directions.T
    return origins, directions / np.sqrt(x * x + y * y + z * z)[:, None]


def _hits(origins: np.ndarray, directions: np.ndarray, distance: np.ndarray) -> Hits:
    """Return the hits at distances along rays; positions are NaN where a ray hits nothing.

    origins, directions: float64 [n, 3]. distance: float64 [n] metres, infinite where a ray hits nothing.
    """
    is_hit = np.isfinite(distance)[:, None]
    with np.errstate(invalid="ignore"):
        return Hits(distance, np.where(is_hit, origins + distance[:, None] * directions, np.nan))
