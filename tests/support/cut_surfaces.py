# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces to be cut, and checks that hold for any part of one."""

from functools import cache

import numpy as np
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from fields import rough


def surface_of(seed: int, error_m: float, meshlet: int, step: float = 10.0):
    """Return a surface in new arrays."""
    return _surface(seed, error_m, meshlet, step).copy()


@cache
def _surface(seed: int, error_m: float, meshlet: int, step: float):
    field = rough(33, 65, seed, step=step)
    return Terrain(field, 1).update(Criterion(error_px=0.0, error_m=error_m, meshlet=meshlet)).surface


def assert_welded(surface) -> np.ndarray:
    """Assert that indices fit, nothing is loose or double, and every triangle faces up; returns the border's edges."""
    corners, sides = surface.triangles, surface.corner_edges.reshape(-1, 3)
    assert (np.bincount(corners.ravel(), minlength=len(surface.positions)) > 0).all() and corners.min() >= 0
    assert corners.max() < len(surface.positions) and len(surface.normals) == len(surface.uv) == len(surface.positions)
    uses = np.bincount(sides.ravel(), minlength=len(surface.edges))
    assert len(uses) == len(surface.edges) and uses.min() >= 1 and uses.max() <= 2
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    assert np.array_equal(np.sort(ends, axis=1), np.sort(surface.edges, axis=1)[sides.ravel()])
    assert len(np.unique(np.sort(surface.edges, axis=1), axis=0)) == len(surface.edges)
    assert len(np.unique(ends, axis=0)) == len(ends), "two triangles run an edge the same way"
    assert len(np.unique(surface.positions, axis=0)) == len(surface.positions)
    assert areas(surface).min() > 0 and np.isfinite(surface.uv).all()
    assert np.abs(np.linalg.norm(surface.normals.astype(np.float64), axis=1) - 1).max() < 1e-6
    return surface.edges[uses == 1]


def areas(surface) -> np.ndarray:
    """float64 [T]: areas in plan."""
    p = surface.positions[:, :2].astype(np.float64)[surface.triangles]
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    return 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
