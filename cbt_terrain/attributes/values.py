# SPDX-License-Identifier: GPL-3.0-or-later
"""Values of attributes for a surface, which those of the last one become.

An array is stored under the name of its attribute. Points that both surfaces have are found as runs of consecutive
ones: values there move to their new places in the same array.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from weakref import ref

import numpy as np
import warp as wp

from ...kernels.effects import keep as kernels
from ..mesh.attributes import Attribute
from ..mesh.surface import Surface
from ..run import launch
from ..run.buffers import flat, shared

MAX_FRESH = 0.75  # fraction of points to compute above which computing all is faster


@dataclass(frozen=True)
class ValueSource:
    """The origin of values, by which they are reused."""

    surface: "ref[Surface] | Callable[[], None]" = lambda: None
    request: tuple = ()  # EffectRequest.key
    keys: dict[str, tuple] = field(default_factory=dict)  # of each step
    attributes: dict[str, Attribute] = field(default_factory=dict)  # the result


class EffectValues:
    """Points of a surface, those that it has in common with the last one, and the values of attributes there.

    A frame history owns it.
    """

    def __init__(self, threads: int) -> None:
        """Start without points; `threads` copy values."""
        self.threads = threads
        self.source = ValueSource()  # of the values
        self._positions = np.empty((0, 3), np.float32)  # points of this surface
        self._arrays: dict[str, np.ndarray] = {}  # values of attributes, maybe with room for more points
        # Levels of the points of this surface and of the last one, by family; maybe with room for more points.
        self._levels: dict[str, tuple[np.ndarray, np.ndarray | None]] = {}
        self._count = self._last_count = 0  # points of this surface and of the last one
        self._zeros: dict[int, np.ndarray] = {}  # for `zeros`, by width
        # Runs of points of both surfaces: first point in this one, first in the last one, count.
        self._runs = np.empty((0, 3), np.int32)

    @property
    def nbytes(self) -> int:
        """Return the bytes of all values and levels."""
        levels = [array for pair in self._levels.values() for array in pair if array is not None]
        return sum(array.nbytes for array in [*self._arrays.values(), *levels])

    def move_to(self, positions: np.ndarray) -> None:
        """Start another surface with these points, float32 [V, 3]; the present one becomes the last one.

        They are compared with those of the next surface, so an array that may be written is copied.
        """
        last, self._last_count, self._count = self._positions, self._count, len(positions)
        self._positions = positions.copy() if positions.flags.writeable else positions
        self._runs = _match_runs(self._positions, last)

    def swap_levels(self, family: str) -> tuple[np.ndarray, np.ndarray | None]:
        """Return an uninitialized array for the points' levels, float32 [V], and that of the last surface or None.

        Call it once a surface for each family. The new array has the memory of the surface before the last, if it is
        large enough.
        """
        last, spare = self._levels.get(family, (None, None))  # those of this surface and the last before the swap
        spare = spare if spare is not None and len(spare) >= self._count else self._with_room(1)
        self._levels[family] = spare, last
        return spare[: self._count], None if last is None else last[: self._last_count]

    def put(self, name: str, values: np.ndarray) -> None:
        """Store the complete array of an attribute on this surface, in place of the last surface's."""
        self._arrays[name] = np.require(values, np.float32, ["C", "W"])  # `reuse` writes into it

    def reuse(self, widths: Mapping[str, int]) -> dict[str, np.ndarray]:
        """Return arrays by name, float32 [V] or [V, width], with the values of points that the last surface has.

        Values of other points are undefined. The arrays are those of the last surface, except where they are too small
        or points changed their order. widths: numbers for each point, by name of the attribute.
        """
        ends = self._runs[:, 1] + self._runs[:, 2]  # of each run in the last surface
        keeps_order = (self._runs[1:, 1] >= ends[:-1]).all()
        last = {name: self._arrays[name] for name in widths}
        for name, width in widths.items():
            if not keeps_order or len(last[name]) < self._count:
                self._arrays[name] = self._with_room(width)
        if len(self._runs) and widths:
            rows = [(last[name].ctypes.data, self._arrays[name].ctypes.data, width) for name, width in widths.items()]
            inputs = [shared(self._runs, wp.vec3i), len(self._runs), shared(np.array(rows, np.int64), wp.int64)]
            cost = 0.1 * self._count
            launch.spread(kernels.move_runs, len(rows), inputs, step="kept", threads=self.threads, cost=cost)
        return {name: self._arrays[name][: self._count] for name in widths}

    def _with_room(self, width: int) -> np.ndarray:
        """Return an uninitialized array for the values of this surface, with room for some more points."""
        room = int(1.25 * self._count)
        return np.empty((room, width) if width > 1 else room, np.float32)

    def zeros(self, width: int) -> np.ndarray:
        """Return zeros, float32 [V, width], for reading only; unwritten pages take no memory."""
        held = self._zeros.get(width)
        if held is None or len(held) < self._count:
            self._zeros[width] = held = np.zeros((int(1.25 * self._count), width), np.float32)
        return held[: self._count]

    def find_fresh(self, levels: np.ndarray, last: np.ndarray | None) -> np.ndarray | None:
        """Return the indices of the points that the last surface lacks or has at another level, int32 [n].

        None stands for all points: if more than MAX_FRESH of them are fresh, when computing all is faster, or if both
        surfaces have no common point. levels, last: pyramid levels of the points of this surface and of the last one,
        float32 [points]; `last` may be None.
        """
        if last is None or not len(self._runs):
            return None
        fresh, num_fresh = np.empty(self._count, np.int32), np.zeros(1, np.int32)
        runs = shared(self._runs, wp.vec3i), len(self._runs)
        arrays = [flat(array, wp.float32) for array in (levels, last)]
        inputs = [self._count, *runs, *arrays, flat(fresh, wp.int32), flat(num_fresh, wp.int32)]
        launch.once(kernels.list_fresh, inputs, step="kept")
        return fresh[: num_fresh[0]] if num_fresh[0] <= MAX_FRESH * self._count else None

    def new_points(self) -> np.ndarray:
        """Return the indices of the points that the last surface lacks, int32 [n]; others keep their values."""
        # Of the runs (first, first in the last surface, count): + 1 where one begins, - 1 after its end.
        change = np.zeros(self._count + 1, np.int8)
        change[self._runs[:, 0]] += 1
        np.subtract.at(change, self._runs[:, 0] + self._runs[:, 2], 1)
        return np.flatnonzero(np.cumsum(change[:-1], dtype=np.int8) == 0).astype(np.int32)

    def forget_others(self, names: set[str], families: set[str]) -> None:
        """Drop all values except those of attributes with these names, and the levels of all other families."""
        self._arrays = {name: array for name, array in self._arrays.items() if name in names}
        self._levels = {family: pair for family, pair in self._levels.items() if family in families}


def _match_runs(positions: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the runs of consecutive points that two surfaces share, in the same order there, int32 [n, 3].

    Columns: first point in `positions`, first point in `last`, count. positions, last: float32 [V, 3].
    """
    if not len(positions) or not len(last):
        return np.empty((0, 3), np.int32)
    runs = np.empty((len(positions), 3), np.int32)
    found = np.zeros(2, np.int32)  # number of runs, and the first point that is not yet searched
    points = [shared(positions, wp.vec3f), len(positions), shared(last, wp.vec3f), len(last)]
    outputs = [shared(runs, wp.vec3i), flat(found, wp.int32)]
    # Most points follow each other as on the last surface. If that search stops early, find the others by a hash table.
    launch.once(kernels.match_in_order, [*points, *outputs], step="kept")
    if found[1] < len(positions):
        bits = len(last).bit_length() + 1  # few points share a hash
        table = np.full(1 << bits, -1, np.int32)
        launch.once(kernels.match_anywhere, [*points, bits, flat(table, wp.int32), *outputs], step="kept")
    return runs[: found[0]].copy()
