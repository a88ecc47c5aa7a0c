# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasters through rasterio (GDAL), each format by its own driver (source_formats.py).

Functions import rasterio, because its libraries must not meet those of Blender. They run in the import's child process,
which first calls `keep_only_drivers`.
"""

import dataclasses
import math
import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ..errors import TerrainError, shown
from ..field.georeference import Georeference, from_transform
from ..rasters.band_notes import band_notes, content_hint, float_alpha, is_picture
from ..rasters.coded_heights import decode_if_coded
from ..rasters.driver_gaps import band_facts
from ..rasters.file_grid import FileGrid, grid_of, has_shear, unit_of
from ..rasters.raster import ImportSettings, Raster, blank, cause
from ..rasters.rasterio_types import DatasetReader
from ..rasters.reproject import reproject
from ..rasters.resampled_file import ResampledFile, Resampling
from ..rasters.rounding import SourceRounding, band_rounding
from ..rasters.sidecars import allow_aux_file, aux_files, mask_notes, named_crs, unread_mask_notes
from ..rasters.source_formats import SourceFormat
from ..rasters.tiff_orientation import orientation_georeference, orientation_notes, orientation_of
from ..rasters.units import height_unit
from .format_choice import format_of
from .gdal_files import OpenedVrt, ignore_neighbours, open_dataset, open_file, open_vrt, start_gdal
from .mask_overviews import as_floats, damaged, hide_masked, lacks_mask_overview
from .vrt_rounding import mosaic_roundings
from .vrt_units import mosaic_notes

BLOCK_ROWS = 128  # of a resampled raster, that are read together


def keep_only_drivers(wanted: set[str]) -> list[str]:
    """Remove all other GDAL drivers from this process, and return those that remain.

    Raises TerrainError if others remain, because files could use them, or if one of `wanted` is missing.
    """
    import rasterio
    from rasterio import _env

    with rasterio.Env() as env:
        known = set(env.drivers())
    os.environ["GDAL_SKIP"] = ",".join(sorted(known - wanted))  # is read when drivers are registered
    _env._have_registered_drivers = False  # so that rasterio registers them again
    _env.GDALEnv().start()
    with rasterio.Env() as env:
        remaining = sorted(env.drivers())
    if set(remaining) != wanted:
        raise TerrainError(
            f"GDAL {rasterio.__gdal_version__} keeps the drivers {shown(', '.join(remaining))}, so no file is opened",
            expected=f"only {', '.join(sorted(wanted))}",
            fix="install rasterio 1.4",
        )
    return remaining


def open_raster(path: Path, settings: ImportSettings) -> Raster:
    """Open the band of the settings of a raster file, which the raster's `close` closes.

    Raises TerrainError if GDAL cannot, or for a name that is no UTF-8 text.
    """
    form = format_of(path)
    assert form is not None, "the file has the suffix of a format"
    driver = form.driver
    check_utf8(path)
    try:
        return _open_raster(path.absolute(), form, settings)
    except TerrainError:
        raise
    except Exception as reason:  # GDAL has many classes of errors, and odd tags raise late
        raise TerrainError(
            f"{shown(path)} cannot be read as {driver} ({cause(reason)})", **content_hint(path, driver)
        ) from reason


def check_utf8(path: Path) -> None:
    """Raise TerrainError for a path whose bytes are no UTF-8 text, which GDAL's bindings cannot pass on."""
    wrong = [part for part in path.parts if part != part.encode(errors="ignore").decode()]
    if wrong:
        raise TerrainError(
            f"{shown(path)} has the name {shown(wrong[-1])!r}, which is no UTF-8 text",
            expected="a name of letters that UTF-8 can write",
            fix="rename the file or the folder",
        )


def _open_raster(path: Path, form: SourceFormat, settings: ImportSettings) -> Raster:
    """Open a file with GDAL and return its band `settings.band` as a raster, which its `close` closes.

    Heights that are coded in colours are one band, decoded in memory. form: the file's format.
    """
    start_gdal()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the report warns about a raster without a georeference
        if form.driver == "VRT":
            vrt = open_vrt(path)
            return raster_of(path, vrt.dataset, settings, form.driver, vrt=vrt)
        notes = allow_aux_file(path)
        original = open_file(path, form)
        notes += unread_mask_notes(path, original)
        dataset = decode_if_coded(path, original, settings)
    if dataset is not original and settings.band != 1:  # the copy has one band
        dataset.close()
        what = f"{shown(path)} has heights in the colours of all its bands, not in band {settings.band}"
        raise TerrainError(what, fix="leave the band out, or name the encoding plain")
    return raster_of(path, dataset, settings, form.driver, notes)


def raster_of(
    path: Path,
    dataset: DatasetReader,
    settings: ImportSettings,
    driver: str,
    notes: Sequence[str] = (),
    vrt: OpenedVrt | None = None,
) -> Raster:
    """Return the band `settings.band` of an open rasterio dataset as a raster.

    The georeference, the unit of heights and the rounding of stored values come from the dataset; roundings of a VRT
    come from its sources. The raster is reprojected if the settings request it or its grid is sheared. driver: GDAL's
    name of the format. notes: warnings so far. vrt: if the file is a VRT, its XML in memory (`texts`), its sources
    (`mosaic`) and their roundings and scales by (file, band), else None. Raises TerrainError for a missing band,
    complex values and a place that cannot be used.
    """
    _check_band(path, dataset, settings.band)
    _check_scale(path, dataset.scales[settings.band - 1], dataset.offsets[settings.band - 1])
    band, notes, mosaic = settings.band, list(notes), vrt.mosaic if vrt is not None else None
    stored = np.dtype(dataset.dtypes[band - 1])
    # Grid, unit and notes, corrected where GDAL's driver leaves facts out; `factor` brings values into the unit.
    facts = band_facts(path, dataset, band, _grid_of(dataset, settings))
    grid = facts.grid
    if grid.transform is not None and grid.crs is None and driver != "VRT":
        grid = grid._replace(crs=named_crs(path, notes))
    in_metres, unit_warnings = height_unit(facts.unit, grid.crs or dataset.crs)
    in_metres *= facts.factor  # `in_metres` is now metres for one of the dataset's values
    notes += [*band_notes(dataset, band, driver), *facts.notes, *unit_warnings]
    roundings: tuple[SourceRounding, ...] = (band_rounding(dataset, band),)
    if vrt is not None:
        roundings = mosaic_roundings(vrt.mosaic, band, str(stored), lambda *file_band: vrt.roundings.get(file_band))
        notes += mosaic_notes(vrt.mosaic, band, lambda *file_band: vrt.scales.get(file_band))
        notes += mask_notes([path, *vrt.mosaic.sources])
    if grid.problem and settings.extent is None:
        notes.append(
            f"The file {grid.problem}: a sample is taken as 1 m, and the first row as the north. Give the extent in "
            f"metres (--extent), or place the raster first ({grid.tool})."
        )
    # The samples as they are stored, and, if they have to be resampled, the plan for it with the new grid and size.
    raster = _stored_raster(path, dataset, settings, driver, grid)
    plan, projected_from, placed_size = None, "", (dataset.width, dataset.height)
    sheared = grid.transform is not None and has_shear(grid, dataset.width, dataset.height)
    if settings.project or sheared:
        projected_from = grid.name if settings.project else "a sheared grid"
        plan = reproject(path, dataset, grid, settings)
        grid, placed_size = (
            FileGrid(plan.target.crs if settings.project else grid.crs, plan.target.transform),
            plan.size,
        )
        if not settings.project:
            notes.append("The file's rows and columns are not perpendicular: it was resampled onto a straight grid.")
    # The place of the result, or only the directions of its rows and columns.
    georeference = _georeference(grid, *placed_size, settings)
    is_sized = georeference is not None
    if georeference is None and driver == "GTiff":  # from its tag Orientation
        georeference = orientation_georeference(orientation_of(path))
    if georeference is None and mosaic is not None:
        notes += orientation_notes(mosaic.sources)
    placed = dataclasses.replace(
        raster,
        georeference=georeference,
        is_sized=is_sized,
        read_grid=grid if is_sized else None,
        has_unit=bool(facts.unit),
        is_picture=is_picture(dataset, settings),
        projected_from=projected_from,
        scale=dataset.scales[band - 1] * in_metres,
        offset=dataset.offsets[band - 1] * in_metres,
        roundings=roundings,
        warnings=notes,
        sources=tuple(mosaic.sources) if mosaic is not None else (),
        close=lambda: _close(dataset, *(vrt.texts if vrt is not None else ())),
    )
    return placed if plan is None else _resampled(placed, plan)


def _check_band(path: Path, dataset: DatasetReader, band: int) -> None:
    """Raise TerrainError for a band that the dataset lacks, or that holds complex values. Bands count from 1."""
    if not 1 <= band <= dataset.count:
        raise TerrainError(f"{path} has {dataset.count} band(s), but not band {band}", fix="choose another band")
    if dataset.dtypes[band - 1].startswith("complex"):
        raise TerrainError(f"{path} holds {dataset.dtypes[band - 1]} values", expected="real numbers")


def _check_scale(path: Path, scale: float, offset: float) -> None:
    """Raise TerrainError for a scale or an offset of a file's values that is no finite number."""
    if not (math.isfinite(scale) and math.isfinite(offset)):
        what = f"{path} gives its values the scale {scale:g} and the offset {offset:g}"
        raise TerrainError(what, expected="finite numbers", fix="correct its header (gdal_edit.py -scale, -offset)")


def _stored_raster(path: Path, dataset: DatasetReader, settings: ImportSettings, driver: str, grid: FileGrid) -> Raster:
    """Return the band of the settings as the dataset stores it: not reprojected, and without a georeference.

    driver: GDAL's name of the format.
    """
    stored = dataset.dtypes[settings.band - 1]
    # Overviews are read from the file itself, not from a decoded copy in memory.
    is_plain = driver == "GTiff" and dataset.name == str(path)
    return dataclasses.replace(
        _band_of(path, dataset, settings),
        grid=grid,
        block_rows=dataset.block_shapes[settings.band - 1][0],
        format=driver,
        overview=lambda factor: open_overview(path, settings, dataset.width, stored, factor) if is_plain else None,
    )


def _band_of(path: Path, dataset: DatasetReader, settings: ImportSettings) -> Raster:
    """Return the samples of the settings' band of a GeoTIFF or another dataset, and nothing else about them."""
    window = _window_reader(path, dataset, settings)
    return Raster(
        width=dataset.width,
        height=dataset.height,
        read=lambda first, count: window(first, count, 0, dataset.width),
        window=window,
        stored=dataset.dtypes[settings.band - 1],
        format="GTiff",
    )


def _close(*files: DatasetReader) -> None:
    """Close files in this order: a VRT before the texts that it reads."""
    for file in files:
        file.close()


def _resampled(original: Raster, plan: Resampling) -> Raster:
    """Return a raster on another grid.

    original: the file's own raster, but with the georeference of that grid. The result's `moved` is the largest
    difference that errors of positions have made to a sample that was read.
    """
    assert original.window is not None, "GDAL reads windows"
    file = ResampledFile(plan, original.window)

    def window(first: int, count: int, column: int, columns: int) -> np.ndarray:
        """Return `columns` samples from `column` on of `count` rows from row `first` on, and update `raster.moved`."""
        file.moved = 0.0
        values = file.window(first, count, column, columns)
        raster.moved = max(raster.moved, file.moved)
        return values

    width, height = plan.size
    raster = dataclasses.replace(
        original,
        width=width,
        height=height,
        read=lambda first, count: window(first, count, 0, width),
        window=window,
        overview=lambda _max_factor: None,
        grid=None,
        block_rows=BLOCK_ROWS,
        original=original,
    )
    return raster


def _window_reader(
    path: Path, dataset: DatasetReader, settings: ImportSettings
) -> Callable[[int, int, int, int], np.ndarray]:
    """Return the function `window` of a Raster for the band of the settings.

    GDAL's mask, which includes the file's no-data value, or an alpha band marks missing samples. A no-data value in the
    settings replaces both.
    """
    from rasterio.enums import MaskFlags
    from rasterio.windows import Window

    band, no_data = settings.band, settings.no_data

    def read(first: int, count: int, column: int, columns: int) -> np.ndarray:
        """Return `columns` samples from `column` on of `count` rows from row `first` on; missing samples are NaN.

        In a masked raster integers of more than 16 bits and float64 become float64, others float32. Raises TerrainError
        for damaged rows.
        """
        window = Window(column, first, columns, count)
        try:
            # Not before samples are read: the search for a mask takes half as long as opening a file for its header.
            masked = no_data is None and MaskFlags.all_valid not in dataset.mask_flag_enums[band - 1]
            # a band that is 0 at missing samples and counts instead of the mask; 0 for none
            alpha = float_alpha(dataset, band) if no_data is None else 0
            rows = dataset.read(band, window=window)
            mask = dataset.read_masks(band, window=window) if masked else None
            mask = dataset.read(alpha, window=window) if alpha else mask
        except Exception as reason:
            raise damaged(path, first, count, reason) from reason
        if mask is not None:
            rows = as_floats(rows)
            rows[mask == 0] = np.nan
            return rows
        return blank(rows, no_data)

    return read


def open_overview(path: Path, settings: ImportSettings, width: int, stored: str, max_factor: int) -> Raster | None:
    """Open the overview of a GeoTIFF that has one sample for `max_factor` (2, 4, 8 ...) samples along each side.

    Return None if the file has no such overview, if that is coarser than `max_factor` or has another type of samples,
    and if the file has an .aux.xml. The caller closes it. The file was opened and checked before. width: columns of the
    file. stored: type of its samples.
    """
    from rasterio.errors import RasterioIOError

    level, band = max_factor.bit_length() - 2, settings.band  # overviews 0, 1, ... should be 2, 4, ... times coarser
    if level < 0 or aux_files(path):  # GDAL ignores its no-data value in overviews
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its position, which takes long to read, is known
        try:
            small = open_dataset(path, "GTiff", OVERVIEW_LEVEL=level, GEOREF_SOURCES="NONE")
            lacks_mask = settings.no_data is None and lacks_mask_overview(path, level, small, band)
            whole = open_dataset(path, "GTiff", GEOREF_SOURCES="NONE") if lacks_mask else small
        except RasterioIOError:
            return None
        finally:
            ignore_neighbours()  # again: opening may have changed this, and a source of another tile may be a VRT
    if width > max_factor * small.width or small.dtypes[band - 1] != stored:
        _close(small, whole)
        return None
    raster = _band_of(path, small, settings)
    if whole is not small:
        window = hide_masked(path, _window_reader(path, small, settings), small.shape, whole, band)
        raster = dataclasses.replace(raster, window=window, read=lambda row, count: window(row, count, 0, small.width))
    return dataclasses.replace(raster, close=lambda: _close(small, whole))


def _grid_of(dataset: DatasetReader, settings: ImportSettings) -> FileGrid:
    """Return the grid of a dataset. If it cannot be used and the user gives the extent, return an empty grid.

    Raises TerrainError if it cannot be used and there is no extent.
    """
    try:
        return grid_of(dataset)
    except TerrainError:
        if settings.extent is None:
            raise
        return FileGrid()


def _georeference(grid: FileGrid, width: int, height: int, settings: ImportSettings) -> Georeference | None:
    """Return the georeference of a raster of `width` x `height` samples, None if the file does not place it.

    The caller adds warnings about distorted lengths. The result is also None if the place cannot be used and the
    settings give the extent; without that TerrainError is raised.
    """
    if grid.transform is None:
        return None
    try:
        return from_transform(grid.transform, width, height, crs=grid.name, **unit_of(grid.crs))
    except TerrainError:
        if settings.extent is None:
            raise
        return None
