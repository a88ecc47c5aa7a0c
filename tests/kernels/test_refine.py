# SPDX-License-Identifier: GPL-3.0-or-later
"""The walk's shortcuts, intervals and even blocks, against a walk that measures every diamond: the same bytes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain import terrain as terrains
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import INTERPOLATIONS
from adaptive_terrain.cbt_terrain.history.frame_history import FrameHistory
from adaptive_terrain.cbt_terrain.refine import refinement
from adaptive_terrain.cbt_terrain.refine.block_tables import block_table
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import PANORAMIC, View
from adaptive_terrain.kernels.refine import plain
from invariants import arrays
from level_ground import level_scenes

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
    budget = int(rng.choice([300, 20_000, 50_000]))
    depth = [None, None, 5, 12][rng.integers(4)]
    return Criterion(
        **asked,
        max_triangles=budget,
        max_depth=depth,
        off_screen_factor=float(rng.choice([1.0, 16.0, 1e6])),
        hidden_factor=8.0 if px < 6.0 else 1.0,
    )


def scenes(kind: str) -> list[tuple]:
    """Return scenes that cover all cases of the walk: fields, views, criteria, two slices."""
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


def refined(field, criterion: Criterion, views: list[View], scale: float, offset: float = 0.0) -> tuple:
    """Return the leaves, whether one was stopped, the limit's factor, and all arrays."""
    terrain, runs = Terrain(field, 2), []
    terrain.update(Criterion(error_px=8.0), views)  # so that there is something to cut for two slices
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(terrains, "refine", lambda *args: runs.append(refinement.refine(*args)) or runs[-1])
        update = terrain.update(criterion, views, vertical_scale=scale, vertical_offset=offset)
    [(leaves, relaxed)] = runs
    return leaves.total, leaves.stopped, relaxed, arrays(update.surface)


@pytest.fixture(scope="module")
def measures_all():
    """Return the walk without shortcuts, as a kernel."""
    return SimpleNamespace(walk=wp.kernel(plain.walk))


def same_as_plain(scenes, measures_all, monkeypatch) -> list[bool]:
    """Assert that the walk makes of each scene what measuring every diamond does; which of them were stopped."""
    monkeypatch.setattr(launch, "SLICE_ITEMS", 2)
    fast, slices = [refined(*scene) for scene in scenes], launch.slices

    def without_history(kernel, inputs, **rest):
        slices(kernel, [values[:3] for values in inputs] if kernel is measures_all.walk else inputs, **rest)

    monkeypatch.setattr(launch, "slices", without_history)
    monkeypatch.setattr(FrameHistory, "reuse_subtrees", lambda *_: None)
    monkeypatch.setattr(refinement, "kernels", measures_all)
    for scene, found in zip(scenes, fast, strict=True):
        assert refined(*scene) == found, scene[1]
    return [stopped for _, stopped, _, _ in fast]


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["flat", "smooth", "noise", "cliffs", "plane"])
def test_the_walk_decides_as_measuring_every_diamond_does(kind, measures_all, monkeypatch):
    stopped = same_as_plain(scenes(kind), measures_all, monkeypatch)
    assert 2 <= sum(stopped) <= len(stopped) - 2


def test_level_ground_is_walked_as_measuring_does(measures_all, monkeypatch):
    """Depths alone decide; and from so high that depths are the difference of two numbers of 16 digits."""
    view, asked = View.look((0.0, 0.0, 1e15 + 4.0), (9.0, 5.0, 1e15)), Criterion(error_px=0.0, edge_px=20.0)
    absurd = from_array(np.zeros((65, 65), np.float32)), asked, [view], 0.0, 1e15
    scenes = [
        (field, replace(criterion, max_triangles=min(criterion.max_triangles, 4_000)), *rest)
        for number, (field, criterion, *rest) in enumerate(level_scenes())
        if number % 8 < 5  # all shapes, kinds of ground and of views
    ]
    same_as_plain([*scenes, absurd], measures_all, monkeypatch)


def test_the_table_of_even_blocks_is_read(monkeypatch):
    """What it holds shows in the leaves: with another state in it, others come out."""
    view = View.look((0.0, 0.0, 2.0), (1.0, 0.0, 2.0), kind=PANORAMIC, fov_deg=360)
    field = from_array(np.zeros((257, 257), np.float32))
    surface = Terrain(field, 1).update(Criterion(error_px=8.0), [view]).surface
    code, found = block_table().code.numpy(), []
    for bit in (0, 1):  # of the state
        terrain = Terrain(field, 1)
        monkeypatch.setattr(terrains, "build_surface", lambda *_: surface)  # of words that are wrong
        code[:] ^= bit
        try:
            leaves = terrain.update(Criterion(error_px=0.0, edge_px=4.0), [view]).leaves
        finally:
            code[:] ^= bit
        found.append(terrain.history.last.arrays.numpy("code")[:leaves].copy())
    assert (found[0] != found[1]).mean() > 0.6
