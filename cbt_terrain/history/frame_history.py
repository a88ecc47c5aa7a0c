# SPDX-License-Identifier: GPL-3.0-or-later
"""The only owner of the state that survives a frame.

Two frames take turns. Functions read the past from `last`, which is committed, and write into `next`. With an empty
history they make the same bytes: the past only saves time. So an update that fails or is interrupted discards it.

`scratch`, `points` and `hints` carry no meaning: whatever is in them, results are the same.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...kernels.field.domain import Domain
from ...kernels.refine import curve
from ...kernels.refine.coherence import Motion
from ...kernels.refine.pixels import CriterionArrays
from ..errors import TerrainError
from ..run.buffers import Buffers, Loans, address_space
from ..run.locks import SharedLock
from ..tree.concurrent_binary_tree import ConcurrentBinaryTree, LeafPart
from .drift import MAX_DRIFT, move
from .frame import Frame, Leaves

# Arrays of a frame that a walk writes, and those of its vertices; a surface is made of the ones in DISPLACED.
LEAF_ARRAYS = ("code", "point", "cached", "cached_counts")
DISPLACED = ("positions", "normals", "uv")
VERTEX_ARRAYS = (*DISPLACED, "known", "relief", "ends", "leaf_level")


@dataclass
class Hints:
    """Guesses from earlier frames that only change how fast a frame is found.

    `capacity`: leaves for which a slice has room. `step`: the last step that kept to a triangle limit, a
    `step_search.Found`. `marks`: positions along the curve, in root squares, between which the last count did equal
    work.
    """

    capacity: int = 4096
    step: Any = None
    marks: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def make_room(self, leaves: int) -> None:
        """Let slices begin with capacity for at least `leaves` leaves, and a quarter more."""
        if leaves > self.capacity:
            self.capacity = int(1.25 * leaves) + 1024


class FrameHistory:
    """Results of the last frame that the next frame may reuse, with the key of the request that made them.

    They are the tree, cached subtrees, vertices, geomorph memory, attribute values and scatter candidates.

    A terrain has one history and each scatter another one. `values` belong to attributes, `ground` and `points` to a
    scatter. A function that updates `values` or `ground` takes it out and puts it back when it is complete.
    """

    def __init__(self) -> None:
        self._lock, self._is_busy = SharedLock(), False
        self.discard()

    def discard(self) -> None:
        """Forget everything that a later update could reuse.

        Results of earlier updates stay valid for their holders.
        """
        self.last, self.next = Frame(), Frame()
        self.tree: ConcurrentBinaryTree | None = None
        self._tree_leaves: Leaves | None = None  # the leaves that the tree holds
        self.values: Any = None
        self.ground: Any = None
        self.scratch, self.points, self.hints, self._loans = Buffers(), Buffers(), Hints(), Loans()

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Keep other threads out of the history for the block; they wait.

        In a process that was forked while another thread was inside, begin with an empty history. Raises TerrainError
        if the same thread is inside already.
        """
        with self._lock:
            if self._lock.broken:
                self.discard()
                self._lock.broken = self._is_busy = False
            if self._is_busy:
                raise TerrainError(
                    "The terrain is being updated on this thread, where a signal or a callback interrupted it",
                    expected="one call after the other",
                    fix="call it later",
                )
            self._is_busy = True
            try:
                yield
            finally:
                self._is_busy = False

    @contextmanager
    def writing(self) -> Iterator[Frame]:
        """Yield the frame that the block writes and commits; discard everything if the block raises."""
        try:
            yield self.next
        except BaseException:
            self.discard()
            raise

    def begin(self, key: tuple) -> bool:
        """Empty the next frame; return True if the last one has this key, so that nothing is to be done.

        key: the arguments of the update.
        """
        self.next = self.next.emptied()
        return key == self.last.key

    def commit(self, key: tuple | None = None, result: object = None, keeps_vertices: bool = False) -> None:
        """Make the next frame the last one; the frame after it reuses the memory of the one before.

        key: the arguments of the update that computed it, None for a frame that is never found again; result: that
        update. keeps_vertices: the next frame has the mesh of the last one and takes over its vertices.
        """
        if keeps_vertices:
            self.next.vertices = self.last.vertices
            self._hand_over_vertices()
        self.next.key, self.next.result = key, result
        self.last, self.next = self.next, self.last.emptied()

    def reuse_subtrees(self, domain: Domain, criterion: CriterionArrays, max_depth: int) -> "Motion | None":
        """Return how the view has moved since the last frame's subtrees were cached; None if none may be reused.

        They may be if only the camera has moved, and lengths of the view and the criterion have drifted by rounding, a
        fraction of at most MAX_DRIFT. The result is in `scratch` until the next call. Arguments: those of the frame
        that begins.
        """
        cached = self.last.subtrees
        if cached is None or (drift := cached.drift(domain, criterion, max_depth)) > MAX_DRIFT:
            return None
        motion = self.scratch.struct(Motion)
        move(motion, cached.criterion.view, criterion.view, drift)
        return motion

    def need_tree(self, max_depth: int, threads: int) -> None:
        """Keep the tree if it has `max_depth` levels, else begin with a new one. threads: those that it may use."""
        if self.tree is None or max_depth != self.tree.max_depth:
            self.tree, self._tree_leaves = ConcurrentBinaryTree(max_depth, threads), None

    def set_tree(self, leaves: Leaves, parts: list[LeafPart], cell_bits: int) -> bool:
        """Write the next frame's leaves into the tree, and return whether it has changed.

        leaves: the object that stands for these leaves as long as the tree holds them. parts: runs of leaves, one for
        each slice of the work, as codes with the depth of a leaf from bit DEPTH_SHIFT on. A part may list nodes
        (`same`) whose leaves are those of the last frame and need not be written. If the tree holds other leaves, their
        number `num_same` is set to 0, so that all leaves are written. cell_bits: log2 of the number of deepest cells in
        a root square.
        """
        if self._tree_leaves is not self.last.leaves:
            parts = [part._replace(num_same=0) for part in parts]
        assert self.tree is not None, "need_tree has not been called"
        changed = self.tree.set_leaves(parts, curve.DEPTH_SHIFT, cell_bits)
        self._tree_leaves = leaves
        return changed

    def replace_leaves(self) -> None:
        """Let the next frame write its leaves into the memory of the last ones, so that none of them can be reused."""
        self.next.arrays.exchange(self.last.arrays, LEAF_ARRAYS)
        self.last.subtrees = None

    def reuse_vertices(self, domain: Domain, morphs: bool, has_runs: bool) -> bool:
        """Return whether vertices of the last frame may be copied; forget its result, which uses their memory.

        If so, they are brought into the order of the last leaves: where the last mesh was cut off, its last vertices
        took the places of removed ones (`swapped`, pairs of vertices), and are moved back. Otherwise the next vertices
        are written into the memory of the last ones. morphs: whether this frame's vertices geomorph. has_runs: whether
        runs of vertices that are in both frames can be known.
        """
        vertices = self.last.vertices
        reuses = has_runs and vertices is not None and vertices.domain is domain and vertices.morphs == morphs
        self.last.result = None
        if not reuses:
            self._hand_over_vertices()
        # Arrays that are written from now on get other memory where callers still hold results that were lent to them.
        # Without swapped vertices the last frame's arrays are only read; otherwise they change here, on a copy.
        written, last = [self.scratch, self.next.arrays], [self.last.arrays]
        if not reuses or vertices is None or not vertices.swapped:
            self._loans.reclaim(written, copied=[], read=last)
        else:
            self._loans.reclaim(written, copied=last)
            for swapped in reversed(vertices.swapped):  # the last cut first
                for name in DISPLACED:  # the arrays of a surface: positions, normals, texture coordinates
                    array = self.last.arrays.numpy(name)
                    array[swapped] = array[swapped[::-1]]
            vertices.swapped = []
        return reuses

    def _hand_over_vertices(self) -> None:
        """Give the memory of the last vertices to the next frame, which keeps them or writes over them."""
        self.next.arrays.exchange(self.last.arrays, VERTEX_ARRAYS)
        self.last.vertices = None

    def room_for_points(self) -> Buffers:
        """Return the memory for scatter points; other memory where a caller still reads the last ones."""
        self._loans.reclaim([self.points], copied=[])
        return self.points

    def lend(self, buffers: Buffers, name: str, count: int) -> np.ndarray:
        """Return the first `count` items of an array, read-only: it is not written while a caller uses it."""
        return self._loans.lend(buffers.numpy(name), count)

    @property
    def nbytes(self) -> int:
        """Return the address space of all arrays; the system commits the pages that are touched."""
        memory = [
            m for buffers in (self.scratch, self.points, self.last.arrays, self.next.arrays) for m in buffers.memory()
        ]
        return address_space(memory + self._loans.memory()) + (self.tree.nbytes if self.tree else 0)
