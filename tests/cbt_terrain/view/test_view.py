# SPDX-License-Identifier: GPL-3.0-or-later
"""Views and their packing: projection, frustum planes, refusals."""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.view.local_view import frustum_planes
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, View
from fields import project


def test_look_puts_the_target_in_the_middle_and_up_upward():
    view = View.look((10, -20, 5), (40, 30, 2), fov_deg=60, resolution=(800, 600))
    pixels, seen = project(view, np.array([[40.0, 30, 2], [40, 30, 3]]))
    assert np.allclose(pixels[0], 0, atol=1e-9) and seen.all()
    assert pixels[1, 1] > 0 and abs(pixels[1, 0]) < 1e-9


def test_field_of_view_spans_the_larger_side():
    for resolution in ((1000, 500), (500, 1000)):
        (left, right), (low, high) = View.look((0, 0, 0), (0, 1, 0), fov_deg=90, resolution=resolution).bounds()
        assert np.isclose(max(right, high), 1.0) and np.isclose(min(left, low), -1.0)
        assert np.isclose((right - left) / (high - low), resolution[0] / resolution[1])


def test_bounds_follow_the_lens_shift():
    view = View.look((0, 0, 0), (0, 1, 0), fov_deg=90, resolution=(100, 100))
    projection = view.projection.copy()
    projection[0, 2] = 0.5
    (left, right), _ = View(view.world_to_camera, projection, (100, 100)).bounds()
    for tangent, edge in ((left, -1.0), (right, 1.0)):
        x, _, _, w = projection @ [tangent, 0, -1, 1]
        assert np.isclose(x / w, edge)


@pytest.mark.parametrize("kind", ["PERSPECTIVE", ORTHOGRAPHIC])
def test_what_is_seen_lies_inside_all_planes(kind):
    rng = np.random.default_rng(0)
    view = View.look((1, 2, 3), (-4, 5, 1), fov_deg=50, kind=kind, ortho_width=8, clip=(0.5, 40))
    points = rng.normal(0, 10, (20_000, 3))
    _, seen = project(view, points)
    camera = np.c_[points @ view.world_to_camera[:3, :3].T + view.world_to_camera[:3, 3], np.ones(len(points))]
    inside = (camera @ frustum_planes(view, (0.0, 0.0)).T > -1e-9).all(axis=1)
    assert seen.sum() > 50 and inside[seen].all()
    behind_start = -camera[:, 2] <= view.clip[0]  # the near plane passes through the eye
    assert not inside[~seen & ~behind_start].any()
    wider = (camera @ frustum_planes(view, (20.0, 20.0)).T > -1e-9).all(axis=1)
    assert wider[inside].all() and wider.sum() > inside.sum()


def test_a_panorama_has_no_planes():
    assert len(frustum_planes(View.look((0, 0, 0), (0, 1, 0), kind=PANORAMIC, fov_deg=360), (5.0, 5.0))) == 0


def test_what_cannot_be_a_view_is_refused():
    good = View.look((0, 0, 1), (1, 0, 0))
    with pytest.raises(TerrainError, match="kind"):
        View(good.world_to_camera, good.projection, (10, 10), "FISHEYE")
    with pytest.raises(TerrainError, match="resolution"):
        View(good.world_to_camera, good.projection, (0, 10))
    with pytest.raises(TerrainError, match="radians"):
        View(good.world_to_camera, None, (10, 10), PANORAMIC)
    for resolution in ((10**400, 5), (float("nan"), 5)):
        with pytest.raises(TerrainError, match="resolution"):
            View.look((0, 0, 1), (1, 0, 0), resolution=resolution)
    for fov in (0.0, 180.0, 274.0, -10.0, 1e-300):
        with pytest.raises(TerrainError, match="field of view"):
            View.look((0, 0, 1), (1, 0, 0), fov_deg=fov)
    with pytest.raises(TerrainError, match="clip range"):
        View.look((0, 0, 1), (1, 0, 0), clip=(5, 5))
    with pytest.raises(TerrainError, match="different points"):
        View.look((0, 0, 0), (0, 0, 0))


@pytest.mark.parametrize("width", [0.0, -2.0, math.inf, math.nan])
def test_an_orthographic_view_has_a_width(width):
    with pytest.raises(TerrainError, match="metres wide"):
        View.look((0, 0, 5), (0, 0, 0), kind=ORTHOGRAPHIC, ortho_width=width)
