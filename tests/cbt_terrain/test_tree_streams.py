# SPDX-License-Identifier: GPL-3.0-or-later
"""The tree's cells where a walk has written them: in parts, with runs that are known to be the same, never copied."""

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.ask.criterion import Criterion
from adaptive_terrain.cbt_terrain.ask.view import View
from adaptive_terrain.cbt_terrain.refine import refinement
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.run.buffers import shared
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.tree.concurrent_tree import ConcurrentBinaryTree
from adaptive_terrain.kernels.refine.sum_reduction import Run, Runs
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


def changed_cells(before, after) -> int:
    """How many cells are in one of two streams only."""
    return len(set(before.tolist()) ^ set(after.tolist()))


def assert_counters_agree(tree: EditedTree) -> None:
    """All counters are those of a tree that was marked from the cells at once."""
    fresh = EditedTree(tree.max_depth)
    fresh.mark(tree.cells())
    assert np.array_equal(fresh._upper_counts, tree._upper_counts)
    assert np.array_equal(fresh._block_counts, tree._block_counts)
    assert fresh.to_bytes() == tree.to_bytes()


def write_apart(tree: EditedTree, rng, cells) -> list[tuple[int, int]]:
    """Write cells as the tree's next ones, in parts with gaps of rubbish; returns the parts, some without a cell."""
    count = len(cells)
    cuts = [0, *np.sort(rng.integers(0, count + 1, rng.integers(0, 5))).tolist(), count]
    room = count + 8 * len(cuts)
    memory = tree.next_cells(room).numpy()
    memory[:] = rng.integers(-9, 9, len(memory))
    parts, at = [], int(rng.integers(0, 3))
    for low, high in zip(cuts, cuts[1:], strict=False):
        parts.append((at, high - low))
        memory[at : at + high - low] = cells[low:high]
        at += high - low + 1 + int(rng.integers(0, 5))
    return parts


def runs_of(rng, now: list[tuple[int, int]], then: list[tuple[int, int]], before, after, lists: int = 3) -> Runs:
    """Some of the rows of cells that lie in both streams, in `lists` lists of a room of 50, some without any."""
    places = [np.concatenate([np.arange(first, first + n) for first, n in parts]) for parts in (now, then)]
    old = dict(zip(before.tolist(), places[0].tolist(), strict=True))
    rows = []
    for cell, place in zip(after.tolist(), places[1].tolist(), strict=True):
        if (was := old.get(cell)) is None or rng.random() < 0.1:
            continue
        if rows and rows[-1][0] + rows[-1][2] == place and rows[-1][1] + rows[-1][2] == was:
            rows[-1][2] += 1
        elif rng.random() < 0.7:
            rows.append([place, was, 1])
    rows = rows[: 50 * lists]
    table, counts = np.zeros(50 * lists, Run.numpy_dtype()), np.zeros(lists, np.int64)
    chosen = np.sort(rng.integers(0, lists, len(rows)))
    for k in range(lists):
        of_list = [row for row, c in zip(rows, chosen, strict=True) if c == k][:50]
        counts[k] = len(of_list)
        for i, row in enumerate(of_list):
            table[50 * k + i] = tuple(row)
    runs = Runs()
    runs.runs, runs.counts, runs.room, runs.lists = shared(table, Run), shared(counts, wp.int64), 50, lists
    return runs


@settings(max_examples=60, deadline=None)
@given(st.sampled_from([6, 12, 13, 20, 31]), st.integers(0, 2**32))
def test_cells_in_parts_and_known_runs_give_the_tree_of_all_cells(max_depth, seed):
    """Parts with gaps, and any of the rows that are in both streams: cells, counters, queries and what changed."""
    rng = np.random.default_rng(seed)
    tree, cells = EditedTree(max_depth), np.zeros(1, np.int64)
    parts = [(0, 1)]
    for _ in range(5):
        before, was = cells, parts
        if rng.random() < 0.7:  # a little different
            extra = cells[rng.random(len(cells)) < 0.1] + (1 << max_depth) // len(cells) // 2
            cells = np.unique(np.concatenate([cells[rng.random(len(cells)) < 0.95], extra, [0]]))
            cells = cells[cells < 1 << max_depth]
        else:
            cells = leaves_of(rng, max_depth, int(rng.integers(1, 400)))
        parts = write_apart(tree, rng, cells)
        runs = runs_of(rng, was, parts, before, cells) if rng.random() < 0.8 else None
        assert tree.mark_written(parts, runs) == changed_cells(before, cells)
        assert tree.leaf_count == len(cells)
        assert np.array_equal(tree.cells(), cells)
        assert [tree.cell_of_leaf(k) for k in range(0, len(cells), 17)] == cells[::17].tolist()
        assert_counters_agree(tree)


def test_cells_that_were_written_and_not_marked_change_nothing():
    tree = EditedTree(14)
    tree.reset(9)
    before = tree.to_bytes()
    tree.next_cells(5_000).numpy()[:] = 3
    assert tree.to_bytes() == before and tree.decode(5) == 517
    assert tree.mark(tree.cells().copy()) == 0
    assert_counters_agree(tree)


@pytest.fixture
def marks(monkeypatch):
    """Of each mark: whether its count of changed cells is exact, cells in known runs, and runs of each list.

    Runs hold the same cells in both streams, and each is as long as it can be.
    """
    found, mark_written = [], ConcurrentBinaryTree.mark_written

    def checked(tree, parts, runs=None):
        counts = runs.counts.numpy()[: runs.lists].copy() if runs else []
        rows = [runs.runs.numpy()[k * runs.room : k * runs.room + n].copy() for k, n in enumerate(counts)]
        now, then = tree.next_cells(1).numpy(), tree.last_cells().numpy()
        for first, was, count in (row.tolist() for of_list in rows for row in of_list):
            assert np.array_equal(now[first : first + count], then[was : was + count])
        for first, was, count in ((r["first"], r["before"], r["count"]) for r in rows):
            assert not ((first + count)[:-1] == first[1:])[(was + count)[:-1] == was[1:]].any()
        before = tree.cells().copy()
        changed = mark_written(tree, parts, runs)
        found.append((changed == changed_cells(before, tree.cells()), sum(int(r["count"].sum()) for r in rows), counts))
        return changed

    monkeypatch.setattr(ConcurrentBinaryTree, "mark_written", checked)
    return found


def taken(terrain: Terrain) -> int:
    """Leaves that the last update took from the frame before."""
    return int(terrain._buffers.numpy("taken")[: terrain._refinement._last.slots].sum())


def assert_as_new(flown: Terrain, criterion: Criterion, view: View) -> None:
    """The next update is to the bit what a new terrain gives: mesh, cells and counters."""
    update, fresh = flown.update(criterion, [view]), Terrain(flown.field, 1)
    new = fresh.update(criterion, [view])
    assert arrays(update.surface) == arrays(new.surface) and update.leaves == new.leaves
    assert np.array_equal(flown.tree.cells(), fresh.tree.cells())
    assert_counters_agree(flown.tree)


@pytest.mark.parametrize("threads", [1, 2, 7])
@pytest.mark.parametrize("shape", SQUARES.values(), ids=SQUARES)
def test_a_flights_tree_is_that_of_a_new_terrain(shape, threads, marks, monkeypatch):
    monkeypatch.setattr(launch, "SLICE_ITEMS", 2)
    flown = Terrain(rough(*shape, relief=20.0), threads)
    for frame in range(6):
        marks.clear()
        assert_as_new(flown, ERROR, over(frame))
        exact, in_runs, counts = marks[0]
        assert exact
        if frame:
            assert len(counts) == threads and in_runs > 0.3 * len(flown.tree.cells())
    assert len(flown.tree._cells._parts) == threads + (shape == (65, 193))


def test_what_is_taken_without_room_for_runs_is_compared(marks, monkeypatch):
    monkeypatch.setattr(launch, "SLICE_ITEMS", 2)
    flown = Terrain(rough(129, 129, relief=20.0), 2)
    for frame, room in enumerate((1000, 2, 1000, 1)):
        monkeypatch.setattr(refinement, "_room_for", lambda _leaves, room=room: room)
        flown.update(ERROR, [over(frame)])
        exact, in_runs, counts = marks[-1]
        assert exact
        if room < 1000:
            assert counts.tolist() == [room, room] and 0 < in_runs < 0.2 * taken(flown)
        assert_counters_agree(flown.tree)


def test_a_new_tree_takes_nothing(marks, monkeypatch):
    flown, slices = Terrain(rough(129, 129, relief=20.0), 1), launch.slices

    def stopped(*args, **options):
        slices(*args, **options)
        if options["step"] == "mark":
            raise KeyboardInterrupt

    flown.update(ERROR, [over(0)])
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(launch, "slices", stopped)
        flown.update(ERROR, [over(1)])
    assert flown.tree is None
    assert_as_new(flown, ERROR, over(2))
    assert taken(flown) == 0
    assert_as_new(flown, ERROR, over(3))
    assert taken(flown) > 1000


def test_a_walk_that_is_given_up_changes_nothing(marks):
    """More leaves than a budget allows: the walk has written into the next stream, the counting ones have not."""
    flown = Terrain(rough(129, 129, relief=20.0), 1)
    for frame, budget in enumerate((None, 3_000, None, 3_000, 2_000)):
        criterion = Criterion(error_px=1.0, max_depth=16, max_triangles=budget)
        assert_as_new(flown, criterion, over(frame))
    assert all(exact for exact, *_ in marks)
    assert flown.update(criterion, [over(0)]).limited == "max_triangles"


@pytest.mark.parametrize("criterion", [ERROR, EDGE], ids=["error", "edge"])
def test_a_warm_frame_copies_no_cells(criterion, monkeypatch):
    """The tree's cells lie where the walk has written them, in two memories that take turns."""
    monkeypatch.setattr(launch, "SLICE_ITEMS", 2)
    terrain, written = Terrain(rough(65, 193), 2), []
    marked = refinement.Refinement._mark

    def noted(self, walks, counts):
        written.append([(walk.cell, walk.last_cell) for walk in walks])
        return marked(self, walks, counts)

    monkeypatch.setattr(refinement.Refinement, "_mark", noted)
    for frame in range(4):
        terrain.update(criterion, [over(frame)])
    for frame in range(4, 8):
        terrain.update(criterion, [over(frame)])
        cells = terrain.tree.last_cells()
        assert len(written[-1]) == 2
        assert all(walk[0] is cells for walk in written[-1])
        assert all(walk[1] is written[-2][0][0] for walk in written[-1])
        assert cells is written[-3][0][0] and cells is not written[-2][0][0]
