# SPDX-License-Identifier: GPL-3.0-or-later
"""Second step of a quick import: the tiles that views need are loaded in more detail.

The first step, the first picture, is a store with every n-th sample of the raster (thinning.py). Each of its cells
becomes FACTOR x FACTOR cells, but none finer than the raster's. The chosen tiles get true samples of the source, as the
first picture has; all others keep its surface (tiling/coarse_land.py). The store keeps the first picture inside, so
that further tiles can be loaded; tiles that it has are not made again.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from ..field.georeference import Georeference
from ..field.heightfield import HeightField
from ..field.store import changed_ns, open_store, read_json
from ..field.store_folder import FIRST, named_folder
from ..rasters.raster import ImportSettings, Raster
from ..tiling.coarse_land import CoarseLand
from ..tiling.tile_grid import TileGrid
from .finer_squares import finer_source, finer_squares, square_bits
from .thinning import REFINED, loaded_m, positions, refined_m, spread, stride_of

FACTOR = 8
BITS = 10  # of the tiles
MAX_READ = 1 << 22  # samples of the source that are read at once
FEWEST = 1 << 29  # samples of a raster whose complete import takes much longer than this step


def first_picture(store: Path) -> Path:
    """Return the folder of the first picture, the store of a quick import with few samples.

    It is inside a store with loaded tiles, else it is the store itself.
    """
    folder = named_folder(store)
    inner = None if folder is None else folder / FIRST
    return inner if inner is not None and changed_ns(inner) else store  # changed_ns: 0 without a store there


def coarse_land(settings: ImportSettings, picture: Path) -> CoarseLand:
    """Return the heights of a quick import in the folder `picture`, around which the settings' tiles are loaded.

    Raises TerrainError if the folder holds no first picture.
    """
    field = open_store(picture)
    full = _full_size(field)
    if full is None:
        raise TerrainError(f"The store {picture} has no first picture", fix="import quickly first")
    bits = _loaded_bits(field, full)  # log2 of a loaded tile's cells along a cell of the picture
    return CoarseLand(field, read_json(picture)["digest"], bits, loaded=frozenset(settings.loaded_tiles))


def refined(raster: Raster, settings: ImportSettings, land: CoarseLand) -> Raster:
    """Return a raster on the grid of a quick import with 2^land.bits cells along each cell, to load single tiles.

    Its samples are those of `raster` that are nearest to the grid's positions. It reads `raster` on demand, and closes
    it. Its `squares` has the finer files of a mosaic, of which the settings choose some parts. land: the quick import.
    """
    stride = stride_of(raster.width, raster.height, settings.quick)
    counts = [(len(positions(count, stride)) - 1) << land.bits for count in (raster.width, raster.height)]
    columns, rows = spread(raster.width, counts[0]), spread(raster.height, counts[1])

    def window(first: int, count: int, column: int, width: int) -> np.ndarray:
        """Return a window of the finer grid, NaN where samples are missing."""
        wanted_rows, wanted_columns = rows[first : first + count], columns[column : column + width]
        if raster.pick is not None:
            values = raster.pick(wanted_rows, wanted_columns)
            fine.shifted = raster.shifted  # the error of datums, which `pick` has set
            return values
        left, num_columns = int(wanted_columns[0]), int(wanted_columns[-1] - wanted_columns[0]) + 1
        if raster.window is None:  # whole rows are read
            left, num_columns = 0, raster.width
        # Read the rows in bands of at most MAX_READ samples; bands: number of the band of each row.
        bands = (wanted_rows - wanted_rows[0]) // max(1, MAX_READ // num_columns)
        parts, raster.moved = [], 0.0
        for band in np.split(wanted_rows, np.flatnonzero(np.diff(bands)) + 1):
            top, num_rows = int(band[0]), int(band[-1] - band[0]) + 1
            read = (
                raster.read(top, num_rows) if raster.window is None else raster.window(top, num_rows, left, num_columns)
            )
            parts.append(read[np.ix_(band - top, wanted_columns - left)])
        fine.moved = max(fine.moved, raster.moved)  # of a reprojected raster
        return np.concatenate(parts)

    place = raster.georeference or Georeference(first_row_south=settings.first_row_south)
    # a finer step in steps of the raster, along columns and rows
    ratios = (raster.width - 1) / counts[0], (raster.height - 1) / counts[1]
    fine = replace(
        raster,
        width=counts[0] + 1,
        height=counts[1] + 1,
        read=lambda first, count: window(first, count, 0, counts[0] + 1),
        window=window,
        pick=None,
        original=None,
        inputs=None,
        georeference=place.with_steps_times(*(ratios[::-1] if place.transposed else ratios)),
        full_size=(raster.width, raster.height),
        squares=finer_source(raster, counts, settings.loaded_finer),
    )
    if fine.squares is not None and fine.squares.squares:  # some squares are chosen
        fine.finer = fine.squares
    return fine


def is_large(field: HeightField) -> bool:
    """Return whether a field is of a quick import of so large a raster that its tiles in view are loaded first.

    Such a raster has FEWEST samples or more; a smaller one is soon imported completely.
    """
    full = _full_size(field)
    return full is not None and full[0] * full[1] >= FEWEST


def loaded_tiles(provenance: dict) -> frozenset[int]:
    """Return the numbers of the loaded tiles of a store; none for a complete store or a first picture."""
    numbers = provenance.get("settings", {}).get("loaded_tiles") if REFINED in provenance else None
    return frozenset(number for number in numbers or () if type(number) is int and number >= 0)


def with_loaded(
    settings: ImportSettings, store: Path, tiles: Iterable[int] = (), squares: Iterable[int] = ()
) -> ImportSettings:
    """Return settings that load further tiles and squares in addition to those of a store. Raises TerrainError.

    tiles: numbers of TileGrid for heights of the raster. squares: numbers of squares of a mosaic's finer files.
    """
    field = open_store(store)
    before = finer_squares(field)
    numbers = loaded_tiles(field.provenance).union(tiles), (before.loaded if before else frozenset()).union(squares)
    return replace(settings, loaded_tiles=tuple(sorted(numbers[0])), loaded_finer=tuple(sorted(numbers[1])))


def loaded_at(field: HeightField, x: float, y: float) -> float | None:
    """Return the step to which a store is loaded at a point, metres; None for a complete store.

    x, y: metres from the raster's middle; beyond its border the nearest tile counts.
    """
    # steps: metres of the first picture, and of all samples. tiles: metres of the loaded tiles, and their number.
    steps, tiles, squares = loaded_m(field.provenance), refined_m(field.provenance), finer_squares(field)
    if steps is None or tiles is None:  # a complete store, or a first picture alone, which has one step
        return steps and steps[0]
    (west, south, _, _), lattice = field.lattice.rectangle(), field.lattice
    grid = TileGrid(lattice, BITS)
    positions = ((x - west) / lattice.step_x, lattice.cells_x), ((y - south) / lattice.step_y, lattice.cells_y)
    cell_x, cell_y = (int(min(max(cell, 0), cells - 1)) for cell, cells in positions)
    if squares is not None:
        shift = square_bits(squares.bits)  # log2 of the cells along a square
        if (cell_y >> shift) * TileGrid(lattice, shift).columns + (cell_x >> shift) in squares.loaded:
            return squares.finest_m
    column, row = cell_x >> BITS, cell_y >> BITS
    return tiles[0] if row * grid.columns + column in loaded_tiles(field.provenance) else steps[0]


def picture_tiles(picture: HeightField) -> int:
    """Return the number of tiles that can be loaded around the heights of a quick import."""
    side = picture_side(picture)
    return -(-picture.lattice.cells_x // side) * -(-picture.lattice.cells_y // side)


def are_all_samples(picture: HeightField) -> bool:
    """Return whether the tiles of a first picture have all samples of its source, and not a coarser step."""
    full = _full_size(picture)
    assert full is not None, "it is a first picture"
    return stride_of(*full, picture.provenance["settings"]["quick"]) <= FACTOR


def picture_side(picture: HeightField) -> int:
    """Return the number of cells of a quick import along a side of one of its tiles."""
    full = _full_size(picture)
    assert full is not None, "it is a first picture"
    return 1 << BITS - _loaded_bits(picture, full)


def _full_size(field: HeightField) -> tuple[int, int] | None:
    """Return columns and rows of the source of a first picture; None for any other field or damaged entries."""
    # loaded_m: steps of an incomplete store; with REFINED it has loaded tiles, so it is no first picture any more.
    if field.path is None or loaded_m(field.provenance) is None or REFINED in field.provenance:
        return None
    full = read_json(field.path)["report"].get("full_raster")
    # the number of samples of the quick import is checked, too: callers read it
    values = [*full, field.provenance.get("settings", {}).get("quick")] if isinstance(full, list) else []
    is_known = [type(value) for value in values] == [int] * 3 and min(values) > 1
    return (values[0], values[1]) if is_known else None


def _loaded_bits(field: HeightField, full: tuple[int, int]) -> int:
    """Return log2 of the number of cells along a side that loaded heights have in one cell of a quick import.

    The number is FACTOR, or less if the complete raster has fewer there; both are powers of two. full: columns and rows
    of the complete raster. settings["quick"] is the number of samples that were asked for.
    """
    return min(FACTOR, stride_of(*full, field.provenance["settings"]["quick"])).bit_length() - 1
