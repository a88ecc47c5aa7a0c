# SPDX-License-Identifier: GPL-3.0-or-later
"""Results over a whole raster, which are made once: kept in memory up to a limit, and in the store where there is one.

The content decides: a result is found by its effect, that effect's version, the parameters and the raster's key. A file
is a guess until it is read: one of another shape or type, with a block that differs from its checksum or a value that
is not finite, is made again.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable

import numpy as np

from ..errors import TerrainError
from ..field import store
from ..field.heightfield import HeightField, as_heights
from ..field.lattice import Lattice
from ..field.store_arrays import verify_array
from ..run.locks import caching

# Bytes that results may hold in memory, the pyramids over them included; the last one stays whatever it holds.
MOST_BYTES = 1 << 28

_kept: OrderedDict[str, HeightField] = OrderedDict()


def whole(
    name: str, version: int, parameters: tuple, field: HeightField, lattice: Lattice, make: Callable[[], np.ndarray]
) -> HeightField:
    """A result of the effect `name`: finite float32 [lattice.height, lattice.width], as the samples of a field.

    `make` makes it, when nothing has kept it. Other results may leave the memory for it.
    """
    file = file_of(name, version, parameters)
    key = f"{field.raster_key}-{file}"
    with caching:  # whoever wants the same waits for it
        if key in _kept:
            _kept.move_to_end(key)
            return _kept[key]
        samples = read_kept(field, file, (lattice.height, lattice.width))
        if samples is None:
            samples = make()
            store.keep(field, file, samples)
        _kept[key] = as_heights(field, samples, key, lattice)
        while len(_kept) > 1 and sum(int(_nbytes(values)) for values in _kept.values()) > MOST_BYTES:
            _kept.popitem(last=False)
        return _kept[key]


def file_of(name: str, version: int, parameters: tuple) -> str:
    """What the file of a result is called in a store, without its suffix."""
    mark = hashlib.blake2b(repr((version, parameters)).encode(), digest_size=8).hexdigest()
    return f"effect_{name}_{mark}"


def forget() -> None:
    """Let go of what is in memory."""
    with caching:
        _kept.clear()


def _nbytes(result: HeightField) -> int:
    return result.samples.nbytes * 4 // 3


def read_kept(field: HeightField, file: str, shape: tuple[int, int]) -> np.ndarray | None:
    """What the store has kept, in memory, if all of it is what was written."""
    folder = store.data_folder(field)
    if folder is None:
        return None
    try:
        verify_array(folder / f"{file}.npy", shape, np.float32)
    except (OSError, TerrainError):
        return None
    samples = store.load_kept(field, file, shape, np.float32)
    return samples if samples is not None and np.isfinite(samples).all() else None
