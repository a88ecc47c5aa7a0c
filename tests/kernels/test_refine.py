# SPDX-License-Identifier: GPL-3.0-or-later
"""The walk's short cuts, bands and even blocks, against a walk that measures every diamond: the same bits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain import kernels
from adaptive_terrain.cbt_terrain.ask.criterion import Criterion
from adaptive_terrain.cbt_terrain.ask.view import PANORAMIC, View
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import INTERPOLATIONS
from adaptive_terrain.cbt_terrain.refine import refinement
from adaptive_terrain.cbt_terrain.refine.block_tables import blocks, shapes
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain, Update
from invariants import arrays
from level_ground import level_scenes
from twins import load

SHAPES = ((33, 33), (65, 129), (100, 37), (5, 3))


def heights(kind: str, shape: tuple[int, int], rng) -> np.ndarray:
    z = rng.standard_normal(shape)
    return {
        "flat": np.zeros(shape),
        "smooth": np.cumsum(np.cumsum(z, 0), 1) * 0.02,
        "noise": z,
        "cliffs": (z > 1.5) * 50.0,
        "plane": np.add.outer(np.arange(shape[0]), np.arange(shape[1])) * 0.3,
    }[kind].astype(np.float32)


def a_view(kind: str, size: tuple[float, float], rng) -> View:
    eye = rng.uniform(-1, 1, 3) * [*size, 0.5 * max(size)]
    target = rng.uniform(-0.5, 0.5, 3) * [*size, 1]
    return View.look(eye, target, kind=kind, **({"fov_deg": 360} if kind == PANORAMIC else {}))


def a_criterion(asks: str, rng) -> Criterion:
    px = float(10 ** rng.uniform(-0.5, 1.5))
    asked = {
        "error": {"error_px": px},
        "edge": {"error_px": 0.0, "edge_px": 4 * px},
        "area": {"error_px": 0.0, "area_px": 20 * px},
        "metres": {"error_px": 0.0, "error_m": float(10 ** rng.uniform(-2, 1))},
        "all": {"error_px": px, "edge_px": 8 * px, "area_px": 60 * px, "error_m": 1.0},
    }[asks]
    budget = int(rng.choice([300, 20_000, 100_000]))
    depth = [None, None, 5, 12][rng.integers(4)]
    return Criterion(
        **asked, max_triangles=budget, max_depth=depth, off_screen_factor=float(rng.choice([1.0, 16.0, 1e6]))
    )


def scenes(kind: str) -> list[tuple]:
    """Everything that the walk may come upon: fields, views, criteria, two slices."""
    rng, found = np.random.default_rng(sum(map(ord, kind))), []
    for asks in ("error", "edge", "area", "metres", "all"):
        for shape in SHAPES:
            rounded = (0.0, 0.0, 0.3)[len(found) % 3]
            field = from_array(heights(kind, shape, rng), *10 ** rng.uniform(-0.5, 0.5, 2), source_max=rounded)
            size = (field.lattice.width * field.lattice.step_x, field.lattice.height * field.lattice.step_y)
            kinds = rng.choice(["PERSPECTIVE", "ORTHOGRAPHIC", "PANORAMIC"], rng.integers(1, 3))
            views = [a_view(str(k), size, rng) for k in kinds]
            field = interpolated(field, INTERPOLATIONS[(len(found) + len(found) // 4) % 2])
            found.append((field, a_criterion(asks, rng), views, float(rng.choice([1.0, -2.0, 0.0]))))
    return found


def result(update: Update) -> tuple:
    bounds = (update.bound_px, update.bound_m, update.bound_edge_px, update.bound_area_px)
    return update.leaves, update.relaxed, update.limited, bounds, arrays(update.surface)


def updated(field, criterion: Criterion, views: list[View], scale: float) -> tuple:
    terrain = Terrain(field, 2)
    terrain.update(Criterion(error_px=8.0), views)  # so that there is something to cut for two slices
    return result(terrain.update(criterion, views, vertical_scale=scale))


@pytest.fixture
def measuring_all(tmp_path):
    """kernels/refine/walk.py with margins so wide that nothing is certain, and without any memory."""
    source = (Path(kernels.__file__).parent / "refine" / "walk.py").read_text()
    limits, met = "limits = limits_of(asked, w.slack)", "if met.x == x and met.y == y and met.mark == mark:"
    wide = [("below", 0.0), ("finer", 0.0), ("coarser", 1e300), ("metres_below", 0.0), ("metres_above", 1e300)]
    lines = [limits, *(f"limits.{name} = wp.float64({value})" for name, value in wide)]
    changes = [
        (limits, "\n        ".join(lines)),
        (met, "if met.x == -2:"),
        ("if kept_cell <= at:", "if kept_cell == -1:"),
        ("if below == LEVEL_GROUND", "if below == 1 << 30"),
    ]
    for here, there in changes:
        assert source.count(here) == 1
        source = source.replace(here, there)
    path = tmp_path / "refine_measuring_all.py"
    path.write_text(source)
    return load(f"refine.{path.stem}", path)


@pytest.mark.parametrize("kind", ["flat", "smooth", "noise", "cliffs", "plane"])
def test_bands_and_blocks_decide_as_measuring_does(kind, measuring_all, monkeypatch):
    monkeypatch.setattr(launch, "SLICE_ITEMS", 2)
    fast = [updated(*scene) for scene in scenes(kind)]
    monkeypatch.setattr(refinement, "kernels", measuring_all)
    assert [updated(*scene) for scene in scenes(kind)] == fast


def test_level_ground_is_walked_as_measuring_does(measuring_all, monkeypatch):
    monkeypatch.setattr(launch, "SLICE_ITEMS", 2)
    fast = [updated(*scene) for scene in level_scenes()]
    monkeypatch.setattr(refinement, "kernels", measuring_all)
    assert [updated(*scene) for scene in level_scenes()] == fast


def mirrored():
    """Half of the ground mirrors the other, so that maxima differ by the last bit."""
    rows = [[0.0, 1.0, 0.0, 0.0], [-0.29122935556356366, 0.0, 0.9566532613533658, -9e-16]]
    rows += [[0.9566532613533658, 0.0, 0.29122935556356366, -45.50553557244149], [0.0, 0.0, 0.0, 1.0]]
    view = replace(View.look((1.0, 0.0, 1.0), (0.0, 0.0, 0.0)), world_to_camera=np.array(rows))
    field = from_array(np.zeros((129, 129), np.float32), 1.1169821440484018)
    return field, view, Criterion(error_px=0.0, edge_px=38.35387215230578), 0.0


def at_an_absurd_height():
    """Depths are what is left of two numbers of 16 digits."""
    view = View.look((0.0, 0.0, 1e15 + 4.0), (9.0, 5.0, 1e15))
    return from_array(np.zeros((65, 65), np.float32)), view, Criterion(error_px=0.0, edge_px=20.0), 1e15


@pytest.mark.parametrize("scene", [mirrored, at_an_absurd_height])
def test_level_ground_is_walked_as_two_equal_views_measure_it(scene):
    field, view, criterion, offset = scene()
    alone, measured = (Terrain(field, 1).update(criterion, [view] * n, vertical_offset=offset) for n in (1, 2))
    assert result(alone) == result(measured)


def codes(terrain: Terrain, view: View, edge_px: float, monkeypatch) -> np.ndarray:
    """Words of the leaves, which nothing is made of: they may be wrong."""
    surface = Terrain(terrain.field, 1).update(Criterion(error_px=8.0), [view]).surface
    monkeypatch.setattr(terrain._builder, "build", lambda *_: surface)
    leaves = terrain.update(Criterion(error_px=0.0, edge_px=edge_px), [view]).leaves
    return terrain._buffers.numpy("code")[:leaves].copy()


@pytest.mark.parametrize(("table", "edge_px", "part"), [(blocks, 4.0, 0.6), (shapes, 80.0, 0.9)])
def test_level_ground_comes_from_tables(table, edge_px, part, monkeypatch):
    """What they hold shows in the leaves: with another state in them, others come out."""
    view = View.look((0.0, 0.0, 2.0), (1.0, 0.0, 2.0), kind=PANORAMIC, fov_deg=360)
    field = from_array(np.zeros((257, 257), np.float32))
    right = codes(Terrain(field, 1), view, edge_px, monkeypatch)
    code = table().code.numpy()
    kept = code.copy()
    try:
        code[:] ^= 1  # a bit of the state
        changed = codes(Terrain(field, 1), view, edge_px, monkeypatch) != right
    finally:
        code[:] = kept
    assert changed.mean() > part
