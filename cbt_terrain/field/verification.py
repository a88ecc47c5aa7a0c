# SPDX-License-Identifier: GPL-3.0-or-later
"""Verification of all files of a store by their checksums."""

import math
import os
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from ..run import stopping
from . import finer_tiles
from .derived_arrays import derived_shapes, samples_by_level
from .displacement_layers import mask_levels
from .shared_pages import SharedPages, verify_pages
from .store import data_folder, open_store
from .store_arrays import PAGE_BYTES, file_bytes, verify_array
from .store_folder import is_array_file
from .store_layers import layer_name


def verify(path: str | os.PathLike) -> dict[str, int]:
    """Check every block of every array of a store and return the number of blocks by file.

    Raises TerrainError for the first array with a fault.
    """
    field = open_store(path)
    field.raster.check_samples()
    folder = data_folder(field.raster)
    block_counts: dict[str, int] = {}
    if folder is None:
        raise TerrainError(f"{path} was replaced while it was opened", fix="check it again")
    # The store's own arrays have to be there; `derived` ones are checked if they are.
    arrays = {name: getattr(field, name) for name in ("samples", "error", "ranges", "valid")}
    arrays |= {layer_name(name): field.layers[name] for name in field.layers}
    if field.raster.finer is not None:
        names = (f"finer_{name}" for name in finer_tiles.ARRAYS)
        arrays |= dict(zip(names, field.raster.finer.arrays, strict=True))
    for name, array in arrays.items():
        stopping.check()
        if isinstance(array, SharedPages):
            block_counts |= verify_pages(folder, name, array.shape, array.dtype)
        elif array is not None:
            block_counts[f"{name}.npy"] = verify_array(folder / f"{name}.npy", array.shape, array.dtype)
    # By the file's name, shape and dtype that it must have.
    derived = {f"{name}.npy": shape_and_dtype for name, shape_and_dtype in derived_shapes(field.lattice).items()}
    derived |= {f"pyramid_{name}.npy": derived["pyramid.npy"] for name in field.layers}
    finer = field.raster.finer
    if finer is not None:
        derived[f"{finer_tiles.PYRAMID}.npy"] = (finer.pyramid_size(field.lattice),), np.float32
        shapes_of_tiles = finer_tiles.bicubic_shapes(field.lattice, finer.bits, len(finer.heights))
        derived |= {f"{name}.npy": shape_and_dtype for name, shape_and_dtype in shapes_of_tiles.items()}
    shapes = samples_by_level(field.lattice)
    for file in sorted(file for file in folder.glob("effect_*.npy") if is_array_file(file)):
        derived[file.name] = _shape_of(file, shapes), np.float32
    masks = {"masks": field.samples.shape, "mask_maxima": (int(mask_levels(field.lattice)[-1]),)}
    for prefix, shape in masks.items():
        for file in sorted(file for file in folder.glob(f"{prefix}_*.npy") if is_array_file(file)):
            # The file is a header of PAGE_BYTES, the masks and checksums that are shorter than one mask, so its length
            # gives the number of masks.
            num_masks = max(1, (os.lstat(file).st_size - PAGE_BYTES) // math.prod(shape))
            derived[file.name] = (num_masks, *shape), np.uint8
    for name, (shape, dtype) in derived.items():
        if os.path.lexists(folder / name):
            try:
                block_counts[name] = verify_array(folder / name, shape, dtype)
            except TerrainError as error:
                raise TerrainError(error.what, fix="delete the file; it is computed again on demand") from error
    return block_counts


def _shape_of(file: Path, shapes: list[tuple[int, int]]) -> tuple[int, int]:
    """Return the shape among `shapes` that matches the size of a file of float32; the first one if none does."""
    size = os.lstat(file).st_size
    return next((shape for shape in shapes if file_bytes(4 * math.prod(shape)) == size), shapes[0])
