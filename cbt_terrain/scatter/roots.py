# SPDX-License-Identifier: GPL-3.0-or-later
"""Points on the mesh of a terrain in place of its surface: their roots touch what is drawn, and move with it."""

from dataclasses import replace

import numpy as np

from ..mesh.surface import Surface
from ..terrain import Terrain
from .points import Points


def on_mesh(points: Points, terrain: Terrain, surface: Surface) -> Points:
    """The points at the heights that the terrain's last surface has there; normals stay those of the ground.

    Where that has no triangle they stay where they are.
    """
    places = points.positions[:, :2].astype(np.float64)
    number = terrain.triangles_at(places)
    there = np.flatnonzero(number >= 0)
    a, b, c = (surface.positions[surface.triangles[number[there], k]].astype(np.float64) for k in range(3))
    (ux, uy), (vx, vy), (px, py) = (b - a)[:, :2].T, (c - a)[:, :2].T, (places[there] - a[:, :2]).T
    area = ux * vy - uy * vx
    s, t = (px * vy - py * vx) / area, (ux * py - uy * px) / area
    positions = points.positions.copy()
    positions[there, 2] = a[:, 2] + s * (b - a)[:, 2] + t * (c - a)[:, 2]
    return replace(points, positions=positions)
