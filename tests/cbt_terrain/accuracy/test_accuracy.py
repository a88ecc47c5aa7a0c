# SPDX-License-Identifier: GPL-3.0-or-later
"""Measured errors in metres and degrees: against brute force, and where the answer is known."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.interpolation import interpolation
from adaptive_terrain.cbt_terrain.accuracy.measure import look, measure, popping, shading_change, triangle_errors
from adaptive_terrain.cbt_terrain.accuracy.mesh import MeasuredMesh, MeshGround, errors_of
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, View
from fields import mesh_heights, reference_heights, rough
from invariants import with_arrays


def mesh_of(field, error_m, scale=1.0, offset=0.0, **asked):
    """Return a copy of the surface for a vertical error."""
    update = Terrain(field, 1).update(
        Criterion(error_px=0.0, error_m=error_m, **asked), vertical_scale=scale, vertical_offset=offset
    )
    return update.surface.copy()


def spiked(height=10.0):
    """Return 5 x 5 flat samples 8 m apart, one of them raised."""
    samples = np.zeros((5, 5), np.float32)
    samples[1, 1] = height
    return from_array(samples, 8.0)


def grid(field, per_cell):
    """Return points [n, 2] of the terrain's own space, `per_cell` to a cell's side."""
    lattice = field.lattice
    i = np.linspace(0, lattice.width - 1, (lattice.width - 1) * per_cell + 1)
    j = np.linspace(0, lattice.height - 1, (lattice.height - 1) * per_cell + 1)
    x, y = np.meshgrid((i - (lattice.width - 1) / 2) * lattice.step_x, (j - (lattice.height - 1) / 2) * lattice.step_y)
    return np.stack([x.reshape(-1), y.reshape(-1)], axis=1)


def test_a_plane_has_no_error_at_all():
    j, i = np.mgrid[0:17, 0:33]
    field = from_array((3.0 * i - 2.0 * j).astype(np.float32), 8.0)
    view = View.look((0, -200, 300), (0, 0, 0), resolution=(64, 48))
    measured = measure(field, mesh_of(field, 1.0), view, random_points=1000)
    assert measured.vertical_m.count == 17 * 33 + 1000
    assert measured.vertical_max_m == measured.vertical_m.max == measured.rounding_m == 0.0
    assert measured.facet_deg.max < 1e-5 and measured.shading_deg.max < 1e-5
    assert measured.screen_px.count > 17 * 33 and measured.screen_px.max == 0.0 and measured.silhouette_px.max < 1e-2


def test_holes_are_no_part_of_a_distribution():
    samples = np.zeros((17, 17), np.float32)
    samples[4:13, 4:13] = np.nan
    field = from_array(samples, 8.0, holes=True)
    surface = mesh_of(field, 1.0)
    raised = with_arrays(surface, positions=surface.positions + np.float32([0.0, 0.0, 2.0]))
    found = measure(field, raised, random_points=4000).vertical_m
    # All that is covered is 2 m off, three quarters of the ground about.
    assert found.max == found.p95 == found.p999 == found.mean == found.rms == 2.0
    assert 17 * 17 - 81 <= found.count - 4000 * (1 - (10 / 16) ** 2) < 17 * 17


@pytest.mark.parametrize("rows", [1, 5, 256])
def test_ground_is_the_corners_of_whole_cells(monkeypatch, rows):
    """For blocks of any number of rows, against a loop over the cells; as if the mesh covered all samples."""
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.accuracy.mesh.ROWS", rows)
    monkeypatch.setattr(MeasuredMesh, "walk", lambda _mesh, _kernel, arrays: arrays[0].fill_(3.0))
    samples = np.zeros((23, 31), np.float32)
    samples[np.random.default_rng(2).random(samples.shape) < 0.25] = np.nan
    field = from_array(samples, 8.0, holes=True)
    mesh = MeasuredMesh(MeshGround(field, 1.0, 0.0, 1), mesh_of(field, 1.0))
    difference, _ = mesh.differences()
    expected = np.zeros(samples.shape, bool)
    for j, i in np.ndindex(22, 30):
        cell = np.s_[j : j + 2, i : i + 2]
        expected[cell] |= np.isfinite(samples[cell]).all()
    assert np.isfinite(samples).sum() > expected.sum() > 400 and np.array_equal(mesh.covered, expected)
    assert np.array_equal(difference, np.where(expected, 3.0, 0.0))


def test_one_spike_is_one_error():
    measured = measure(spiked(), mesh_of(spiked(), 100.0), random_points=0)
    assert measured.vertical_m.__dict__ == {"count": 25, "max": 10.0, "p95": 0.0, "p999": 10.0, "mean": 0.4, "rms": 2.0}
    assert measured.vertical_max_m == 10.0 and measured.screen_px is None


def test_a_saddle_is_a_quarter_of_its_twist_from_two_triangles():
    field = from_array(np.array([[0, 0], [0, 8]], np.float32), 4.0)
    measured = measure(field, mesh_of(field, 100.0), random_points=0)
    assert measured.vertical_m.max == 0.0 and measured.vertical_max_m == 2.0


def test_normals_of_a_ramp_seen_as_flat_are_off_by_its_slope():
    field = from_array(np.arange(25, dtype=np.float32).reshape(5, 5) // 5 * 8, 8.0)  # 45 degrees
    surface = mesh_of(field, 1.0)
    assert measure(field, surface, random_points=0).facet_deg.max < 1e-5
    flat = with_arrays(surface, normals=np.tile(np.float32([0, 0, 1]), (len(surface.normals), 1)))
    level = replace(flat, positions=surface.positions * np.float32([1, 1, 0]))
    measured = measure(field, level, random_points=0)
    assert measured.facet_deg.max == pytest.approx(45.0) and measured.shading_deg.mean == pytest.approx(45.0)


@pytest.mark.parametrize("meshlet", [0, 2])
@pytest.mark.parametrize("error_m", [40.0, 0.4])  # far above and below the raster's cells
def test_vertical_errors_are_those_of_brute_force(meshlet, error_m):
    z = rough(9, 17, seed=3).samples
    field, scale, offset = from_array(np.array(z), 10.0, 7.0), -2.0, 5.0
    surface = mesh_of(field, error_m, scale, offset, meshlet=meshlet)
    ground = MeshGround(field, scale, offset, 1)
    mesh = MeasuredMesh(ground, surface)
    points = ground.random_points(2000, 1)
    plane = points * 2.0 ** -(ground.bits + 7) * (10.0, 7.0) - (80.0, 28.0)
    expected = mesh_heights(surface, plane) - (reference_heights(field, plane) * scale + offset)
    found, owner = mesh.differences_at(points)
    assert np.abs(found - expected).max() < 1e-4
    inside = surface.positions[surface.triangles[owner], :2].astype(float)
    assert (plane <= inside.max(axis=1) + 1e-4).all() and (plane >= inside.min(axis=1) - 1e-4).all()

    samples = grid(field, 1)
    expected = mesh_heights(surface, samples) - (reference_heights(field, samples) * scale + offset)
    assert np.abs(mesh.differences()[0].reshape(-1) - expected).max() < 1e-4

    dense = grid(field, 16)
    dense_max = np.abs(mesh_heights(surface, dense) - (reference_heights(field, dense) * scale + offset)).max()
    measured = measure(field, surface, vertical_scale=scale, vertical_offset=offset, random_points=0)
    assert dense_max - 1e-4 < measured.vertical_max_m < 1.05 * dense_max
    worst = triangle_errors(field, surface, [], vertical_scale=scale, vertical_offset=offset)
    assert worst.shape == (len(surface.level),) and worst.max() == np.float32(measured.vertical_max_m)


def test_points_on_borders_of_triangles_are_found_once():
    field = rough(9, 17)
    ground = MeshGround(field, 1.0, 0.0, 1)
    mesh = MeasuredMesh(ground, mesh_of(field, 0.1, meshlet=1))
    ends = np.array(ground.point_ends)
    points = np.array([[0, 0], ends, [ends[0], 0], [0, ends[1]], ends // 2, ends // 4, [ends[0], ends[1] // 2]])
    plane = (points / 2.0 ** (ground.bits + 7) - (8, 4)) * 10.0
    found, _ = mesh.differences_at(points)
    assert np.abs(found - (mesh_heights(_surface(mesh), plane) - reference_heights(field, plane))).max() < 1e-4


def _surface(mesh):
    class Plain:
        positions = mesh.packed.positions.numpy()
        triangles = mesh.packed.corners.numpy().reshape(-1, 3)

    return Plain


def test_a_mesh_whose_heights_were_moved_is_measured_as_it_is():
    field = rough(17, 17)
    surface = mesh_of(field, 2.0)
    moved = surface.positions + np.random.default_rng(0).uniform(-1, 1, (len(surface.positions), 1)) * [0, 0, 1]
    surface = replace(surface, positions=moved.astype(np.float32))
    dense = grid(field, 8)
    expected = np.abs(mesh_heights(surface, dense) - reference_heights(field, dense)).max()
    measured = measure(field, surface, random_points=0)
    assert expected - 1e-4 < measured.vertical_max_m < 1.05 * expected
    assert 0 < measured.rounding_m < 1e-5  # half a unit in the last place of 100 m is 4e-6


def test_rounding_of_positions_is_a_separate_figure():
    j, i = np.mgrid[0:33, 0:33]
    field = from_array((64.0 * i).astype(np.float32), 0.1)
    measured = measure(field, mesh_of(field, 1e-12), random_points=0)
    # the surface is a plane, so all error is rounding: 2^-25 of 1.6 m on a slope of 640, at most
    assert 0 < measured.rounding_m < 640 * 2.0**-24
    assert measured.vertical_max_m == pytest.approx(measured.rounding_m, rel=1e-6)


def test_a_mesh_that_leaves_samples_uncovered_is_refused():
    field = rough(17, 17)
    surface = mesh_of(field, 5.0)
    part = replace(surface, corner_verts=surface.corner_verts[:-9])
    with pytest.raises(TerrainError, match="does not cover"):
        measure(field, part)
    broken = replace(surface, positions=surface.positions * np.float32(np.nan))
    with pytest.raises(TerrainError, match="not finite"):
        measure(field, broken)


def test_the_same_bytes_for_any_number_of_threads(eager_threads):
    field = rough(17, 33)
    surface = mesh_of(field, 1.0, meshlet=1)
    view = View.look((0, -150, 120), (0, 0, 0), resolution=(64, 48))
    results = [measure(field, surface, view, random_points=500, threads=n) for n in (1, 2, 7)]
    assert results[0].silhouette_px.count > 0
    assert repr(results[0]) == repr(results[1]) == repr(results[2])
    by_triangle = [triangle_errors(field, surface, [view], threads=n).tobytes() for n in (1, 2, 7)]
    assert by_triangle[0] == by_triangle[1] == by_triangle[2]


def test_a_sight_serves_every_mesh_of_its_view_and_no_other():
    field, view = rough(17, 33), View.look((0, -150, 120), (0, 0, 0), resolution=(64, 48))
    sight = look(field, view)
    for error_m in (5.0, 1.0):
        surface = mesh_of(field, error_m)
        assert repr(measure(field, surface, view, sight=sight)) == repr(measure(field, surface, view))
    with pytest.raises(TerrainError, match="sight"):
        measure(field, surface, View.look((0, -151, 120), (0, 0, 0), resolution=(64, 48)), sight=sight)


def test_progress_rises_to_one_and_may_cancel():
    field, told = rough(17, 17), []
    view = View.look((0, -150, 120), (0, 0, 0), resolution=(64, 48))
    measure(field, mesh_of(field, 5.0), view, on_progress=told.append)
    assert told == sorted(told) and 0 < told[0] and told[-1] == 1.0

    def cancel(fraction):
        if fraction > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        measure(field, mesh_of(field, 5.0), view, on_progress=cancel)


def test_popping_is_how_far_points_jump():
    field = spiked()
    coarse, fine = mesh_of(field, 100.0), mesh_of(field, 0.1)
    # 45 degrees from above, 2 pixels a metre: 10 m of height are 10 sqrt(2) pixels
    view = View.look((0, -90, 90), (0, 0, 0), kind=ORTHOGRAPHIC, ortho_width=80.0, resolution=(160, 160))
    sight = look(field, view)
    jump = popping(coarse, fine, sight)
    assert jump.max == pytest.approx(10 * 2**0.5, rel=0.01)
    assert popping(fine, fine, sight).max == 0.0
    assert popping(fine, coarse, sight) == jump


def test_a_shading_change_is_the_distance_between_normals():
    """A level mesh, and the same with one normal turned by 90 degrees: nothing changes in triangles without it."""
    field = spiked()
    before = mesh_of(field, 100.0)
    view = View.look((0, -90, 90), (0, 0, 0), kind=ORTHOGRAPHIC, ortho_width=80.0, resolution=(160, 160))
    sight = look(field, view)
    level = before.copy()
    level.normals[:] = (0.0, 0.0, 1.0)
    turned = level.copy()
    turned.normals[:] = (1.0, 0.0, 0.0)
    found = shading_change(level, turned, sight)
    assert found.max == found.mean == pytest.approx(255 * 2**0.5) and found.count > 1000
    turned.normals[:] = level.normals
    turned.normals[turned.triangles[0]] = (0.6, 0.0, 0.8)
    some = shading_change(level, turned, sight)
    assert some.mean < some.max <= 255 * 0.4**0.5 + 1e-3 and some == shading_change(turned, level, sight)
    assert shading_change(level, level, sight).max == 0.0


def test_a_distribution_is_that_of_numpy():
    values = np.random.default_rng(0).standard_normal(1001)
    found = errors_of(values.copy())
    assert (found.count, found.max) == (1001, np.abs(values).max())
    assert found.p95 == np.quantile(np.abs(values), 0.95, method="inverted_cdf")
    assert found.p999 == np.quantile(np.abs(values), 0.999, method="inverted_cdf") < found.max
    assert found.mean == pytest.approx(np.abs(values).mean()) and found.rms == pytest.approx((values**2).mean() ** 0.5)
    assert errors_of(np.zeros(0)).count == 0


def test_interpolation_of_a_spike_differs_as_keys_kernel_says():
    samples = np.zeros((9, 9), np.float32)
    samples[4, 4] = 16.0
    found = interpolation(from_array(samples, 1.0))
    # 81/256 of 16 m less a quarter in the nearest cells; 9/16 less a half, and 1/16, on the lines through the spike
    assert found.count == 2 * 9 * 8 + 8 * 8 and found.max == 81 / 16 - 4
    total = 4 * (9 - 8) + 4 * 1 + 4 * (81 / 16 - 4) + 8 * 9 / 16 + 4 / 16
    assert found.mean == pytest.approx(total / found.count)


@pytest.mark.parametrize("rows", [255, 256, 257, 258, 511, 513])
def test_interpolation_of_a_parabola_is_off_by_its_curvature(rows):
    y = np.arange(rows, dtype=np.float32)
    field = from_array(np.repeat(y[:, None] ** 2, 5, axis=1), 1.0)
    assert field.samples.shape == (rows, 5)
    found = interpolation(field)
    high, wide = field.samples.shape
    inner, outer = (high - 3) * 0.25, 2 * 0.125  # at the border the curvature is half
    assert found.count == high * (wide - 1) + (high - 1) * wide + (high - 1) * (wide - 1)
    assert found.max == 0.25 and found.mean * found.count == pytest.approx((inner + outer) * (2 * wide - 1))
