# SPDX-License-Identifier: GPL-3.0-or-later
"""The tree as a refinement writes it: in parts, each on a thread, without the leaves that it has already."""

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.refine import slices
from adaptive_terrain.cbt_terrain.run.buffers import shared
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.tree.concurrent_binary_tree import ConcurrentBinaryTree, LeafPart
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from adaptive_terrain.kernels.tree.bitfield import SameLeaves
from fields import rough
from hypothesis import given, settings
from hypothesis import strategies as st
from invariants import arrays, reused_leaves

ERROR, EDGE = Criterion(error_px=0.3, max_depth=18), Criterion(error_px=0.0, edge_px=12.0)
SQUARES = {"one square": (129, 129), "three squares and a spare one": (65, 193)}


def over(frame: int) -> View:
    return View.look((0.05 * frame, -300.0 + 0.1 * frame, 120.0), (0, 0, 0), resolution=(960, 540))


def random_depths(rng, max_depth: int, rounds: int, depths: np.ndarray) -> np.ndarray:
    """Return the depths of a tree's leaves after random splits and merges of pairs."""
    for _ in range(rounds):
        splits = (rng.random(len(depths)) < rng.choice([0.05, 0.5, 0.9])) & (depths < max_depth)
        depths = np.repeat(depths + splits, 1 + splits)
        sizes = np.int64(1) << max_depth - depths
        first = (np.cumsum(sizes) - sizes) & (2 * sizes - 1) == 0
        pairs = np.flatnonzero(first[:-1] & (depths[:-1] == depths[1:]) & (rng.random(len(depths) - 1) < 0.3))
        depths[pairs] -= 1
        depths = np.delete(depths, pairs + 1)
    return depths


def cells_of(depths: np.ndarray, max_depth: int) -> np.ndarray:
    sizes = np.int64(1) << max_depth - depths
    return np.cumsum(sizes) - sizes


def common_nodes(rng, before: np.ndarray, now: np.ndarray, max_depth: int) -> list[tuple[int, int, int]]:
    """Return disjoint nodes with the same leaves in both trees: first leaf and number of leaves now, and depth."""
    cells, old = cells_of(now, max_depth), cells_of(before, max_depth)
    nodes, end = [], 0
    for leaf in np.sort(rng.integers(0, len(now), 40)).tolist():
        depth = int(rng.integers(0, now[leaf] + 1))
        size = 1 << max_depth - depth
        low = int(cells[leaf]) // size * size
        (first, last), (was, until) = (np.searchsorted(of, [low, low + size]) for of in (cells, old))
        same = cells[first:last].tolist() == old[was:until].tolist() and last - first > 1
        if low >= end and same and np.array_equal(now[first:last], before[was:until]):
            nodes.append((int(first), int(last - first), depth))
            end = low + size
    return nodes


def parts_of(rng, depths: np.ndarray, nodes: list, max_depth: int) -> list[LeafPart]:
    """Return the leaves in parts with rubbish between them, cut anywhere except inside `nodes`."""
    codes = (depths << 5).astype(np.uint16)
    inside = {leaf for first, count, _ in nodes for leaf in range(first + 1, first + count)}
    cuts = sorted({0, len(depths), *rng.integers(0, len(depths) + 1, rng.integers(0, 6)).tolist()} - inside)
    ends, parts = np.append(cells_of(depths, max_depth), 1 << max_depth), []
    for low, high in zip(cuts, cuts[1:], strict=False):
        gap = int(rng.integers(0, 5))
        memory = np.concatenate([rng.integers(0, 2**16, gap).astype(np.uint16), codes[low:high]])
        same = np.array([(n - low + gap, m, d) for n, m, d in nodes if low <= n < high], SameLeaves.numpy_dtype())
        lists = shared(same, SameLeaves) if len(same) else None
        parts.append(LeafPart(shared(memory, wp.uint16), gap, high - low, int(ends[high]), lists, 0, len(same)))
    return parts


@settings(max_examples=20, deadline=None)
@given(
    st.sampled_from([6, 7, 12, 13, 20, 31, 40, 48, 55, 61, 62]), st.integers(0, 2**32), st.sampled_from([1, 2, 3, 8])
)
def test_leaves_in_parts_give_the_tree_of_all_leaves(max_depth, seed, threads):
    rng = np.random.default_rng(seed)
    tree, depths = ConcurrentBinaryTree(max_depth, threads), np.zeros(1, np.int64)
    for _ in range(5):
        before = depths
        depths = random_depths(rng, max_depth, int(rng.choice([1, 1, 12])), depths)[: 1 << 13]
        if (np.int64(1) << max_depth - depths).sum() != 1 << max_depth:
            depths = before
        nodes = common_nodes(rng, before, depths, max_depth) if rng.random() < 0.7 else []
        changed = tree.set_leaves(parts_of(rng, depths, nodes, max_depth), 5, max_depth)
        assert changed == (before.tolist() != depths.tolist())
        assert tree.leaf_count == len(depths) and tree.depths().tolist() == depths.tolist()
        assert np.array_equal(tree.cells(), cells_of(depths, max_depth))
        fresh = ConcurrentBinaryTree(max_depth)
        fresh.set_depths(depths)
        assert fresh.to_bytes() == tree.to_bytes()


def assert_as_new(flown: Terrain, criterion: Criterion, view: View) -> None:
    """Assert that the next update gives the bytes of a new terrain: mesh and cells."""
    update, fresh = flown.update(criterion, [view]), Terrain(flown.field, 1)
    new = fresh.update(criterion, [view])
    assert arrays(update.surface) == arrays(new.surface) and update.leaves == new.leaves
    assert np.array_equal(flown.tree.cells(), fresh.tree.cells())


@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=pytest.mark.thorough), 7])
@pytest.mark.parametrize("shape", SQUARES.values(), ids=SQUARES)
def test_a_flights_tree_is_that_of_a_new_terrain(shape, threads, eager_threads):
    flown = Terrain(rough(*shape, relief=20.0), threads)
    for frame in range(4):
        assert_as_new(flown, ERROR, over(frame))


def test_reused_points_without_room_for_runs_are_displaced_again(monkeypatch, eager_threads):
    flown = Terrain(rough(129, 129, relief=20.0), 2)
    for frame, room in enumerate((1000, 2, 1000, 1)):
        monkeypatch.setattr(slices, "room_for", lambda _leaves, room=room: room)
        assert_as_new(flown, ERROR, over(frame))


def test_a_new_tree_takes_nothing(monkeypatch):
    flown, written = Terrain(rough(129, 129, relief=20.0), 1), ConcurrentBinaryTree.set_leaves

    def stopped(tree, *args):
        written(tree, *args)
        raise KeyboardInterrupt

    flown.update(ERROR, [over(0)])
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(ConcurrentBinaryTree, "set_leaves", stopped)
        flown.update(ERROR, [over(1)])
    assert flown.tree is None
    assert_as_new(flown, ERROR, over(2))
    assert reused_leaves(flown) == 0
    assert_as_new(flown, ERROR, over(3))
    assert reused_leaves(flown) > 1000


def test_a_walk_that_is_given_up_changes_nothing():
    """More leaves than a budget allows: the walk has written into the next cells, the counting ones have not."""
    flown = Terrain(rough(129, 129, relief=20.0), 1)
    for frame, budget in enumerate((None, 3_000, None, 3_000, 2_000)):
        criterion = Criterion(error_px=1.0, max_depth=16, max_triangles=budget)
        assert_as_new(flown, criterion, over(frame))
    assert flown.update(criterion, [over(0)]).limited == "max_triangles"


@pytest.mark.parametrize("threads", [1, 3])
def test_a_flight_skips_the_leaves_that_stay(threads, monkeypatch, eager_threads):
    """Words of subtrees that the walk takes from the last frame are not written, and the tree is right."""
    flown, skipped, written = Terrain(rough(129, 129, relief=20.0), threads), [], ConcurrentBinaryTree.set_leaves

    def noted(tree, parts, *args):
        lists = [part.same.numpy()[part.first_same :][: part.num_same] for part in parts if part.num_same]
        skipped.append(sum(int(nodes["count"].sum()) for nodes in lists))
        return written(tree, parts, *args)

    for frame in range(4):
        with monkeypatch.context() as patch:
            patch.setattr(ConcurrentBinaryTree, "set_leaves", noted)
            flown.update(ERROR, [over(frame)])
        assert_as_new(flown, ERROR, over(frame))
    assert skipped[0] == 0 and min(skipped[1:]) > 0.5 * flown.tree.leaf_count
