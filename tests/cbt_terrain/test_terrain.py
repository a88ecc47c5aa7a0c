# SPDX-License-Identifier: GPL-3.0-or-later
"""What a warm frame does not do: allocate, and walk more often than it must."""

import tracemalloc

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.mesh import builder
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import rough
from invariants import arrays

VIEWS = [View.look((x, -400.0, 120.0), (0, 0, 0)) for x in np.linspace(0, 20, 8)]


@pytest.mark.parametrize("meshlet", [0, pytest.param(2, marks=pytest.mark.thorough)])
def test_a_warm_frame_allocates_nothing_that_grows_with_the_mesh(meshlet, eager_threads):
    terrain = Terrain(rough(65, 129), 2)
    criterion = Criterion(error_px=0.1, meshlet=meshlet)
    views = VIEWS[::2]
    for view in (*views, *views):  # the first frame is one slice, all others two
        update = terrain.update(criterion, [view])  # each frame while the one before is in use
    for view in views:
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


@pytest.mark.parametrize(
    ("step", "threads"),
    [
        *((step, 2) for step in ("refine", "weld", "displace")),
        *(pytest.param(step, 1, marks=pytest.mark.thorough) for step in ("refine", "weld", "displace")),
    ],
)
def test_an_update_that_was_stopped_leaves_nothing_behind(monkeypatch, eager_threads, step, threads):
    """Ctrl-C when a step has just run: later updates, of the view before it and others, are those of new terrains."""
    field, criterion = rough(65, 65), Criterion(error_px=1.0, max_depth=14)
    views = [View.look((x, -300.0, 200.0), (0, 0, 0), resolution=(640, 480)) for x in (0.0, 60.0, 61.0)]
    terrain, slices = Terrain(field, threads), launch.slices

    def stopped(*args, **options):
        slices(*args, **options)
        if options["step"] == step:
            raise KeyboardInterrupt

    terrain.update(criterion, [views[0]])
    for later in (0, 2, 1):
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(launch, "slices", stopped)
            terrain.update(criterion, [views[1]])
        update, fresh = terrain.update(criterion, [views[later]]), Terrain(field, 1).update(criterion, [views[later]])
        assert update.changed and update.leaves == fresh.leaves == terrain.tree.leaf_count
        assert arrays(update.surface) == arrays(fresh.surface) and update.bound_px == fresh.bound_px
        terrain.update(criterion, [views[0]])


@pytest.mark.parametrize("meshlet", [0, 2])
def test_a_mesh_too_large_for_memory_is_refused(monkeypatch, meshlet):
    terrain = Terrain(rough(65, 65), 1)
    view = View.look((0, -300.0, 200.0), (0, 0, 0), resolution=(640, 480))
    asked = Criterion(error_px=1.0, max_depth=12, meshlet=meshlet)
    before = arrays(terrain.update(asked, [view]).surface)
    finer = Criterion(error_px=1e-30, max_depth=14, meshlet=meshlet)
    # Room for twice as many triangles; `level` has four bytes of each.
    monkeypatch.setattr(builder, "physical_memory", lambda: 400 * len(before["terrain_level"]))
    with pytest.raises(TerrainError, match="would have .* triangles; expected at most .*: choose a larger error"):
        terrain.update(finer, [view])
    monkeypatch.undo()
    assert arrays(terrain.update(asked, [view]).surface) == before
