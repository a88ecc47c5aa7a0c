# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement against numpy, meshlets against their definition, the welded arrays against their contract."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain import terrain as terrains
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import reference_heights, rough
from invariants import arrays, assert_invariants

VIEW = View.look((0.0, -400.0, 120.0), (0, 0, 0))


def test_vertices_lie_on_the_reference_surface():
    field = rough(33, 65)
    surface = Terrain(field, 1).update(Criterion(error_px=0.5), [VIEW]).surface
    p = surface.positions.astype(np.float64)
    # plane coordinates are rounded to float32: allow what that moves on the steepest slope, and float32 of the height
    slope = np.abs(np.diff(field.samples, axis=0)).max() / field.lattice.step_y * 2
    assert np.abs(p[:, 2] - reference_heights(field, p[:, :2])).max() < slope * 2**-15 + 2**-17


def test_vertices_on_samples_have_the_samples_bits():
    field = rough(17, 17)
    surface = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=1e-9, max_depth=9)).surface
    assert len(surface.level) == 2 * 16 * 16
    i = np.rint(surface.positions[:, 0] / 10 + 8).astype(int)
    j = np.rint(surface.positions[:, 1] / 10 + 8).astype(int)
    assert np.array_equal(surface.positions[:, 2], field.samples[j, i])
    assert np.array_equal(surface.uv, np.stack([i, j], axis=1).astype(np.float32) / 16)


@pytest.mark.parametrize("scale", [1.0, -3.0])
def test_normals_are_those_of_the_full_resolution_height_field(scale):
    field = rough(17, 33)
    criterion = Criterion(error_px=0.0, error_m=30.0, max_depth=9)  # coarse: normals must not depend on the triangles
    surface = Terrain(field, 1).update(criterion, vertical_scale=scale).surface
    gy, gx = np.gradient(np.asarray(field.samples, np.float64), 10.0)
    i = np.rint(surface.positions[:, 0] / 10 + 16).astype(int)
    j = np.rint(surface.positions[:, 1] / 10 + 8).astype(int)
    expected = np.stack([-scale * gx[j, i], -scale * gy[j, i], np.ones(len(i))], axis=1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert np.abs(surface.normals - expected).max() < 1e-6


@pytest.mark.parametrize("meshlet", [1, 2, 3, 4])
def test_a_meshlet_is_the_same_surface_as_that_many_bisections(meshlet):
    field = rough(9, 17)
    coarse = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=1e9, meshlet=meshlet, max_depth=15))
    assert coarse.triangles == 2 * field.lattice.squares << (2 * meshlet)
    assert_invariants(coarse.surface, field.lattice, meshlet)
    flat = from_array(np.full((9, 17), 5, np.float32), 10.0)
    # every node wants to be split down to the same depth: the uniform mesh
    view = View.look((0, 0, 1e4), (0, 1, 0))
    uniform = Terrain(flat, 1).update(
        Criterion(error_px=0, edge_px=1e-6, max_depth=1 + 2 * meshlet, off_screen_factor=1), [view]
    )
    assert uniform.triangles == coarse.triangles

    def by_corner(surface):
        return np.unique(np.sort(surface.positions[surface.triangles][:, :, :2].reshape(-1, 6), axis=1), axis=0)

    assert np.array_equal(by_corner(uniform.surface), by_corner(coarse.surface))


def test_vertical_scale_and_offset_move_every_height():
    field = rough(17, 17)
    plain = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=5.0))
    scaled = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=10.0), vertical_scale=2.0, vertical_offset=7.0)
    assert np.allclose(scaled.surface.positions[:, 2], plain.surface.positions[:, 2] * 2 + 7, atol=1e-4)
    assert scaled.terms_m.geometric == pytest.approx(2 * plain.terms_m.geometric, rel=1e-9)


def test_a_flat_map_is_two_triangles_a_square_with_flat_normals():
    field = from_array(np.full((5, 9), -3.0, np.float32), 10.0)
    update = Terrain(field, 1).update(Criterion(error_px=0.01), [VIEW])
    assert update.triangles == 2 * field.lattice.squares and update.terms_px.geometric == 0.0
    assert np.array_equal(np.unique(update.surface.normals, axis=0), [[0, 0, 1]])


@pytest.mark.parametrize("meshlet", [0, 2])
def test_a_warm_build_allocates_no_memory(meshlet, monkeypatch, eager_threads):
    """Also where a caller still has the surface of the update before, as in every loop."""
    build, peaks = terrains.build_surface, []

    def measured(*arguments):
        tracemalloc.start()
        surface = build(*arguments)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        return surface

    monkeypatch.setattr(terrains, "build_surface", measured)
    terrain = Terrain(rough(65, 129), 2)
    criterion = Criterion(error_px=0.2, meshlet=meshlet)
    views = [View.look((x, -400.0, 120.0), (0, 0, 0)) for x in (0.0, 30.0)]
    for n in range(8):
        update = terrain.update(criterion, [views[n % 2]])
        assert update.changed and len(peaks) == n + 1
    assert update.surface.positions.nbytes > 80_000 and peaks[0] > 30_000
    # Of each view's warm builds the least: what grows is in every one, what Python itself happens to keep is not.
    assert max(min(peaks[4::2]), min(peaks[5::2])) < 30_000


def flown(field, meshlet=0, threads=2):
    """Return a terrain after three frames of a slow flight, its criterion, and the views of the next frames."""
    terrain, views = Terrain(field, threads), [View.look((0.1 * n, -400.0, 120.0), (0, 0, 0)) for n in range(6)]
    asked = Criterion(error_px=0.2 if meshlet == 3 else 0.4, meshlet=meshlet)  # of meshlets few leaves are left
    for view in views[:3]:
        terrain.update(asked, [view])
    return terrain, asked, views[3:]


@pytest.mark.parametrize(
    ("interpolation", "meshlet", "rows"),
    [("bicubic", 0, 65), ("bilinear", 1, 65), pytest.param("bilinear", 3, 129, marks=pytest.mark.thorough)],
)
def test_points_that_stay_are_not_displaced_again(interpolation, meshlet, rows, eager_threads):
    """Positions that change unseen between two frames stay changed where points were taken from the last frame."""
    field = interpolated(rough(rows, 129), interpolation)
    terrain, asked, views = flown(field, meshlet)
    terrain.history.last.arrays.numpy("positions")[:, 2] += 1000.0
    heights = terrain.update(asked, [views[0]]).surface.positions[:, 2]
    fresh = Terrain(field, 1).update(asked, [views[0]]).surface.positions[:, 2]
    raised = heights > 500.0
    # 4 triangles for a leaf have no point inside of it
    assert raised.mean() == 0 if meshlet == 1 else 0.2 < raised.mean() < 1.0
    assert np.array_equal(heights, np.where(raised, fresh + np.float32(1000.0), fresh))


def test_meshlets_that_follow_others_are_those_of_a_single_frame(eager_threads):
    """Another level, another scale, a frame without meshlets: nothing of the last frame fits then."""
    field = rough(65, 129)
    terrain, asked, views = flown(field, meshlet=2)
    for meshlet, scale in ((2, 1.0), (2, 1.0), (3, 1.0), (3, 2.0), (3, 2.0), (0, 2.0), (2, 2.0), (2, 2.0), (1, 2.0)):
        criterion = replace(asked, meshlet=meshlet)
        views.append(View.look((0.1 * len(views), -400.0, 120.0), (0, 0, 0)))
        flown_one = terrain.update(criterion, [views[-1]], vertical_scale=scale).surface
        single = Terrain(field, 1).update(criterion, [views[-1]], vertical_scale=scale).surface
        assert arrays(flown_one) == arrays(single), (meshlet, scale)


@pytest.mark.parametrize("meshlet", [0, 2])
def test_an_interrupted_displacement_is_no_ones_last_frame(meshlet, monkeypatch, eager_threads):
    terrain, asked, views = flown(rough(129, 129), meshlet)

    slices = launch.slices

    def stopped(*args, **options):
        if options["step"] == "displace":
            raise KeyboardInterrupt
        slices(*args, **options)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(launch, "slices", stopped)
        terrain.update(asked, [View.look((60.0, -300.0, 100.0), (0, 0, 0))])
    assert terrain.history.last.vertices is None
    again = terrain.update(asked, [views[1]]).surface
    fresh = Terrain(rough(129, 129), 1).update(asked, [views[1]]).surface
    assert arrays(again) == arrays(fresh)
