# SPDX-License-Identifier: GPL-3.0-or-later
"""Cached candidates of a scatter on the ground, which later frames find by their squares."""

import numpy as np
import warp as wp

from ...kernels.scatter import points as kernels
from ..run.buffers import flat, shared

SPARE = 2.0  # capacity over the number of candidates


class Candidates:
    """Runs of candidates in a few long arrays, found by int64 keys.

    `positions`, `normals`: float32 [capacity, 3]; `density`: float32 [capacity]. Runs are listed by ascending key, with
    their first candidate and count; `_used` candidates are in the arrays, those of replaced runs included.
    """

    def __init__(self) -> None:
        """Start with no candidates and memory for none."""
        self._used = 0  # candidates in the arrays, those of replaced runs included
        self._keys = np.empty(0, np.int64)  # ascending
        self._first = np.empty(0, np.int64)  # first candidate of each run
        self._count = np.empty(0, np.int64)  # candidates of each run
        self._allocate(0)

    @property
    def nbytes(self) -> int:
        """Return the bytes of all arrays."""
        return self.positions.nbytes + self.normals.nbytes + self.density.nbytes

    def packed(self) -> kernels.CandidateArrays:
        """Return the arrays for kernels, which share the memory."""
        arrays = kernels.CandidateArrays()
        arrays.positions, arrays.normals = shared(self.positions, wp.vec3f), shared(self.normals, wp.vec3f)
        arrays.density = flat(self.density, wp.float32)
        return arrays

    def find(self, keys: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the first candidate of each key's run, int64 [n], and whether the run has `count` or more, bool [n].

        Where it has not, the first is arbitrary. keys, count: int64 [n].
        """
        if not len(self._keys):
            return np.zeros(len(keys), np.int64), np.zeros(len(keys), bool)
        run = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        return self._first[run], (self._keys[run] == keys) & (self._count[run] >= count)

    def reserve(self, count: int, keys: np.ndarray) -> int:
        """Reserve `count` candidates and return the index of the first; `add` has to follow once they are written.

        If the arrays are full, they grow and only the runs of the given `keys`, which have to be there, are copied;
        other runs are computed again.
        """
        if self._used + count > len(self.density):
            runs = np.searchsorted(self._keys, np.sort(keys))
            counts, old_arrays = self._count[runs], (self.positions, self.normals, self.density)
            ends = np.cumsum(counts)
            used = int(ends[-1]) if len(ends) else 0
            old_indices = np.arange(used) + np.repeat(self._first[runs] - (ends - counts), counts)
            self._allocate(int(SPARE * (used + count)))
            for array, old in zip((self.positions, self.normals, self.density), old_arrays, strict=True):
                array[:used] = old[old_indices]
            self._keys, self._first, self._count, self._used = self._keys[runs], ends - counts, counts, used
        return self._used

    def add(self, keys: np.ndarray, count: np.ndarray) -> None:
        """Add reserved and written runs of candidates; they replace those of the same keys.

        keys: of the runs, int64 [n]. count: candidates of each run, int64 [n].
        """
        firsts = self._used + np.cumsum(count) - count
        is_other = ~np.isin(self._keys, keys)
        added = (self._keys, keys), (self._first, firsts), (self._count, count)
        merged = [np.concatenate([old[is_other], new]) for old, new in added]
        order = np.argsort(merged[0])
        self._keys, self._first, self._count = (array[order] for array in merged)
        self._used += int(count.sum())

    def _allocate(self, capacity: int) -> None:
        """Make room for `capacity` candidates."""
        self.positions, self.normals = np.empty((capacity, 3), np.float32), np.empty((capacity, 3), np.float32)
        self.density = np.empty(capacity, np.float32)
