# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays that live as long as a terrain and only ever grow, so that a warm frame allocates nothing.

Results are lent: their arrays are read-only, and while one of them is in use its memory is not written again.
"""

import weakref
from collections.abc import Container

import numpy as np
import warp as wp

_NUMPY = {
    wp.vec2i: (np.int32, 2),
    wp.vec3i: (np.int32, 3),
    wp.vec4i: (np.int32, 4),
    wp.vec2f: (np.float32, 2),
    wp.vec3f: (np.float32, 3),
    wp.vec3d: (np.float64, 3),
}


def shared(array: np.ndarray, dtype) -> wp.array:
    """A Warp array over the memory of a numpy array of the same layout."""
    return wp.array(array, dtype=dtype, device="cpu", copy=False)


def flat(array: np.ndarray, dtype) -> wp.array:
    """The same, of one dimension: in C order."""
    return shared(array.reshape(-1), dtype)


def bind(struct, **values) -> None:
    """Set the fields of a Warp struct that are not so already: setting an array costs as much as a launch."""
    for name, value in values.items():
        held = getattr(struct, name)
        if held is not value and not (isinstance(value, int) and held == value):
            setattr(struct, name, value)


def _scalar(dtype):
    """The numpy dtype of a Warp scalar or struct."""
    return dtype.numpy_dtype() if hasattr(dtype, "numpy_dtype") else wp.dtype_to_numpy(dtype)


class Buffers:
    """Named Warp arrays over uninitialised memory, which the system commits as it is touched."""

    def __init__(self):
        self._arrays: dict[str, tuple[np.ndarray, wp.array]] = {}
        # Memory, and the arrays that were lent of it: of buffers, and of what were buffers.
        self._lent: list[tuple[np.ndarray, weakref.ref[np.ndarray]]] = []

    def get(self, name: str, count: int, dtype) -> wp.array:
        """At least `count` items of a Warp dtype; the contents are kept only if it did not have to grow."""
        held = self._arrays.get(name)
        if held is None or len(held[0]) < count:
            scalar, columns = _NUMPY.get(dtype) or (_scalar(dtype), 1)
            room = count if held is None else max(count, int(1.25 * len(held[0])))
            array = np.empty((room, columns) if columns > 1 else room, scalar)
            self._arrays[name] = held = (array, shared(array, dtype))
        return held[1]

    def extend(self, name: str, count: int) -> np.ndarray:
        """The memory of a buffer with room for at least `count` items; the contents are kept."""
        array, shared_array = self._arrays[name]
        if len(array) < count:
            larger = np.empty((int(1.25 * count), *array.shape[1:]), array.dtype)
            larger[: len(array)] = array
            self._arrays[name] = (larger, shared(larger, shared_array.dtype))
        return self.numpy(name)

    def swap(self, a: str, b: str) -> None:
        """What was called one is called the other; a name that nothing has yet stays free."""
        held = {a: self._arrays.pop(b, None), b: self._arrays.pop(a, None)}
        self._arrays |= {name: array for name, array in held.items() if array is not None}

    def numpy(self, name: str) -> np.ndarray:
        """The memory of a buffer that `get` has made."""
        return self._arrays[name][0]

    def lend(self, name: str, count: int) -> np.ndarray:
        """Return the first `count` items of a buffer, read-only."""
        memory = self.numpy(name)
        # Over a memoryview numpy cannot make it writable, and views of it refer to it rather than to the memory.
        lent = np.asarray(memoryview(memory[:count]).toreadonly())
        self._lent.append((memory, weakref.ref(lent)))
        return lent

    def reclaim(self, keep: Container[str]) -> None:
        """Replace the memory of every buffer of which a lent array is in use; those named in `keep` are copied."""
        in_use = {id(memory): memory for memory, lent in self._lent if lent() is not None}
        returned = {id(memory): memory for memory, _ in self._lent if id(memory) not in in_use}
        current = {id(memory) for memory, _ in self._arrays.values()}
        spare = [memory for memory in returned.values() if id(memory) not in current]
        for name, (memory, shared_array) in self._arrays.items():
            if id(memory) in in_use:
                fresh = _taken_from(spare, memory)
                if name in keep:
                    np.copyto(fresh[: len(memory)], memory)
                self._arrays[name] = fresh, shared(fresh, shared_array.dtype)
        self._lent = [(memory, lent) for memory, lent in self._lent if id(memory) in in_use]

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays, touched or not, with what is lent of earlier ones."""
        memory = [array for array, _ in self._arrays.values()] + [array for array, _ in self._lent]
        return sum(int(array.nbytes) for array in {id(array): array for array in memory}.values())


def _taken_from(spare: list[np.ndarray], memory: np.ndarray) -> np.ndarray:
    """Take an array like `memory`, or one that is up to a half longer, out of the spare ones, or make one."""
    for k, array in enumerate(spare):
        alike = array.dtype == memory.dtype and array.shape[1:] == memory.shape[1:]
        if alike and len(memory) <= len(array) <= 1.5 * len(memory):
            return spare.pop(k)
    return np.empty_like(memory)
