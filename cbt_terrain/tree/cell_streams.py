# SPDX-License-Identifier: GPL-3.0-or-later
"""The leaves of a tree as a stream: the first cell of each, int64, ascending, where a walk has written them."""

import numpy as np
import warp as wp

from ...kernels.refine.sum_reduction import END_LINK
from ..run.buffers import Buffers

AHEAD = 8  # entries behind a stream that a comparison may read


class CellStreams:
    """The stream that holds now, and memory for the next one.

    A stream lies in parts, (first entry, cells) each, that ascend and are not empty; what leads from one to the next is
    in the entry behind its last cell, see kernels/refine/sum_reduction.py.
    """

    def __init__(self):
        self._now, self._next = Buffers(), Buffers()
        self._parts: list[tuple[int, int]] = []
        self.next()
        self.link([])
        self.advance([])

    @property
    def nbytes(self) -> int:
        """Bytes of both streams' arrays."""
        return self._now.nbytes + self._next.nbytes

    def now(self) -> wp.array:
        """Memory of the stream that holds: the same object until `advance`."""
        return self._now.get("cells", 1 + AHEAD, wp.int64)

    def next(self, room: int = 1) -> wp.array:
        """Memory of the next stream, at least `room` entries, one behind the cells of each part included."""
        return self._next.get("cells", room + AHEAD, wp.int64)

    def link(self, parts: list[tuple[int, int]]) -> None:
        """Write the entries that lead through the parts of the next stream."""
        cells = self._next.numpy("cells")
        end = 0
        for first, count in parts:
            if first != end or end > 0:
                cells[end] = ~first
            end = first + count
        cells[end] = END_LINK

    def advance(self, parts: list[tuple[int, int]]) -> None:
        """Make the next stream, of these parts, the one that holds."""
        self._now, self._next, self._parts = self._next, self._now, parts

    def joined(self) -> np.ndarray:
        """All cells: a view if the stream is in one part, else a copy."""
        return _joined(self._slices())

    def within(self, start: int, end: int) -> np.ndarray:
        """Cells from `start` to before `end`: a view if they are in one part, else a copy."""
        near = [cells for cells in self._slices() if cells[0] < end and cells[-1] >= start]
        return _joined([cells[slice(*np.searchsorted(cells, [start, end]))] for cells in near])

    def _slices(self) -> list[np.ndarray]:
        cells = self._now.numpy("cells")
        return [cells[first : first + count] for first, count in self._parts]


def _joined(slices: list[np.ndarray]) -> np.ndarray:
    return slices[0] if len(slices) == 1 else np.concatenate([np.empty(0, np.int64), *slices])
