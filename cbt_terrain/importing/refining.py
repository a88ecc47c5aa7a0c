# SPDX-License-Identifier: GPL-3.0-or-later
"""Second step of a quick import: the tiles that views need are loaded in more detail.

Each cell of the first picture becomes FACTOR x FACTOR cells, or those of the raster if they are larger. The chosen
tiles get true samples of the source, as the first picture has; all others keep its surface (tiling/coarse_land.py).
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..attributes import sizing
from ..attributes.tiling import Tiling
from ..errors import TerrainError
from ..field.georeference import Georeference
from ..field.heightfield import HeightField
from ..field.lattice import Lattice
from ..field.store import open_store, read_json
from ..rasters.raster import ImportSettings, Raster
from ..tiling.coarse_land import CoarseLand
from ..tiling.tile_grid import TileGrid, rows_of
from ..view.view import View
from .thinning import REFINED, loaded_m, positions, stride_of

FACTOR = 8
BITS = 10  # of the tiles
MAX_TILES = 64  # 0.3 s each, and as long for its neighbours
MAX_READ = 1 << 22  # samples of the source that are read at once
FEWEST = 1 << 29  # samples of a raster whose complete import takes much longer than this step


def coarse_land(settings: ImportSettings, store: Path) -> CoarseLand:
    """Return the land of the first picture in a store, with the tiles of the settings. Raises TerrainError."""
    field = open_store(store)
    full = _full_raster(field)
    if full is None:
        raise TerrainError(f"The store {store} has no first picture", fix="import quickly first")
    return CoarseLand(field, _bits(field, full), frozenset(settings.loaded_tiles))


def refined(raster: Raster, settings: ImportSettings, land: CoarseLand) -> Raster:
    """Return a raster with the samples of a land's finer grid. Raises TerrainError for one that has no quick import."""
    stride = stride_of(raster.width, raster.height, settings.quick)
    if stride == 1 or raster.original is not None or settings.holes:
        raise TerrainError(
            f"{settings.name} cannot be loaded by tile",
            expected="a large raster on its own grid without holes",
            fix="import all of it",
        )
    counts = [(len(positions(count, stride)) - 1) << land.bits for count in (raster.width, raster.height)]
    columns, rows = (
        (2 * np.arange(cells + 1) * (count - 1) + cells) // (2 * cells)
        for cells, count in zip(counts, (raster.width, raster.height), strict=True)
    )

    def window(first: int, count: int, column: int, width: int) -> np.ndarray:
        """Return a window of the finer grid, NaN where samples are missing."""
        v, u = rows[first : first + count], columns[column : column + width]
        if raster.pick is not None:
            values = raster.pick(v, u)
            fine.shifted = raster.shifted
            return values
        left, wide = int(u[0]), int(u[-1] - u[0]) + 1
        if raster.window is None:
            left, wide = 0, raster.width
        bands = (v - v[0]) // max(1, MAX_READ // wide)
        parts = []
        for band in np.split(v, np.flatnonzero(np.diff(bands)) + 1):
            top, high = int(band[0]), int(band[-1] - band[0]) + 1
            read = raster.read(top, high) if raster.window is None else raster.window(top, high, left, wide)
            parts.append(read[np.ix_(band - top, u - left)])
        return np.concatenate(parts)

    place = raster.georeference or Georeference(first_row_south=settings.first_row_south)
    along = (raster.width - 1) / counts[0], (raster.height - 1) / counts[1]
    fine = replace(
        raster,
        width=counts[0] + 1,
        height=counts[1] + 1,
        read=lambda first, count: window(first, count, 0, counts[0] + 1),
        window=window,
        pick=None,
        inputs=None,
        georeference=place.with_steps_times(*(along[::-1] if place.transposed else along)),
        full_size=(raster.width, raster.height),
    )
    return fine


def seen_tiles(
    field: HeightField,
    views: Sequence[View],
    placement: np.ndarray,
    error_px: float = 1.0,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
) -> tuple[int, ...]:
    """Return the numbers of the tiles that views of a first picture need, the MAX_TILES most needed ones at most.

    A tile is needed where the finest stored errors are larger than `error_px` pixels, because samples in between are
    about as far from the surface. There are none if the source is small, so that its complete import is soon done.

    Args:
        field: the first picture.
        placement: float64 [4, 4], maps the terrain's space to the world.
    """
    full = _full_raster(field)
    if full is None or full[0] * full[1] < FEWEST:
        return ()
    bits = _bits(field, full)
    grid = TileGrid(_divided(field.lattice, bits), BITS)
    side, lattice = 1 << BITS - bits, field.lattice
    west, south, _, _ = lattice.rectangle()
    tiling = Tiling(grid.columns, grid.rows, west, south, side * lattice.step_x, side * lattice.step_y, 0.0)
    boxes = sizing.boxes(tiling, field, vertical_scale, vertical_offset)
    pixels = sizing.footprints(boxes, views, placement, only_seen=True)
    missing = _finest_errors(field, side).ravel() * abs(vertical_scale)
    with np.errstate(divide="ignore", invalid="ignore"):
        needs = np.nan_to_num(missing / pixels, posinf=np.inf)
    order = np.argsort(-needs, kind="stable")[:MAX_TILES]
    return tuple(sorted(int(tile) for tile in order if needs[tile] > error_px))


def _full_raster(field: HeightField) -> tuple[int, int] | None:
    """Return columns and rows of the source of a first picture; None for any other store."""
    if field.path is None or loaded_m(field.provenance) is None or REFINED in field.provenance:
        return None
    full = read_json(field.path)["report"].get("full_raster")
    values = [*full, field.provenance.get("settings", {}).get("quick")] if isinstance(full, list) else []
    is_known = [type(value) for value in values] == [int] * 3 and min(values) > 1
    return (values[0], values[1]) if is_known else None


def _bits(field: HeightField, full: tuple[int, int]) -> int:
    """Return the binary logarithm of the finer cells along one of a first picture. full: see `_full_raster`."""
    return min(FACTOR, stride_of(*full, field.provenance["settings"]["quick"])).bit_length() - 1


def _divided(lattice: Lattice, bits: int) -> Lattice:
    """Return a lattice with each cell divided into 2**bits x 2**bits."""
    cells = lattice.cells_x << bits, lattice.cells_y << bits
    return Lattice(lattice.columns, lattice.rows, lattice.levels + bits, cells_x=cells[0], cells_y=cells[1])


def _finest_errors(field: HeightField, side: int) -> np.ndarray:
    """Return the largest error, metres, of the finest vertices in each square of side x side cells: [rows, columns]."""
    base, pages = field.lattice.layout()
    codes = rows_of(field.error[base[0] : base[1]], int(pages[0]))
    codes = codes[1 : field.lattice.height : 2, 1 : field.lattice.width : 2]  # centres of 2 x 2 cells
    for axis in (0, 1):
        codes = np.maximum.reduceat(codes, np.arange(0, codes.shape[axis], max(side // 2, 1)), axis=axis)
    return field.table[0][codes]
