# SPDX-License-Identifier: GPL-3.0-or-later
"""Measured errors in pixels: against brute force over the same points, and where sight and outline are known."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.measure import look, measure, triangle_errors
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View
from adaptive_terrain.kernels.accuracy.screen import HIDDEN, VISIBLE
from fields import mesh_heights, project, reference_heights, rough, screen_error

PLACEMENT = np.array([[1.1, 0.3, 0, 20], [-0.2, 0.8, 0.1, -10], [0.1, 0, 1.3, 5], [0, 0, 0, 1]])


def seen_from(kind, eye=(-60, -190, 170), resolution=(60, 44)):
    fov = 360.0 if kind == PANORAMIC else 50.0
    return View.look(eye, (0, 20, 0), kind=kind, fov_deg=fov, ortho_width=260.0, resolution=resolution)


def plane_of(field, points, bits):
    """Return points of the measurement in the terrain's own space, [n, 2] metres."""
    lattice = field.lattice
    cells = points * 2.0 ** -(bits + 7)
    return (cells - (np.array([lattice.width, lattice.height]) - 1) / 2) * (lattice.step_x, lattice.step_y)


def all_samples(field):
    j, i = np.mgrid[0 : field.lattice.height, 0 : field.lattice.width]
    centre = (field.lattice.width - 1) / 2, (field.lattice.height - 1) / 2
    x, y = (i - centre[0]) * field.lattice.step_x, (j - centre[1]) * field.lattice.step_y
    return np.stack([x.reshape(-1), y.reshape(-1)], axis=1)


@pytest.mark.parametrize("placement", [None, PLACEMENT], ids=["at the origin", "sheared"])
@pytest.mark.parametrize("kind", [PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC])
def test_screen_errors_are_those_of_brute_force(kind, placement):
    field, view = rough(17, 33, seed=1), seen_from(kind)
    surface = Terrain(field, 1).update(Criterion(error_px=4.0), [view], placement).surface
    sight = look(field, view, placement)
    measured = measure(field, surface, view, placement, sight=sight, random_points=0)
    points = plane_of(field, sight.visible_points(), sight.ground.bits)
    assert measured.screen_px.max == pytest.approx(
        max(
            screen_error(view, field, surface, points, placement),
            screen_error(view, field, surface, all_samples(field)[sight.states() == int(VISIBLE)], placement),
        ),
        rel=1e-4,
    )
    # By area on the screen: a point a pixel, however dense the samples are.
    heights = reference_heights(field, points), mesh_heights(surface, points)
    ends, _ = zip(*(project(view, np.c_[points, z], placement) for z in heights), strict=True)
    apart = np.linalg.norm(ends[0] - ends[1], axis=1)
    if kind == PANORAMIC:
        apart = 2 * np.arcsin(apart / 2) / view.radians_per_pixel
    assert measured.screen_px.p95 == pytest.approx(np.quantile(apart, 0.95, method="inverted_cdf"), rel=1e-3)
    assert measured.screen_px.mean == pytest.approx(apart.mean(), rel=1e-3)
    hidden = screen_error(view, field, surface, all_samples(field)[sight.states() == int(HIDDEN)], placement)
    assert measured.hidden_px.max == pytest.approx(hidden, rel=1e-4)
    truth = np.c_[all_samples(field), reference_heights(field, all_samples(field))]
    in_frame = project(view, truth, placement)[1].sum()
    assert measured.screen_px.count + measured.hidden_px.count == in_frame + len(points)
    worst = triangle_errors(field, surface, [view], placement)
    assert worst.max() >= max(measured.screen_px.max, measured.hidden_px.max) > 0.5


def first_crossings(field, sight, points, seen):
    """Walk densely from the eye: return whether rays meet the surface before the points that they should meet first."""
    eye = np.array(sight.eye.eye)
    eye[:2] = (eye[:2] - (np.array([field.lattice.width, field.lattice.height]) - 1) / 2) * 10.0
    along = np.linspace(0.0, 1.0, 4001)[:-4]
    early = []
    for target in points[seen]:
        walked = eye + along[:, None] * (target - eye)
        inside = (np.abs(walked[:, :2]) <= np.array([160.0, 80.0])).all(axis=1)
        above = np.sign(walked[inside, 2] - reference_heights(field, walked[inside, :2]))
        early.append(len(above) > 1 and (above != above[0]).any())
    return np.array(early)


@pytest.mark.parametrize("eye", [(-60, -190, 170), (10, 5, 90), (30, -40, -300)], ids=["outside", "inside", "below"])
def test_points_are_seen_where_no_surface_is_before_them(eye):
    field, view = rough(17, 33, seed=2), seen_from(PERSPECTIVE, eye, (24, 18))
    sight = look(field, view)
    seen = sight.visible_points()
    plane = plane_of(field, seen, sight.ground.bits)
    points = np.c_[plane, reference_heights(field, plane)]
    pixels, in_frame = project(view, points)
    middles = np.argwhere(sight.covered())[:, ::-1] + 0.5 - (12, 9)
    assert len(seen) > 100 and in_frame.all() and np.abs(pixels - middles).max() < 1e-3
    assert not first_crossings(field, sight, points, slice(None)).any()

    samples = np.c_[all_samples(field), reference_heights(field, all_samples(field))]
    for state, covered in ((VISIBLE, False), (HIDDEN, True)):
        chosen = sight.states() == int(state)
        early = first_crossings(field, sight, samples, chosen)
        # a ray that grazes may pass between two of the places looked at
        assert chosen.sum() > 5 and (early == covered).mean() > 0.97


def wall():
    """Return level ground of 33 x 33 samples, 1 m apart, with a wall of 8 m from west to east in its middle."""
    samples = np.zeros((33, 33), np.float32)
    samples[16] = 8.0
    return from_array(samples, 1.0)


def test_a_wall_hides_exactly_the_ground_in_its_shadow():
    field = wall()
    view = View.look((0, -50, 50), (0, 0, 0), kind=ORTHOGRAPHIC, ortho_width=60.0, resolution=(60, 60))
    states = look(field, view).states().reshape(33, 33)
    # at 45 degrees the shadow is 8 long; the ray to its end touches the top of the wall
    assert (states[17:24] == int(HIDDEN)).all()
    assert (states[:17] == int(VISIBLE)).all() and (states[24:] == int(VISIBLE)).all()


def test_ground_before_the_clip_start_hides_nothing():
    field = wall()
    view = View.look((0, -2, 2), (0, 14, 0), resolution=(60, 60), fov_deg=60.0)
    behind = (slice(20, 33), slice(13, 20))
    assert (look(field, view).states().reshape(33, 33)[behind] == int(HIDDEN)).all()
    cut = replace(view, clip=(4.0, 1e6))
    assert (look(field, cut).states().reshape(33, 33)[behind] == int(VISIBLE)).all()


def full_mesh(field):
    surface = (
        Terrain(field, 1).update(Criterion(error_px=0.0, error_m=1e-9, max_depth=field.lattice.cell_depth)).surface
    )
    return replace(surface, positions=surface.positions.copy())


@pytest.mark.parametrize("roll_deg", [0.0, 27.0])
def test_a_ridge_raised_by_a_metre_moves_the_outline(roll_deg):
    field = wall()
    surface = full_mesh(field)
    true, raised = surface.positions, surface.positions.copy()
    raised[true[:, 2] == 8.0, 2] = 9.0
    view = View.look(
        (0, -100, 4), (0, 0, 4), kind=ORTHOGRAPHIC, ortho_width=40.0, resolution=(80, 60), roll_deg=roll_deg
    )
    outline = measure(field, surface, view).silhouette_px
    assert outline.count > 64 and outline.max < 2**-9
    outline = measure(field, replace(surface, positions=raised), view).silhouette_px
    assert outline.max == pytest.approx(2.0, abs=2**-9)
    # the ridge's top is as far from its place along all its length, the sides and the foot did not move
    assert 0.3 < outline.mean / 2.0 < 0.7


def test_no_sky_in_the_frame_is_no_outline():
    field = rough(17, 33)
    view = View.look((0, 0, 500), (0, 1, 0), kind=ORTHOGRAPHIC, ortho_width=50.0, resolution=(40, 40))
    measured = measure(field, full_mesh(field), view)
    assert measured.silhouette_px is None and measured.screen_px.count > 1600


def test_a_missing_outline_counts_with_the_border_distance():
    field = wall()
    surface = full_mesh(field)
    flat = surface.positions * np.float32([1, 1, 0]) - np.float32([0, 0, 500])
    view = View.look((0, -100, 4), (0, 0, 4), kind=ORTHOGRAPHIC, ortho_width=20.0, resolution=(80, 60))
    outline = measure(field, replace(surface, positions=flat), view).silhouette_px
    # the ridge's top is 16 pixels above the middle of 60, sixteen more are searched
    assert outline.max == pytest.approx(30 + 16 - 16 - 0.5, abs=0.1)


def test_a_point_behind_the_eye_counts_at_half_the_clip_start():
    field = from_array(np.float32(1e-6) * np.random.default_rng(0).random((5, 5)), 1.0)
    surface = full_mesh(field)
    positions = surface.positions.copy()
    positions[(np.abs(positions[:, :2]) < 0.1).all(axis=1), 2] = 100.0
    view = View.look((0.25, 0.0, 5.0), (0.25, 1e-9, 0.0), clip=(0.5, 1e6), resolution=(100, 100), fov_deg=90.0)
    measured = measure(field, replace(surface, positions=positions), view)
    # the frame is 50 pixels from its middle to where it is as wide as far
    expected = 50 * 0.25 * (1 / 0.25 - 1 / 5.0)
    states = look(field, view).states()
    assert states[12] == int(VISIBLE) and measured.screen_px.count > 25 + 40**2
    # points beside the middle, on the slopes of the raised vertex, are moved further
    assert expected - 1e-3 < measured.screen_px.max < 50 * 2**0.5 * 2 * (1 / 0.25)
    assert np.isfinite(triangle_errors(field, replace(surface, positions=positions), [view])).all()


def test_a_flat_map_is_seen():
    field = from_array(np.full((5, 5), 3.0, np.float32), 1.0)
    view = View.look((0, 0, 100), (0, 1e-9, 3), kind=ORTHOGRAPHIC, ortho_width=8.0, resolution=(80, 80))
    assert look(field, view).covered().sum() == 40 * 40
    measured = measure(field, full_mesh(field), view)
    assert measured.screen_px.max == 0.0 and measured.silhouette_px.max < 2**-9


def test_error_of_a_spike_is_on_its_triangles():
    samples = np.zeros((5, 5), np.float32)
    samples[1, 1] = 10.0
    field = from_array(samples, 8.0)
    surface = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=100.0)).surface
    side = View.look((0, -90, 0.0), (0, 0, 0), kind=ORTHOGRAPHIC, ortho_width=80.0, resolution=(160, 160))
    above = View.look((0, 0, 90), (0, 1e-9, 0), kind=ORTHOGRAPHIC, ortho_width=80.0, resolution=(160, 160))
    worst = triangle_errors(field, surface, [side, above])
    # two pixels a metre; seen from above, height moves nothing
    assert worst.shape == (2,) and sorted(worst)[1] == pytest.approx(20.0, rel=1e-6)
    assert triangle_errors(field, surface, [above]).max() < 1e-6
    away = View.look((0, -90, 0.0), (0, -180, 0), kind=PERSPECTIVE, resolution=(160, 160))
    assert triangle_errors(field, surface, [away]).max() == 0.0


@pytest.mark.parametrize("x", [0.0, 1e-10])
def test_an_eye_on_the_mesh_sees_finite_errors(x):
    """The reference a nanometre below the eye, in front of the clip start, and the mesh at the eye's own height."""
    heights = np.zeros((3, 3), np.float32)
    heights[1, 1] = -1e-9
    field = from_array(heights)
    view = View.look((x, 0.0, 0.0), (x, 0.0, -1.0), clip=(1e-10, 1.0), resolution=(16, 16))
    found = Terrain(field, 1).update(Criterion(error_px=1.0, max_depth=1), [view])
    measured = measure(field, found.surface, view, random_points=10)
    assert measured.screen_px.count == 257 and measured.screen_px.max <= found.bound_px
    assert triangle_errors(field, found.surface, [view]).max() <= found.bound_px
