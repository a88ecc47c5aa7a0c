# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays that are computed from a raster and cached in its store, where they are mapped like the store's own arrays.

An array is written through a mapping of its file, so it takes no memory of the process, whatever its size. Files appear
when all arrays that belong together are complete. They are in the folder of arrays that store.json names, and go with
it. Without a store, or if that cannot be written, the arrays are in memory.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import ExitStack

import numpy as np
from numpy.typing import DTypeLike

from ..errors import TerrainError
from ..run import partial_files
from ..run.owned_files import NotOursError
from . import store, store_arrays
from .blocks import level_shapes
from .heightfield import HeightRaster
from .lattice import MAX_MESHLET, Lattice

Arrays = dict[str, np.ndarray]
# Samples of a large raster; derived arrays of fewer take some milliseconds.
MIN_CACHED = 1 << 20
# Bytes of a large scratch array; smaller files save little memory and take up to a third of the time of *flow*.
MIN_SCRATCH = 20_000_000
# Shape and dtype of each array.
Shapes = Mapping[str, tuple[tuple[int, ...], DTypeLike]]


def derive_cached(
    raster: HeightRaster,
    shapes: Shapes,
    fill: Callable[[Arrays], None],
    is_valid: Callable[[Arrays], bool] | None = None,
) -> Arrays:
    """Return arrays by name from the raster's store; compute and cache all of them if one is missing or damaged.

    shapes: (shape, dtype) of each array by name. fill(arrays): fills zeroed arrays by name, and keeps no reference to
    them; it is called again, for arrays in memory, if the store cannot be written. is_valid: further test of cached
    arrays; False computes them again.
    """
    arrays = load(raster, shapes)
    if arrays is None or not (is_valid is None or is_valid(arrays)):
        arrays = load(raster, shapes) if _fill_in_store(raster, shapes, fill) else None
    return _fill_in_memory(shapes, fill) if arrays is None else arrays


def derive_cached_if_large(raster: HeightRaster, shapes: Shapes, fill: Callable[[Arrays], None]) -> Arrays:
    """Return arrays by name: of a raster of MIN_CACHED samples or more by `derive_cached`, of others in memory.

    shapes: (shape, dtype) of each array by name. fill(arrays): fills zeroed arrays.
    """
    if raster.samples.size >= MIN_CACHED:
        return derive_cached(raster, shapes, fill)
    return _fill_in_memory(shapes, fill)


def _fill_in_memory(shapes: Shapes, fill: Callable[[Arrays], None]) -> Arrays:
    """Return arrays by name in memory, zeroed and then filled by `fill`. shapes: (shape, dtype) of each."""
    arrays = {name: np.zeros(*spec) for name, spec in shapes.items()}
    fill(arrays)
    return arrays


def scratch_array(raster: HeightRaster, shape: tuple[int, ...], dtype: DTypeLike) -> np.ndarray:
    """Return an array of any content for intermediate results; one of MIN_SCRATCH bytes or more is mapped from a file.

    The system can write its pages to that file when it needs memory. The file is created beside the raster's arrays in
    the store and loses its name before this returns, so nothing remains however the process ends. A forked child shares
    the array's content. Without a store, or if that cannot be written, the array is in memory; so it is on Windows,
    which removes no mapped file.
    """
    is_large = math.prod(shape) * np.dtype(dtype).itemsize >= MIN_SCRATCH
    folder = store.data_folder(raster) if is_large and store_arrays.CAN_REMOVE_MAPPED else None
    if folder is not None:
        try:
            with partial_files.private_folder(folder) as private:
                return store_arrays.allocate_array(private / "scratch.npy", shape, dtype, huge_pages=True)
        except (OSError, NotOursError):
            pass  # a full disk, or a store that may not be written
    return np.empty(shape, dtype)


def load(raster: HeightRaster, shapes: Shapes) -> Arrays | None:
    """Return cached arrays of a raster's store, mapped; None without a store, or if one is missing or damaged.

    shapes: shape and type of each array by name.
    """
    folder = store.data_folder(raster)
    if folder is None:
        return None
    try:
        return {name: store_arrays.map_array(folder / f"{name}.npy", *spec) for name, spec in shapes.items()}
    except (OSError, TerrainError):
        return None


def _fill_in_store(raster: HeightRaster, shapes: Shapes, fill: Callable[[Arrays], None]) -> bool:
    """Compute arrays into files of the raster's store; return False if there is none or it cannot be written.

    Other errors of `fill` than OSError are raised. The files appear only after all are complete. shapes: shape and type
    of each array by name. fill: computes them in place.
    """
    folder = store.data_folder(raster)
    if folder is None:
        return False
    partial_files.remove_abandoned(folder)
    try:
        with ExitStack() as files:
            parts = {name: files.enter_context(partial_files.written_beside(folder / f"{name}.npy")) for name in shapes}
            arrays = {name: store_arrays.allocate_array(parts[name], *spec) for name, spec in shapes.items()}
            fill(arrays)
            for name, array in arrays.items():
                store_arrays.append_checksums(parts[name], array)
            del array
            arrays.clear()  # Windows renames no mapped file
    except OSError:
        return False
    return True


def derived_shapes(lattice: Lattice) -> dict[str, tuple]:
    """Return shape and dtype of each array that a store caches, by name.

    These can be computed again from samples and errors: errors for leaves drawn as 4**m triangles ("_m1" ...), the
    arrays of the bicubic surface ("_c"), and of a large raster the coarser levels of the heights ("pyramid") and the
    highest and lowest samples of blocks of 2^FINEST cells a side and larger ("tops", "bottoms").
    """
    from ...kernels.effects.horizon import FINEST

    plain, cells = lattice.node_count, lattice.node_count - lattice.cell_base
    # The curvatures of the raster's cells follow the errors of a bicubic surface.
    errors = {"error": plain, "error_c": plain + cells}
    arrays: dict[str, tuple] = {
        f"{name}_m{m}": ((n,), np.uint8) for name, n in errors.items() for m in range(1, MAX_MESHLET + 1)
    }
    arrays |= {"error_c": ((plain + cells,), np.uint8), "ranges_c": ((lattice.range_count + cells, 2), np.uint16)}
    levels = level_shapes(-(-lattice.cells_y >> FINEST), -(-lattice.cells_x >> FINEST))
    arrays |= dict.fromkeys(("tops", "bottoms"), ((sum(int(rows * columns) for rows, columns in levels),), np.float32))
    coarser = sum(int(rows * columns) for rows, columns in samples_by_level(lattice)[1:])
    arrays["pyramid"] = (max(coarser, 1),), np.float32
    # NUMBERS of bicubic.py, and the exponents of the error tables of the groups of depths, the cells and curvatures.
    return arrays | {"numbers_c": ((6 + lattice.groups + 2,), np.float64)}


def samples_by_level(lattice: Lattice) -> list[tuple[int, int]]:
    """Return rows and columns of samples of each level of a raster: of all samples, of every other one, and so on."""
    cells = [(lattice.cells_y, lattice.cells_x)]
    while min(cells[-1]) > 1:
        cells.append((-(-cells[-1][0] // 2), -(-cells[-1][1] // 2)))
    return [(rows + 1, columns + 1) for rows, columns in cells]
