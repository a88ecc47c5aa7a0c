# SPDX-License-Identifier: GPL-3.0-or-later
"""Images and objects' shadows as files that masks of land effects are read from: arrays named for their content."""

import hashlib
import math
from pathlib import Path

import numpy as np
from mathutils import Matrix

from ...cbt_terrain.errors import unwritable
from ...cbt_terrain.run.owned_files import is_real_file, open_folder
from ...cbt_terrain.run.partial_files import written_beside
from ..bridge.cleanup import plan_triangles
from ..bridge.evaluated import anchor_of, evaluated_or_still
from ..layers.images import painted_of

SHADOW_SIDE = 512  # samples of a shadow along the terrain's longer side
FINE = 4  # points along a side of each sample, whose covered fraction is its value: the border of a shadow is soft


def write_image_mask(image, folder: Path) -> str:
    """Write the red channel of an image as a mask file, first row in the north; return its path.

    folder: where masks are stored, named for their content, so that an unchanged mask has the same path. Raises
    TerrainError for an image that cannot be read or a folder that cannot be written.
    """
    painted = painted_of(image, "of a mask")
    return _write_once(folder, painted.digest, lambda: painted.values[::-1])


def write_shadow_mask(obj, terrain, extent_m: tuple[float, float], depsgraph, folder: Path) -> str:
    """Write a mask that is 1 where the mesh `obj` is above or below the terrain, 0 elsewhere; return its path.

    At the outline it is the covered fraction; the first row is in the north. terrain: evaluated object. extent_m: its
    size in metres, from west to east and from south to north. folder: where masks are stored, named for their content.
    Raises TerrainError if the object's shape in this frame is unknown: Blender has not evaluated it, because it is
    hidden, and it may have changed.
    """
    evaluated, matrix = evaluated_or_still(depsgraph, obj, "mask")
    triangles = plan_triangles(evaluated, matrix, Matrix(terrain.matrix_world).inverted_safe(), "mask")
    triangles += anchor_of(terrain)  # from metres about the object's origin to metres about the raster's middle
    content = repr(extent_m).encode() + triangles.tobytes()
    digest = hashlib.blake2b(content, digest_size=16).hexdigest()
    return _write_once(folder, digest, lambda: rasterize_shadow(triangles, extent_m)[::-1])


def _write_once(folder: Path, digest: str, make) -> str:
    """Write a float32 array to `folder`/`digest`.npy unless the file exists; return its path.

    digest: of the array's content or of all that determines it. make: returns the array; called only if the file is
    missing. Raises TerrainError.
    """
    path = folder / f"{digest}.npy"
    if is_real_file(path):
        return str(path)
    try:
        with open_folder(folder, make=True):
            pass  # it is created
        with written_beside(path) as partial, open(partial, "wb") as file:
            np.save(file, np.ascontiguousarray(make(), np.float32))
    except OSError as reason:
        elsewhere = "pack the store into a folder that can be written"
        raise unwritable(f"The mask {path}", reason, elsewhere) from reason
    return str(path)


def rasterize_shadow(triangles: np.ndarray, extent_m: tuple[float, float]) -> np.ndarray:
    """Return the fraction of each sample that triangles cover on the plan, float32 [rows, columns], row 0 in the south.

    triangles: float64 [n, 3, 2], metres from the middle of the terrain. extent_m: its size from west to east and from
    south to north. The longer side has SHADOW_SIDE samples.
    """
    longer = max(extent_m)
    columns, rows = (max(2, math.ceil(SHADOW_SIDE * length / longer)) for length in extent_m)
    covered = np.zeros((rows * FINE, columns * FINE), bool)  # FINE points along each side of a sample
    scale = np.array([columns * FINE / extent_m[0], rows * FINE / extent_m[1]])
    corners = (triangles + np.array(extent_m) / 2) * scale - 0.5  # point [0, 0] is half a spacing inside the border
    for triangle in corners:
        _mark_inside(covered, triangle)
    return covered.reshape(rows, FINE, columns, FINE).mean(axis=(1, 3), dtype=np.float32)


def _mark_inside(covered: np.ndarray, triangle: np.ndarray) -> None:
    """Set the points of a grid, bool [rows, columns], inside or on a triangle, float64 [3, 2] in columns and rows.

    Its corners may be in either order and beyond the grid.
    """
    shape = np.array(covered.shape[::-1])
    low = np.clip(np.ceil(triangle.min(axis=0)), 0, shape).astype(int)
    high = np.clip(np.floor(triangle.max(axis=0)) + 1, 0, shape).astype(int)
    if (low >= high).any():
        return
    x, y = np.arange(low[0], high[0])[None, :], np.arange(low[1], high[1])[:, None]
    sides = []
    for (ax, ay), (bx, by) in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        sides.append((bx - ax) * (y - ay) - (by - ay) * (x - ax))  # cross product: its sign is the side of the edge
    inside = np.logical_and.reduce([side >= 0 for side in sides]) | np.logical_and.reduce([side <= 0 for side in sides])
    covered[low[1] : high[1], low[0] : high[0]] |= inside
