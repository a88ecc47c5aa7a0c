# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights in the colours of an image: Terrarium's and Mapbox's encodings, and the position of web map tiles.

Codes are decoded before anything is resampled: a mean of two coded colours is no height.
"""

import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import TerrainError, shown
from .raster import ImportSettings
from .rasterio_types import DatasetReader

PLAIN = "plain"  # the encoding of an image without codes, even if it looks like one
HALF_WORLD = math.pi * 6378137.0  # metres of web mercator, EPSG:3857
MAX_ZOOM, MAX_TILE = 30, 1024  # of tiles that are recognised
MAX_SAMPLES = 1 << 28  # decoded in memory, 4 bytes each
BLOCK_SAMPLES = 1 << 20
CERTAIN_M = -9000.0, 9000.0  # heights of a tile that is recognised
MISSING = 0  # code of a sample without data: -32,768 or -10,000 m
_TILE = re.compile(r"(\d{1,2})/(\d{1,10})/(\d{1,10})(?:@\dx)?")


class HeightCoding(NamedTuple):
    """A height is `scale` * (65536 red + 256 green + blue) + `offset` metres."""

    scale: float
    offset: float


CODINGS = {"terrarium": HeightCoding(1 / 256, -32768.0), "mapbox": HeightCoding(0.1, -10000.0)}


def tile_of(path: Path) -> tuple[int, int, int] | None:
    """Return the zoom, column and row of a web map tile with a path that ends with z/x/y and a suffix; else None."""
    match = _TILE.fullmatch("/".join((*path.parts[-3:-1], path.stem)))
    if not match:
        return None
    zoom, column, row = map(int, match.groups())
    return (zoom, column, row) if zoom <= MAX_ZOOM and max(column, row) < 1 << zoom else None


def may_be_coded(path: Path, encoding: str) -> bool:
    """Return whether a file may hold coded heights, by the setting and its name.

    encoding: the setting, "" if not given.
    """
    return encoding in CODINGS or (not encoding and tile_of(path) is not None)


def codes_of(bands: np.ndarray) -> np.ndarray:
    """Return the codes, uint32 [rows, columns], of uint8 bands [3 or 4, rows, columns]; MISSING where alpha is 0."""
    red, green, blue = bands[:3].astype(np.uint32)
    codes = (red << np.uint32(16)) | (green << np.uint32(8)) | blue
    if len(bands) > 3:
        codes[bands[3] == 0] = MISSING
    return codes


def decode_if_coded(path: Path, dataset: DatasetReader, settings: ImportSettings) -> DatasetReader:
    """Return a rasterio dataset of heights: `dataset`, or its decoded copy in memory if it holds coded ones.

    The copy has one band of codes with their scale, offset, unit and no-data value, and the position of a web map tile;
    `dataset` is then closed. Raises TerrainError for an image that cannot hold codes.
    """
    if not may_be_coded(path, settings.encoding):
        return dataset
    is_image = dataset.count in (3, 4) and all(kind == "uint8" for kind in dataset.dtypes)
    name = settings.encoding or (_recognise_coding(path, dataset) if is_image else "")
    if not name:
        return dataset
    if not is_image:
        raise TerrainError(
            f"{shown(path)} holds {dataset.count} band(s) of {dataset.dtypes[0]}, so no heights coded as {name}",
            expected="red, green and blue of 8 bits",
            fix="leave the encoding out",
        )
    if dataset.tags(ns="IMAGE_STRUCTURE").get("COMPRESSION_REVERSIBILITY", "").startswith("LOSSY"):
        what = f"{shown(path)} was compressed with loss, which destroys heights coded in colours"
        raise TerrainError(what, expected="a PNG or another image without loss", fix="get the tile as a PNG")
    if dataset.width * dataset.height > MAX_SAMPLES:
        what = f"{shown(path)} has {dataset.width} x {dataset.height} coded samples"
        raise TerrainError(what, expected=f"{MAX_SAMPLES:,} at most", fix="cut it into tiles")
    return _decode(path, dataset, CODINGS[name])


def _decode(path: Path, dataset: DatasetReader, coding: HeightCoding) -> DatasetReader:
    """Return a copy in memory of a dataset of coded heights, as one band of codes, and close the dataset.

    coding: how colours stand for heights.
    """
    import rasterio
    from rasterio.enums import MaskFlags
    from rasterio.windows import Window

    # An alpha band or a file beside it (.msk) can hide samples; a no-data value of single colours hides none.
    masked = not {MaskFlags.all_valid, MaskFlags.nodata} & {*dataset.mask_flag_enums[0]}
    shape = {"width": dataset.width, "height": dataset.height, "count": 1, "dtype": "uint32"}
    points, system = dataset.gcps
    place = {"crs": dataset.crs, "transform": dataset.transform}
    place = {"crs": system, "gcps": points} if points and dataset.transform.is_identity else place
    tile = tile_of(path)
    # A web map tile that has no position itself has one by its path.
    if tile is not None and dataset.transform.is_identity and dataset.width == dataset.height:
        place = _tile_place(tile, dataset.width)
    memory = rasterio.MemoryFile(ext=".tif")
    with memory.open(driver="GTiff", nodata=MISSING, **shape, **place) as copy:
        copy.scales, copy.offsets, copy.units = (coding.scale,), (coding.offset,), ("m",)
        rows = max(1, BLOCK_SAMPLES // dataset.width)
        for first in range(0, dataset.height, rows):
            window = Window(0, first, dataset.width, min(rows, dataset.height - first))
            codes = codes_of(dataset.read(window=window))
            if masked:
                codes[dataset.read_masks(1, window=window) == 0] = MISSING
            copy.write(codes, 1, window=window)
    dataset.close()
    return memory.open(driver="GTiff")


def _tile_place(tile: tuple[int, int, int], side: int) -> dict:
    """Return the coordinate system and the geotransform of a web map tile of `side` samples."""
    from rasterio.transform import Affine

    zoom, column, row = tile
    size = 2.0 * HALF_WORLD / (1 << zoom)
    corner = column * size - HALF_WORLD, HALF_WORLD - row * size
    return {"crs": "EPSG:3857", "transform": Affine(size / side, 0.0, corner[0], 0.0, -size / side, corner[1])}


def _recognise_coding(path: Path, dataset: DatasetReader) -> str:
    """Return the encoding of a web map tile if only one gives heights on Earth without cliffs; "" otherwise.

    Without cliffs: neighbours differ by less than a pixel's width in the mean.
    """
    if max(dataset.width, dataset.height) > MAX_TILE or dataset.width != dataset.height:
        return ""
    codes = codes_of(dataset.read())
    valid = codes != MISSING
    tile = tile_of(path)
    assert tile is not None, "its path is that of a tile"
    pixel = 2.0 * HALF_WORLD / (1 << tile[0]) / dataset.width  # metres; at zoom z, tile[0], 2^z tiles span the world
    possible = []
    for name, coding in CODINGS.items():
        heights = np.where(valid, codes * coding.scale + coding.offset, np.nan)
        steps = np.abs(np.concatenate([np.diff(heights, axis=0).ravel(), np.diff(heights, axis=1).ravel()]))
        steps = steps[np.isfinite(steps)]
        low, high = CERTAIN_M
        if steps.size and low < np.nanmin(heights) and np.nanmax(heights) < high and steps.mean() < pixel:
            possible.append(name)
    return possible[0] if len(possible) == 1 else ""
