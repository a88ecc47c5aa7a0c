# SPDX-License-Identifier: GPL-3.0-or-later
"""Time of a scatter of a million points in a flight, against the same points computed in numpy."""

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.history.frame_history import FrameHistory
from ...cbt_terrain.scatter.points import ScatterRequest, place_points
from ...cbt_terrain.scatter.scatter import Scatter
from ...cbt_terrain.scatter.tile import FINEST, POINTS, SHIFTS, UNITS, shifts, tile
from ...cbt_terrain.view.linear import inverse
from ...cbt_terrain.view.local_view import frustum_planes
from ...cbt_terrain.view.view import View
from ..rig import scenes
from ..rig.measure import BenchmarkRow, alternate, stopwatch

SCATTER = Scatter(spacing=2.05, full_until=1500.0)
# Accepted fractions of points that differ by rounding, and of points that are pending where tiles meet.
ROUNDED, PENDING = 1e-5, 0.01


def scatter_flight_row(field: HeightField) -> BenchmarkRow:
    """Measure the next frame of a flight over the rough terrain; every run is another frame."""
    history, frames = FrameHistory(), iter(range(10_000))
    points, frame = None, 0

    def ours() -> dict[str, float]:
        nonlocal points, frame
        frame = next(frames)
        with stopwatch() as elapsed:
            points = place_points(field, ScatterRequest(SCATTER, [scenes.over(frame)]), history)
        return {"total": elapsed[0]}

    def plain() -> float:
        with stopwatch() as elapsed:
            ids_in_numpy(field, SCATTER, scenes.over(next(frames)))
        return elapsed[0]

    timed = alternate(ours, plain)
    check_points(points.id, ids_in_numpy(field, SCATTER, scenes.over(frame)))
    ms = timed.ms["total"]
    figures = {"points": len(points), "tested": points.tested, "ns_point": ms * 1e6 / len(points)}
    return BenchmarkRow("scatter_flight", len(points), ms, "numpy", timed.baseline_ms, figures=figures)


def check_points(ids: np.ndarray, expected: np.ndarray) -> None:
    """Raise TerrainError unless two sets of points agree but for rounding and pending points."""
    agreement = np.isin(ids, expected).mean()
    if agreement < 1 - ROUNDED or not 1 - PENDING < len(ids) / len(expected) < 1 + ROUNDED:
        raise TerrainError("A scatter has other points than the same in numpy")


def ids_in_numpy(field: HeightField, scatter: Scatter, view: View) -> np.ndarray:
    """Return the unsorted ids of the points in a view, found in the smallest squares of all tiles.

    Positions and sizes are computed as well. Seeds, rules, holes, a rotated terrain and the distance across seams are
    not supported.
    """
    lattice, side, squares = field.lattice, scatter.tile_side, 1 << FINEST
    west, south, east, north = lattice.rectangle()
    tiles, pattern, small = int(max(east - west, north - south) / side) + 2, tile(), side / squares
    planes = frustum_planes(view, (scatter.margin_deg, scatter.margin_deg)) @ view.world_to_camera
    eye = inverse(view.world_to_camera)[:3, 3]
    row, column = np.divmod(np.arange((tiles * squares) ** 2), tiles * squares)
    low = np.stack([west + column * small, south + row * small, np.full(len(row), field.min_height)], 1)
    high = low + (small, small, field.max_height - field.min_height)
    seen = (low[:, 0] <= east) & (low[:, 1] <= north)
    for plane in planes:
        seen &= np.where(plane[:3] > 0, high, low) @ plane[:3] + plane[3] >= 0
    row, column, low, high = row[seen], column[seen], low[seen], high[seen]
    near2 = (np.maximum(np.maximum(low - eye, eye - high), 0) ** 2).sum(1)
    density = 1.25 * np.minimum(1, scatter.full_until**2 / np.maximum(near2, 1e-9))
    ranks = np.ceil(POINTS * np.minimum(1, density)).astype(np.int64)
    number, inside = np.divmod(np.stack([column, row], 1).astype(np.int32), squares)
    shift = shifts(number, scatter.seed)
    window = pattern.windows(np.full(len(row), FINEST), inside, shift)
    count = pattern.count(FINEST, window, ranks)
    square = np.repeat(np.arange(len(row)), count)
    first = np.repeat(pattern.first[FINEST][window] - (np.cumsum(count) - count), count)
    rank = pattern.order[FINEST][np.arange(len(square)) + first]
    number = number[square]
    position = (west, south) + side * (number + (pattern.place[rank] / UNITS + shift[square] / SHIFTS) % 1)
    inside = (position <= (east, north)).all(1)
    position, rank, number = position[inside], rank[inside], number[inside]
    u, v = ((position - (west, south)) / (lattice.step_x, lattice.step_y)).T
    i, j = np.minimum(u.astype(int), lattice.width - 2), np.minimum(v.astype(int), lattice.height - 2)
    u, v, h = u - i, v - j, field.samples
    z = (h[j, i] * (1 - u) + h[j, i + 1] * u) * (1 - v) + (h[j + 1, i] * (1 - u) + h[j + 1, i + 1] * u) * v
    point = np.column_stack([position, z])
    wanted = np.minimum(1, scatter.full_until**2 / ((point - eye) ** 2).sum(1))
    for plane in planes:
        wanted[point @ plane[:3] + plane[3] < 0] = 0
    r = (rank + 0.5) / POINTS
    growth = np.clip((1.25 * wanted - r) / (0.25 * r), 0, 1)
    size = growth * growth * (3 - 2 * growth)
    exists = (1.25 * wanted > r) & np.isfinite(size)
    return (number[exists, 1] * tiles + number[exists, 0]) * POINTS + rank[exists]
