# SPDX-License-Identifier: GPL-3.0-or-later
"""What queries of the built-in island cost on one thread, beside the plainest numpy that answers the same."""

from collections.abc import Callable, Iterator

import numpy as np

from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.island import SIDE
from ...cbt_terrain.query.ground import ground_at
from ...cbt_terrain.query.rays import pick
from ...cbt_terrain.query.viewshed import viewshed
from ..rig import scenes
from ..rig.measure import Row, alternate, stopwatch

PLACES = 1_000_000
RAYS = 640, 360
MARCHED = 500  # of the rays: numpy visits a thousand places of each
ABOVE = 300.0  # metres over the ground, from where rays are cast
SEEN_M = 500.0  # how far an eye looks


def query_rows() -> Iterator[Row]:
    """Heights and normals at places in order, the first hits of a camera's rays, and what an eye sees."""
    field = scenes.built_in_island()
    yield _heights(field)
    eye = np.array([0.1, -0.4, 0.0]) * SIDE
    eye[2] = ground_at(field, eye[:2]).heights[0] + ABOVE
    yield _rays(field, eye)
    yield _sight(field, eye)


def _ms(work: Callable[[], object]) -> float:
    with stopwatch() as elapsed:
        work()
    return elapsed[0]


def _heights(field: HeightField) -> Row:
    """The plain way gives heights alone; ours normals and slopes, too."""
    side = int(PLACES**0.5)
    line = np.linspace(-0.1, 0.1, side) * SIDE
    places = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    mixed = np.random.default_rng(0).uniform(-0.5, 0.5, places.shape) * SIDE
    timed = alternate(
        lambda: {"total": _ms(lambda: ground_at(field, places, threads=1))}, lambda: _ms(lambda: _plain(field, places))
    )
    ms = timed.ms["total"]
    random_ms = min(_ms(lambda: ground_at(field, mixed, threads=1)) for _ in range(3))
    figures = {"ns_place": 1e6 * ms / len(places), "ns_random": 1e6 * random_ms / len(places)}
    return Row("query_heights", len(places), ms, "numpy", timed.baseline_ms, figures=figures)


def _plain(field: HeightField, places: np.ndarray) -> np.ndarray:
    """Bilinear heights in whole arrays, not a number beyond the rim."""
    lattice, h = field.lattice, field.samples
    cells = places / (lattice.step_x, lattice.step_y) + np.array([lattice.cells_x, lattice.cells_y]) / 2
    inside = ((cells >= 0) & (cells <= (lattice.cells_x, lattice.cells_y))).all(axis=1)
    i, j = np.clip(cells.astype(np.int64), 0, (lattice.cells_x - 1, lattice.cells_y - 1)).T
    s, t = cells[:, 0] - i, cells[:, 1] - j
    low, high = h[j, i] * (1 - s) + h[j, i + 1] * s, h[j + 1, i] * (1 - s) + h[j + 1, i + 1] * s
    return np.where(inside, low * (1 - t) + high * t, np.nan)


def _rays(field: HeightField, eye: np.ndarray) -> Row:
    """Beside a march by a raster cell's side, which is not exact; both as times of a ray."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, RAYS[0]), np.linspace(0.1, -0.6, RAYS[1]))
    directions = np.stack([x, np.ones_like(x), y], -1).reshape(-1, 3)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    origins = np.broadcast_to(eye, directions.shape)
    some = directions[:: max(len(directions) // MARCHED, 1)]
    timed = alternate(
        lambda: {"total": _ms(lambda: pick(field, origins, directions, threads=1))},
        lambda: _ms(lambda: _marched(field, eye, some)) * len(directions) / len(some),
    )
    figures = {"ns_ray": 1e6 * timed.ms["total"] / len(directions)}
    return Row("query_rays", len(directions), timed.ms["total"], "numpy's march", timed.baseline_ms, figures=figures)


def _marched(field: HeightField, eye: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Metres to the first place below the ground: all rays go a step at a time until each has met it or left."""
    step, found = field.lattice.step_x, np.full(len(directions), np.inf)
    going = np.arange(len(directions))
    for n in range(int(1.5 * SIDE / step)):
        points = eye + n * step * directions[going]
        heights = _plain(field, points[:, :2])
        below = points[:, 2] <= heights
        found[going[below]] = n * step
        going = going[~below & ~np.isnan(heights)]
        if not len(going):
            break
    return found


def _sight(field: HeightField, eye: np.ndarray) -> Row:
    timed = alternate(lambda: {"total": _ms(lambda: viewshed(field, eye, radius=SEEN_M, threads=1))})
    looked = np.pi * SEEN_M**2 / (field.lattice.step_x * field.lattice.step_y)
    figures = {"ns_sample": 1e6 * timed.ms["total"] / looked}
    return Row("query_sight", round(looked), timed.ms["total"], figures=figures)
