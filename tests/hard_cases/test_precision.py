# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases 1, 3, 4, 6 and 7 of meshes: the deepest level, far from the origin, beyond what float32 counts."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.ask.criterion import Criterion
from adaptive_terrain.cbt_terrain.ask.view import View
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.refine.domain import depth_limit
from adaptive_terrain.cbt_terrain.terrain import Terrain
from fields import reference_heights, rough
from invariants import arrays, assert_invariants


def test_case_01_the_deepest_mesh_has_exact_plane_coordinates():
    """A mesh at the depth limit, 34: every plane coordinate is a whole number of lattice units."""
    field = from_array(rough(3, 3, relief=0.1).samples, 1.0)
    limit = depth_limit(field)
    for eye in ((0.1, 0.2, 2.0), (-0.999, 0.999, 1.5)):
        view = View.look(eye, (eye[0], eye[1], 0), fov_deg=0.00002, clip=(1e-3, 10.0))
        asked = Criterion(
            error_px=0, edge_px=0.3, guard_deg=0.0, off_screen_factor=1e12, max_depth=limit, max_triangles=100_000
        )
        update = Terrain(field, 1).update(asked, [view])
        assert_invariants(update.surface, field.lattice)
        assert update.surface.level.max() == limit >= 30
        unit = 2.0 ** (1 - limit // 2)  # a side of the root square is 2 m
        plane = update.surface.positions[:, :2].astype(np.float64) / unit
        assert np.array_equal(plane, np.rint(plane)) and (plane % 2 == 1).any()


def test_case_03_a_deep_terrain_pays_for_its_leaves():
    """Thousands of leaves among 2^28 to 2^34 possible ones: the tree keeps at most 64 bytes a leaf."""
    field = rough(17, 17, relief=5.0)
    for depth in (28, 31, depth_limit(field)):
        terrain = Terrain(field, 1)
        view = View.look((3.0, -4.0, 8.0), (0, 0, 0), fov_deg=0.2, clip=(1e-3, 1e4))
        asked = Criterion(
            error_px=0, edge_px=4.0, guard_deg=0.0, off_screen_factor=1e12, max_depth=depth, max_triangles=100_000
        )
        for _ in range(2):
            update = terrain.update(asked, [view])
        assert_invariants(update.surface, field.lattice)
        assert 2000 < update.leaves <= 100_000 and update.surface.level.max() == depth
        assert terrain.tree.nbytes <= 64 * update.leaves


def earth_centred():
    """float64 [4, 4]: a local frame on an Earth-centred sphere, east, north and up at 47 degrees north, 11 east."""
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
def test_case_04_far_from_the_origin_the_error_at_the_camera_is_under_a_millimetre(far):
    """6.4e6 m out, every mesh point within 1 km of the camera is within 1 mm of its place in camera space."""
    field = rough(257, 257, step=30.0)  # 7.7 km
    eye = np.array([500.0, -800.0, 150.0])
    here = Terrain(field, 1).update(Criterion(), [View.look(eye, (0, 0, 0))])
    # the same camera, carried along with the terrain
    near_view = View.look(eye, (0, 0, 0))
    view = View(near_view.world_to_camera @ np.linalg.inv(far), near_view.projection, near_view.resolution)
    there = Terrain(field, 1).update(Criterion(), [view], placement=far)
    assert_invariants(there.surface, field.lattice)
    assert abs(there.leaves - here.leaves) <= 1e-3 * here.leaves
    p = there.surface.positions.astype(np.float64)
    p = p[np.linalg.norm(p - eye, axis=1) < 1000]
    assert len(p) > 100
    # where these points belong: on their lattice line, on the reference surface
    fine = 30.0 / 2**8
    plane = np.rint(p[:, :2] / fine) * fine
    true = np.c_[plane, reference_heights(field, plane)]
    shown = (view.world_to_camera @ far @ np.c_[p, np.ones(len(p))].T).T[:, :3]
    meant = (near_view.world_to_camera @ np.c_[true, np.ones(len(p))].T).T[:, :3]
    assert np.linalg.norm(shown - meant, axis=1).max() < 1e-3


def test_case_04_a_camera_that_is_moved_along_sees_the_same_bytes():
    """A terrain and its camera moved by 6.4e6 m: the same bytes of every array."""
    field, far = rough(257, 257, step=30.0), utm()
    eye = np.array([500.0, -800.0, 150.0])
    here = Terrain(field, 1).update(Criterion(), [View.look(eye, (0, 0, 0))])
    there = Terrain(field, 1).update(Criterion(), [View.look(eye + far[:3, 3], far[:3, 3])], placement=far)
    assert_invariants(there.surface, field.lattice)
    # float64 keeps the camera to a nanometre even there
    assert arrays(here.surface) == arrays(there.surface)


def test_case_06_vertical_scales_of_a_billion_and_a_billionth():
    """Vertical scales 1e9, 1e-9, 0, -1 and heights below the smallest normal number: finite bounds, a whole mesh."""
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


def test_case_07_more_than_2_to_the_24_corners():
    """8.4 million triangles, 25 million corners: odd and even indices above 2^24 all there, one closed sheet."""
    field = rough(33, 33)
    view = View.look((0, 0, 1000), (0, 1, 0), clip=(0.1, 1e5))
    terrain = Terrain(field)
    update = terrain.update(Criterion(error_px=0, edge_px=1e-3, off_screen_factor=1, max_depth=23, meshlet=4), [view])
    surface = update.surface
    assert update.triangles == 1 << 23 and len(surface.corner_verts) > 2**24
    # beyond 2^24 float32 skips every other whole number: odd and even indices must both be there
    assert surface.corner_edges.max() > 3 << 22 and len(surface.positions) > 1 << 22
    assert {0, 1} == set(np.unique(surface.corner_edges[surface.corner_edges > 3 << 22] & 1))
    assert_invariants(surface, field.lattice, meshlet=4)
    uses = np.bincount(surface.corner_edges, minlength=len(surface.edges))
    assert (uses == 1).sum() == 4 << 11
