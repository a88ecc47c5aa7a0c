# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks of overviews: those that a GeoTIFF has, and others, reduced from the mask of all its samples.

A mask that is made after the overviews has none itself, and GDAL then takes all samples of the overviews as valid.
"""

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..errors import TerrainError, shown
from ..rasters.raster import cause
from ..rasters.rasterio_types import DatasetReader
from ..rasters.sidecars import is_alone, mask_files
from .gdal_files import open_dataset

ReadWindow = Callable[[int, int, int, int], np.ndarray]  # first row, rows, first column, columns


def lacks_mask_overview(path: Path, level: int, small: DatasetReader, band: int) -> bool:
    """Return whether a GeoTIFF has a mask, but its overview has none.

    level: number of the overview, from 0. small: the open overview. band: from 1.
    """
    from rasterio.errors import RasterioIOError

    if not _is_masked(small, band) and is_alone(path):  # GDAL takes overviews in an .ovr as unmasked
        return False
    with open_dataset(path, "GTiff", GEOREF_SOURCES="NONE") as whole:
        if not _is_masked(whole, band):
            return False
    masks = mask_files(path)
    try:
        for mask in masks:
            with open_dataset(mask, "GTiff", OVERVIEW_LEVEL=level) as mask_overview:
                if mask_overview.shape != small.shape:
                    return True
    except RasterioIOError:  # it has fewer overviews
        return True
    return not _is_masked(small, band) or not (masks or _holds_mask(path, small.shape))


def _is_masked(dataset: DatasetReader, band: int) -> bool:
    """Return whether a mask hides samples, rather than a no-data value or an alpha band."""
    from rasterio.enums import MaskFlags

    return not {MaskFlags.all_valid, MaskFlags.nodata, MaskFlags.alpha} & {*dataset.mask_flag_enums[band - 1]}


def _holds_mask(path: Path, shape: tuple[int, int]) -> bool:
    """Return whether a TIFF holds a mask of this shape, (rows, columns), as a directory of samples of one bit."""
    import rasterio
    from rasterio.errors import RasterioIOError

    for number in itertools.count(1):
        try:
            with rasterio.open(f"GTIFF_DIR:{number}:{path}", driver="GTiff", sharing=False) as directory:
                if directory.shape == shape and directory.tags(1, ns="IMAGE_STRUCTURE").get("NBITS") == "1":
                    return True
        except RasterioIOError:  # the last one was before
            return False
    return False


def hide_masked(path: Path, window: ReadWindow, shape: tuple[int, int], whole: DatasetReader, band: int) -> ReadWindow:
    """Return the window of an overview with NaN for each sample that is made of masked ones, even if also of others.

    The mask is read for one row of the overview at once. path: the file, for errors. window: that of the overview,
    without its mask. shape: rows and columns of the overview. whole: the open file. band: from 1.
    """
    from rasterio.windows import Window

    def read(first: int, count: int, column: int, columns: int) -> np.ndarray:
        """Return `columns` samples from `column` on of `count` rows from row `first` on. Raises TerrainError."""
        values = as_floats(window(first, count, column, columns))
        lefts, rights = _parts(column, columns, shape[1], whole.width)
        left, width = int(lefts[0]), int(rights[-1] - lefts[0])
        for row, top, bottom in zip(values, *_parts(first, count, shape[0], whole.height), strict=True):
            try:
                mask = whole.read_masks(band, window=Window(left, int(top), width, int(bottom - top)))
            except Exception as reason:
                raise damaged(path, int(top), int(bottom - top), reason) from reason
            masked = np.concatenate([[0], np.cumsum((mask == 0).any(axis=0))])  # number of columns up to each one
            row[masked[rights - left] > masked[lefts - left]] = np.nan
        return values

    return read


def _parts(first: int, count: int, small: int, whole: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first columns of a raster that columns of its overview are means of, and the columns behind the last.

    GDAL makes an overview of the next finer one, and rounds the borders of means outwards. first, count: columns of the
    overview. small, whole: columns of the overview and of the raster.
    """
    sizes = [whole]
    while sizes[-1] > small:
        sizes.append(max(-(-sizes[-1] // 2), small))
    begins = np.arange(first, first + count)
    ends = begins + 1
    for coarse, fine in itertools.pairwise(reversed(sizes)):
        begins, ends = begins * fine // coarse, -(-ends * fine // coarse)
    return begins, ends


def as_floats(rows: np.ndarray) -> np.ndarray:
    """Return samples as floats for NaN: integers of more than 16 bits and float64 as float64, others as float32."""
    return rows.astype(np.float64 if rows.itemsize > 2 and rows.dtype != np.float32 else np.float32)


def damaged(path: Path, first: int, count: int, reason: Exception) -> TerrainError:
    """Return the error about a file of which `count` rows from row `first` on cannot be read, and the reason."""
    return TerrainError(
        f"{shown(path)} is damaged or incomplete in rows {first} to {first + count - 1} ({cause(reason)})",
        fix="get the file again",
    )
