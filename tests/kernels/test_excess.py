# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a leaf is in the frame: bounds in pixels speak of that, and hold for all of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.domain import make_domain
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.local_view import localise
from adaptive_terrain.cbt_terrain.view.view import View
from fields import mesh_heights, project, reference_heights, rough, scattered, screen_error
from twins import load

BOXES = 200


@pytest.fixture(scope="module")
def kernels():
    return load("refine.boxes_in_view", Path(__file__).with_name("boxes_in_view.py"))


def test_nothing_in_a_box_and_seen_is_less_deep_than_is_said(kernels):
    """200 boxes near a camera, 4,000 points each; of those whose true height is in the frustum."""
    rng = np.random.default_rng(5)
    known = []
    for _ in range(BOXES):
        size = 10.0 ** rng.uniform(-1, 3)
        eye = rng.uniform(-1, 1, 3) * 100.0
        view = View.look(eye, eye + rng.normal(size=3), fov_deg=rng.uniform(20, 110), resolution=(960, 540))
        low = eye + rng.normal(size=3) * size
        high = low + rng.random(3) * size
        placement = np.diag([*(10.0 ** rng.uniform(-0.5, 0.5, 3)), 1.0])
        placement[0, 1] = rng.normal() * 0.2
        off = rng.choice([0.0, 0.1, 1.0]) * size * rng.random()
        local = localise(view, placement, np.array([[-1e4] * 3, [1e4] * 3]), Criterion(guard_deg=0.0), 1.0, off)
        exact = localise(view, placement, np.array([[-1e4] * 3, [1e4] * 3]), Criterion(guard_deg=0.0), 1.0)
        found = wp.zeros(1, dtype=wp.float64, device="cpu")
        wp.launch(kernels.depth_of_box, 1, inputs=[local, wp.vec3d(*low), wp.vec3d(*high), found], device="cpu")
        points = np.c_[rng.uniform(low, high, (4_000, 3)), np.ones(4_000)]
        true = points + off * rng.uniform(-1, 1, (4_000, 1)) * [0, 0, 1, 0]
        planes = np.array([[float(exact.planes[p, k]) for k in range(4)] for p in range(exact.plane_count)])
        depths = (points @ np.array([float(part) for part in local.depth]))[(true @ planes.T >= 0).all(axis=1)]
        if len(depths) > 100:
            assert depths.min() >= found.numpy()[0]
            known.append(found.numpy()[0] / depths.min())
    assert len(known) > 0.06 * BOXES and np.median(known) > 0.7


def test_heights_over_a_rectangle_match_the_bilinear_surface(kernels):
    rng = np.random.default_rng(6)
    field = rough(9, 14, seed=2)
    domain = make_domain(field, 0, 1.0, 0.0)
    cell = 1 << domain.unit_bits - domain.levels
    low = rng.integers(0, [12 * cell, 7 * cell], (200, 2))
    high = low + rng.integers(1, cell, (200, 2))
    rectangles = wp.array(np.c_[low, high].astype(np.int32), dtype=wp.vec4i, device="cpu")
    found = wp.zeros(200, dtype=wp.vec2d, device="cpu")
    wp.launch(kernels.heights_of_rectangles, 1, inputs=[domain, rectangles, found], device="cpu")
    for (least, most), a, b in zip(found.numpy(), low, high, strict=True):
        x, y = np.meshgrid(*(np.linspace(p, q, 65) for p, q in zip(a, b, strict=True)))
        plane = np.c_[x.ravel() * domain.unit_x + domain.west, y.ravel() * domain.unit_y + domain.south]
        heights = reference_heights(field, plane)
        assert heights.min() >= least - 1e-9 and heights.max() <= most + 1e-9
        assert np.ptp(heights) > 0.97 * (most - least)


@pytest.mark.parametrize("seed", [0, 4, 5])
def test_near_the_ground_a_bound_is_at_most_twice_the_truth(seed):
    """Leaves at the depth limit are larger than their distance: the bound is at most twice the visible error."""
    rng = np.random.default_rng(seed)
    field = from_array(rough(65, 65, seed=seed).samples.astype(np.float64) * 2.0, 30.0)
    spot, heading = rng.uniform(-400, 400, 2), rng.uniform(0, 6.28)
    eye = np.array([*spot, reference_heights(field, spot[None])[0] + 0.5])
    view = View.look(eye, eye + [np.cos(heading), np.sin(heading), -0.2], resolution=(960, 540), clip=(0.1, 1e5))
    update = Terrain(field, 1).update(Criterion(error_px=0.5), [view])
    away, turned = np.geomspace(0.2, 600.0, 400), heading + np.linspace(-0.7, 0.7, 200)
    plane = spot + np.stack([np.outer(away, f(turned)).ravel() for f in (np.cos, np.sin)], axis=1)
    true = screen_error(view, field, update.surface, plane[(np.abs(plane) < 950).all(axis=1)])
    assert update.limited == "max_depth" and true <= update.bound_px <= 2.0 * true


@pytest.mark.parametrize(
    ("tilt", "source_max"),
    [
        (-0.15, 0.0),
        (0.3, 0.5),
        *(
            pytest.param(*case, marks=pytest.mark.thorough)
            for case in ((0.0, 0.0), (0.3, 0.0), (0.0, 0.5), (-0.15, 0.5))
        ),
    ],
)
def test_near_the_ground_a_bound_counts_ground_in_frame_only(tilt, source_max):
    """20 m above ground of 37 degrees (median): ground nearer than all ground in the frame does not count."""
    field = replace(from_array(rough(65, 65, seed=3).samples.astype(np.float64) * 3.0, 30.0), source_max=source_max)
    plane = scattered(field, 80_000)
    ground = float(reference_heights(field, np.zeros((1, 2)))[0])
    eye = np.array([0.0, 0.0, ground + 20.0])
    view = View.look(eye, eye + [1.0, 0.3, tilt - 0.1], fov_deg=40, resolution=(960, 540), clip=(0.1, 1e5))
    update = Terrain(field, 1).update(Criterion(error_px=1.0, guard_deg=0.0), [view])
    truth = np.c_[plane, reference_heights(field, plane)]
    moved = [project(view, truth + [0.0, 0.0, side * source_max]) for side in (-1, 1)]
    seen = moved[0][1] & moved[1][1]
    apart = np.linalg.norm(moved[0][0] - moved[1][0], axis=1)[seen].max() / 2
    assert screen_error(view, field, update.surface, plane) <= update.bound_px
    mesh, _ = project(view, np.c_[plane, mesh_heights(update.surface, plane)])
    for true, in_frame in moved:
        assert np.linalg.norm(true - mesh, axis=1)[in_frame].max() <= update.bound_px
    assert apart <= update.bound_px <= 1.0 + 1.6 * apart
    assert update.limited == ("source" if source_max else "")
