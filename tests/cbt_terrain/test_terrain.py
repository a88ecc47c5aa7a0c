# SPDX-License-Identifier: GPL-3.0-or-later
"""What a warm frame does not do: allocate, and walk more often than it must."""

import tracemalloc

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain import launch
from adaptive_terrain.cbt_terrain.criterion import Criterion
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view import View
from fields import rough

VIEWS = [View.look((x, -400.0, 120.0), (0, 0, 0)) for x in np.linspace(0, 20, 12)]


@pytest.mark.parametrize("meshlet", [0, 2])
def test_a_warm_frame_allocates_nothing_that_grows_with_the_mesh(meshlet, monkeypatch):
    monkeypatch.setattr(launch, "SLICE_ITEMS", 2)
    terrain = Terrain(rough(129, 129), 2)
    criterion = Criterion(error_px=0.1, meshlet=meshlet)
    for view in VIEWS:
        terrain.update(criterion, [view])
    for view in VIEWS:
        tracemalloc.start()
        update = terrain.update(criterion, [view])
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert update.changed and update.surface.positions.nbytes > 200_000 and peak < 60_000


def test_a_still_frame_walks_not_at_all(monkeypatch):
    terrain = Terrain(rough(65, 65), 1)
    terrain.update(Criterion(), VIEWS[:1])
    monkeypatch.setattr(launch, "slices", lambda *a, **k: pytest.fail("a kernel was launched"))
    assert not terrain.update(Criterion(), VIEWS[:1]).changed


def test_a_budget_counts_twice_while_the_camera_moves_slowly(monkeypatch):
    """One count that fits and one that does not: with the walk itself at most three times one refinement."""
    slices, steps = launch.slices, []

    def counted(kernel, inputs, *, step, **rest):
        steps.append(step)
        slices(kernel, inputs, step=step, **rest)

    monkeypatch.setattr(launch, "slices", counted)
    terrain = Terrain(rough(129, 129), 2)
    criterion = Criterion(error_px=0.01, max_triangles=20_000)
    terrain.update(criterion, VIEWS[:1])
    steps.clear()
    for view in VIEWS[1:]:
        assert terrain.update(criterion, [view]).limited == "max_triangles"
    assert steps.count("refine") == len(VIEWS) - 1
    assert steps.count("budget") <= 2.5 * steps.count("refine")
