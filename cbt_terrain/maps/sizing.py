# SPDX-License-Identifier: GPL-3.0-or-later
"""How fine each tile has to be: its texels are no larger than the finest pixel that looks at it.

A tile's resolution follows from distances alone, so it stays while a camera turns.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from ..ask.linear import least_stretch, lengths, product
from ..ask.local_view import eye_of, frustum_planes
from ..ask.view import ORTHOGRAPHIC, View
from ..effects.effect import Asked
from ..errors import TerrainError
from ..field.heightfield import HeightField
from .tiling import LEAST, MOST, Tiling

# By steps of so much of an octave everything gets coarser until a budget is kept.
COARSER = 1 / 8
MEGABYTE = 1_000_000


def boxes(tiling: Tiling, field: HeightField, vertical_scale: float, vertical_offset: float) -> np.ndarray:
    """float64 [tiles, 2, 3] metres: what each tile's ground lies in, heights as displaced. Reads every sample."""
    lattice = field.lattice
    found = np.empty((len(tiling), 2, 3))
    for tile in range(len(tiling)):
        west, south, east, north = tiling.box(tile)
        columns = _samples((west, east), tiling.west, lattice.step_x, lattice.width)
        rows = _samples((south, north), tiling.south, lattice.step_y, lattice.height)
        # Whole rows of the file at a time, in the order that they have there.
        parts = [field.heights(row, columns) for row in range(rows.start, rows.stop)]
        heights = np.array([min(p.min() for p in parts), max(p.max() for p in parts)]) * vertical_scale
        heights += vertical_offset
        found[tile] = (west, south, heights.min()), (east, north, heights.max())
    return found


def _samples(ends: tuple[float, float], first: float, step: float, count: int) -> slice:
    """Samples from one end to the other."""
    low, high = math.floor((ends[0] - first) / step + 1e-6), math.ceil((ends[1] - first) / step - 1e-6)
    return slice(max(low, 0), min(high + 1, count))


def footprints(boxes: np.ndarray, views: Sequence[View], placement: np.ndarray, only_seen: bool = False) -> np.ndarray:
    """float64 [tiles] metres in the terrain's own space: the finest pixel that any of the views has on each tile.

    `boxes` as of `boxes`; `placement` float64 [4, 4] takes the terrain's space to the world. `only_seen`: a tile that
    is in no view's frame counts as infinitely far; else only the distance counts.
    """
    finest = np.full(len(boxes), np.inf)
    seen = np.zeros(len(boxes), bool)
    for view in views:
        finest = np.minimum(finest, _pixels(boxes, view, placement))
        seen |= _in_frame(boxes, view, placement)
    return np.where(seen, finest, np.inf) if only_seen else finest


def _pixels(boxes: np.ndarray, view: View, placement: np.ndarray) -> np.ndarray:
    """float64 [tiles] metres in the terrain's own space: of one view, where a box is nearest; never more than it is."""
    to_camera = product(view.world_to_camera, placement)
    linear = to_camera[:3, :3]
    stretch = lengths(linear)
    if view.kind == ORTHOGRAPHIC:
        distance = np.ones(len(boxes))
    else:
        eye = eye_of(to_camera)
        away = np.maximum(np.maximum(boxes[:, 0] - eye, eye - boxes[:, 1]), 0.0) * stretch
        # As in local_view.py: with shear a distance may be shorter than its axes say.
        distance = least_stretch(linear / stretch) * np.sqrt((away * away).sum(axis=1))
    return distance / (view.pixels_per_unit * max(stretch[0], stretch[1]))


def _in_frame(boxes: np.ndarray, view: View, placement: np.ndarray) -> np.ndarray:
    """bool [tiles]: False where a box is wholly on the outer side of one plane of the frame."""
    inside = np.ones(len(boxes), bool)
    for a, b, c, d in product(frustum_planes(view, (0.0, 0.0)), product(view.world_to_camera, placement)):
        normal = np.array([a, b, c])
        farthest = np.where(normal > 0, boxes[:, 1], boxes[:, 0])
        inside &= (farthest * normal).sum(axis=1) + d >= 0
    return inside


def resolutions(
    tiling: Tiling, footprints: np.ndarray, shown: np.ndarray, texel_bytes: int, budget_mb: float | None = None
) -> list[int]:
    """The side in texels of each tile's image: a power of two, so that a texel is no larger than the footprint.

    `footprints`, `shown`: metres, float64 [tiles], of what looks at them and of what there is (`shown_by`).
    `texel_bytes`: of a texel of all maps together, as Blender holds them. Where
    they would take more than `budget_mb`, all tiles get coarser alike. Raises TerrainError for one that is no limit.
    """
    if budget_mb is not None and not budget_mb > 0:
        raise TerrainError(f"The budget of the maps is {budget_mb} MB; expected more than 0.")
    # A tile that holds an eye has a footprint of 0, which no factor makes coarser.
    footprints = np.maximum(footprints, shown)
    coarser = 0.0
    while True:
        sides = [_side(tiling, metres * 2**coarser) for metres in footprints]
        total = sum(int(side * side) for side in sides) * texel_bytes
        if budget_mb is None or total <= budget_mb * MEGABYTE or max(sides) == LEAST:
            return sides
        coarser += COARSER


def shown_by(tiling: Tiling, field: HeightField, asked: Iterable[Asked]) -> np.ndarray:
    """float64 [tiles] metres: the finest that there is to show in each tile. Between samples the ground is smooth:
    images that are finer than the raster show no more of it, but of decals that lie there."""
    found = np.full(len(tiling), min(field.lattice.step_x, field.lattice.step_y))
    for decal in {decal for item in asked for decal in dict(item.parameters).get("decals", ())}:
        west, south, east, north = decal.box
        for tile in range(len(tiling)):
            box = tiling.box(tile)
            if west <= box[2] and box[0] <= east and south <= box[3] and box[1] <= north:
                found[tile] = min(found[tile], decal.pixel)
    return found


def _side(tiling: Tiling, metres: float) -> int:
    """Texels along a side of a tile whose texels are to be no larger than `metres`."""
    wanted = max(tiling.width, tiling.height) / tiling.inner / metres
    return min(1 << max(math.ceil(math.log2(max(wanted, LEAST)) - 1e-9), 0), MOST)
