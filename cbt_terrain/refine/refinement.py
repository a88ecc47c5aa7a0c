# SPDX-License-Identifier: GPL-3.0-or-later
"""The refinement of a terrain for a set of views: drives the walk, keeps to a budget, marks the tree."""

import math
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.refine import curve
from ...kernels.refine import replay as replay_kernels
from ...kernels.refine import walk as kernels
from ...kernels.refine.band import Band
from ...kernels.refine.coherence import Motion, Subtree
from ...kernels.refine.pixels import Asked
from ...kernels.refine.runs import Run, Runs
from ...kernels.refine.walk_state import STACK, Keeper, Walk
from ..field.heightfield import HeightField
from ..run import launch
from ..run.buffers import Buffers, bind, shared
from ..tree.concurrent_tree import MIN_DEPTH, ConcurrentBinaryTree
from .block_tables import blocks
from .budget import Budget, Found, limit_of
from .drift import MOST_DRIFT, Walked, move
from .horizon import fill, has_rings

# Indices are int32, three corners a triangle; beyond this a mesh is no use to Blender either.
MAX_TRIANGLES = 1 << 26
# By which part spans of a pixel may change before what is kept of the last frame has to be walked anew.
SLACK = 0.05
# What a leaf costs that is taken from the last frame, of one that is found anew: 8 ns of 91, by a fit to flights of
# four speeds.
TAKEN_COST = 0.1
# A count and a walk agree but where errors are not nested, except on step 0, which need not be counted.
MOST_SEARCHES = 2
# How far a triangle limit may relax what is asked while the horizons hold that were made for it: the first that do are
# taken, the last hide nothing. Of a mesh that nobody limits, and where somebody does.
RELAXED = (1.0, math.inf), (4.0, 64.0, math.inf)
# What a walk writes that the next one may copy.
WRITTEN = ("code", "point", "kept", "kept_counts")


@dataclass
class Leaves:
    """The leaves of one refinement, in curve order, slice by slice.

    `counts` int64 [slices, 3]: leaves, vertices, edges. `squares` int32 [slices]: where each begins.
    `before` int32 [slices, 4]: edges of that square's sides that earlier slices have passed. `sides` int32 [squares,
    4]. `base` int64 [slices]: first entry in the buffers "code" and "point".
    `stopped`: whether a leaf is still too coarse by the criterion, and as deep as leaves may be.
    `slots` int64 [slices]: rows of the walk's lists.
    `after`: the leaves of the last frame if points were taken from them, `taken`: the runs of those.
    """

    counts: np.ndarray
    squares: np.ndarray
    before: np.ndarray
    sides: np.ndarray
    base: np.ndarray
    stopped: bool
    slots: np.ndarray
    after: "Leaves | None" = None
    taken: "Runs | None" = None
    changed: bool = True

    @property
    def total(self) -> int:
        return int(self.counts[:, 0].sum())


class Refinement:
    """Persistent state of the refinement of one height field: the tree and the walk's buffers."""

    def __init__(self, field: HeightField, buffers: Buffers, threads: int):
        self.field, self.lattice = field, field.lattice
        self.buffers = buffers
        self.threads = threads
        self.tree: ConcurrentBinaryTree | None = None
        self._cell_bits = 0
        self._capacity = 4096
        self._budget = Budget(self.lattice, buffers, threads)
        self._found: Found | None = None  # by the last refinement's search, None before the first
        # Two sets that take turns, as the tree's streams do: setting arrays and structs costs as much as launches.
        self._walk_structs: tuple[list[Walk], list[Walk]] = [], []
        self._recorded: tuple[dict, dict] = {}, {}
        self._motion, self._point_runs = Motion(), Runs()
        self._last: Walked | None = None

    def run(
        self,
        domain: Domain,
        asked: Asked,
        max_depth: int,
        max_leaves: int,
        limited: bool = False,
        rises_until: float = 1.0,
    ):
        """Refine from the roots to at most `max_leaves` and mark the tree.

        Returns the leaves and the factor by which the budget coarsened what was asked (1: not at all). Both are
        functions of the arguments alone. Fewer leaves than two a root square cannot be had. `limited`: somebody has
        asked for so few leaves, so they may well be too few; without `rises_until` it only says what is tried first.
        `rises_until`: points rise until this ratio, so the mesh may be off by so many times what is asked. Then the
        factor is the one from which they rise.
        """
        self._need_tree(max(max_depth, MIN_DEPTH))
        most, walks = max(max_leaves, 2 * self.lattice.squares), None
        hides = has_rings(asked)
        for relaxed in RELAXED[limited] if hides else (math.inf,):
            if hides:
                off = relaxed * (rises_until * math.sqrt(limit_of(1)) if rises_until > 1 else 1.0)
                fill(self.field, domain, asked, max_depth, off, self.buffers, self.threads)
            walks, counts = self._limited(domain, asked, max_depth, most, limited, relaxed)
            if walks is not None:
                break
        leaves, factor = self._leaves(walks, counts), math.sqrt(asked.limit)
        if rises_until > 1 and limited:
            factor = self._budget.ramp_start(domain, asked, max_depth, most, self._found.step, leaves.total)
        if self._last:
            leaves.after, leaves.taken = self._last.after, self._listed()
            self._last.after = None
            if leaves.after:
                leaves.after.after = None  # or all leaves of a flight would stay
        leaves.changed = self._mark(walks, counts)
        if self._last:
            self._last.leaves = leaves
        return leaves, factor

    def _limited(self, domain: Domain, asked: Asked, max_depth: int, most: int, limited: bool, relaxed: float):
        """The finest walk with at most `most` leaves; (None, None) if what is asked has to be coarsened by more than
        `relaxed`."""
        asked.limit, walks, counts = 1.0, None, None
        start, self._found = self._found, Found(0)
        # Where the last refinement kept to the limit as asked, this one may, too.
        plain = not limited or (start is not None and start.step == 0)
        if plain:
            walks, counts = self._walk(domain, asked, max_depth, most)
        low, too_many = int(plain), 0
        while walks is None:
            near = start if start and start.step else None
            self._found = self._budget.search(domain, asked, max_depth, most, near, low)
            asked.limit, low = limit_of(self._found.step), self._found.step + 1
            if asked.limit > relaxed * relaxed:
                break
            leaves = self._found.splits + 2 * self.lattice.squares
            walks, counts = self._walk(domain, asked, max_depth, most, leaves)
            too_many += walks is None
            if too_many > MOST_SEARCHES:
                raise self.field.damage("there are more leaves than its errors allow")
        return walks, counts

    def replay(self, domain: Domain, depths: np.ndarray, cell_bits: int) -> tuple[Leaves, float]:
        """The leaves of a saved tree, as the walk that found them gave them, and marked again.

        depths: uint8, bisections of a square of each of its leaves, 1 .. cell_bits, square by square without a gap.
        Returns the largest error of a leaf, too: metres before scaling.
        """
        self._need_tree(cell_bits)
        self._last = self._found = None
        self._make_room(len(depths))
        walks = self._walks([0, self.lattice.squares << cell_bits], cell_bits, len(depths), self._capacity)
        worst = self.buffers.get("replay_worst", 1, wp.float32)
        launch.once(replay_kernels.replay, [domain, walks[0], shared(depths, wp.uint8), worst], step="refine")
        counts = self.buffers.numpy("counts")[:4].reshape(1, 4).copy()
        leaves = self._leaves(walks, counts)
        leaves.changed = self._mark(walks, counts)
        return leaves, float(self.buffers.numpy("replay_worst")[0])

    def _need_tree(self, cell_bits: int) -> None:
        """A tree with so many levels below a square; another one is forgotten."""
        if self.tree is None or cell_bits != self._cell_bits:
            self.tree = ConcurrentBinaryTree(self.lattice.square_bits + cell_bits)
            self._cell_bits = cell_bits

    def _walk(self, domain: Domain, asked: Asked, max_depth: int, max_leaves: int, expected: int = 0):
        """The walk, again with more room if it needs more; (None, None) if there are more than `max_leaves`."""
        cuts, last, self._last = self._cuts(), self._last, None
        self._make_room(expected // (len(cuts) - 1))
        # Of edges alone bands decide so fast that keeping them costs as much as it saves; what is hidden changes with
        # each map of horizons.
        keeps = asked.view_count == 1 and asked.error_px2 < math.inf and not asked.view.rings.count
        if keeps:
            for name in WRITTEN:
                self.buffers.swap(name, "last_" + name)
        drift = last.drift(domain, asked, max_depth) if keeps and last else math.inf
        kept = drift <= MOST_DRIFT
        if kept:
            move(self._motion, last.asked.view, asked.view, drift)
        while True:
            walks = self._walks(cuts, max_depth, max_leaves, self._capacity)
            for walk in walks:
                if keeps:
                    bind(walk, slack=SLACK, room=_room_for(self._capacity))
                if kept:
                    bind(walk, last_slots=last.slots, last_room=last.room)
                walk.motion = self._motion
            launch.slices(kernels.walk, [[domain, asked, w] for w in walks], step="refine", recorded=self._recorded[0])
            counts = self.buffers.numpy("counts")[: 4 * len(walks)].reshape(-1, 4).copy()
            if counts[:, 0].sum() > max_leaves:
                return None, None
            if counts[:, 0].max() <= self._capacity:
                if keeps:
                    after = last.leaves if kept else None
                    room, taken = _room_for(self._capacity), self.buffers.numpy("taken")[: len(walks)]
                    work = counts[:, 0], counts[:, 0] - (1 - TAKEN_COST) * taken
                    self._last = Walked(domain, asked, max_depth, len(walks), room, work, after)
                return walks, counts
            self._make_room(counts[:, 0].max())

    def _make_room(self, leaves: int):
        """Room for so many leaves in each slice, and some more."""
        if leaves > self._capacity:
            self._capacity = int(1.25 * leaves) + 1024

    def _cuts(self) -> list[int]:
        """Where the curve is cut for the threads: evenly by what the last refinement has cost; any cut does."""
        tree, end = self.tree, self.lattice.squares << self._cell_bits
        leaves = tree.leaf_count - (1 << self.lattice.square_bits) + self.lattice.squares
        if self.threads < 2 or leaves < launch.SLICE_ITEMS:
            return [0, end]
        shares = np.arange(1, self.threads) / self.threads
        ends = costs = np.array([0, leaves])
        if self._last is not None:
            ends, costs = (np.cumsum([0, *of]) for of in self._last.work)
        at = np.interp(shares * costs[-1], costs, ends).astype(np.int64)
        inner = [tree.cell_of_leaf(min(leaf, leaves - 1)) for leaf in at.tolist()]
        return [0, *sorted({cut for cut in inner if 0 < cut < end}), end]

    def _walks(self, cuts: list[int], max_depth: int, max_leaves: int, capacity: int) -> list[Walk]:
        """The walks of the slices between `cuts`; beyond `capacity` leaves each only counts."""
        slices, squares = len(cuts) - 1, self.lattice.squares
        stride, stacks = capacity + 2 * squares + 8, slices * STACK
        get = self.buffers.get
        arrays = {
            "code": get("code", slices * stride, wp.uint16),
            "point": get("point", slices * stride, wp.vec2i),
            "cell": self.tree.next_cells(slices * stride + (1 << self.lattice.square_bits)),
            "stack": get("walk_stack", stacks, wp.vec4i),
            "aside": get("walk_aside", stacks, wp.int32),
            "bands": get("walk_bands", stacks, Band),
            "blocks": blocks(),
            "sides": get("sides", slices * 4 * squares, wp.int32),
            "counts": get("counts", slices * 4, wp.int64),
            "keeper": get("keeper", slices, Keeper),
            "taken": get("taken", slices, wp.int64),
            "kept": get("kept", slices * _room_for(capacity), Subtree),
            "kept_counts": get("kept_counts", slices, wp.int64),
            "last_kept": get("last_kept", 1, Subtree),
            "last_counts": get("last_kept_counts", 1, wp.int64),
            "last_code": get("last_code", 1, wp.uint16),
            "last_point": get("last_point", 1, wp.vec2i),
            "last_cell": self.tree.last_cells(),
            "point_runs": get("point_runs", slices * _room_for(capacity), Run),
            "point_run_counts": get("point_run_counts", slices, wp.int64),
        }
        self.buffers.numpy("sides")[: slices * 4 * squares] = 0
        while len(self._walk_structs[0]) < slices:
            self._walk_structs[0].append(Walk())
        walks = self._walk_structs[0][:slices]
        for k, walk in enumerate(walks):
            bind(
                walk,
                first_cell=cuts[k],
                end_cell=cuts[k + 1],
                cell_bits=self._cell_bits,
                max_depth=max_depth,
                leaf_capacity=capacity,
                leaf_limit=max_leaves,
                leaf_base=k * stride,
                slot=k,
                grid=int(squares > 1),
                slack=0.0,
                room=0,
                last_slots=0,
                last_room=1,
                **arrays,
            )
        return walks

    def _leaves(self, walks: list[Walk], counts: np.ndarray) -> Leaves:
        """Describe the slices that hold any leaves."""
        slices, squares = len(walks), self.lattice.squares
        used = np.flatnonzero(counts[:, 0])
        sides = self.buffers.numpy("sides")[: slices * 4 * squares].reshape(slices, squares, 4)
        code = self.buffers.numpy("code")
        base = np.array([w.leaf_base for w in walks], np.int64)[used]
        starts = (code[base] >> curve.FIRST & 1).astype(bool)
        cells = np.array([w.first_cell for w in walks], np.int64)[used]
        # A slice whose first cells belong to the last leaf of a square begins with the next square.
        squares_of = (cells >> self._cell_bits) + (starts & (cells & ((1 << self._cell_bits) - 1) > 0))
        before = np.array([sides[:slot, q].sum(axis=0) for slot, q in zip(used, squares_of, strict=True)], np.int32)
        stopped = bool(counts[:, 3].any())
        found, squares_of = np.ascontiguousarray(counts[used, :3]), squares_of.astype(np.int32)
        return Leaves(found, squares_of, before, sides.sum(axis=0), base, stopped, used)

    def _mark(self, walks: list[Walk], counts: np.ndarray) -> bool:
        """Make the leaves those of the tree; returns whether it is another one now."""
        parts = [(w.leaf_base, n) for w, n in zip(walks, counts[:, 0], strict=True)]
        squares, most = self.lattice.squares, 1 << self.lattice.square_bits
        if squares < most:  # those that only fill the tree up to a power of two are a leaf each, after all others
            cells = self.tree.next_cells(1).numpy()
            first = len(cells) - (most - squares)
            cells[first : first + most - squares] = np.arange(squares, most, dtype=np.int64) << self._cell_bits
            parts.append((first, most - squares))
        # A mark that is stopped half-way: then the next refinement has a new tree.
        tree, self.tree = self.tree, None
        changed = tree.would_change(parts)
        tree.mark(parts)
        self.tree = tree
        self._walk_structs, self._recorded = self._walk_structs[::-1], self._recorded[::-1]
        return changed

    def _listed(self) -> Runs:
        """The points that a walk that keeps has taken."""
        get, last, runs = self.buffers.get, self._last, self._point_runs
        bind(runs, runs=get("point_runs", 1, Run), counts=get("point_run_counts", 1, wp.int64))
        bind(runs, room=last.room, lists=last.slots)
        return runs


def _room_for(leaves: int) -> int:
    """Subtrees that a slot of so many leaves may keep."""
    return leaves // 8 + 8
