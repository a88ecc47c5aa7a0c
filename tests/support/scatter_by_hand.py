# SPDX-License-Identifier: GPL-3.0-or-later
"""A scatter by asking every place of every tile, in numpy alone: no squares, nothing kept, frames by projection; points
that are too near over seams by trying all pairs."""

import math

import numpy as np
from adaptive_terrain.cbt_terrain.scatter.tile import POINTS, UNITS, tile
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC
from own_surface import bilinear


def places_by_hand(field, scatter):
    """Return ids, float64 ranks (before seams are resolved) and plan places, float64 [n, 2], of all candidates."""
    lattice, side = field.lattice, scatter.spacing * math.sqrt(POINTS)
    size = np.array([lattice.cells_x * lattice.step_x, lattice.cells_y * lattice.step_y])
    first = -size / 2 - side * np.array([scatter.seed * 0.7548776662466927 % 1, scatter.seed * 0.5698402909980532 % 1])
    tiles = int(size.max() / side) + 2
    numbers = [(column, row) for row in range(tiles + 1) for column in range(tiles + 1)]
    at = np.stack([np.add(number, pattern_by_hand(scatter.seed, *number)) for number in numbers])
    ranks, places = ranks_by_hand(at), first + side * at
    inside = (np.abs(places) <= size / 2).all(axis=2)
    tile_of = np.array([row * tiles + column for column, row in numbers])[:, None]
    return (tile_of * POINTS + np.arange(POINTS))[inside], ranks[inside], places[inside]


def scramble(value):
    """Hash with lowbias32."""
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        value = (value ^ value >> shift) * factor & 0xFFFFFFFF
    return value ^ value >> 16


def pattern_by_hand(seed, column, row):
    """Return a tile's points, float64 [POINTS, 2] in sides: the pattern shifted by eighths of a side."""
    drawn = scramble((scramble((row + seed) & 0xFFFFFFFF) + column) & 0xFFFFFFFF) >> 26
    return (tile().place / UNITS + np.array([drawn % 8, drawn // 8]) / 8) % 1


def ranks_by_hand(at):
    """Return the fractions of full density at which points appear, float64 [tiles, POINTS].

    There, two points of different tiles may be as near as each is to one of lower rank; a billion if that exceeds 1.
    at: places, [tiles, POINTS, 2], in sides.
    """
    found = np.tile(np.arange(0.5, POINTS), (len(at), 1))
    low = 0.5
    while low < POINTS:  # octave by octave: those of higher ranks keep less apart
        near = (np.abs(at - np.rint(at)) < 0.6 / math.sqrt(low)).any(axis=2)
        tiles, ranks = np.nonzero(near & (np.arange(POINTS) < 2 * low))
        key = ranks * len(at) + tiles
        late = np.flatnonzero(ranks >= low - 0.5)
        for some in np.array_split(late, 1 + len(late) // 500):
            apart2 = ((at[tiles[some], ranks[some]][:, None] - at[tiles, ranks]) ** 2).sum(axis=2)
            apart2[(key >= key[some][:, None]) | (tiles == tiles[some][:, None])] = np.inf
            found[tiles[some], ranks[some]] = np.maximum(ranks[some] + 0.5, 0.36 / apart2.min(axis=1))
        low *= 2
    return np.where(found > POINTS, 1e9, found / POINTS)


def heights_by_hand(field, places, vertical_scale=1.0, vertical_offset=0.0):
    lattice = field.lattice
    x = places[:, 0] / lattice.step_x + lattice.cells_x / 2
    y = places[:, 1] / lattice.step_y + lattice.cells_y / 2
    return bilinear(field.heights(), x, y) * vertical_scale + vertical_offset


def wanted_by_hand(scatter, points, views, placement):
    """Return the density that the views want at points [n, 3], and the distance from the nearest frame's border."""
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
