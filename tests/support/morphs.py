# SPDX-License-Identifier: GPL-3.0-or-later
"""Where rising points have to be, by code that knows nothing of how they rise: means of whole meshes, and a recursion
over every triangle of a small field."""

import numpy as np
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import mesh_heights
from reference_criterion import correction, reference_pixels

# Points that rise at once: as the criterion without a morph, except outside the frame.
AT_ONCE = 1.0 + 1e-9


def weight(ratio, k: float):
    """Return the smoothstep of (1 - 1 / ratio) / (1 - 1 / k)."""
    u = np.clip((1 - 1 / np.maximum(ratio, 1.0)) / (1 - 1 / k), 0.0, 1.0)
    return u * u * (3 - 2 * u)


def mean_ratio(k: float, parts: int = 4000) -> float:
    """Mean of the ratio by the weight, by the trapezoidal rule."""
    ratio = np.linspace(1.0, k, parts + 1)
    return float((np.diff(weight(ratio, k)) * (ratio[1:] + ratio[:-1]) / 2).sum())


def means_of_meshes(field: HeightField, criterion: Criterion, views, plane, parts: int, **placed) -> list[np.ndarray]:
    """Return the means of the heights of `parts` and of 3 * `parts` meshes at points [n, 2], float64 [n] each.

    The meshes go from the finest to k times its error. The middle of a part is that of one of its thirds.
    """
    k, terrain, heights = criterion.morph, Terrain(field, 1), []
    for u in (np.arange(3 * parts) + 0.5) / (3 * parts):
        factor = 1 / (1 - u * (1 - 1 / k)) / mean_ratio(k)
        asked = {name: getattr(criterion, name) * factor for name in ("error_px", "edge_px", "error_m")}
        area = criterion.area_px * factor**2
        coarser = Criterion(**{**vars(criterion), **asked, "area_px": area, "morph": AT_ONCE})
        heights.append(mesh_heights(terrain.update(coarser, views, **placed).surface, plane))
    ends = np.linspace(0.0, 1.0, 3 * parts + 1)
    weights = ends * ends * (3 - 2 * ends)
    return [np.diff(weights[::3]) @ heights[1::3], np.diff(weights) @ heights]


def risen_points(field: HeightField, view: View, error_px: float, k: float, rounded: float) -> tuple[dict, dict]:
    """Return the heights, metres, and the unit normals of all split vertices above the raster's cells and of the
    corners, by sample (column, row)."""
    lattice, heights = field.lattice, field.samples.astype(np.float64)
    slope_y, slope_x = np.gradient(heights, lattice.step_y, lattice.step_x)
    own = _unit(np.stack([-slope_x, -slope_y, np.ones_like(heights)], axis=-1))
    side, ends = 1 << lattice.levels, {}
    triangles = []
    for x in range(0, lattice.columns * side, side):
        for y in range(0, lattice.rows * side, side):
            sw, se, nw, ne = (x, y), (x + side, y), (x, y + side), (x + side, y + side)
            triangles += [(nw, sw, se), (se, ne, nw)]
    z = {corner: heights[corner[1], corner[0]] for triangle in triangles for corner in triangle}
    normals = {corner: own[corner[1], corner[0]] for corner in z}
    times = correction(view, error_px) * mean_ratio(k) / error_px
    for depth in range(1, 2 * lattice.levels + 1):
        for left, _, right in triangles:
            x, y = middle = (left[0] + right[0]) // 2, (left[1] + right[1]) // 2
            ends.setdefault(middle, (left, right))
            if middle not in z:
                surplus = heights[y, x] - (heights[left[1], left[0]] + heights[right[1], right[0]]) / 2
                ratio = reference_pixels(field, view, x, y, depth, rounded) * times
                w = weight(ratio, k)
                z[middle] = (z[left] + z[right]) / 2 + w * surplus
                normals[middle] = _unit((1 - w) * (normals[left] + normals[right]) / 2 + w * own[y, x])
        halves = [(t, ((t[0][0] + t[2][0]) // 2, (t[0][1] + t[2][1]) // 2)) for t in triangles]
        triangles = [half for (left, apex, right), m in halves for half in ((left, m, apex), (apex, m, right))]
    return z, normals


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
