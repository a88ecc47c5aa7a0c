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
FRAMES, POINTS = (200, 5000) if LONG else (5, 400)
FIELDS = {
    "rough": lambda: rough(129, 129, relief=60.0),
    "island": lambda: from_array(island(257), SIDE / 256),
    "real": lambda: from_array(jacksboro()[:129, :193], 30.0),
}
ASKED = {"error_px": 3.0, "off_screen_factor": 1.0}


def jumps(field, criterion: Criterion, step: float) -> tuple[list[float], list[float]]:
    """Pixels that points in the frame move between frames beside what their places do, at most: first and second
    differences of a flight that goes on by `step` times a hundredth of the terrain's width a frame."""
    terrain, plane, wide = Terrain(field, 1), scattered(field, POINTS), field.lattice.step_x * field.lattice.width
    heights, first, second = [], [], []
    for frame in range(FRAMES):
        eye = np.array([0.1, -0.6, 0.2]) * wide + [0, 0, field.max_height]
        view = View.look(eye + np.array([0.002, 0.01, -0.001]) * wide * step * frame, (0, 0, 0), resolution=(1920, 1080))
        heights.append(mesh_heights(terrain.update(criterion, [view]).surface, plane))
        if frame > 0:
            (now, seen), (before, _) = (project(view, np.c_[plane, z]) for z in (heights[-1], heights[-2]))
            first.append(np.linalg.norm(now - before, axis=1)[seen].max())
        if frame > 1:
            bent = heights[-1] - 2 * heights[-2] + heights[-3]
            second.append(np.abs(bent[seen]).max())
    return first, second


@pytest.mark.parametrize("name", FIELDS)
def test_case_60_jumps_fall_with_the_step_of_the_camera(name):
    """On three fields, at four camera steps: the largest jump in pixels falls in proportion to the step, a slope of 1
    +- 0.1 in log-log; without a morph it stays."""
    field, steps = FIELDS[name](), 0.1 * 0.5 ** np.arange(4)
    rising = [max(jumps(field, Criterion(**ASKED, morph=SMOOTH), step)[0]) for step in steps]
    slope = np.polyfit(np.log(steps), np.log(rising), 1)[0]
    assert abs(slope - 1) < 0.1, (slope, rising)
