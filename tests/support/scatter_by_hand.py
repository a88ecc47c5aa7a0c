# SPDX-License-Identifier: GPL-3.0-or-later
"""A scatter by asking every place of every tile, in numpy alone: no squares, nothing kept, frames by projection."""

import math

import numpy as np
from adaptive_terrain.cbt_terrain.ask.view import ORTHOGRAPHIC, PANORAMIC
from adaptive_terrain.cbt_terrain.scatter.tile import POINTS, UNITS, tile
from own_surface import bilinear


def places_by_hand(field, scatter):
    """Ids, ranks and plan places, float64 [n, 2], of every point that there could be on the raster."""
    lattice, side = field.lattice, scatter.spacing * math.sqrt(POINTS)
    size = np.array([lattice.cells_x * lattice.step_x, lattice.cells_y * lattice.step_y])
    first = -size / 2 - side * np.array([scatter.seed * 0.7548776662466927 % 1, scatter.seed * 0.5698402909980532 % 1])
    tiles = int(size.max() / side) + 2
    ids, ranks, places = [], [], []
    for row in range(tiles):
        for column in range(tiles):
            at = first + side * (np.array([column, row]) + tile().place / UNITS)
            inside = (np.abs(at) <= size / 2).all(axis=1)
            ids.append((row * tiles + column) * POINTS + np.flatnonzero(inside))
            ranks.append((np.flatnonzero(inside) + 0.5) / POINTS)
            places.append(at[inside])
    return np.concatenate(ids), np.concatenate(ranks), np.concatenate(places)


def heights_by_hand(field, places, vertical_scale=1.0, vertical_offset=0.0):
    lattice = field.lattice
    x = places[:, 0] / lattice.step_x + lattice.cells_x / 2
    y = places[:, 1] / lattice.step_y + lattice.cells_y / 2
    return bilinear(field.heights(), x, y) * vertical_scale + vertical_offset


def wanted_by_hand(scatter, points, views, placement):
    """How much the views want at points [n, 3], and how far inside or outside the nearest frame's rim each is."""
    want = np.zeros(len(points)) if views else np.ones(len(points))
    clearance = np.full(len(points), np.inf)
    for view in views:
        at = np.column_stack([points, np.ones(len(points))]) @ (view.world_to_camera @ placement).T
        sides = np.full((1, len(points)), np.inf)
        if view.kind != PANORAMIC:
            clip = at @ view.projection.T
            sides = np.array([clip[:, 3] - clip[:, 0], clip[:, 3] + clip[:, 0], clip[:, 3] - clip[:, 1],
                              clip[:, 3] + clip[:, 1], view.clip[1] + at[:, 2],
                              -at[:, 2] - (view.clip[0] if view.kind == ORTHOGRAPHIC else 0.0)])  # fmt: skip
        distance = np.linalg.norm(at[:, :3], axis=1) * (view.kind != ORTHOGRAPHIC)
        full = scatter.full_until or np.inf
        ramp = np.minimum(1.0, (full / np.maximum(distance, 1e-9)) ** 2)
        want = np.maximum(want, np.where((sides >= 0).all(axis=0), ramp, 0.0))
        clearance = np.minimum(clearance, np.abs(sides).min(axis=0))
    return want, clearance


def grown_by_hand(want, rank):
    part = np.clip((1.25 * want - rank) / (0.25 * rank), 0, 1)
    return part * part * (3 - 2 * part)
