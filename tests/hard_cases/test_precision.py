# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases 1, 3, 4, 6 and 7 of meshes: the deepest level, far from the origin, beyond integers in float32."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.depths import depth_limit
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import reference_heights, rough
from invariants import arrays, assert_invariants


def test_case_01_the_deepest_mesh_has_exact_plane_coordinates():
    """In a mesh at the depth limit, 34, every plane coordinate is a whole number of lattice units."""
    field = from_array(rough(3, 3, relief=0.1).samples, 1.0)
    limit = depth_limit(field)
    for eye in ((0.1, 0.2, 2.0), (-0.999, 0.999, 1.5)):
        view = View.look(eye, (eye[0], eye[1], 0), fov_deg=0.00002, clip=(1e-3, 10.0))
        criterion = Criterion(
            error_px=0, edge_px=0.3, guard_deg=0.0, off_screen_factor=1e12, max_depth=limit, max_triangles=100_000
        )
        update = Terrain(field, 1).update(criterion, [view])
        assert_invariants(update.surface, field.lattice)
        assert update.surface.level.max() == limit >= 30
        unit = 2.0 ** (1 - limit // 2)  # a side of the root square is 2 m
        plane = update.surface.positions[:, :2].astype(np.float64) / unit
        assert np.array_equal(plane, np.rint(plane)) and (plane % 2 == 1).any()


def test_case_03_a_deep_terrain_pays_for_its_leaves():
    """Thousands of leaves among 2^28 to 2^34 possible ones need at most 64 bytes per leaf."""
    field = rough(17, 17, relief=5.0)
    for depth in (28, 31, depth_limit(field)):
        terrain = Terrain(field, 1)
        view = View.look((3.0, -4.0, 8.0), (0, 0, 0), fov_deg=0.2, clip=(1e-3, 1e4))
        criterion = Criterion(
            error_px=0, edge_px=4.0, guard_deg=0.0, off_screen_factor=1e12, max_depth=depth, max_triangles=100_000
        )
        for _ in range(2):
            update = terrain.update(criterion, [view])
        assert_invariants(update.surface, field.lattice)
        assert 2000 < update.leaves <= 100_000 and update.surface.level.max() == depth
        assert terrain.tree.nbytes <= 64 * update.leaves


def earth_centred():
    """Return the frame east, north, up on an Earth-centred sphere at 47 degrees north, 11 east, float64 [4, 4]."""
    latitude, longitude = np.radians([47.0, 11.0])
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    placement = np.eye(4)
    placement[:3, :3] = np.stack([east, np.cross(up, east), up], axis=1)
    placement[:3, 3] = 6.4e6 * up
    return placement


def utm():
    placement = np.eye(4)
    placement[:3, 3] = 6.4e6, -5.1e6, 3.2e5
    return placement


@pytest.mark.parametrize("far", [utm(), earth_centred()], ids=["utm", "earth-centred"])
def test_case_04_far_from_the_origin_vertices_are_exact_to_1_mm(far):
    """At 6.4e6 m from the origin, every vertex within 1 km of the camera is exact to 1 mm in camera space."""
    field = rough(257, 257, step=30.0)  # 7.7 km
    eye = np.array([500.0, -800.0, 150.0])
    here = Terrain(field, 1).update(Criterion(), [View.look(eye, (0, 0, 0))])
    # the same camera, moved with the terrain
    near_view = View.look(eye, (0, 0, 0))
    view = View(near_view.world_to_camera @ np.linalg.inv(far), near_view.projection, near_view.resolution)
    there = Terrain(field, 1).update(Criterion(), [view], placement=far)
    assert_invariants(there.surface, field.lattice)
    assert abs(there.leaves - here.leaves) <= 1e-3 * here.leaves
    p = there.surface.positions.astype(np.float64)
    p = p[np.linalg.norm(p - eye, axis=1) < 1000]
    assert len(p) > 100
    # the exact positions: on lattice lines, on the reference surface
    fine = 30.0 / 2**8
    plane = np.rint(p[:, :2] / fine) * fine
    true = np.c_[plane, reference_heights(field, plane)]
    shown = (view.world_to_camera @ far @ np.c_[p, np.ones(len(p))].T).T[:, :3]
    meant = (near_view.world_to_camera @ np.c_[true, np.ones(len(p))].T).T[:, :3]
    assert np.linalg.norm(shown - meant, axis=1).max() < 1e-3


def test_case_04_moving_camera_and_terrain_keeps_the_bytes():
    """A terrain and its camera moved together by 6.4e6 m give the same bytes of every array."""
    field, far = rough(257, 257, step=30.0), utm()
    eye = np.array([500.0, -800.0, 150.0])
    here = Terrain(field, 1).update(Criterion(), [View.look(eye, (0, 0, 0))])
    there = Terrain(field, 1).update(Criterion(), [View.look(eye + far[:3, 3], far[:3, 3])], placement=far)
    assert_invariants(there.surface, field.lattice)
    # float64 keeps the camera to a nanometre even there
    assert arrays(here.surface) == arrays(there.surface)


def test_case_06_vertical_scales_of_a_billion_and_a_billionth():
    """Vertical scales of 1e9, 1e-9, 0 and -1 and denormal heights give finite bounds and valid meshes."""
    field = rough(17, 17)
    view = View.look((0, -400, 120), (0, 0, 0))
    for scale in (1e9, 1e-9, 0.0, -1.0):
        update = Terrain(field, 1).update(Criterion(max_triangles=20_000), [view], vertical_scale=scale)
        assert_invariants(update.surface, field.lattice)
        assert np.isfinite(update.bound_px) and np.isfinite(sum(vars(update.terms_px).values()))
        heights = reference_heights(field, update.surface.positions[:, :2].astype(np.float64)) * scale
        assert np.allclose(update.surface.positions[:, 2], heights, rtol=1e-5, atol=1e-5 * abs(scale) * 100)
    denormal = from_array((rough(17, 17).samples * 1e-42).astype(np.float32), 10.0)
    assert 0 < denormal.samples.max() < np.finfo(np.float32).tiny
    assert_invariants(Terrain(denormal, 1).update(Criterion(), [view]).surface, denormal.lattice)


@pytest.mark.thorough
def test_case_07_more_than_2_to_the_24_corners():
    """A mesh with 8.4 million triangles has odd and even indices above 2^24 and is one closed sheet."""
    field = rough(33, 33)
    view = View.look((0, 0, 1000), (0, 1, 0), clip=(0.1, 1e5))
    terrain = Terrain(field)
    update = terrain.update(Criterion(error_px=0, edge_px=1e-3, off_screen_factor=1, max_depth=23, meshlet=4), [view])
    surface = update.surface
    assert update.triangles == 1 << 23 and len(surface.corner_verts) > 2**24
    # float32 holds only even integers above 2^24
    assert surface.corner_edges.max() > 3 << 22 and len(surface.positions) > 1 << 22
    assert {0, 1} == set(np.unique(surface.corner_edges[surface.corner_edges > 3 << 22] & 1))
    assert_invariants(surface, field.lattice, meshlet=4)
    uses = np.bincount(surface.corner_edges, minlength=len(surface.edges))
    assert (uses == 1).sum() == 4 << 11
