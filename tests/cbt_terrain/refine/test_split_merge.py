# SPDX-License-Identifier: GPL-3.0-or-later
"""The classic update: passes of splits and merges end with the leaves that the walk finds in one call."""

import os
from functools import cache

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.leb.bisection import plant
from adaptive_terrain.cbt_terrain.refine import refinement
from adaptive_terrain.cbt_terrain.refine.split_merge import split_merge
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.tree.concurrent_binary_tree import ConcurrentBinaryTree
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import PANORAMIC, View
from fields import rough

ASKS = ("error", "metres", "edge", "area", "all", "hidden", "budget")
# Of each kind; with ADAPTIVE_TERRAIN_FUZZ more than 500 in all.
VIEWS = 75 if int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) else 3


@cache
def field(number: int):
    """Return a field of one square, of a grid with a spare leaf, or of padded squares."""
    height, width = ((65, 65), (33, 97), (100, 37))[number]
    rng = np.random.default_rng(number)
    z = rng.standard_normal((height, width))
    heights = (np.cumsum(np.cumsum(z, 0), 1) * 0.02, (z > 1.5) * 50.0, z)[number]
    return from_array(heights.astype(np.float32), 2.0)


def random_view(rng, size: np.ndarray) -> View:
    kind = str(rng.choice(["PERSPECTIVE", "ORTHOGRAPHIC", PANORAMIC]))
    eye, target = rng.uniform(-1, 1, 3) * [*size, 0.5 * size.max()], rng.uniform(-0.5, 0.5, 3) * [*size, 1]
    return View.look(eye, target, kind=kind, **({"fov_deg": 360} if kind == PANORAMIC else {}))


def random_criterion(asks: str, rng) -> Criterion:
    px = float(10 ** rng.uniform(-0.3, 1.3))
    numbers = {
        "metres": {"error_px": 0.0, "error_m": float(10 ** rng.uniform(-1, 1))},
        "edge": {"error_px": 0.0, "edge_px": 6 * px},
        "area": {"error_px": 0.0, "area_px": 30 * px},
        "all": {"error_px": px, "edge_px": 12 * px, "area_px": 90 * px, "error_m": 1.0},
        "hidden": {"error_px": px, "hidden_factor": 8.0},
        "budget": {"error_px": 0.1, "max_triangles": int(rng.integers(100, 3000))},
    }.get(asks, {"error_px": px})
    limits = {"max_triangles": 10_000, "off_screen_factor": float(rng.choice([1.0, 16.0, 1e6]))}
    return Criterion(**limits | numbers, max_depth=[None, 7, 12][rng.integers(3)])


def walked(terrain: Terrain, criterion: Criterion, views: list[View], monkeypatch) -> tuple:
    """Update a terrain; return the domain, the criterion in kernels, and the depth of its last walk."""
    requests, refine = [], refinement.refine
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.terrain.refine", lambda *a: requests.append(a[1]) or refine(*a))
    terrain.update(criterion, views)
    return requests[-1].domain, requests[-1].criterion, requests[-1].max_depth


def converge(tree: ConcurrentBinaryTree, lattice, asked: tuple) -> int:
    """Return the number of passes until no leaf changes."""
    passes = 0
    while split_merge(tree, lattice, *asked):
        passes += 1
        assert passes < 100
    return passes


@pytest.mark.parametrize("asks", ASKS)
def test_passes_end_with_the_leaves_of_the_walk(asks, monkeypatch):
    """From whatever leaves there were: those of the view before, of another criterion's depth, or the roots."""
    monkeypatch.setattr(launch, "SLICE_ITEMS", 50)
    rng, trees, passes = np.random.default_rng(ASKS.index(asks)), {}, []
    for k in range(VIEWS):
        ground = field(k % 3)
        size = np.array([2.0 * ground.lattice.width, 2.0 * ground.lattice.height])
        views = [random_view(rng, size) for _ in range(rng.integers(1, 3))]
        terrain = Terrain(ground, 1)
        asked = walked(terrain, random_criterion(asks, rng), views, monkeypatch)
        key = k % 3, terrain.tree.max_depth
        if key not in trees:
            trees[key] = ConcurrentBinaryTree(terrain.tree.max_depth, int(rng.integers(1, 4)))
            plant(trees[key], ground.lattice)
        passes.append(converge(trees[key], ground.lattice, asked))
        assert trees[key].to_bytes() == terrain.tree.to_bytes()
        assert not split_merge(trees[key], ground.lattice, *asked)
    assert max(passes) > 3


def test_a_pass_changes_leaves_by_one_level(monkeypatch):
    ground, view = rough(65, 65), View.look((0.0, -300.0, 120.0), (0, 0, 0))
    terrain = Terrain(ground, 1)
    asked = walked(terrain, Criterion(error_px=1.0), [view], monkeypatch)
    tree = ConcurrentBinaryTree(terrain.tree.max_depth)
    plant(tree, ground.lattice)
    for _ in range(terrain.tree.depths().max() - 1):
        before = tree.depths().max()
        assert split_merge(tree, ground.lattice, *asked)
        assert tree.depths().max() == before + 1
    assert tree.to_bytes() == terrain.tree.to_bytes()
