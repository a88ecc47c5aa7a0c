# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 60: vertices that morph to their heights without a pop or a crack."""

import os

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.island import SIDE, island
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.morph import SMOOTH
from adaptive_terrain.cbt_terrain.view.view import View
from fields import mesh_heights, project, rough, scattered
from invariants import assert_invariants
from rasters import jacksboro

LONG = int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) >= 10_000
FRAMES, POINTS = (200, 5000) if LONG else (12, 1500)
FIELDS = {
    "rough": lambda: rough(65, 65, relief=60.0),
    "island": lambda: from_array(island(129), SIDE / 128),
    "real": lambda: from_array(jacksboro()[:65, :97], 30.0),
}
SETTINGS = {"error_px": 6.0, "off_screen_factor": 1.0}
STEPS = 0.4 * 0.5 ** np.arange(4)


def jumps(field, criterion: Criterion, step: float) -> tuple[float, float]:
    """Return how far points in the frame jump in a flight of `step` hundredths of the terrain's width per frame.

    Returns:
        The largest jump in pixels, and the 99.9th percentile of second differences in metres. A few paths have a
        kink where distance replaces depth, or one direction of the slant the other.
    """
    terrain, plane, wide = Terrain(field, 1), scattered(field, POINTS), field.lattice.step_x * field.lattice.width
    heights, first, second = [], 0.0, []
    for frame in range(FRAMES):
        eye = np.array([0.1, -0.6, 0.2]) * wide + [0, 0, field.max_height]
        eye += np.array([0.2, 1.0, -0.1]) * wide * 0.01 * step * frame
        view = View.look(eye, (0, 0, 0), resolution=(1920, 1080))
        heights = [*heights[-2:], mesh_heights(terrain.update(criterion, [view]).surface, plane)]
        if frame > 0:
            (now, seen), (before, _) = (project(view, np.c_[plane, z]) for z in heights[:-3:-1])
            first = max(first, np.linalg.norm(now - before, axis=1)[seen].max())
        if frame > 1:
            second.append(np.abs(heights[2] - 2 * heights[1] + heights[0])[seen])
    return first, np.percentile(np.concatenate(second), 99.9)


@pytest.mark.parametrize(
    "name", ["real", *(pytest.param(name, marks=pytest.mark.thorough) for name in FIELDS if name != "real")]
)
def test_case_60_jumps_fall_with_the_step_of_the_camera(name):
    """Jumps fall in proportion to the camera's step (slope 1 +- 0.1), and second differences with its square.

    A flight has 12 frames, or 200 if ADAPTIVE_TERRAIN_FUZZ is 10,000.
    """
    field = FIELDS[name]()
    found = np.array([jumps(field, Criterion(**SETTINGS, morph=SMOOTH), step) for step in STEPS])
    slope, second_slope = np.polyfit(np.log(STEPS), np.log(found), 1)[0]
    assert abs(slope - 1) < 0.1 and second_slope > 1.7 and found[0, 0] < 0.15, found


def shading(field, step: float, morph: float) -> float:
    """Return the largest change of Lambert shading under any light in two frames `step` metres apart, in 255ths.

    It is the distance between a point's unit normals.
    """
    plane, found, terrain = scattered(field, 500), [], Terrain(field, 1)
    for start in (0.0, 40.0, 80.0):
        normals = []
        for flown in (start, start + step):
            eye = np.array([-600.0 + flown, -500.0, field.max_height + 100.0])
            view = View.look(eye, eye + [1.0, 0.8, -0.6], resolution=(960, 540))
            surface = terrain.update(Criterion(error_px=2.0, morph=morph), [view]).surface
            n = mesh_heights(surface, plane, surface.normals)
            normals.append(n / np.linalg.norm(n, axis=1, keepdims=True))
        _, seen = project(view, np.c_[plane, mesh_heights(surface, plane)])
        found.append(np.linalg.norm(normals[1] - normals[0], axis=1)[seen].max())
    return 255.0 * max(found)


@pytest.mark.parametrize("name", [pytest.param("rough", marks=pytest.mark.thorough), "real"])
def test_case_60_shading_changes_with_the_step_of_the_camera(name):
    """The change of shading falls in proportion to the camera's step, slope 1 +- 0.15."""
    field, steps = FIELDS[name](), np.array([8.0, 4.0, 2.0])
    found = np.array([shading(field, step, SMOOTH) for step in steps])
    assert abs(np.polyfit(np.log(steps), np.log(found), 1)[0] - 1) < 0.15, found
    assert found[0] < 0.25 * shading(field, steps[0], 1.0)


def test_case_60_a_vertex_morphs_from_its_edge_to_its_height():
    """A new vertex starts on the previous mesh, within the motion of all others, and one at its height stays there."""
    field = rough(17, 17, relief=10.0)
    terrain, last, z_before, at_height, new = Terrain(field, 2), None, {}, set(), 0
    criterion = Criterion(**SETTINGS, morph=2.0, max_depth=field.lattice.cell_depth)
    for way in np.arange(0.0, 0.4, 0.002):
        eye = np.array([-200.0, -700.0, 500.0]) * (1 - way)
        surface = terrain.update(criterion, [View.look(eye, eye * -0.1, resolution=(960, 540))]).surface
        assert_invariants(surface, field.lattice)
        samples = [tuple(p) for p in np.rint(surface.positions[:, :2] / 10.0 + 8.0).astype(int).tolist()]
        z = dict(zip(samples, surface.positions[:, 2].tolist(), strict=True))
        now_at_height = {p for p in samples if z[p] == float(field.samples[p[1], p[0]])}
        assert at_height <= now_at_height
        if last is not None:
            fresh = [p for p in samples if p not in z_before]
            moved = max(abs(z[p] - z_before[p]) for p in z_before)
            on_edge = mesh_heights(last, (np.array(fresh).reshape(-1, 2) - 8.0) * 10.0) if fresh else []
            assert all(abs(z[p] - at) <= 2 * moved + 1e-5 for p, at in zip(fresh, on_edge, strict=True))
            new += len(fresh)
        last, z_before, at_height = surface.copy(), z, now_at_height
    assert new > 40 and len(at_height) > 35
