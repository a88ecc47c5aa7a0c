# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases 4 and 7 (and 6, vertical scales): far from the origin, beyond what float32 counts."""

import numpy as np
from adaptive_terrain.cbt_terrain.criterion import Criterion
from adaptive_terrain.cbt_terrain.heightfield import from_array
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view import View
from fields import reference_heights, rough
from invariants import arrays, assert_invariants


def test_case_04_far_from_the_origin_the_error_at_the_camera_is_under_a_millimetre():
    field = rough(257, 257, step=30.0)  # 7.7 km
    far = np.eye(4)
    far[:3, 3] = 6.4e6, -5.1e6, 3.2e5
    eye = np.array([500.0, -800.0, 150.0])
    here = Terrain(field, 1).update(Criterion(), [View.look(eye, (0, 0, 0))])
    there = Terrain(field, 1).update(Criterion(), [View.look(eye + far[:3, 3], far[:3, 3])], placement=far)
    # float64 keeps the camera to a nanometre even there: the same leaves, the same local mesh
    assert arrays(here.surface) == arrays(there.surface)
    p = there.surface.positions.astype(np.float64)
    near = np.linalg.norm(p - eye, axis=1) < 1000
    assert near.sum() > 100
    # what float32 about the local origin loses: the plane coordinate against its lattice line, the height at it
    fine = 30.0 / 2**8
    off = np.abs(p[near, :2] / fine - np.rint(p[near, :2] / fine)).max() * fine
    height = np.abs(p[near, 2] - reference_heights(field, np.rint(p[near, :2] / fine) * fine)).max()
    assert off < 1e-3 and height < 1e-3


def test_case_06_vertical_scales_of_a_billion_and_a_billionth():
    field = rough(17, 17)
    view = View.look((0, -400, 120), (0, 0, 0))
    for scale in (1e9, 1e-9, 0.0, -1.0):
        update = Terrain(field, 1).update(Criterion(max_triangles=20_000), [view], vertical_scale=scale)
        assert_invariants(update.surface, field.lattice)
        assert np.isfinite(update.bound_px) and np.isfinite(update.bound_m)
    denormal = from_array((rough(17, 17).samples * 1e-42).astype(np.float32), 10.0)
    assert 0 < denormal.samples.max() < np.finfo(np.float32).tiny
    assert_invariants(Terrain(denormal, 1).update(Criterion(), [view]).surface, denormal.lattice)


def test_case_07_more_than_2_to_the_24_corners():
    field = rough(33, 33)
    update = Terrain(field).update(Criterion(error_px=0, error_m=1e9, meshlet=4, max_depth=8))
    small = update.triangles
    view = View.look((0, 0, 1000), (0, 1, 0), clip=(0.1, 1e5))
    terrain = Terrain(field)
    update = terrain.update(Criterion(error_px=0, edge_px=1e-3, off_screen_factor=1, max_depth=23, meshlet=4), [view])
    surface = update.surface
    assert update.triangles == 1 << 23 > small and len(surface.corner_verts) > 2**24
    # beyond 2^24 float32 skips every other whole number: odd and even indices must both be there
    last = surface.corner_verts[-(1 << 16) :]
    assert {0, 1} == set(np.unique(last[last > 1 << 21] & 1)) and surface.corner_edges.max() > 3 << 22
    assert surface.corner_verts.max() == len(surface.positions) - 1 and len(surface.positions) > 1 << 22
    assert len(surface.positions) - len(surface.edges) + update.triangles == 1
    uses = np.bincount(surface.corner_edges, minlength=len(surface.edges))
    assert uses.min() == 1 and uses.max() == 2 and (uses == 1).sum() == 4 << 11
