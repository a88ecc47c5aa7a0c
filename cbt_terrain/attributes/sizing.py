# SPDX-License-Identifier: GPL-3.0-or-later
"""Resolution of tiles: texels are no larger than the finest pixel footprint on the tile.

It depends on distances alone, so that it does not change when a camera rotates.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from ..errors import TerrainError
from ..field.cell_ranges import rectangle_ranges
from ..field.heightfield import HeightField
from ..view.linear import lengths, min_stretch, product
from ..view.local_view import eye_of, frustum_planes
from ..view.view import ORTHOGRAPHIC, View
from .attribute import AttributeRequest
from .finer_pyramid import is_finer, min_level
from .tiling import MAX_SIDE, MIN_SIDE, Tiling

# Steps in octaves by which all tiles get coarser until they fit into a budget.
COARSER = 1 / 8
MEGABYTE = 1_000_000


def boxes(tiling: Tiling, field: HeightField, vertical_scale: float, vertical_offset: float) -> np.ndarray:
    """Return a box around each tile's ground without its detail, float64 [tiles, 2, 3] metres: lowest, highest corner.

    The heights come from stored ranges. tiling: how the raster is divided into tiles. Heights are multiplied by
    `vertical_scale`, then `vertical_offset` metres are added.
    """
    lattice = field.lattice
    corners = np.empty((tiling.rows, tiling.columns, 2, 3))
    sides = []
    for axis, first, size, count, step in (
        (0, tiling.west, tiling.width, tiling.columns, lattice.step_x),
        (1, tiling.south, tiling.height, tiling.rows, lattice.step_y),
    ):
        low = first + np.arange(count) * size
        ends = np.stack([low, low + size], axis=1)
        corners[..., axis] = ends if axis == 0 else ends[:, None]
        sides.append((ends - first) / step)  # in samples
    heights = rectangle_ranges(field, *sides) * vertical_scale + vertical_offset
    corners[..., 2] = np.sort(heights, axis=-1)
    return corners.reshape(-1, 2, 3)


def footprints(
    boxes: np.ndarray, views: Sequence[View], placement: np.ndarray, only_seen: bool = False, nearest: float = 0.0
) -> np.ndarray:
    """Return the finest pixel footprint of any view on each tile, float64 [tiles] metres in the terrain's space.

    `boxes`: float64 [tiles, 2, 3], lowest and highest corner of each tile's ground, metres. `placement`: float64 [4,
    4], maps the terrain's space to the world. `only_seen`: a tile outside of every view's frame has an infinite
    footprint; otherwise only the distance counts. `nearest`: shorter distances count as this, metres.
    """
    finest = np.full(len(boxes), np.inf)
    seen = np.zeros(len(boxes), bool)
    for view in views:
        finest = np.minimum(finest, _footprints(boxes, view, placement, nearest))
        seen |= _in_frame(boxes, view, placement)
    return np.where(seen, finest, np.inf) if only_seen else finest


def _footprints(boxes: np.ndarray, view: View, placement: np.ndarray, nearest: float) -> np.ndarray:
    """Return the footprint of one view at the nearest point of each box, or less, float64 [tiles] metres.

    boxes: lowest and highest corners in the terrain's space, float64 [tiles, 2, 3] metres. placement: matrix from there
    to the world. nearest: shortest distance that counts, metres in the terrain's space. A pixel covers 1 /
    `pixels_per_unit` camera units at distance 1; in an orthographic view, at any distance.
    """
    to_camera = product(view.world_to_camera, placement)
    linear = to_camera[:3, :3]
    stretch = lengths(linear)  # camera units per metre along x, y and z
    if view.kind == ORTHOGRAPHIC:
        distance = np.ones(len(boxes))
    else:
        eye = eye_of(to_camera)
        away = np.maximum(np.maximum(boxes[:, 0] - eye, eye - boxes[:, 1]), 0.0) * stretch
        # Shear may make a distance shorter than its components suggest, by at most this factor.
        distance = min_stretch(linear / stretch) * np.sqrt((away * away).sum(axis=1))
        distance = np.maximum(distance, nearest * stretch.min())
    # The axis of larger stretch has the smaller footprint on the ground.
    return distance / (view.pixels_per_unit * max(stretch[0], stretch[1]))


def _in_frame(boxes: np.ndarray, view: View, placement: np.ndarray) -> np.ndarray:
    """Return which boxes may be in a view's frame: those that no plane of it has completely outside, bool [tiles].

    boxes: float64 [tiles, 2, 3], lowest and highest corners in the terrain's space, metres. placement: matrix from
    there to the world.
    """
    inside = np.ones(len(boxes), bool)
    to_camera = product(view.world_to_camera, placement)
    for a, b, c, d in product(frustum_planes(view, margins=(0.0, 0.0)), to_camera):  # positive on the inside
        normal = np.array([a, b, c])
        farthest = np.where(normal > 0, boxes[:, 1], boxes[:, 0])  # the box's corner that is furthest inside
        inside &= (farthest * normal).sum(axis=1) + d >= 0
    return inside


def resolutions(
    tiling: Tiling, footprints: np.ndarray, finest_content: np.ndarray, texel_bytes: int, budget_mb: float | None = None
) -> list[int]:
    """Return the side of each tile's image in texels, a power of two from MIN_SIDE to MAX_SIDE.

    A texel is no larger than the footprint, as far as MAX_SIDE and the budget allow. `footprints`: of pixels on each
    tile, float64 [tiles] metres; a texel need not be smaller than `finest_content` (`shown_by`). `texel_bytes`: bytes
    of one texel in Blender, summed over all maps. If images exceed `budget_mb`, all tiles get coarser. Raises
    TerrainError for an invalid budget. tiling: the tiles of the maps.
    """
    if budget_mb is not None and not budget_mb > 0:
        raise TerrainError(f"The budget of the maps is {budget_mb} MB", expected="more than 0")
    # A tile around an eye has a footprint of 0, which no factor makes coarser.
    footprints = np.maximum(footprints, finest_content)
    coarser = 0.0
    while True:
        sides = [_side(tiling, metres * 2**coarser) for metres in footprints]
        total = sum(int(side * side) for side in sides) * texel_bytes
        if budget_mb is None or total <= budget_mb * MEGABYTE or max(sides) == MIN_SIDE:
            return sides
        coarser += COARSER


def shown_by(tiling: Tiling, field: HeightField, requests: Iterable[AttributeRequest]) -> np.ndarray:
    """Return the size of the finest content of each tile: samples, finer ones too, or pixels of decals.

    The result is float64 [tiles] in metres. tiling: the tiles of the maps. requests: the attributes that maps are made
    of.
    """
    raster, spacing = field.raster, min(field.lattice.step_x, field.lattice.step_y)
    finer = np.array([is_finer(raster, tiling.box(tile)) for tile in range(len(tiling))])
    finest = np.where(finer, spacing * 2.0 ** min_level(raster), spacing)
    for decal in {decal for request in requests for decal in dict(request.parameters).get("decals", ())}:
        west, south, east, north = decal.box
        for tile in range(len(tiling)):
            box = tiling.box(tile)
            if west <= box[2] and box[0] <= east and south <= box[3] and box[1] <= north:
                finest[tile] = min(finest[tile], decal.pixel)
    return finest


def _side(tiling: Tiling, metres: float) -> int:
    """Return the texels along a side of a tile with texels of at most `metres`."""
    needed = max(tiling.width, tiling.height) / tiling.inner / metres
    exponent = math.ceil(math.log2(max(needed, MIN_SIDE)) - 1e-9)  # 1e-9: rounding must not double a power of two
    return min(1 << max(exponent, 0), MAX_SIDE)
