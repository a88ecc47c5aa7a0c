# SPDX-License-Identifier: GPL-3.0-or-later
"""Cached results for a whole raster, in memory up to a limit and in the store.

The key of a result is its attribute's name and version, the parameters and the raster's key. A file of another shape or
type, with a block that differs from its checksum or a value that is not finite, is computed again.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from ..errors import TerrainError
from ..field import derived_arrays, store
from ..field.heightfield import HeightField, HeightRaster
from ..field.lattice import Lattice
from ..field.store_arrays import all_finite, verify_array
from ..run import owned_files
from ..run.locks import caching
from ..run.owned_files import NotOursError

# Bytes of results in memory, including their pyramids; the last result stays whatever its size.
MAX_BYTES = 1 << 28

_results: OrderedDict[str, HeightRaster] = OrderedDict()


def whole(
    name: str, version: int, parameters: tuple, field: HeightField, lattice: Lattice, make: Callable[[], np.ndarray]
) -> HeightRaster:
    """Return the result of the attribute `name`, float32 [lattice.height, lattice.width], as a raster.

    `make` returns finite values and is called if none are cached. Other results may be evicted from memory for it.
    version: the attribute's. parameters: everything else that the result depends on except the raster. lattice: of the
    result, which may be coarser than the field's.
    """
    file = result_file(name, version, parameters)
    key = f"{field.raster.digest}-{file}"
    with caching:  # threads that need the same result wait for it
        if key in _results:
            _results.move_to_end(key)
            return _results[key]
        samples = read_stored(field, file, (lattice.height, lattice.width))
        if samples is None:
            samples = write_result(field, file, make())
        _results[key] = HeightRaster(samples, lattice, key)
        # The pyramid of a result is a third of it.
        while len(_results) > 1 and sum(int(r.samples.nbytes * 4 // 3) for r in _results.values()) > MAX_BYTES:
            _results.popitem(last=False)
        return _results[key]


def result_file(name: str, version: int, parameters: tuple) -> str:
    """Return the name, without its suffix, of the file in a store that caches a result for the whole raster.

    version: the attribute's version. parameters: everything else that the result depends on except the raster.
    """
    digest = hashlib.blake2b(repr((version, parameters)).encode(), digest_size=8).hexdigest()
    return f"effect_{name}_{digest}"


def forget_results() -> None:
    """Clear the results in memory, for tests and benchmarks."""
    with caching:
        _results.clear()


def read_stored(field: HeightField, file: str, shape: tuple[int, int]) -> np.ndarray | None:
    """Return the float32 result `file` of this shape from the field's store; None if missing, damaged or not finite."""
    folder = store.data_folder(field.raster)
    if folder is None:
        return None
    try:
        verify_array(folder / f"{file}.npy", shape, np.float32)
    except (OSError, TerrainError):
        return None
    loaded = derived_arrays.load(field.raster, {file: (shape, np.float32)})
    return loaded[file] if loaded is not None and all_finite(loaded[file]) else None


def write_result(field: HeightField, file: str, values: np.ndarray) -> np.ndarray:
    """Write a float32 result into the field's store, in place of an older one, and return it mapped from there.

    file: name without its suffix. values: the result. Without a store, or if it cannot be written, a copy in memory is
    returned.
    """
    shapes = {file: (values.shape, np.float32)}

    def fill(arrays: dict[str, np.ndarray]) -> None:
        """Copy the values into the file's array."""
        np.copyto(arrays[file], values)

    # No older result is valid, so that it is replaced.
    return derived_arrays.derive_cached(field.raster, shapes, fill, is_valid=lambda _arrays: False)[file]


def remove_old(field: HeightField, pattern: str, newest: str, max_files: int) -> None:
    """Remove the oldest results that match a pattern from the field's store, so that `max_files` remain.

    newest: name, without its suffix, of one that stays.
    """
    folder = store.data_folder(field.raster)
    if folder is None or field.path is None or not owned_files.is_real_folder(field.path):
        return  # never removes files through a link
    with suppress(OSError, NotOursError):  # another process may do the same
        others = [f for f in folder.glob(pattern) if f.stem != newest]
        for old in sorted(others, key=lambda f: f.stat().st_mtime_ns)[: max(0, len(others) + 1 - max_files)]:
            owned_files.remove_file(old)
