# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 60: points that rise to their places, without a pop and without a crack."""

import os

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.ask.criterion import Criterion
from adaptive_terrain.cbt_terrain.ask.morph import SMOOTH
from adaptive_terrain.cbt_terrain.ask.view import View
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.island import SIDE, island
from adaptive_terrain.cbt_terrain.terrain import Terrain
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
ASKED = {"error_px": 6.0, "off_screen_factor": 1.0}
STEPS = 0.4 * 0.5 ** np.arange(4)


def jumps(field, criterion: Criterion, step: float) -> tuple[float, float]:
    """How far points in the frame jump in a flight that goes on by `step` hundredths of the terrain's width a frame:
    pixels at most, and metres of second differences that 99.9 % stay within: the way of a few has a bend, where the
    distance takes over from the depth, or one direction of the slant from the other."""
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


@pytest.mark.parametrize("name", FIELDS)
def test_case_60_jumps_fall_with_the_step_of_the_camera(name):
    """Three fields, four steps of the camera: jumps fall as the step does, slope 1 +- 0.1; their differences twice so.

    Of 12 frames a flight, 200 where ADAPTIVE_TERRAIN_FUZZ is 10,000.
    """
    field = FIELDS[name]()
    found = np.array([jumps(field, Criterion(**ASKED, morph=SMOOTH), step) for step in STEPS])
    slope, bend = np.polyfit(np.log(STEPS), np.log(found), 1)[0]
    assert abs(slope - 1) < 0.1 and bend > 1.7 and found[0, 0] < 0.15, found


def shading(field, step: float, morph: float) -> float:
    """Return the largest distance between a point's unit normals in two frames `step` metres apart, in 255ths: the most
    that Lambert's shading changes there under any light."""
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


@pytest.mark.parametrize("name", ["rough", "real"])
def test_case_60_shading_changes_with_the_step_of_the_camera(name):
    """Three steps of the camera: the change falls as the step does, slope 1 +- 0.15."""
    field, steps = FIELDS[name](), np.array([8.0, 4.0, 2.0])
    found = np.array([shading(field, step, SMOOTH) for step in steps])
    assert abs(np.polyfit(np.log(steps), np.log(found), 1)[0] - 1) < 0.15, found
    assert found[0] < 0.25 * shading(field, steps[0], 1.0)


def test_case_60_a_point_begins_on_its_edge_and_ends_in_its_place():
    """An eye that comes nearer by a thousandth of its way a frame: new points are on the mesh that there was, within
    what all others move; what is in its place stays there; and every mesh keeps the invariants."""
    field = rough(17, 17, relief=10.0)
    terrain, last, z_before, placed, new = Terrain(field, 2), None, {}, set(), 0
    criterion = Criterion(**ASKED, morph=2.0, max_depth=field.lattice.cell_depth)
    for way in np.arange(0.0, 0.4, 0.002):
        eye = np.array([-200.0, -700.0, 500.0]) * (1 - way)
        surface = terrain.update(criterion, [View.look(eye, eye * -0.1, resolution=(960, 540))]).surface
        assert_invariants(surface, field.lattice)
        places = [tuple(p) for p in np.rint(surface.positions[:, :2] / 10.0 + 8.0).astype(int).tolist()]
        z = dict(zip(places, surface.positions[:, 2].tolist(), strict=True))
        in_place = {p for p in places if z[p] == float(field.samples[p[1], p[0]])}
        assert placed <= in_place
        if last is not None:
            fresh = [p for p in places if p not in z_before]
            moved = max(abs(z[p] - z_before[p]) for p in z_before)
            on_edge = mesh_heights(last, (np.array(fresh).reshape(-1, 2) - 8.0) * 10.0) if fresh else []
            assert all(abs(z[p] - at) <= 2 * moved + 1e-5 for p, at in zip(fresh, on_edge, strict=True))
            new += len(fresh)
        last, z_before, placed = surface.copy(), z, in_place
    assert new > 40 and len(placed) > 35
