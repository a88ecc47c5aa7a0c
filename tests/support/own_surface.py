# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a mesh is from a raster's own bilinear surface, in numpy alone: at samples, between, and along cell edges."""

import numpy as np


def distances(raster, step_x, step_y, positions, corner_verts, parts=4):
    """float64 [(h - 1) * parts + 1, (w - 1) * parts + 1]: metres at points `parts` a cell; NaN where no triangle is.

    raster: heights, row 0 south, its middle at the origin of `positions`. Triangles may reach beyond it.
    """
    height, width = raster.shape
    far = np.full(((height - 1) * parts + 1, (width - 1) * parts + 1), np.nan)
    for x, y, mesh in mesh_points(raster.shape, step_x, step_y, positions, corner_verts, parts):
        np.fmax.at(far, (y, x), np.abs(mesh - bilinear(raster, x / parts, y / parts)))
    return far


def mesh_points(shape, step_x, step_y, positions, corner_verts, parts=4):
    """Yield columns and rows of points, `parts` a cell of a raster of this shape, and the mesh's heights there."""
    height, width = shape
    across, up = (width - 1) * parts, (height - 1) * parts
    xy = positions[:, :2].astype(np.float64) / (step_x / parts, step_y / parts) + (across / 2, up / 2)
    z = positions[:, 2].astype(np.float64)
    triangles = np.asarray(corner_verts).reshape(-1, 3)
    low = np.maximum(np.ceil(xy[triangles].min(1) - 1e-6).astype(int), 0)
    high = np.minimum(np.floor(xy[triangles].max(1) + 1e-6).astype(int), (across, up))
    sizes = high - low + 1
    for size in np.unique(sizes[(sizes > 0).all(1)], axis=0):
        chosen = np.flatnonzero((sizes == size).all(1))
        for few in np.array_split(chosen, len(chosen) * size[0] * size[1] // 2**22 + 1):
            i, j = (a.ravel() for a in np.meshgrid(np.arange(size[0]), np.arange(size[1])))
            x, y = low[few, :1] + i, low[few, 1:] + j
            a, b, c = (xy[triangles[few, k]][:, None] for k in range(3))
            area = (b - a)[..., 0] * (c - a)[..., 1] - (b - a)[..., 1] * (c - a)[..., 0]
            u = ((x - a[..., 0]) * (c - a)[..., 1] - (y - a[..., 1]) * (c - a)[..., 0]) / area
            v = ((b - a)[..., 0] * (y - a[..., 1]) - (b - a)[..., 1] * (x - a[..., 0])) / area
            inside = (u >= -1e-6) & (v >= -1e-6) & (u + v <= 1 + 1e-6)
            za, zb, zc = (z[triangles[few, k]][:, None] for k in range(3))
            yield x[inside], y[inside], (za + (zb - za) * u + (zc - za) * v)[inside]


def bilinear(raster, x, y):
    """Return the heights of the surface at arrays of columns and rows."""
    i = np.clip(x.astype(int), 0, raster.shape[1] - 2)
    j = np.clip(y.astype(int), 0, raster.shape[0] - 2)
    u, v, h = x - i, y - j, np.asarray(raster, np.float64)
    south = h[j, i] * (1 - u) + h[j, i + 1] * u
    return south * (1 - v) + (h[j + 1, i] * (1 - u) + h[j + 1, i + 1] * u) * v
