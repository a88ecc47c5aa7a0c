# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays that live as long as a terrain and only ever grow, so that a warm frame allocates nothing.

Results are lent (`Loans`): their arrays are read-only, and their memory is not written while one of them is in use.
"""

import weakref
from collections.abc import Container, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import warp as wp

MAX_ITEMS = 2**31 - 1  # Warp's shapes and indices are int32


def shared(array: np.ndarray, dtype: Any) -> "wp.array":
    """Return a Warp array over the memory of a numpy array of the same layout.

    dtype: of Warp, as wp.vec3f for [n, 3]. The length that Warp sees is MAX_ITEMS at most: kernels read longer arrays
    without it (kernels/unchecked.py).
    """
    from ...kernels import wp

    if len(array) > MAX_ITEMS:
        array = array[:MAX_ITEMS]
    return wp.array(array, dtype=dtype, device="cpu", copy=False)


def flat(array: np.ndarray, dtype: Any) -> "wp.array":
    """Return a one-dimensional Warp array over the memory of a numpy array, in C order, without a copy.

    A Warp array ends at MAX_ITEMS; kernels reach the items of a larger one by `item_at` and `put` alone.
    """
    return shared(array.reshape(-1)[:MAX_ITEMS], dtype)


def bind(struct: Any, **values: Any) -> None:
    """Set the fields of a Warp struct that differ from `values`, because setting an array costs as much as a launch.

    Arrays and structs differ if they are other objects, integers if their values do; floats are set unless the object
    is the same.
    """
    for name, value in values.items():
        held = getattr(struct, name)
        if held is not value and not (isinstance(value, int) and held == value):
            setattr(struct, name, value)


def _layout_of(dtype: Any) -> tuple[Any, int]:
    """Return the numpy dtype of a Warp scalar or struct, or of a vector's elements, and the number of columns."""
    from ...kernels import wp

    vectors = {
        wp.vec2i: (np.int32, 2),
        wp.vec3i: (np.int32, 3),
        wp.vec4i: (np.int32, 4),
        wp.vec2f: (np.float32, 2),
        wp.vec3f: (np.float32, 3),
        wp.vec4f: (np.float32, 4),
        wp.vec3d: (np.float64, 3),
    }
    if dtype in vectors:
        return vectors[dtype]
    return (dtype.numpy_dtype() if hasattr(dtype, "numpy_dtype") else wp.dtype_to_numpy(dtype)), 1


class Loans:
    """Memory that callers may still read: their arrays are read-only, and it is not written while one is in use."""

    def __init__(self) -> None:
        self._lent: list[tuple[np.ndarray, weakref.ref[np.ndarray]]] = []  # memory, and a lent array over it

    def lend(self, memory: np.ndarray, count: int) -> np.ndarray:
        """Return the first `count` items of some memory, read-only."""
        # An array over a read-only memoryview cannot be made writable, and all views of it keep it alive, so that the
        # weak reference tells whether any of them is in use.
        lent = np.asarray(memory[:count].data.toreadonly())
        self._lent.append((memory, weakref.ref(lent)))
        return lent

    def reclaim(
        self, written: "Iterable[Buffers]", copied: "Iterable[Buffers]", read: "Iterable[Buffers]" = ()
    ) -> None:
        """Give buffers that will be written other memory where a caller still uses a lent array over their memory.

        written: buffers whose contents are lost then. copied: buffers whose contents are copied into the other memory.
        read: buffers that will not be written; they keep their memory. Memory of arrays that callers have released is
        used again.
        """
        in_use = {id(memory): memory for memory, lent_ref in self._lent if lent_ref() is not None}
        returned = {id(memory): memory for memory, _ in self._lent if id(memory) not in in_use}
        self._lent = [(memory, lent_ref) for memory, lent_ref in self._lent if id(memory) in in_use]
        written, copied = list(written), list(copied)
        held = {id(memory) for buffers in (*written, *copied, *read) for memory in buffers.memory()}
        # Memory that callers have released and that none of these buffers uses.
        spare = [memory for memory in returned.values() if id(memory) not in held]
        for buffers in (*written, *copied):
            buffers.replace(in_use, spare, copy=buffers in copied)

    def memory(self) -> list[np.ndarray]:
        """Return the arrays of which a part was lent, so that callers can count their bytes."""
        return [memory for memory, _ in self._lent]


class Buffers:
    """Named Warp arrays over uninitialised memory, which the system commits as it is touched.

    `launches` are recorded with structs that are bound to these arrays: see `launch.slices`.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, tuple[np.ndarray, wp.array]] = {}  # memory, and the Warp array over it
        self._structs: dict = {}  # by kind and slot
        self.launches: dict = {}

    def get(self, name: str, count: int, dtype: Any) -> "wp.array":
        """Return an array of at least `count` items of a Warp dtype; the contents are kept only if it need not grow.

        dtype: the same at every call with a name. A larger array gets a quarter more than the last one had, so that
        slowly growing meshes rarely allocate.
        """
        existing = self._arrays.get(name)
        if existing is None or len(existing[0]) < count:
            scalar, columns = _layout_of(dtype)
            capacity = count if existing is None else max(count, int(1.25 * len(existing[0])))
            array = np.empty((capacity, columns) if columns > 1 else capacity, scalar)
            self._arrays[name] = existing = (array, shared(array, dtype))
        return existing[1]

    def struct(self, kind: Any, slot: int = 0) -> Any:
        """Return the Warp struct of one kind: always the same object, so that `bind` sets only changes.

        slot: tells structs of one kind apart, for example those of several slices.
        """
        if (kind, slot) not in self._structs:
            self._structs[kind, slot] = kind()
        return self._structs[kind, slot]

    def table(self, name: str, values: np.ndarray, dtype: Any) -> "wp.array":
        """Return the buffer `name` with `values` at its beginning. It may be longer, because buffers only grow."""
        table = self.get(name, values.size, dtype)
        self.numpy(name)[: values.size] = values.reshape(-1)
        return table

    def extend(self, name: str, count: int) -> np.ndarray:
        """Return the memory of a buffer with room for at least `count` items; the contents are kept.

        If it grows, an array that `get` returned before shares the old memory.
        """
        array, shared_array = self._arrays[name]
        if len(array) < count:
            larger = np.empty((int(1.25 * count), *array.shape[1:]), array.dtype)
            larger[: len(array)] = array
            self._arrays[name] = (larger, shared(larger, shared_array.dtype))
        return self.numpy(name)

    def exchange(self, other: "Buffers", names: Iterable[str]) -> None:
        """Exchange the arrays of these names with other buffers, which may lack some of them."""
        for name in names:
            pair = other._arrays.pop(name, None), self._arrays.pop(name, None)
            for buffers, held in zip((self, other), pair, strict=True):
                if held is not None:
                    buffers._arrays[name] = held

    def numpy(self, name: str) -> np.ndarray:
        """Return the memory of a buffer that `get` has made, as numpy array. It may be longer than was requested."""
        return self._arrays[name][0]

    def memory(self) -> list[np.ndarray]:
        """Return the memory of all buffers, so that callers can count its bytes."""
        return [array for array, _ in self._arrays.values()]

    @property
    def nbytes(self) -> int:
        """Return the bytes of all arrays, touched or not."""
        return address_space(self.memory())

    def replace(self, in_use: Container[int], spare: list[np.ndarray], copy: bool) -> None:
        """Take other memory in place of memory with an id `in_use`; `copy`: with its contents.

        spare: unused memory, which is taken first and removed from the list.
        """
        for name, (memory, shared_array) in self._arrays.items():
            if id(memory) in in_use:
                fresh = _find_spare(spare, memory)
                if copy:
                    np.copyto(fresh[: len(memory)], memory)
                self._arrays[name] = fresh, shared(fresh, shared_array.dtype)


def address_space(memory: Iterable[np.ndarray]) -> int:
    """Return the bytes of some memory, touched or not; arrays that occur twice count once."""
    return sum(int(array.nbytes) for array in {id(array): array for array in memory}.values())


def _find_spare(spare: list[np.ndarray], memory: np.ndarray) -> np.ndarray:
    """Remove an array like `memory`, at most a half longer, from the spare ones and return it, or return a new one."""
    for k, array in enumerate(spare):
        alike = array.dtype == memory.dtype and array.shape[1:] == memory.shape[1:]
        if alike and len(memory) <= len(array) <= 1.5 * len(memory):
            return spare.pop(k)
    return np.empty_like(memory)
