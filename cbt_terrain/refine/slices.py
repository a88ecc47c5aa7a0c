# SPDX-License-Identifier: GPL-3.0-or-later
"""The slices of the curve that threads walk side by side, bound to the arrays of the frame that they write.

Of a FrameHistory: `next.arrays` are those of the frame that is being made, `last.arrays` those of the frame before,
and `scratch` has arrays without meaning from one frame to the next. Each gives the array of a name, made longer if
needed.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from ...kernels.refine.coherence import Motion, Subtree
from ...kernels.refine.interval import LodInterval, MeasuredDiamond
from ...kernels.refine.reuse_state import Reuse, ReuseCursor
from ...kernels.refine.runs import Run, Runs
from ...kernels.refine.walk_state import STACK, Walk
from ...kernels.tree.bitfield import SameLeaves
from ..field.lattice import Lattice
from ..history.frame_history import FrameHistory
from ..run.buffers import bind
from ..tree.concurrent_binary_tree import LeafPart
from .block_tables import block_table

# Fraction by which pixel footprints may change before a cached subtree has to be walked anew.
SLACK = 0.05


@dataclass
class Slices:
    """The structs of all slices.

    `walks`, `reuses`: a kernels' struct for each slice, the latter after `bind_reuse`. `capacity`: leaves for which
    each slice has room. `cell_bits`: bisections of a square down to cells of the tree. `counts` int64 [slices, 4]:
    leaves, vertices, edges, and 1 if a leaf is too coarse at the deepest level. `reused` int64 [slices]: leaves.
    """

    history: FrameHistory
    walks: list[Walk]
    reuses: list[Reuse]
    capacity: int
    cell_bits: int
    counts: np.ndarray
    reused: np.ndarray

    @classmethod
    def of(cls, history: FrameHistory, lattice: Lattice, cuts: list[int], max_depth: int, max_leaves: int) -> "Slices":
        """Return the walks between `cuts`, bound to the next frame's arrays.

        cuts: deepest cells of the root squares, ascending, at which walks begin, and the end of the last one.
        max_depth: bisections of a square. A walk with more leaves than fit into its part of the arrays counts the
        others; above `max_leaves` it may stop.
        """
        assert history.tree is not None, "refine and replay have a tree"
        count, squares, capacity = len(cuts) - 1, lattice.squares, history.hints.capacity
        # a square begins with up to two more vertices; the rest is spare
        stride, cell_bits = capacity + 2 * squares + 8, history.tree.max_depth - lattice.square_bits
        written, scratch = history.next.arrays, history.scratch
        arrays = {
            "code": written.get("code", count * stride, wp.uint16),
            "point": written.get("point", count * stride, wp.vec2i),
            "stack": scratch.get("walk_stack", count * STACK, wp.vec4i),  # corners of triangles that are to be visited
            "aside": scratch.get("walk_aside", count * STACK, wp.int32),  # their state, depth and interval
            "intervals": scratch.get("walk_intervals", count * STACK, LodInterval),
            "diamonds": scratch.get("walk_diamonds", count * STACK, MeasuredDiamond),
            "blocks": block_table(),
            "sides": scratch.get("sides", count * 4 * squares, wp.int32),  # edges on the four sides of each square
            "counts": scratch.get("counts", count * 4, wp.int64),
            "ends": scratch.get("ends", count, wp.uint64),
        }
        scratch.numpy("sides")[: count * 4 * squares] = 0
        counts = scratch.numpy("counts")[: count * 4].reshape(count, 4)
        counts[:] = 0
        walks = [written.struct(Walk, slot) for slot in range(count)]
        for slot, walk in enumerate(walks):
            bind(
                walk,
                first_cell=cuts[slot],
                end_cell=cuts[slot + 1],
                cell_bits=cell_bits,
                max_depth=max_depth,
                leaf_capacity=capacity,
                leaf_limit=max_leaves,
                leaf_base=slot * stride,
                slot=slot,
                grid=int(squares > 1),  # 1: leaves at borders of squares are tracked
                **arrays,
            )
        return cls(history, walks, [], capacity, cell_bits, counts, np.zeros(count, np.int64))

    def bind_reuse(self, caches: bool, motion: "Motion | None") -> None:
        """Bind the lists of subtrees that the walks cache, and those of the last frame that they reuse.

        Each slice has `room` entries in such a list. caches: whether subtrees are cached for the next frame. motion:
        movement of the view since the last frame; None to reuse no subtree.
        """
        history, count, last = self.history, len(self.walks), self.history.last
        written, scratch, read = history.next.arrays, history.scratch, history.last.arrays
        room = room_for(self.capacity) if caches else 0
        arrays = {
            "cursor": scratch.get("reuse_cursor", count, ReuseCursor),
            "cached": written.get("cached", max(count * room, 1), Subtree),
            "cached_counts": written.get("cached_counts", count, wp.int64),
            "point_runs": scratch.get("point_runs", max(count * room, 1), Run),
            "point_run_counts": scratch.get("point_run_counts", count, wp.int64),
            "same": scratch.get("same", max(count * room, 1), SameLeaves),  # an entry for each run
            "reused": scratch.get("reused", count, wp.int64),
            # written in the last frame, so that any size will do
            "last_cached": read.get("cached", 1, Subtree),
            "last_counts": read.get("cached_counts", 1, wp.int64),
            "last_code": read.get("code", 1, wp.uint16),
            "last_point": read.get("point", 1, wp.vec2i),
        }
        last_slots, last_room = (last.subtrees.slots, last.subtrees.room) if motion and last.subtrees else (0, 1)
        self.reuses = [written.struct(Reuse, slot) for slot in range(count)]
        for reuse in self.reuses:
            bind(reuse, slack=SLACK if caches else 0.0, room=room, last_slots=last_slots, last_room=last_room, **arrays)
            if motion:
                reuse.motion = motion
        self.reused = scratch.numpy("reused")[:count]

    def read_counts(self) -> np.ndarray:
        """Return the counts that the kernels have written, int64 [slices, 4].

        They and `reused` are copies from now on, which a later walk does not overwrite.
        """
        self.counts, self.reused = self.counts.copy(), self.reused.copy()
        return self.counts

    def leaf_parts(self) -> list[LeafPart]:
        """Return for each slice its leaves and the nodes whose leaves were reused, in the form that the tree reads."""
        scratch, counts = self.history.scratch, self.counts[:, 0].tolist()
        ends = scratch.numpy("ends").tolist()
        parts = [LeafPart(w.code, int(w.leaf_base), counts[k], ends[k]) for k, w in enumerate(self.walks)]
        if self.history.next.reused_points is not None:
            num_runs = scratch.numpy("point_run_counts").tolist()  # also those of `same`
            for k, reuse in enumerate(self.reuses):
                parts[k] = parts[k]._replace(same=reuse.same, first_same=k * int(reuse.room), num_same=num_runs[k])
        return parts

    def reused_points(self) -> Runs:
        """Return the runs of points that the walks have copied from the last frame, for displacement."""
        runs, scratch = self.history.scratch.struct(Runs), self.history.scratch
        bind(runs, runs=scratch.get("point_runs", 1, Run), counts=scratch.get("point_run_counts", 1, wp.int64))
        bind(runs, room=self.reuses[0].room, lists=len(self.walks))
        return runs


def room_for(leaves: int) -> int:
    """Return the number of subtrees that a slice with room for `leaves` leaves may cache: few are of fewer than 8."""
    return leaves // 8 + 8
