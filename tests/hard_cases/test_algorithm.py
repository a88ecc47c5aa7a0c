# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases 37 to 43 and 46: the refinement is a function of the view, keeps its budget and its invariants."""

import os

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.spans import as_seen, slants_of, whole_of
from adaptive_terrain.cbt_terrain.view.view import View
from fields import least_triangles, random_view, rough, scattered, screen_error
from invariants import arrays, assert_invariants

VIEW = View.look((-300.0, -400.0, 150.0), (0, 0, 0))
# `make fuzz` has 10,000 rounds.
ROUNDS = int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "100"))


@pytest.fixture(scope="module")
def field():
    return rough(65, 65)


def checked(terrain, criterion, views, **placed):
    """Update the terrain and assert the invariants of its mesh."""
    update = terrain.update(criterion, views, **placed)
    assert_invariants(update.surface, terrain.field.lattice, criterion.meshlet)
    return update


def budgets(full, least):
    return sorted({0, 1, 2, 3, 100, least - 1, least, least + 1, full - 1, full, full + 1})


@pytest.mark.parametrize(
    ("shape", "threads"),
    [
        ((65, 65), 1),
        ((33, 97), 2),
        *(pytest.param(*case, marks=pytest.mark.thorough) for case in (((65, 65), 2), ((33, 97), 1))),
    ],
)
def test_case_37_budget_of_nothing_and_exactly_full(eager_threads, shape, threads):
    """The mesh is closed, has at most max(budget, two per root square) triangles and keeps its reported bound."""
    field = rough(*shape)
    full = checked(Terrain(field, threads), Criterion(error_px=0.5), [VIEW])
    whole, least, points = arrays(full.surface), 2 * field.lattice.squares, scattered(field, 1000)
    for budget in budgets(full.triangles, least):
        update = checked(Terrain(field, threads), Criterion(error_px=0.5, max_triangles=budget), [VIEW])
        assert least <= update.triangles <= max(budget, least)
        assert (update.limited == "max_triangles") == (budget < full.triangles)
        assert screen_error(VIEW, field, update.surface, points) <= update.bound_px
        _, smallest = slants_of(VIEW, np.eye(4), Criterion())
        assert update.bound_px <= as_seen(VIEW, whole_of(VIEW, np.eye(4), smallest), 0.5 * update.relaxed)
    assert arrays(update.surface) == arrays(full.surface)
    assert arrays(update.surface) == whole


def test_case_38_a_larger_budget_is_never_worse(field):
    """From budget 2 to 4,000 the bound never increases and the number of triangles never decreases."""
    terrain, last_bound, last_triangles = Terrain(field, 1), np.inf, 0
    for budget in range(2, 4000, 97):
        update = checked(terrain, Criterion(error_px=0.1, max_triangles=budget), [VIEW])
        assert update.triangles <= budget
        assert update.bound_px <= last_bound and update.triangles >= last_triangles
        last_bound, last_triangles = update.bound_px, update.triangles


def test_case_39_the_same_view_changes_nothing(field):
    """A second update of one view and an equivalent request change no byte of tree and mesh."""
    terrain = Terrain(field, 1)
    first = checked(terrain, Criterion(), [VIEW])
    assert first.changed
    mesh, before = arrays(first.surface), terrain.tree.to_bytes()
    assert not terrain.update(Criterion(), [VIEW]).changed
    # a slightly different guard band makes the walk run again
    again = checked(terrain, Criterion(guard_deg=2.5000001), [VIEW])
    assert not again.changed and arrays(again.surface) == mesh
    assert terrain.tree.to_bytes() == before


@pytest.mark.parametrize("meshlet", [0, 2])
def test_case_40_threads_do_not_show(eager_threads, meshlet):
    """1, 2, 3 and 16 threads: the same bytes of every array, the same bounds, the same tree."""
    for shape in ((65, 65), (33, 97), (129, 33)):
        field = rough(*shape)
        criterion = Criterion(error_px=0.5, meshlet=meshlet)
        alone = Terrain(field, 1)
        one = checked(alone, criterion, [VIEW])
        for threads in (2, 3, 16):
            terrain = Terrain(field, threads)
            terrain.update(Criterion(error_px=1.5, meshlet=meshlet), [VIEW])  # its leaves divide the work
            many = terrain.update(criterion, [VIEW])
            assert arrays(many.surface) == arrays(one.surface)
            assert (many.bound_px, many.bound_m, many.leaves) == (one.bound_px, one.bound_m, one.leaves)
            assert terrain.tree.to_bytes() == alone.tree.to_bytes()


def test_case_41_there_and_back_again(field):
    """After A -> B -> A the mesh and the tree have the bytes of A."""
    terrain = Terrain(field, 2)
    there = View.look((500.0, 100.0, 40.0), (0, 0, 0), fov_deg=30)
    first = checked(terrain, Criterion(), [VIEW])
    first, tree = arrays(first.surface), terrain.tree.to_bytes()
    assert arrays(checked(terrain, Criterion(), [there]).surface) != first
    assert arrays(checked(terrain, Criterion(), [VIEW]).surface) == first
    assert terrain.tree.to_bytes() == tree


def test_case_42_a_trembling_camera_changes_no_leaf(field):
    """Cameras within 1e-6 m of one position give one mesh: 20 frames at each of ten positions."""
    rng = np.random.default_rng(3)
    for _ in range(10):
        terrain = Terrain(field, 1)
        middle = np.array([-300.0, -400.0, 150.0]) + rng.uniform(-50, 50, 3)
        eyes = middle + rng.uniform(-1e-6, 1e-6, (20, 3))
        views = [View.look(eye, eye + [300.0, 400.0, -150.0]) for eye in eyes]
        assert checked(terrain, Criterion(), views[:1]).changed
        mesh = arrays(terrain.update(Criterion(), views[:1]).surface)
        for view in views[1:]:
            update = terrain.update(Criterion(), [view])
            assert not update.changed and arrays(update.surface) == mesh


def leaf_set(terrain):
    return set(terrain.tree.leaves().tolist())


def test_case_42_at_the_threshold_one_diamond_flips(field):
    """Across a threshold, two views a nanometre apart differ by one diamond, and both meshes keep the criterion."""
    terrain, criterion = Terrain(field, 1), Criterion(error_px=2.0, off_screen_factor=1.0)
    low, high = np.array([-300.0, -400.0, 150.0]), np.array([-280.0, -370.0, 140.0])

    def seen_from(eye):
        return View.look(eye, eye + [300.0, 400.0, -150.0])

    def leaves(eye):
        terrain.update(criterion, [seen_from(eye)])
        return leaf_set(terrain)

    first = leaves(low)
    assert leaves(high) != first
    while np.linalg.norm(high - low) > 1e-9:
        middle = (low + high) / 2
        low, high = (middle, high) if leaves(middle) == first else (low, middle)
    before, after = leaves(low), leaves(high)
    assert 0 < len(before ^ after) <= 6  # a diamond: its two triangles against their four halves
    points = scattered(field, 2000)
    for eye in (low, high):
        update = checked(terrain, criterion, [seen_from(eye)])
        assert screen_error(seen_from(eye), field, update.surface, points) <= update.bound_px
        assert update.bound_px <= 2.0


def test_case_43_a_teleport_converges_in_one_call(field):
    """After each of 20 jumps with a budget, one call gives the mesh that a new terrain makes for that view."""
    terrain = Terrain(field, 2)
    rng = np.random.default_rng(5)
    for _ in range(20):
        view = random_view(rng, field)
        criterion = Criterion(error_px=1.0, max_triangles=30_000)
        jumped = arrays(checked(terrain, criterion, [view]).surface)
        assert jumped == arrays(Terrain(field, 1).update(criterion, [view]).surface)


def test_case_46_random_views_keep_all_invariants(eager_threads):
    """Random sizes, depths, lenses, budgets and scales keep the budget; one and two threads give the same bytes."""
    rng = np.random.default_rng(46)
    shapes = [(2, 2), (3, 3), (5, 9), (33, 33), (17, 49), (65, 33), (7, 40), (33, 129)]
    terrains = [(f, Terrain(f, 1), Terrain(f, 2)) for f in (rough(*s, seed=i) for i, s in enumerate(shapes))]
    for _ in range(ROUNDS):
        field, one, two = terrains[rng.integers(len(terrains))]
        view = random_view(rng, field)
        criterion = Criterion(
            error_px=float(10 ** rng.uniform(-1, 2)),
            edge_px=float(10 ** rng.uniform(0, 3)) if rng.random() < 0.2 else 0.0,
            area_px=float(10 ** rng.uniform(0, 4)) if rng.random() < 0.2 else 0.0,
            error_m=float(10 ** rng.uniform(-1, 2)) if rng.random() < 0.2 else 0.0,
            guard_deg=float(rng.uniform(0, 30)),
            off_screen_factor=float(10 ** rng.uniform(0, 3)),
            max_depth=int(rng.integers(1, 20)) if rng.random() < 0.3 else None,
            max_triangles=int(10 ** rng.uniform(0, 3.7)),
            meshlet=int(rng.integers(3)) if rng.random() < 0.3 else 0,
        )
        scale = float(rng.choice([1.0, 1.0, -2.0, 0.0, 1e-9, 1e3]))
        a, b = one.update(criterion, [view], vertical_scale=scale), two.update(criterion, [view], vertical_scale=scale)
        assert_invariants(a.surface, field.lattice, criterion.meshlet)
        assert arrays(a.surface) == arrays(b.surface)
        assert a.triangles <= max(criterion.max_triangles, least_triangles(field, criterion.meshlet))
        assert a.bound_px == b.bound_px and np.isfinite(a.bound_px)
