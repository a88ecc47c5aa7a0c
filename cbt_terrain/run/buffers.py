# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays that live as long as a terrain and only ever grow, so that a warm frame allocates nothing."""

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

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays, touched or not."""
        return sum(array.nbytes for array, _ in self._arrays.values())
