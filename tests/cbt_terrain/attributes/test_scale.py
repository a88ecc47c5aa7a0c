# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of footprints, against logarithms in numpy, for all kinds of cameras and placements."""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.scale import fixed_level, footprint_levels
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.view.linear import product
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, View

STEP = 0.5  # metres
FIELD = from_array(np.zeros((1025, 1025), np.float32), 0.25, STEP)
POSITIONS = np.random.default_rng(0).uniform(-200, 200, (5000, 3)).astype(np.float32)
LOOK = View.look((150.0, -300.0, 90.0), (0, 0, 0), resolution=(96, 54))


def turned(scale=(1.0, 1.0, 1.0), angles=(0.3, -0.5, 1.1)) -> np.ndarray:
    """float64 [4, 4]: scaled, turned about all axes, moved far away."""
    a, b, c = angles
    x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    matrix = np.eye(4)
    matrix[:3, :3] = product(product(z, y), product(x, np.diag(scale)))
    matrix[:3, 3] = 5e4, -3e4, 200.0
    return matrix


def moved(view: View, matrix: np.ndarray) -> View:
    """Return the view of a camera that a rigid matrix moves with the terrain."""
    inverse = np.eye(4)
    inverse[:3, :3] = matrix[:3, :3].T
    inverse[:3, 3] = -product(matrix[:3, :3].T, matrix[:3, 3])
    return View(product(view.world_to_camera, inverse), view.projection, view.resolution, view.kind, view.clip)


def agree(found: np.ndarray, metres: np.ndarray) -> None:
    """Assert that levels are multiples of 1/8 within 1/16 of the logarithm, from 0 to the coarsest level."""
    assert (found * 8 == np.rint(found * 8)).all()
    expected = np.clip(np.log2(metres / STEP), 0, 10)
    assert abs(found - expected).max() <= 1 / 16 + 1e-6
    assert len(np.unique(found)) > 3 or np.ptp(expected) < 0.2


def distance(eye) -> np.ndarray:
    return np.sqrt(((POSITIONS.astype(np.float64) - eye) ** 2).sum(1))


@pytest.mark.parametrize("resolution", [(1920, 1080), (64, 100)])
def test_of_a_lens_it_grows_with_distance(resolution):
    view = View.look((150.0, -300.0, 90.0), (0, 0, 0), fov_deg=40, resolution=resolution)
    pixel = 2 * math.tan(math.radians(20)) / max(resolution)
    agree(footprint_levels(FIELD, POSITIONS, [view]), distance((150, -300, 90)) * pixel)


def test_of_a_panorama_it_grows_with_distance_on_all_sides():
    view = View.look((10.0, 20.0, 30.0), (0, 0, 0), kind=PANORAMIC, fov_deg=360, resolution=(200, 100))
    agree(footprint_levels(FIELD, POSITIONS, [view]), distance((10, 20, 30)) * math.tau / 200)


def test_of_an_orthographic_view_it_is_one_and_the_same():
    view = View.look((0, -300.0, 90.0), (0, 0, 0), kind=ORTHOGRAPHIC, ortho_width=960.0, resolution=(320, 200))
    agree(footprint_levels(FIELD, POSITIONS, [view]), np.full(5000, 3.0))


def test_turning_the_camera_changes_nothing():
    around = View.look((150.0, -300.0, 90.0), (150.0, -300.0, 0.0), roll_deg=33, resolution=(96, 54))
    found = footprint_levels(FIELD, POSITIONS, [LOOK])
    assert found.min() > 0 and (found == footprint_levels(FIELD, POSITIONS, [around])).all()


def test_of_several_views_the_finest_counts_in_any_order():
    views = [LOOK, View.look((-300.0, 40.0, 100.0), (0, 0, 0), resolution=(100, 60))]
    alone = [footprint_levels(FIELD, POSITIONS, [view]) for view in views]
    both = footprint_levels(FIELD, POSITIONS, views, threads=3)
    assert (both == np.minimum(*alone)).all() and (alone[0] != alone[1]).any()
    assert both.tobytes() == footprint_levels(FIELD, POSITIONS, views[::-1]).tobytes()


def test_where_camera_and_terrain_go_together_nothing_changes():
    rigid = turned()
    found = footprint_levels(FIELD, POSITIONS, [moved(LOOK, rigid)], rigid)
    assert abs(found - footprint_levels(FIELD, POSITIONS, [LOOK])).max() <= 1 / 8
    agree(found, distance((150, -300, 90)) / LOOK.pixels_per_unit)


def test_the_footprint_is_along_the_least_scaled_axis():
    """Distances are the world's, footprints the terrain's own metres; how heights are stretched does not count."""
    matrix = turned((4.0, 0.5, 0.01))
    eye = np.array([5e4 + 900, -3e4, 400.0])
    view = View.look(eye, (5e4, -3e4, 200.0))
    world = product(POSITIONS, matrix[:3, :3].T) + matrix[:3, 3]
    metres = np.sqrt(((world - eye) ** 2).sum(1)) / view.pixels_per_unit / 0.5
    agree(footprint_levels(FIELD, POSITIONS, [view], matrix), metres)


def test_at_the_eye_and_without_views_it_is_the_finest():
    eye = POSITIONS[7].astype(np.float64)
    levels = footprint_levels(FIELD, POSITIONS, [View.look(eye, eye + [1, 2, 0], fov_deg=120, resolution=(10, 10))])
    assert levels[7] == 0 and levels.max() > 3
    assert not footprint_levels(FIELD, POSITIONS, []).any()


def test_a_scale_in_metres_is_a_level():
    assert [fixed_level(FIELD, metres) for metres in (0.0, 0.1, 0.5, 1.0, 4.0, 3.0, 1e9)] == [0, 0, 0, 1, 3, 2.625, 10]
    for metres in (-1.0, math.nan, math.inf):
        with pytest.raises(TerrainError, match=r"scale of effects for geometry is .* m; expected a distance"):
            fixed_level(FIELD, metres)
