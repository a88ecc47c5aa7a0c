# SPDX-License-Identifier: GPL-3.0-or-later
"""Values of attributes for a surface and for the last one, in two sets of arrays that alternate.

An array is stored under the name of its attribute; the points are one of them, and so are their levels. Points that
both surfaces have are found as runs of consecutive ones: values there are copied.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from weakref import ref

import numpy as np
import warp as wp

from ...kernels.effects import keep as kernels
from ..mesh.attributes import Attribute
from ..mesh.surface import Surface
from ..run import launch
from ..run.buffers import flat, shared

PLACES = "places"  # name of the points' array, float32 [V, 3], among those of attributes and levels
MAX_FRESH = 0.75  # fraction of points to compute above which computing all is faster


@dataclass(frozen=True)
class ValueSource:
    """The origin of values, by which they are reused."""

    surface: "ref[Surface] | Callable[[], None]" = lambda: None
    request: tuple = ()  # EffectRequest.key
    keys: dict[str, tuple] = field(default_factory=dict)  # of each step
    attributes: dict[str, Attribute] = field(default_factory=dict)  # the result


class EffectValues:
    """Points of this surface and of the last one, their common points, and the values of attributes there.

    A frame history owns it.
    """

    def __init__(self, threads: int) -> None:
        """Start without points; `threads` copy and compare them."""
        self.threads = threads
        self.source = ValueSource()  # of the values
        self._arrays: dict[str, tuple[np.ndarray, np.ndarray | None]] = {}  # of this surface, of the last one
        self._count = self._last_count = 0  # points of this surface and of the last one
        self._zeros: dict[int, np.ndarray] = {}  # for `zeros`, by width
        # Runs of points of both surfaces: first point in this one, first in the last one, count.
        self._runs = np.empty((0, 3), np.int32)

    @property
    def nbytes(self) -> int:
        """Return the bytes of all arrays."""
        return sum(array.nbytes for pair in self._arrays.values() for array in pair if array is not None)

    def move_to(self, positions: np.ndarray) -> np.ndarray:
        """Start another surface with these points, float32 [V, 3]; the present one becomes the last one.

        Return a copy of the points, which is valid until the second next call.
        """
        self._last_count, self._count = self._count, len(positions)
        copied, last = self.swap_arrays(PLACES, 3)
        launch.together([partial(np.copyto, copied[a:b], positions[a:b]) for a, b in self._point_ranges()])
        self._runs = np.empty((0, 3), np.int32) if last is None else _match_runs(copied, last)
        return copied

    def swap_arrays(self, name: str, width: int = 1) -> tuple[np.ndarray, np.ndarray | None]:
        """Return an uninitialized array for this surface, float32 [V] or [V, width], and the last one's, or None.

        Call it once a surface for each name. The new array has the memory of the surface before the last, if it is
        large enough.
        """
        last, spare = self._arrays.get(name, (None, None))  # those of this surface and the last before the swap
        if spare is None or len(spare) < self._count:
            room = int(1.25 * self._count)  # so that small growth of the mesh allocates nothing
            spare = np.empty((room, width) if width > 1 else room, np.float32)
        self._arrays[name] = spare, last
        return spare[: self._count], None if last is None else last[: self._last_count]

    def put(self, name: str, values: np.ndarray, drop_last: bool = False) -> None:
        """Store the complete array of an attribute on this surface.

        The array that `name` had before belongs to the last surface. It is kept beside the new one, so that values can
        be reused. drop_last: do not keep it.
        """
        self._arrays[name] = values, None if drop_last else self._arrays.get(name, (None, None))[0]

    def reuse(self, widths: Mapping[str, int]) -> dict[str, np.ndarray]:
        """Return new arrays by name, float32 [V] or [V, width], with the values of points that the last surface has.

        Values of other points are uninitialized. widths: numbers for each point, by name of the attribute.
        """
        swapped = {name: self.swap_arrays(name, width) for name, width in widths.items()}
        pairs = [_pair(values, last, widths[name]) for name, (values, last) in swapped.items() if last is not None]
        if len(self._runs) and pairs:
            arrays = [shared(self._runs, wp.vec3i), len(self._runs)]
            arrays.append(wp.array(pairs, dtype=kernels.Pair, device=launch.DEVICE))
            launch.slices(kernels.copy_runs, [[a, b, *arrays] for a, b in self._point_ranges()], step="kept")
        return {name: values for name, (values, _) in swapped.items()}

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

    def forget(self, names: set[str]) -> None:
        """Drop these arrays of both surfaces."""
        self._arrays = {name: pair for name, pair in self._arrays.items() if name not in names}

    def forget_others(self, names: set[str]) -> None:
        """Drop all arrays except the points and these."""
        self._arrays = {name: pair for name, pair in self._arrays.items() if name in names or name == PLACES}

    def _point_ranges(self) -> list[tuple[int, int]]:
        """Return ranges of points, one for each thread that is worth its start."""
        pieces = max(1, min(self.threads, self._count // launch.SLICE_ITEMS))
        return launch.ranges(self._count, pieces)


def _pair(values: np.ndarray, last: np.ndarray, width: int) -> kernels.Pair:
    """Return the arrays of an attribute on this and the last surface, for the kernel that copies values.

    values: of this surface. width: numbers for each point.
    """
    pair = kernels.Pair()
    pair.last, pair.values, pair.width = flat(last, wp.float32), flat(values, wp.float32), width
    return pair


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
