# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases 21 to 31, 33, 34, 46 and 71: cameras and transforms in the engine."""

import math
from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View
from fields import (
    random_view,
    reference_heights,
    rough,
    sample_position,
    scattered,
    screen_error,
)
from first_hits import first_hits
from invariants import arrays, assert_invariants

ONE_PIXEL = Criterion(error_px=1.0, max_triangles=20_000)


@pytest.fixture(scope="module")
def field():
    return rough(65, 65)


def update_and_check(field, views, criterion=ONE_PIXEL, **placed):
    update = Terrain(field, threads=1).update(criterion, views, **placed)
    assert_invariants(update.surface, field.lattice, criterion.meshlet)
    return update


def assert_bound(field, view, update, placement=None):
    measured = screen_error(view, field, update.surface, scattered(field, 2000), placement)
    assert measured <= update.bound_px


def test_case_21_eye_on_vertex_on_surface_inside_and_below(field):
    """An eye on a vertex, on an edge, 20 m and 500 m below the surface has a finite bound that holds."""
    on_vertex = sample_position(field, 20, 30)
    edge = (sample_position(field, 20, 30) + sample_position(field, 21, 30)) / 2
    for eye in (on_vertex, edge, on_vertex - [0, 0, 20], on_vertex - [0, 0, 500]):
        view = View.look(eye, eye + [100, 50, -5])
        update = update_and_check(field, [view])
        assert np.isfinite(update.bound_px)
        assert_bound(field, view, update)


def test_case_22_straight_down_up_level_and_rolled(field):
    """Looking straight down, up and level: a panorama ignores roll, and a perspective keeps its bound."""
    position_only = Criterion(error_px=1.0, off_screen_factor=1.0)
    eye = np.array([30.0, -40.0, 400.0])
    for target in (eye - [0, 0, 1], eye + [0, 0, 1], eye + [1, 0, 0]):
        views = [View.look(eye, target, roll_deg=roll, kind=PANORAMIC, fov_deg=360) for roll in (0, 90, 180)]
        meshes = [arrays(update_and_check(field, [view], position_only).surface) for view in views]
        assert meshes[0] == meshes[1] == meshes[2]
        for roll in (0, 180):
            view = View.look(eye, target, roll_deg=roll)
            assert_bound(field, view, update_and_check(field, [view]))


def test_case_23_orthographic(field):
    """An orthographic view reaches 1 px and keeps it; the projection of ortho_scale 0 is refused."""
    view = View.look((0, 0, 1000), (1, 2, 0), kind=ORTHOGRAPHIC, ortho_width=300.0, clip=(0.1, 5000))
    update = update_and_check(field, [view])
    assert 0 < update.bound_px <= 1
    assert_bound(field, view, update)
    with pytest.raises(TerrainError, match="projection"):
        projection = view.projection.copy()
        projection[0, 0] = np.inf  # what ortho_scale 0 gives
        View(view.world_to_camera, projection, view.resolution, ORTHOGRAPHIC)


def test_case_24_field_of_view_near_180_and_near_0(field):
    """179.9999 and 0.0001 degrees keep their bound; 180 and 0 are refused."""
    for fov in (179.9999, 0.0001):
        view = View.look((0, -400, 200), (0, 0, 0), fov_deg=fov)
        update = update_and_check(field, [view])
        assert_bound(field, view, update)
    for fov in (180.0, 0.0, math.nan):
        with pytest.raises(TerrainError, match="expected more than 1e-7 and less than 180"):
            View.look((0, -400, 200), (0, 0, 0), fov_deg=fov)
    with pytest.raises(TerrainError, match="180"):
        View(np.eye(4), np.diag([0.0, 0.0, 1.0, 0.0]), (100, 100))


def test_case_25_panorama_bounds_the_angle(field):
    """A full panorama reaches 1 px, measured as an angle between the true and the shown direction."""
    view = View.look((0, 0, 150), (1, 0, 150), kind=PANORAMIC, fov_deg=360, resolution=(2000, 1000))
    update = update_and_check(field, [view])
    assert 0 < update.bound_px <= 1
    assert_bound(field, view, update)


def test_case_25_panorama_from_above_takes_fewer_triangles(field):
    """High above the ground errors of height look small: a panorama takes 30 % fewer triangles."""
    view = View.look((20, -30, 600), (1, 0, 600), kind=PANORAMIC, fov_deg=360, resolution=(2000, 1000))
    upright, steep = (update_and_check(field, [view], Criterion(error_px=0.5, shading_floor=k)) for k in (1.0, 0.5))
    assert steep.triangles < 0.7 * upright.triangles and 0 < steep.bound_px <= 0.5
    assert_bound(field, view, steep)


def test_case_26_triangle_behind_the_eye_is_not_judged_small():
    """An eye 2 m above flat triangles that reach behind it shows a one-sample spike within 1 px."""
    samples = np.zeros((33, 33), np.float32)
    samples[16, 17] = 3.0
    field = from_array(samples, 10.0, 10.0)
    view = View.look((0, -45, 2), (10, 0, 2), fov_deg=90)
    update = update_and_check(field, [view], Criterion(error_px=1.0, max_triangles=100_000))
    assert_bound(field, view, update)
    assert 0 < update.bound_px <= 1


def test_case_27_clip_start_beyond_clip_end_culls_nothing(field):
    """A view away from the terrain whose clip range is reversed refines all of the terrain."""
    turned = Criterion(error_px=4.0)
    eye, target = (0, -600, 300), (0, -2000, 300)
    culled = update_and_check(field, [View.look(eye, target, clip=(0.1, 1e5))], turned)
    all_of_it = update_and_check(field, [View.look(eye, target, clip=(1e5, 0.1))], turned)
    assert culled.leaves == 2 < all_of_it.leaves


def test_case_28_nan_in_the_matrix_leaves_the_last_mesh(field):
    """NaN or infinity in the matrix of camera or terrain is refused, and the mesh keeps its bytes."""
    terrain = Terrain(field, threads=1)
    view = View.look((0, -400, 200), (0, 0, 0))
    before = arrays(terrain.update(ONE_PIXEL, [view]).surface)
    broken = view.world_to_camera.copy()
    broken[0, 3] = np.nan
    with pytest.raises(TerrainError, match="not finite"):
        View(broken, view.projection, view.resolution)
    placement = np.eye(4)
    placement[2, 3] = np.inf
    with pytest.raises(TerrainError, match="not finite"):
        terrain.update(ONE_PIXEL, [view], placement)
    again = terrain.update(ONE_PIXEL, [view])
    assert_invariants(again.surface, field.lattice)
    assert not again.changed and arrays(again.surface) == before


def test_case_29_far_away_shifted_and_stretched(field):
    """A view from 1e30 m has two triangles; a lens shift of 1e6 and pixels of 1 : 100 keep the bound."""
    far = update_and_check(field, [View.look((1e30, 0, 0), (0, 0, 0))])
    assert far.leaves == 2
    base = View.look((0, -400, 200), (0, 0, 0))
    shifted = base.projection.copy()
    shifted[0, 2] = 1e6
    stretched = base.projection.copy()
    stretched[1, 1] *= 100
    for projection in (shifted, stretched):
        view = View(base.world_to_camera, projection, (19, 10))
        assert_bound(field, view, update_and_check(field, [view]))


def test_case_30_looking_away_gives_the_smallest_mesh():
    """A view away from the terrain leaves two triangles per root square."""
    field = rough(33, 65)
    update = update_and_check(field, [View.look((0, -500, 200), (0, -1000, 200))])
    assert update.leaves == 2 * field.lattice.squares


def refined(field, views):
    """Return the heap ids of all inner nodes, which are the split triangles."""
    terrain = Terrain(field, 1)
    terrain.update(Criterion(error_px=1.0), views)
    split = set()
    for leaf in terrain.tree.leaves().tolist():
        while (leaf := leaf >> 1) and leaf not in split:
            split.add(leaf)
    return split


def test_case_31_several_cameras_each_bound_holds(field):
    """A mesh for two cameras keeps 1 px for both, and each camera alone needs fewer leaves."""
    left = View.look((-300, -300, 80), (0, 0, 0))
    right = View.look((300, 200, 60), (0, 0, 0), fov_deg=20)
    union = update_and_check(field, [left, right], Criterion(error_px=1.0))
    assert 0 < union.bound_px <= 1
    for view in (left, right):
        assert_bound(field, view, union)
        alone = update_and_check(field, [view], Criterion(error_px=1.0))
        assert alone.leaves < union.leaves
    both = [set(refined(field, views)) for views in ([left], [right], [left, right])]
    assert both[2] == both[0] | both[1]  # the mesh for both splits the union of their triangles


def assert_outward(surface, placement):
    """Assert that vertex normals and triangles face the terrain's local up in world space."""
    normals = surface.normals.astype(np.float64) @ np.linalg.inv(placement[:3, :3])  # covectors
    corners = surface.positions.astype(np.float64)[surface.triangles] @ placement[:3, :3].T
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faces *= np.sign(np.linalg.det(placement[:3, :3]))  # a mirror turns the winding over
    up = placement[:3, 2]
    assert (normals @ up > 0).all() and (faces @ up > 0).all()


def test_case_33_mirrored_sheared_and_stretched(field):
    """Mirrored, sheared and stretched terrains keep the bound in world space, and their normals point outward."""
    mirrored, sheared, stretched = np.eye(4), np.eye(4), np.diag([1, 1, 10.0, 1])
    mirrored[0, 0] = -1
    sheared[0, 1], sheared[0, 2] = 1.5, 0.7
    for placement in (mirrored, sheared, stretched, mirrored @ sheared @ stretched):
        view = View.look((100, -500, 400), (0, 0, 0))
        update = update_and_check(field, [view], Criterion(error_px=2.0, max_triangles=200_000), placement=placement)
        assert_bound(field, view, update, placement)
        assert_outward(update.surface, placement)
    camera = View.look((100, -500, 400), (0, 0, 0))
    bent = np.eye(4)
    bent[0, 1] = 0.8
    view = View(bent @ camera.world_to_camera, camera.projection, camera.resolution)
    assert_bound(field, view, update_and_check(field, [view]))


def test_case_34_zero_scale_is_refused_and_nothing_changes(field):
    """A scale of 0 is refused, and the next update returns the previous surface unchanged."""
    terrain = Terrain(field, threads=1)
    view = View.look((0, -400, 200), (0, 0, 0))
    before = terrain.update(ONE_PIXEL, [view])
    with pytest.raises(TerrainError, match="scale"):
        terrain.update(ONE_PIXEL, [view], np.diag([1, 0, 1, 1.0]))
    after = terrain.update(ONE_PIXEL, [view])
    assert_invariants(after.surface, field.lattice)
    assert not after.changed and after.surface is before.surface


def test_case_46_bounds_hold_for_random_views():
    """For 40 random views, meshlets and budgets, the error at 2,000 points stays within the bound."""
    rng = np.random.default_rng(7)
    for round_ in range(40):
        field = rough(*[(33, 33), (17, 49), (33, 65)][round_ % 3], seed=round_)
        view = random_view(rng, field)
        criterion = Criterion(
            error_px=float(10 ** rng.uniform(-1, 1.5)), max_triangles=3000, meshlet=int(rng.integers(3))
        )
        update = update_and_check(field, [view], criterion)
        assert_bound(field, view, update)


def test_case_71_nothing_visible_is_called_hidden():
    """Occlusion culling coarsens no visible triangle, for one view or two, above, on and below the ground.

    An orthographic view is never culled.
    """
    for kinds in ([PERSPECTIVE], [PANORAMIC], [PERSPECTIVE, PANORAMIC], [ORTHOGRAPHIC]):
        for height in (250.0, 60.0, 0.0, -40.0):
            field = rough(129, 129, 4, relief=200.0)
            eye = np.array([-250.0, -300.0, 0.0])
            eye[2] = reference_heights(field, eye[None, :2])[0] + height
            wide = {PANORAMIC: 360.0}
            views = [
                View.look(
                    eye + 40.0 * k, (200, 100, eye[2]), kind=kind, fov_deg=wide.get(kind, 60.0), ortho_width=500.0
                )
                for k, kind in enumerate(kinds)
            ]
            criterion = Criterion(error_px=1.5, max_depth=16)
            whole = Terrain(field, 1).update(criterion, views)
            culled = Terrain(field, 1).update(replace(criterion, hidden_factor=50.0), views)
            assert culled.bound_px <= whole.bound_px
            if kinds == [ORTHOGRAPHIC] or (height < 0.0 and len(kinds) == 1):
                assert culled.triangles == whole.triangles
                continue
            for view in views:
                seen, alone = first_hits(culled.surface, view, np.eye(4)), Terrain(field, 1)
                levels = alone.update(criterion, [view]).surface.level
                middles = culled.surface.positions[culled.surface.triangles[seen]].astype(np.float64).mean(axis=1)
                assert (culled.surface.level[seen] >= levels[alone.triangles_at(middles[:, :2])]).all()
