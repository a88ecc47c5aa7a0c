# SPDX-License-Identifier: GPL-3.0-or-later
"""A triangle budget: the finest step that fits, from wherever the search begins, and few leaves counted for it."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain import terrain as terrains
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import INTERPOLATIONS
from adaptive_terrain.cbt_terrain.refine.budget import count_splits, limit_at_step
from adaptive_terrain.cbt_terrain.refine.contract import Bound, factor_of
from adaptive_terrain.cbt_terrain.refine.request import RefinementRequest
from adaptive_terrain.cbt_terrain.refine.slices import Slices
from adaptive_terrain.cbt_terrain.refine.step_search import MAX_STEP, Found, find_finest_step
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from adaptive_terrain.kernels.budget.count_state import MARKS, STEPS_PER_OCTAVE, Count
from adaptive_terrain.kernels.refine import walk
from fields import random_view, rough
from invariants import arrays
from level_ground import level_scenes

SHAPES = [(65, 65), (33, 129), (100, 37), (129, 129), (5, 3)]


def scene(seed: int):
    """Return a field, views, a criterion, and a triangle limit that is too small for it, mostly by far."""
    rng = np.random.default_rng(seed)
    height, width = SHAPES[rng.integers(len(SHAPES))]
    if rng.random() < 0.7:
        field = rough(height, width, seed, relief=float(rng.choice([2.0, 30.0, 200.0])))
    else:
        flat = rng.random() < 0.5
        field = from_array((rng.random((height, width)) > 0.97).astype(np.float32) * (0.0 if flat else 20.0), 10.0)
    field = interpolated(field, INTERPOLATIONS[rng.integers(2)])
    px = float(10 ** rng.uniform(-3, 0))
    asked = [
        {"error_px": px},
        {"error_px": 0.0, "edge_px": 8 * px},
        {"error_px": 0.0, "area_px": 60 * px * px},
        {"error_px": px, "edge_px": 20 * px},
        {"error_px": 0.0, "error_m": px},
    ][rng.integers(5)]
    views = [random_view(rng, field) for _ in range(rng.integers(1, 3))]
    meshlet, most = int(rng.choice([0, 0, 2])), int(10 ** rng.uniform(2.5, 4.5))
    return field, views, Criterion(**asked, max_triangles=most, meshlet=meshlet, max_depth=24), most >> 2 * meshlet


def step_of(relaxed: float) -> int:
    """Return the relaxation step of a refinement; MAX_STEP + 1 if no step fits."""
    return round(STEPS_PER_OCTAVE * math.log2(relaxed)) if relaxed < math.inf else MAX_STEP + 1


def moved(view, rng):
    """Return the view moved by a thousandth of its distance."""
    shift = np.eye(4)
    shift[:3, 3] = 1e-3 * np.linalg.norm(view.world_to_camera[:3, 3]) * rng.normal(size=3)
    return replace(view, world_to_camera=shift @ view.world_to_camera)


@pytest.fixture
def counted(monkeypatch):
    """Per launch: the step's name, and leaves that were counted or made."""
    launched, slices = [], launch.slices

    def noted(kernel, inputs, *, step, **rest):
        slices(kernel, inputs, step=step, **rest)
        walks = [values[2] for values in inputs] if step in ("budget", "refine") else []
        if step == "budget":
            leaves = walks[0].last_steps.numpy()[: len(walks) * (MAX_STEP + 2)].reshape(len(walks), -1).sum(axis=0)
            launched.append((step, int(leaves.sum())))
        if step == "refine":
            launched.append((step, int(walks[0].counts.numpy()[: 4 * len(walks) : 4].sum())))

    monkeypatch.setattr(launch, "slices", noted)
    return launched


@pytest.fixture
def called(monkeypatch):
    """Record the request of each refinement."""
    requests, refine = [], terrains.refine
    monkeypatch.setattr(terrains, "refine", lambda *args: requests.append(args[1]) or refine(*args))
    return requests


def walked(terrain: Terrain, request: RefinementRequest, step: int) -> int:
    """Count the leaves of a refinement at a step by the walk itself."""
    lattice, history = terrain.field.lattice, terrain.history
    request.criterion.limit = limit_at_step(step)
    history.hints.capacity = 0
    end = lattice.squares << history.tree.max_depth - lattice.square_bits
    slices = Slices.of(history, lattice, [0, end], request.max_depth, 1 << 30)
    slices.bind_reuse(False, None)
    launch.slices(walk.walk, [[request.domain, request.criterion, slices.walks[0], slices.reuses[0]]], step="count")
    return int(slices.counts[0, 0])


@pytest.mark.thorough
@pytest.mark.parametrize("threads", [1, 3])
def test_the_step_is_the_finest_that_fits(eager_threads, threads, called):
    """By the walk: 60 scenes, their counts at the step, at the one before it, and far from both."""
    coarsened = 0
    for seed in range(60):
        field, views, criterion, most = scene(seed)
        terrain = Terrain(field, threads)
        update = terrain.update(criterion, views)
        step, most = step_of(update.relaxed), max(most, 2 * field.lattice.squares)
        assert walked(terrain, called[-1], step) == update.leaves <= most
        assert step == 0 or walked(terrain, called[-1], step - 1) > most
        coarsened += step > 0
        roots = 2 * field.lattice.squares
        finer, given = max(step - 5, 0), (field.lattice, called[-1], terrain.history, threads)
        first, splits = count_splits(*given, finer, MAX_STEP, most - roots)
        assert first == step
        for further in (0, 1, 7, 40, 300):
            if step + further <= MAX_STEP:
                assert splits[further] + roots == walked(terrain, called[-1], step + further)
    assert coarsened > 40


def test_the_answer_does_not_depend_on_what_came_before():
    """Views, criteria and budgets one after the other: each mesh is the one that a new terrain makes."""
    for seed in range(4):
        field, _, _, _ = scene(seed)
        flown = Terrain(field, 2)
        for other in range(4):
            _, views, criterion, _ = scene(seed + 100 * other)
            update, fresh = flown.update(criterion, views), Terrain(field, 1).update(criterion, views)
            assert (update.relaxed, update.bound_px, update.bound_m) == (fresh.relaxed, fresh.bound_px, fresh.bound_m)
            assert arrays(update.surface) == arrays(fresh.surface)


def test_level_ground_is_counted_as_it_is_walked(eager_threads, called):
    """Windows of many and of few steps, where whole cells are counted at once: the first step that fits, and splits."""
    rng, fitted = np.random.default_rng(3), 0
    for field, criterion, views, scale in level_scenes():
        terrain = Terrain(field, 2)
        terrain.update(replace(criterion, max_triangles=None), views, vertical_scale=scale)
        roots, given = 2 * field.lattice.squares, (field.lattice, called[-1], terrain.history, 2)
        for _ in range(4):
            finest, most = int(rng.integers(0, 60)), int(10 ** rng.uniform(2, 5))
            coarsest = finest + int(rng.choice([1, 5, 40, 400, MAX_STEP - 60]))
            first, splits = count_splits(*given, finest, coarsest, most)
            for step in {first, (first + coarsest) // 2, coarsest} if len(splits) else ():
                assert splits[step - first] + roots == walked(terrain, called[-1], step)
                fitted += 1
            if finest < first:
                assert walked(terrain, called[-1], first - 1) - roots > most
    assert fitted > 100


def test_threads_share_by_places_that_are_noted(monkeypatch, called):
    """Every place that is due is noted: none is left as it was, nothing is written behind them."""
    nowhere = np.uint64(1 << 62)
    monkeypatch.setattr(launch, "SLICE_ITEMS", 2)
    terrain = Terrain(rough(257, 257, relief=20.0), 3)
    terrain.update(Criterion(error_px=0.02), [View.look((0.0, -150.0, 40.0), (0.0, 0.0, 0.0))])
    scratch, given = terrain.history.scratch, (terrain.field.lattice, called[-1], terrain.history, 3)
    count_splits(*given, 404, 1600, 2000)  # its buffers, and the places of the first cuts
    for most in (2000, 128_000):
        scratch.get("count_marks", 4 * MARKS, wp.uint64)
        scratch.numpy("count_marks")[:] = nowhere
        count_splits(*given, 404, 1600, most)
        marks = scratch.numpy("count_marks")
        measured = scratch.numpy("count_measured")[:3]
        assert np.all(marks[3 * MARKS :] == nowhere)
        structs = [scratch.struct(Count, slot) for slot in range(3)]
        for struct, places, count in zip(structs, marks.reshape(-1, MARKS), measured, strict=False):
            due = min(count // struct.spacing, MARKS)
            assert due > 0 and np.all(places[:due] < struct.end_cell) and np.all(places[due:] == nowhere)


@pytest.mark.parametrize("most", [0, 10])
def test_a_limit_below_the_root_triangles_does_not_coarsen(most):
    """12 squares have at least 24 triangles, and the criterion needs no more."""
    field = from_array(np.random.default_rng(0).random((13, 17), np.float32))
    coarse, view = Criterion(error_px=100.0, max_triangles=most), View.look((0.0, 0.0, 50.0), (1.0, 0.0, 0.0))
    flown = Terrain(field, 1)
    flown.update(replace(coarse, max_triangles=None), [view])
    assert flown.update(coarse, [view]).relaxed == Terrain(field, 1).update(coarse, [view]).relaxed == 1.0


@pytest.mark.parametrize("metres", [None, Bound(3.0)])
def test_the_factor_of_an_area_is_the_root_of_its_ratio(metres):
    """Where no factor meets the limit, with and without another criterion."""
    asked, no_factor = (
        Criterion(error_px=0.0, error_m=1.0 if metres else 0.0, area_px=2.0),
        SimpleNamespace(relaxed=math.inf),
    )
    assert factor_of(asked, no_factor, [None, metres, None, Bound(200.0)]) == 10.0


def test_a_limit_that_does_not_bind_is_searched_for_once(counted):
    terrain = Terrain(rough(257, 257, relief=20.0), 1)
    criterion = Criterion(error_px=1.0, max_triangles=200_000)
    for frame in range(4):
        counted.clear()
        view = View.look((0.5 * frame, -300.0, 120.0), (0, 0, 0))
        assert terrain.update(criterion, [view]).relaxed == 1.0
        assert frame == 0 or [step for step, _ in counted] == ["refine"]


def a_curve(rng) -> np.ndarray:
    """Return random numbers of splits per step: smooth, in stairs, or 0 from some step on."""
    steps = np.arange(MAX_STEP + 2)
    octaves = rng.uniform(2, 24) - rng.uniform(0.2, 3.0) * steps / STEPS_PER_OCTAVE
    if rng.random() < 0.4:
        octaves = np.floor(octaves / 2) * 2
    splits = np.floor(2.0 ** np.minimum(octaves, 40)).astype(np.int64)
    if rng.random() < 0.1:
        splits[:] = splits[0]  # none fits but the smallest mesh
    splits[-1] = 0
    return splits


def test_the_search_finds_the_finest_step_from_anywhere():
    rng = np.random.default_rng(1)
    for _ in range(150):
        splits, most = a_curve(rng), int(10 ** rng.uniform(0, 6)) - 1
        expected = int(np.argmax(splits <= most))
        for start in (None, expected, *rng.integers(1, MAX_STEP + 2, 3), expected + int(rng.integers(-40, 40))):
            passes = []

            def counted(finest, coarsest, goal, splits=splits, passes=passes):
                assert 0 <= finest <= coarsest <= MAX_STEP and len(passes) < 40
                passes.append(finest)
                first = finest + int(np.count_nonzero(splits[finest : coarsest + 1] > goal))
                return first, splits[first : coarsest + 1]

            found = find_finest_step(counted, most, None if start is None else Found(max(1, int(start))), 0)
            if found.step == 0 and start is None:  # a guess, which may be wrong
                found = find_finest_step(counted, most, None, 1) if expected else found
            assert found.step == expected
            if start is None and 4 <= expected <= MAX_STEP:  # again, from the result
                passes.clear()
                assert find_finest_step(counted, most, found, 0) == found and len(passes) == 1


def test_a_search_counts_few_times_the_budget(counted):
    """Leaves counted, in parts of the budget: a first search, one after a jump of the camera, and those of a flight.

    Of a leaf that is counted none of the rest is made: it takes about half the time of one that is refined.
    """
    first, jumps, flights = [], [], []
    for seed in range(200, 230):
        field, views, criterion, most = scene(seed)
        rng = np.random.default_rng(seed)
        if most < 1000:
            continue
        terrain = Terrain(field, 1)
        for parts, eyes in ((first, 1), (jumps, 4), (flights, 6)):
            for _ in range(eyes):
                if parts is jumps:
                    views = [random_view(rng, field)]
                if parts is flights:
                    views = [moved(view, rng) for view in views]
                counted.clear()
                if terrain.update(criterion, views).limited == "max_triangles":
                    parts.append(sum(leaves for step, leaves in counted if step == "budget") / most)
                    assert [step for step, _ in counted].count("refine") <= 3
    for parts, usual, most_ever in ((first, 2.6, 6.0), (jumps, 2.3, 7.0), (flights, 1.1, 2.5)):
        assert len(parts) > 10 and np.median(parts) < usual and max(parts) < most_ever
