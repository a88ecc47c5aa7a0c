# SPDX-License-Identifier: GPL-3.0-or-later
"""Scatter behind the horizon: what is left out nobody sees, and what is left is as it was."""

from dataclasses import replace

import numpy as np
from adaptive_terrain.cbt_terrain.scatter.points import Points, Scatterer
from adaptive_terrain.cbt_terrain.scatter.scatter import Scatter
from adaptive_terrain.cbt_terrain.terrain import Terrain
from fields import extent
from first_hits import in_sight
from horizon_scenes import scenes, updated

REACH = 4.0  # metres of the world


def scattered(scene, threads: int = 1) -> Scatterer:
    """Some 20,000 places, which reach out by REACH."""
    field, *_, heights = scene
    size = extent(field)
    spacing = float(np.sqrt(size[0] * size[1] / 2e4))
    full_until = 0.3 * float(size[0]) if len(scene[2]) > 1 else 0.0
    return Scatterer(field, Scatter(spacing, full_until, margin_m=REACH), *heights, threads=threads)


def meshed(scene, threads: int = 1, **asked) -> Terrain:
    field, criterion, views, placement, heights = scene
    terrain = Terrain(field, threads)
    terrain.surface = updated(terrain, replace(criterion, **asked), views, placement, heights).surface
    return terrain


def arrays(points: Points) -> list[np.ndarray]:
    return [points.positions, points.normals, points.size, points.id, points.variant, points.rotation]


def check_what_is_left_out(scene, **asked) -> tuple[int, int]:
    """What is left is as it is without the horizon. Of each point that is left out, five places within its reach have
    a triangle in front, or are outside the frame. Returns how many points there are with and without."""
    _, _, views, placement, _ = scene
    terrain, scatterer = meshed(scene, **asked), scattered(scene)
    whole = scatterer.points(views, placement)
    left = scatterer.points(views, placement, terrain.horizon())
    kept = np.isin(whole.id, left.id)
    order, own = np.argsort(whole.id[kept]), np.argsort(left.id)
    for a, b in zip(arrays(whole), arrays(left), strict=True):
        assert np.array_equal(a[kept][order], b[own])
    rng, out = np.random.default_rng(len(whole)), whole.positions[~kept].astype(np.float64)
    for view in views:
        to_camera = view.world_to_camera @ placement
        roots = out @ to_camera[:3, :3].T + to_camera[:3, 3]
        for k in range(5):  # a camera's space has the world's metres
            toward = rng.normal(size=out.shape)
            toward *= min(k, 1) * REACH / np.linalg.norm(toward, axis=1, keepdims=True)
            seen = in_sight(terrain.surface, view, placement, roots + toward)
            assert not seen.any(), (seen.sum(), scene[1], asked)
    return len(left), len(whole)


def test_what_is_left_out_nobody_sees():
    """Views from low over the ground, from inside and below it, of terrains that are turned, stretched and sheared;
    meshes of any criterion, with hidden ground coarser, rising and within a triangle limit."""
    others = {}, {"hidden_factor": 50.0}, {"morph": 1.5}, {"max_triangles": 1500, "morph": 1.5}
    counts = [check_what_is_left_out(scene, **others[k % 4]) for k, scene in enumerate(scenes(171, 40))]
    fewer = [a < 0.9 * b for a, b in counts]
    assert sum(fewer) > 5 and sum(a > 0 for a, _ in counts) > 30, counts


def test_what_one_of_several_views_sees_is_left():
    counts = [check_what_is_left_out(scene) for views in (2, 3) for scene in scenes(170 + views, 10, views)]
    assert sum(a < b for a, b in counts) > 4, counts
