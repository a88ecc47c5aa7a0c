# SPDX-License-Identifier: GPL-3.0-or-later
"""What scatter costs beside the same in numpy: a million points of a first frame, and of the next of a flight."""

import numpy as np

from ...cbt_terrain.ask.criterion import Criterion
from ...cbt_terrain.ask.linear import inverse
from ...cbt_terrain.ask.local_view import frustum_planes
from ...cbt_terrain.ask.view import View
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.scatter.points import Scatterer
from ...cbt_terrain.scatter.scatter import Scatter
from ...cbt_terrain.scatter.tile import FINEST, POINTS, SHIFTS, UNITS, shifts, tile
from ..rig import scenes
from ..rig.measure import Row, alternate, stopwatch

SCATTER = Scatter(spacing=2.05, full_until=1500.0)
# Of points, that rounding may have on the other side of what is wanted; and that wait where tiles meet.
UNSURE, WAITING = 1e-5, 0.01


def scatter_rows(field: HeightField):
    """`field`: as of scenes.rough. Each frame of either row has moved on."""
    found, frames = {}, iter(range(10_000))

    def ours(scatterer: Scatterer) -> dict[str, float]:
        found["frame"] = next(frames)
        with stopwatch() as elapsed:
            found["ours"] = scatterer.points([scenes.over(found["frame"])])
        return {"total": elapsed[0]}

    def plain() -> float:
        found["frame"] = next(frames)
        with stopwatch() as elapsed:
            found["numpy"] = ids_in_numpy(field, SCATTER, scenes.over(found["frame"]))
        return elapsed[0]

    kept = Scatterer(field, SCATTER)
    for name, make in (("scatter", lambda: Scatterer(field, SCATTER)), ("scatter_flight", lambda: kept)):
        timed = alternate(lambda make=make: ours(make()), plain)
        points = found["ours"]
        expected = ids_in_numpy(field, SCATTER, scenes.over(found["frame"]))
        known = np.isin(points.id, expected).mean()
        if known < 1 - UNSURE or not 1 - WAITING < len(points) / len(expected) < 1 + UNSURE:
            raise TerrainError("A scatter has other points than the same in numpy.")
        figures = {"points": len(points), "tested": points.tested, "ns_point": timed.ms["total"] * 1e6 / len(points)}
        yield Row(name, len(points), timed.ms["total"], "numpy", timed.baseline_ms, figures=figures)


def ids_in_numpy(field: HeightField, scatter: Scatter, view: View) -> np.ndarray:
    """Ids, unsorted, of the points that a view sees, by the smallest squares of all tiles; their positions and sizes
    are computed as well. Without a seed, rules, holes or a turned terrain, and without what keeps seams apart."""
    lattice, side, squares = field.lattice, scatter.tile_side, 1 << FINEST
    west, south, east, north = lattice.rectangle()
    tiles, own, small = int(max(east - west, north - south) / side) + 2, tile(), side / squares
    planes = frustum_planes(view, Criterion(guard_deg=scatter.margin_deg).guard_deg) @ view.world_to_camera
    eye = inverse(view.world_to_camera)[:3, 3]
    row, column = np.divmod(np.arange((tiles * squares) ** 2), tiles * squares)
    low = np.stack([west + column * small, south + row * small, np.full(len(row), field.min_height)], 1)
    high = low + (small, small, field.max_height - field.min_height)
    seen = (low[:, 0] <= east) & (low[:, 1] <= north)
    for plane in planes:
        seen &= np.where(plane[:3] > 0, high, low) @ plane[:3] + plane[3] >= 0
    row, column, low, high = row[seen], column[seen], low[seen], high[seen]
    near2 = (np.maximum(np.maximum(low - eye, eye - high), 0) ** 2).sum(1)
    there = 1.25 * np.minimum(1, scatter.full_until**2 / np.maximum(near2, 1e-9))
    ranks = np.ceil(POINTS * np.minimum(1, there)).astype(np.int64)
    number, inside = np.divmod(np.stack([column, row], 1).astype(np.int32), squares)
    shift = shifts(number, scatter.seed)
    window = own.windows(np.full(len(row), FINEST), inside, shift)
    count = own.count(FINEST, window, ranks)
    which = np.repeat(np.arange(len(row)), count)
    first = np.repeat(own.first[FINEST][window] - (np.cumsum(count) - count), count)
    rank = own.order[FINEST][np.arange(len(which)) + first]
    number = number[which]
    place = (west, south) + side * (number + (own.place[rank] / UNITS + shift[which] / SHIFTS) % 1)
    inside = (place <= (east, north)).all(1)
    place, rank, number = place[inside], rank[inside], number[inside]
    u, v = ((place - (west, south)) / (lattice.step_x, lattice.step_y)).T
    i, j = np.minimum(u.astype(int), lattice.width - 2), np.minimum(v.astype(int), lattice.height - 2)
    u, v, h = u - i, v - j, field.samples
    z = (h[j, i] * (1 - u) + h[j, i + 1] * u) * (1 - v) + (h[j + 1, i] * (1 - u) + h[j + 1, i + 1] * u) * v
    at = np.column_stack([place, z])
    want = np.minimum(1, scatter.full_until**2 / ((at - eye) ** 2).sum(1))
    for plane in planes:
        want[at @ plane[:3] + plane[3] < 0] = 0
    r = (rank + 0.5) / POINTS
    grown = np.clip((1.25 * want - r) / (0.25 * r), 0, 1)
    size = grown * grown * (3 - 2 * grown)
    there = (1.25 * want > r) & np.isfinite(size)
    return (number[there, 1] * tiles + number[there, 0]) * POINTS + rank[there]
