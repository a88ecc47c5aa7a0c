# SPDX-License-Identifier: GPL-3.0-or-later
"""Opening of files with GDAL: its options, and checks of a file before samples are read."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import TerrainError, shown
from ..rasters.band_notes import WHOLE_FILE
from ..rasters.raster import cause
from ..rasters.rasterio_types import DatasetReader
from ..rasters.rounding import SourceRounding, band_rounding
from ..rasters.sidecars import allow_aux_file, is_alone
from ..rasters.source_formats import FORMATS, SourceFormat
from ..run.named_file import open_regular
from .header_files import check_header, check_length
from .netcdf_header import netcdf_damage
from .png_file import png_damage
from .vrt_source import Mosaic, read_mosaic
from .vrt_units import HeightScale, dataset_scales

MOSAIC_SUFFIXES = {suffix for suffix, form in FORMATS.items() if form.in_mosaic}  # of files that a VRT may name
DAMAGE = {"PNG": png_damage, "netCDF": netcdf_damage}  # checks before a driver reads a file
MAX_BANDS = 1024  # more than any height map has; interleaved bands are all read
# Max bytes of a piece of a file that is read at once: a tile or strip, with all its bands if they are interleaved.
LARGEST_BLOCK = 256 << 20
CACHE_BYTES = 256 << 20  # rasterio takes bytes, GDAL's environment variable megabytes
# No network, no code from a file, a bounded cache. PAM is GDAL's name for reading and writing .aux.xml files. It is
# switched on only for a file that was checked; GDAL writes none for a dataset that it only reads.
OPTIONS = {
    "GDAL_CACHEMAX": CACHE_BYTES,
    "GDAL_PAM_ENABLED": "NO",
    "GDAL_DISABLE_READDIR_ON_OPEN": "FALSE",
    "GDAL_VRT_ENABLE_PYTHON": "NO",
    "CPL_VSIL_CURL_ALLOWED_FILENAME": "none",
}


class OpenedVrt(NamedTuple):
    """An open VRT. The dataset has to be closed before the texts.

    Attributes:
        dataset: a rasterio dataset.
        texts: its files in memory, which must live as long.
        mosaic: the VRT as it was read.
        roundings: rounding of each band of each file, by path and number.
        scales: conversion to heights, by the same.
    """

    dataset: DatasetReader
    texts: list
    mosaic: Mosaic
    roundings: dict
    scales: dict


def start_gdal() -> None:
    """Set GDAL's options for the rest of this process."""
    import rasterio

    rasterio.Env(**OPTIONS).__enter__()


def open_file(path: Path, form: SourceFormat) -> DatasetReader:
    """Open the dataset of one file, which the caller closes.

    Raises TerrainError if it, or its smallest readable piece, is too large, if it is damaged, lacks its header or names
    files in another folder; and rasterio's errors for other files that GDAL cannot open. form: the format that its name
    or content gives.
    """
    if form.max_bytes and path.stat().st_size > form.max_bytes:
        raise TerrainError(
            f"{shown(path)} has {path.stat().st_size / 1e6:,.0f} MB of text",
            expected=f"{form.max_bytes / 1e6:,.0f} MB at most in a file of {form.title}",
            fix="convert it to a GeoTIFF (gdal_translate)",
        )
    if form.driver in DAMAGE:
        _check_damage(path, form)
    header = check_header(path) if form.has_header else None
    dataset = open_dataset(path, form.driver)
    _check_files(path, dataset)
    _check_blocks(path, dataset)
    if header is not None:
        check_length(path, header, dataset)
    return dataset


def open_dataset(path: Path, driver: str, **options: object) -> DatasetReader:
    """Open a file with one driver and its open options. Raises rasterio's errors.

    GDAL lists the folder, to find files that belong to this one (.msk, .ovr, world files), only if there may be any:
    in a folder of 2,400 files this takes as long as opening one.
    """
    import rasterio
    from rasterio.env import setenv

    needs_no_list = driver == "GTiff" and is_alone(path)
    setenv(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR" if needs_no_list else "FALSE")
    try:
        return rasterio.open(path, driver=driver, sharing=False, **options)
    finally:
        setenv(GDAL_DISABLE_READDIR_ON_OPEN="FALSE")


def ignore_neighbours() -> None:
    """Let GDAL read no files beside those that it opens from now on, such as the sources of a VRT that is read."""
    from rasterio.env import setenv

    setenv(GDAL_PAM_ENABLED="NO", GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR")


def _check_files(path: Path, dataset: DatasetReader) -> None:
    """Refuse a file that names samples in another folder. Raises TerrainError."""
    home = os.path.realpath(path.parent)
    for name in dataset.files:
        if os.path.realpath(os.path.dirname(name)) != home:
            raise TerrainError(
                f"{shown(path)} names the file {shown(name)!r}",
                expected="its parts in its own folder",
                fix="convert it to a GeoTIFF (gdal_translate) if you trust it",
            )


def _check_damage(path: Path, form: SourceFormat) -> None:
    """Refuse damage that GDAL does not notice, or not soon. Raises TerrainError.

    form: the file's format.
    """
    with open_regular(path, links=True) as file:
        damage = DAMAGE[form.driver](file)
    if damage:
        expected = f"a whole {form.title}"
        raise TerrainError(f"{shown(path)} is damaged ({damage})", expected=expected, fix="get the file again")


def open_vrt(path: Path) -> OpenedVrt:
    """Open a VRT after each of its files was opened once and checked.

    GDAL reads the VRT as texts in memory, in which `read_mosaic` has replaced the names of the files. From then on GDAL
    ignores files beside rasters (.msk, .ovr) in this process. Raises TerrainError, and rasterio's errors for the VRT
    itself.
    """
    import rasterio
    from rasterio.env import setenv

    mosaic = read_mosaic(path, MOSAIC_SUFFIXES)
    roundings: dict[tuple[Path, int], SourceRounding] = {}
    scales: dict[tuple[Path, int], HeightScale] = {}
    for source in mosaic.sources:
        form = FORMATS[source.suffix.lower()]
        if form.driver == "VRT":
            continue
        allow_aux_file(source)  # its warnings do not matter: the mosaic gets nothing of that file
        try:
            with open_file(source, form) as opened:
                roundings |= {(source, n): band_rounding(opened, n) for n in range(1, opened.count + 1)}
                scales |= {(source, n): scale for n, scale in enumerate(dataset_scales(opened), 1)}
        except TerrainError:
            raise
        except Exception as reason:
            raise TerrainError(
                f"{shown(source)}, a source of {shown(path)}, cannot be read as {form.driver} ({cause(reason)})",
                expected=WHOLE_FILE,
            ) from reason
        finally:
            setenv(GDAL_PAM_ENABLED="NO")  # no .aux.xml is read, as before `allow_aux_file`
    ignore_neighbours()  # files beside a source (.msk, .ovr) could be VRTs again
    texts = [
        rasterio.MemoryFile(text.encode(), dirname=mosaic.folder, filename=f"{number}.vrt")
        for number, text in enumerate(mosaic.texts)
    ]
    dataset = rasterio.open(texts[-1].name, driver="VRT", sharing=False)  # the outermost VRT
    _check_blocks(path, dataset)  # refuses too many bands and too large pieces
    return OpenedVrt(dataset, texts, mosaic, roundings, scales)


def _check_blocks(path: Path, dataset: DatasetReader) -> None:
    """Refuse a dataset with too many bands or with too large pieces, and let GDAL's cache hold two pieces.

    Raises TerrainError.
    """
    from rasterio.enums import Interleaving
    from rasterio.env import setenv

    if not 1 <= dataset.count <= MAX_BANDS:
        raise TerrainError(
            f"{shown(path)} has {dataset.count} bands",
            expected=f"1 to {MAX_BANDS}",
            fix="write a file with the band of heights alone",
        )
    rows, columns = dataset.block_shapes[0]
    size = rows * columns * max(16 if "complex" in kind else np.dtype(kind).itemsize for kind in dataset.dtypes)
    if dataset.count > 1 and dataset.interleaving == Interleaving.pixel:  # a piece holds all bands
        size *= dataset.count
    if size > LARGEST_BLOCK:
        raise TerrainError(
            f"{shown(path)} is stored in pieces of {size / 1e9:.1f} GB",
            expected=f"{LARGEST_BLOCK / 1e9:.1f} GB at most",
            fix="write it again with smaller tiles or strips",
        )
    if 2 * size > CACHE_BYTES:  # otherwise each part of a piece unpacks the whole piece again
        setenv(GDAL_CACHEMAX=2 * LARGEST_BLOCK)
