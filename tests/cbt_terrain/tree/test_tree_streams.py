# SPDX-License-Identifier: GPL-3.0-or-later
"""The tree's cells where a walk has written them: in parts, never copied."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.ask.criterion import Criterion
from adaptive_terrain.cbt_terrain.ask.view import View
from adaptive_terrain.cbt_terrain.history.frame_history import FrameHistory
from adaptive_terrain.cbt_terrain.refine import slices
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.tree.concurrent_tree import ConcurrentBinaryTree
from adaptive_terrain.kernels.refine.reuse_state import Reuse
from adaptive_terrain.kernels.refine.walk_state import Walk
from edited_tree import EditedTree
from fields import rough
from hypothesis import given, settings
from hypothesis import strategies as st
from invariants import arrays

ERROR, EDGE = Criterion(error_px=0.3, max_depth=18), Criterion(error_px=0.0, edge_px=12.0)
SQUARES = {"one square": (129, 129), "three squares and a spare one": (65, 193)}


def over(frame: int) -> View:
    return View.look((0.05 * frame, -300.0 + 0.1 * frame, 120.0), (0, 0, 0), resolution=(960, 540))


def leaves_of(rng, max_depth: int, count: int) -> np.ndarray:
    """First cells of `count` leaves of a random tree, int64, or of as many as fit."""
    leaves = {(0, 1 << max_depth)}
    while len(leaves) < count and (large := sorted(leaf for leaf in leaves if leaf[1] > 1)):
        cell, size = large[rng.integers(len(large))]
        leaves.remove((cell, size))
        leaves |= {(cell, size // 2), (cell + size // 2, size // 2)}
    return np.array(sorted(cell for cell, _ in leaves), np.int64)


def write_apart(tree: EditedTree, rng, cells) -> list[tuple[int, int]]:
    """Write cells as the tree's next ones, in parts with gaps of rubbish; returns the parts, some without a cell."""
    count = len(cells)
    cuts = [0, *np.sort(rng.integers(0, count + 1, rng.integers(0, 5))).tolist(), count]
    memory = tree.next_cells(count + 8 * len(cuts)).numpy()
    memory[:] = rng.integers(-9, 9, len(memory))
    parts, at = [], int(rng.integers(0, 3))
    for low, high in zip(cuts, cuts[1:], strict=False):
        parts.append((at, high - low))
        memory[at : at + high - low] = cells[low:high]
        at += high - low + int(rng.integers(0, 5))
    return parts


@settings(max_examples=60, deadline=None)
@given(st.sampled_from([6, 12, 13, 20, 31]), st.integers(0, 2**32))
def test_cells_in_parts_give_the_tree_of_all_cells(max_depth, seed):
    """Parts with gaps: cells, queries and whether anything changed."""
    rng = np.random.default_rng(seed)
    tree, cells = EditedTree(max_depth), np.zeros(1, np.int64)
    for _ in range(5):
        before = cells
        kind = rng.random()
        if kind < 0.5:  # a little different
            extra = cells[rng.random(len(cells)) < 0.1] + (1 << max_depth) // len(cells) // 2
            cells = np.unique(np.concatenate([cells[rng.random(len(cells)) < 0.95], extra, [0]]))
            cells = cells[cells < 1 << max_depth]
        elif kind < 0.8:
            cells = leaves_of(rng, max_depth, int(rng.integers(1, 400)))
        parts = write_apart(tree, rng, cells)
        assert tree.would_change(parts) == (before.tolist() != cells.tolist())
        tree.mark(parts)
        assert tree.leaf_count == len(cells)
        assert np.array_equal(tree.cells(), cells)
        assert [tree.cell_of_leaf(k) for k in range(0, len(cells), 17)] == cells[::17].tolist()
        fresh = EditedTree(max_depth)
        fresh.put(cells)
        assert fresh.to_bytes() == tree.to_bytes()


def test_cells_that_were_written_and_not_marked_change_nothing():
    tree = EditedTree(14)
    tree.reset(9)
    before = tree.to_bytes()
    tree.next_cells(5_000).numpy()[:] = 3
    assert tree.to_bytes() == before and tree.decode(5) == 517
    assert not tree.put(tree.cells().copy())


def taken(terrain: Terrain) -> int:
    """Leaves that the last update took from the frame before."""
    history = terrain.history
    return int(history.scratch.numpy("reused")[: history.last.subtrees.slots].sum())


def assert_as_new(flown: Terrain, criterion: Criterion, view: View) -> None:
    """The next update is to the bit what a new terrain gives: mesh and cells."""
    update, fresh = flown.update(criterion, [view]), Terrain(flown.field, 1)
    new = fresh.update(criterion, [view])
    assert arrays(update.surface) == arrays(new.surface) and update.leaves == new.leaves
    assert np.array_equal(flown.tree.cells(), fresh.tree.cells())


@pytest.mark.parametrize("threads", [1, 2, 7])
@pytest.mark.parametrize("shape", SQUARES.values(), ids=SQUARES)
def test_a_flights_tree_is_that_of_a_new_terrain(shape, threads, monkeypatch):
    monkeypatch.setattr(launch, "SLICE_ITEMS", 2)
    flown = Terrain(rough(*shape, relief=20.0), threads)
    for frame in range(6):
        assert_as_new(flown, ERROR, over(frame))
    assert len(flown.tree._parts) == threads + (shape == (65, 193))


def test_points_that_are_taken_without_room_for_runs_are_displaced_again(monkeypatch):
    monkeypatch.setattr(launch, "SLICE_ITEMS", 2)
    flown = Terrain(rough(129, 129, relief=20.0), 2)
    for frame, room in enumerate((1000, 2, 1000, 1)):
        monkeypatch.setattr(slices, "room_for", lambda _leaves, room=room: room)
        assert_as_new(flown, ERROR, over(frame))


def test_a_new_tree_takes_nothing(monkeypatch):
    flown, mark = Terrain(rough(129, 129, relief=20.0), 1), ConcurrentBinaryTree.mark

    def stopped(tree, parts):
        mark(tree, parts)
        raise KeyboardInterrupt

    flown.update(ERROR, [over(0)])
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(ConcurrentBinaryTree, "mark", stopped)
        flown.update(ERROR, [over(1)])
    assert flown.tree is None
    assert_as_new(flown, ERROR, over(2))
    assert taken(flown) == 0
    assert_as_new(flown, ERROR, over(3))
    assert taken(flown) > 1000


def test_a_walk_that_is_given_up_changes_nothing():
    """More leaves than a budget allows: the walk has written into the next cells, the counting ones have not."""
    flown = Terrain(rough(129, 129, relief=20.0), 1)
    for frame, budget in enumerate((None, 3_000, None, 3_000, 2_000)):
        criterion = Criterion(error_px=1.0, max_depth=16, max_triangles=budget)
        assert_as_new(flown, criterion, over(frame))
    assert flown.update(criterion, [over(0)]).limited == "max_triangles"


@pytest.mark.parametrize("criterion", [ERROR, EDGE], ids=["error", "edge"])
def test_a_warm_frame_copies_no_cells(criterion, monkeypatch):
    """The tree's cells lie where the walk has written them, in two memories that take turns."""
    monkeypatch.setattr(launch, "SLICE_ITEMS", 2)
    terrain, written = Terrain(rough(65, 193), 2), []
    commit = FrameHistory.commit

    def noted(history, *args, **kwargs):
        structs = [[history.next.arrays.struct(kind, slot) for kind in (Walk, Reuse)] for slot in range(2)]
        written.append([(walk.cell, reuse.last_cell) for walk, reuse in structs])
        commit(history, *args, **kwargs)

    monkeypatch.setattr(FrameHistory, "commit", noted)
    for frame in range(4):
        terrain.update(criterion, [over(frame)])
    for frame in range(4, 8):
        terrain.update(criterion, [over(frame)])
        cells = terrain.tree.last_cells()
        assert len(written[-1]) == 2
        assert all(walk[0] is cells for walk in written[-1])
        assert all(walk[1] is written[-2][0][0] for walk in written[-1])
        assert cells is written[-3][0][0] and cells is not written[-2][0][0]
