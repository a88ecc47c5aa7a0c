# SPDX-License-Identifier: GPL-3.0-or-later
"""Scatter behind the horizon: removed points are invisible, and the others do not change."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.island import SIDE, island
from adaptive_terrain.cbt_terrain.scatter.points import ScatterPoints
from adaptive_terrain.cbt_terrain.scatter.scatter import Scatter
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, View
from fields import extent, reference_heights
from first_hits import in_sight
from horizon_scenes import behind_a_ridge, scenes, updated
from scattered_frames import ScatteredFrames

REACH = 25.0  # metres of the world


def low_scenes(seed: int, count: int, views: int = 1):
    """Yield random scenes; every second one is over the island with level views from 30 m above its ground."""
    rng, land = np.random.default_rng(seed), from_array(island(257)[:200], SIDE / 256)
    for k, (field, criterion, seen, placement, heights) in enumerate(scenes(seed, count, views)):
        criterion = replace(criterion, max_depth=16, meshlet=0)
        if k % 2:
            field, seen = land, []
            for _ in range(views):
                eye, target = rng.uniform(-0.4, 0.4, (2, 3)) * extent(field)
                eye[2] = target[2] = reference_heights(field, eye[None, :2])[0] * heights[0] + heights[1] + 30.0
                ends = (placement[:3, :3] @ p + placement[:3, 3] for p in (eye, target))
                seen.append(View.look(*ends, fov_deg=60.0, resolution=(640, 360), clip=(0.1, 1e6)))
        yield field, criterion, seen, placement, heights


def scattered(scene, threads: int = 1) -> ScatteredFrames:
    """Some 150,000 places, which reach out by REACH."""
    field, *_, heights = scene
    size = extent(field)
    spacing = float(np.sqrt(size[0] * size[1] / 1.5e5))
    full_until = 0.3 * float(size[0]) if len(scene[2]) > 1 else 0.0
    return ScatteredFrames(field, Scatter(spacing, full_until, margin_m=REACH), *heights, threads=threads)


def meshed(scene, threads: int = 1, **asked) -> Terrain:
    field, criterion, views, placement, heights = scene
    terrain = Terrain(field, threads)
    terrain.surface = updated(terrain, replace(criterion, **asked), views, placement, heights).surface
    return terrain


def arrays(points: ScatterPoints) -> list[np.ndarray]:
    return [points.positions, points.normals, points.size, points.id, points.variant, points.rotation]


def check_what_is_left_out(scene, **asked) -> tuple[int, int]:
    """Assert that the horizon removes only hidden points and changes no other.

    Of each removed point, five places within its reach have a triangle in front or are outside the frame. Returns the
    number of points without and with the horizon.
    """
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
        toward = rng.normal(size=(5, *out.shape))  # a camera's space has the world's metres
        toward *= REACH / np.linalg.norm(toward, axis=2, keepdims=True)
        toward[0] = 0.0
        seen = in_sight(terrain.surface, view, placement, (roots + toward).reshape(-1, 3))
        assert not seen.any(), (seen.sum(), scene[1], asked)
    return len(left), len(whole)


@pytest.mark.thorough
def test_no_omitted_point_is_visible():
    """Views from low over the ground, from inside and below it, of terrains that are turned, stretched and sheared;
    meshes of any criterion, with hidden ground coarser, rising and within a triangle limit."""
    others = {}, {"hidden_factor": 50.0}, {"morph": 1.5}, {"max_triangles": 3000, "morph": 1.5}
    counts = [check_what_is_left_out(scene, **others[k // 2 % 4]) for k, scene in enumerate(low_scenes(171, 24))]
    fewer = [a < 0.9 * b for a, b in counts]
    assert sum(fewer) > 6 and sum(a > 0 for a, _ in counts) > 18, counts


def test_objects_that_reach_over_a_ridge_stay():
    """A ridge of 100 m, 130 m from an eye at 112 m: behind it is ground that one does not see and whose trees one does.
    Of a coarse mesh the ridge may be lower than that of the heights, and hides less."""
    y, x = np.arange(300)[:, None] - 100.0, np.arange(200)[None, :]
    field = from_array((100 * np.exp(-((y + 0.3 * np.sin(x)) ** 2) / 18) + np.sin(x / 3)).astype(np.float32), 10.0)
    for k in (0, 7):
        views = [View.look((0.0, k - 625.0, 112.0), (50.0 * k, 600.0, 90.0), resolution=(960, 540))]
        scenes_of = ((field, Criterion(error_px), views, np.eye(4), (1.0, 0.0)) for error_px in (0.5, 20.0))
        (fine, whole), (coarse, _) = map(check_what_is_left_out, scenes_of)
        assert 0 < fine < coarse < 0.99 * whole


@pytest.mark.thorough
def test_points_in_one_of_several_views_stay():
    counts = [check_what_is_left_out(scene) for views in (2, 3) for scene in low_scenes(170 + views, 6, views)]
    assert sum(a < b for a, b in counts) > 4, counts


def a_wall() -> tuple:
    z, view = behind_a_ridge(129)
    return from_array(z, 8.0), Criterion(), [view], np.eye(4), (1.0, 0.0)


def test_objects_that_reach_out_of_their_square_stay():
    """Reaching further leaves more: 150 m in many places over the wall."""
    scene = a_wall()
    horizon, counts = meshed(scene).horizon(), []
    for reach in (0.0, 20.0, 150.0):
        scatterer = ScatteredFrames(scene[0], Scatter(8.0, 0.0, margin_m=reach), threads=1)
        whole, left = (scatterer.points(scene[2], None, of) for of in (None, horizon))
        counts.append(len(left) / len(whole))
    assert counts == sorted(counts) and counts[0] < 0.3 and counts[2] > 0.5, counts


def test_a_frame_alone_is_a_frame_of_a_sequence_on_any_threads(eager_threads):
    for field, criterion, (first, second), *rest in scenes(175, 2, 2):
        one, other = ((field, criterion, [view], *rest) for view in (first, second))
        scatterer, terrain = scattered(one, 3), Terrain(field, 3)
        for scene in (one, other, one):
            updated(terrain, *scene[1:])
            flown = scatterer.points(scene[2], rest[0], terrain.horizon())
            alone = scattered(scene).points(scene[2], rest[0], meshed(scene).horizon())
            assert [a.tobytes() for a in arrays(flown)] == [a.tobytes() for a in arrays(alone)]


def test_without_hidden_ground_all_points_stay():
    """Holes, a mesh of edges alone, a saved tree, no views; an orthographic view has no eye."""
    field, criterion, views, placement, heights = a_wall()
    holed = field.heights().copy()
    holed[60:64, 60:64] = np.nan
    edges, metres = Criterion(error_px=0.0, edge_px=20.0), Criterion(error_px=0.0, error_m=1.0)
    assert meshed((from_array(holed, 8.0, holes=True), criterion, views, placement, heights)).horizon() is None
    assert meshed((field, edges, views, placement, heights)).horizon() is None
    assert meshed((field, metres, [], placement, heights)).horizon() is None
    terrain = meshed((field, criterion, views, placement, heights))
    tree, how = terrain.saved()
    terrain.restore(tree, **how)
    assert terrain.horizon() is None
    above = [View.look((0, -900, 300), (0, 0, 0), kind=ORTHOGRAPHIC, ortho_width=900)]
    scene = field, criterion, above, placement, heights
    plain, hiding = (scattered(scene).points(above, None, of) for of in (None, meshed(scene).horizon()))
    assert [a.tobytes() for a in arrays(plain)] == [a.tobytes() for a in arrays(hiding)]


def test_the_horizon_of_other_views_is_refused():
    scene = a_wall()
    moved = [View.look((1.0, -500.0, 60.0), (0, 0, 60.0))]
    for views in (moved, [*scene[2], *moved], []):
        with pytest.raises(TerrainError, match="horizon is one of other views"):
            scattered(scene).points(views, None, meshed(scene).horizon())
