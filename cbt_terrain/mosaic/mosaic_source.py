# SPDX-License-Identifier: GPL-3.0-or-later
"""A mosaic as one raster for an import, opened from headers alone.

A Composite has the files (tiles) of a mosaic in the order of their priority, and returns heights on the target grid.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import TerrainError, shown
from ..field.georeference import Georeference, from_transform
from ..formats.archives import UnpackedFiles, archive_of
from ..formats.file_options import check_applies
from ..importing.source_list import options_of_several
from ..importing.thinning import FROM_OVERVIEWS, WORTHWHILE
from ..rasters.file_grid import FileGrid, unit_of
from ..rasters.length_scale import length_warnings, mirror_warnings
from ..rasters.raster import MOSAIC, FinerSource, ImportSettings, Raster
from ..view.linear import add_up
from .catalogue import SourceTile, build_catalogue, keep_catalogue
from .composite import Composite
from .finer_plan import plan_finer
from .hidden_files import hidden_warnings, thin_warnings
from .nearest import nearest_samples
from .systems import crs_of
from .target_grid import TargetGrid, choose_grid, footprints
from .tile_paths import picture_notes

BLOCK_ROWS = 128  # read together; a quarter of most files' tiles, which GDAL's cache keeps meanwhile
MAX_WARNINGS = 3  # of files
BLENDING = 1  # increased when the same insets blend to other heights


def open_composite(
    settings: ImportSettings,
    store: Path | None,
    on_progress: Callable[[float], None] = lambda _fraction: None,
    unpacked: UnpackedFiles | None = None,
) -> Composite:
    """Open the mosaic of the settings' sources, as heights on one grid; the caller closes it. Raises TerrainError.

    If its finest files cover little, the composite has a coarser grid, and `finer` has the finer tiles. A
    quick import does so only if a complete one takes little longer; otherwise the composite has the finest grid, and
    `finest` has the plan.

    store: folder whose kept catalogue is used, None to read all headers. on_progress: gets the fraction of headers that
    are known. unpacked: height maps of archives.
    """
    check_settings(settings)
    unpacked = unpacked or UnpackedFiles()
    tiles, pictures = build_catalogue(settings, store, on_progress, unpacked)
    grid = choose_grid(tiles, settings)
    tile_footprints = footprints(tiles, grid.crs)
    whole = Composite(tiles, grid, tile_footprints, settings, unpacked)
    whole.notes = picture_notes(pictures)
    # A step of the settings holds everywhere, so there are no finer tiles then.
    plan = None
    if settings.step is None:
        plan = plan_finer(grid, whole.step_levels, whole.steps, whole.boxes, settings.holes)
    # `quick` is the number of samples of a quick import, 0 for a complete one. Up to WORTHWHILE times as many samples
    # are soon imported completely; plan.work is the number of samples whose import takes as long as the plan's.
    is_quick_enough = plan is not None and (not settings.quick or plan.work <= WORTHWHILE * settings.quick)
    if plan is None or not is_quick_enough:
        whole.finest = plan
        return whole
    coarse = Composite(tiles, plan.grid, tile_footprints, settings, unpacked)
    coarse.finer, coarse.notes = (plan, whole), whole.notes
    return coarse


def check_settings(settings: ImportSettings) -> None:
    """Raise TerrainError for settings that several files cannot have."""
    settings.check()
    check_applies(settings, options_of_several(settings))
    if settings.extent is not None:
        raise TerrainError(
            "An extent in metres is of one file", expected="files with a position", fix="leave the extent out"
        )


def georeference_of(grid: TargetGrid) -> Georeference:
    """Return the georeference of a grid, with a warning if steps in its system are not true lengths."""
    crs = crs_of(grid.crs) if grid.crs else None
    file_grid = FileGrid(crs, grid.transform)
    georeference = from_transform(grid.transform, grid.width, grid.height, crs=grid.crs, **unit_of(crs))
    notes = length_warnings(file_grid, grid.width, grid.height, georeference)
    return replace(georeference, size_warnings=(*georeference.size_warnings, *notes))


def mosaic_raster(composite: Composite, settings: ImportSettings) -> Raster:
    """Return a composite as the raster of an import.

    While it is read, its `moved` and `shifted` keep the largest errors of interpolated positions and of conversions
    between vertical datums. If few of the composite's files are finer than the others, `finest` (on a raster of the
    finer step) or `finer` (on one of the coarser step) says where these are.
    """
    grid = composite.grid
    file_grid = FileGrid(crs_of(grid.crs) if grid.crs else None, grid.transform)
    grids = composite.shifts.grids(composite.tiles) if composite.shifts is not None else []
    raster = Raster(
        width=grid.width,
        height=grid.height,
        read=lambda first, count: window(first, count, column=0, columns=grid.width),
        stored=composite.stored,
        format=MOSAIC,
        grid=file_grid,
        georeference=georeference_of(grid),
        is_sized=True,
        has_unit=True,
        block_rows=BLOCK_ROWS,
        scale=composite.scale,
        offset=composite.offset,
        roundings=composite.all_roundings(),
        warnings=[
            *composite.notes,
            *hidden_warnings(composite),
            *(thin_warnings(composite) if settings.holes else []),
            *file_warnings(composite.tiles),
            *mirror_warnings(file_grid, grid.width, grid.height),
        ],
        details=_surface_entry(composite),
        sources=(*(archive_of(Path(entry[0])) for tile in composite.tiles for entry in tile.files), *grids),
        method=BLENDING if composite.insets else 0,  # 0: older versions made the same samples
        inputs=composite.inputs_of if min(grid.width, grid.height) > 1 else None,  # a single line is read by rows
        close=composite.close,
    )

    def read_window(source: Composite, first: int, count: int, column: int, columns: int) -> np.ndarray:
        """Read a window, and keep the largest errors of positions and of shifts of datums."""
        values, moved = source.read(first, count, column, columns)
        raster.moved = max(raster.moved, moved)
        raster.shifted = max(raster.shifted, source.shift_error(first, count, column, columns))
        return values

    window = partial(read_window, composite)
    if composite.finer is not None and composite.finer[0].is_of_gaps and settings.holes:
        window = partial(_read_widened, window, (grid.height, grid.width))

    def finish(folder: Path) -> None:
        """Check that no file has changed, and keep the catalogue in the store."""
        for tile in composite.tiles:
            tile.check_unchanged()
        keep_catalogue(composite.tiles, settings, folder)

    def pick(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Read single samples, and note in the report if they are of overviews."""
        values = nearest_samples(composite, rows, columns)
        # Single samples are spread over the whole grid, so the error of any of its files counts.
        raster.shifted = composite.shift_error(row=0, rows=grid.height, column=0, columns=grid.width)
        raster.details.update(FROM_OVERVIEWS if composite.reads_overviews else {})
        return values

    raster.window, raster.pick, raster.finish = window, pick, finish
    if composite.finest is not None:  # the raster has the finest step everywhere
        plan = composite.finest
        raster.finest = FinerSource(plan.bits, plan.boxes, window, continues=plan.is_of_gaps)
    if composite.finer is not None:  # the raster has the step of the coarser files
        plan, all_files = composite.finer  # all_files: another composite, on the finest grid
        finer_window = partial(read_window, all_files)
        raster.finer = FinerSource(
            plan.bits,
            plan.boxes,
            finer_window,
            inputs=all_files.inputs_by_seams,
            keep_seams=all_files.keep_seams,
            continues=plan.is_of_gaps,
        )
    return raster


def _read_widened(
    read: Callable[..., np.ndarray], size: tuple[int, int], first: int, count: int, column: int, columns: int
) -> np.ndarray:
    """Read a window of a coarse grid, in which samples next to known ones have the mean of these; others stay NaN.

    So a coarse cell with a finer sample of a file is not cut out. read(first, count, column, columns): reads a window.
    size: rows and columns of the grid. first, count, column, columns: first row, rows, first column and columns.
    """
    ends = (first, count, size[0]), (column, columns, size[1])
    # One sample more on each side, where the grid has one: lines before the window, and after it.
    (above, below), (left, right) = ((min(start, 1), min(end - start - lines, 1)) for start, lines, end in ends)
    values = read(first - above, count + above + below, column - left, columns + left + right)
    values = np.pad(values, ((1 - above, 1 - below), (1 - left, 1 - right)), constant_values=np.nan)
    around = [values[y : y + count, x : x + columns] for y in range(3) for x in range(3)]  # with the sample itself
    number = add_up(np.isfinite(part) for part in around)
    total = add_up(np.where(np.isfinite(part), part, 0.0) for part in around)
    known = np.isfinite(values[1:-1, 1:-1])
    return np.where(known, values[1:-1, 1:-1], total / np.where(number > 0, number, np.nan))


def blend_metres(composite: Composite) -> float:
    """Return the largest width, metres, over which finer files are blended to the tiles below; 0 without such files."""
    if composite.insets is None:
        return 0.0
    place = georeference_of(composite.grid)
    steps = np.array([place.step_y, place.step_x])
    # Rings are by the level of the tiles below; no tile is on the last, finest one. A ring's cell is in grid samples.
    return max(float((steps * ring.cell * ring.width).max()) for ring in composite.insets.rings[:-1])


def _surface_entry(composite: Composite) -> dict:
    """Return the report's entry about the surface that error bounds refer to; {} for the files' own."""
    if not composite.resamples:
        return {}
    against = f"the mosaic as resampled to {composite.grid.crs}, bilinear"
    width = blend_metres(composite)
    blended = f", finer files blended to coarser ones over {width:.4g} m at most" if width else ""
    return {"bounds_against": against + blended}


def file_warnings(tiles: Sequence[SourceTile]) -> list[str]:
    """Return the warnings of files, each text once with the number of files that have it.

    After MAX_WARNINGS texts a last line counts the others.
    """
    counts: dict[str, list[str]] = {}
    for tile in tiles:
        for text in tile.warnings:
            counts.setdefault(text, []).append(tile.path)
    notes = []
    for text, paths in list(counts.items())[:MAX_WARNINGS]:
        name = shown(Path(paths[0]).name)
        notes.append(f"{name if len(paths) == 1 else f'{len(paths):,} files, such as {name}'}: {text}")
    if len(counts) > MAX_WARNINGS:
        notes.append(f"{len(counts) - MAX_WARNINGS:,} more warnings about single files: `info FILE` shows them.")
    return notes
