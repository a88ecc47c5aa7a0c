# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights above different vertical datums as heights above one of them, by PROJ's grids of geoids.

rasterio's wheel has no grids. They are searched in the folders of the user's own PROJ, and used for heights alone, of
which the report tells: grids for positions would make a terrain depend on the machine.
"""

import math
import os
import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import TerrainError, shown
from ..rasters.grid_pieces import interpolation_error
from ..run.child import GRID_FOLDERS
from .catalogue import SourceTile
from .systems import ELLIPSOID, crs_of, projected

GEOGRAPHIC, GEOGRAPHIC_3D = "EPSG:4326", "EPSG:4979"  # the second with heights above the ellipsoid of WGS 84
# PROJ's files with heights of a geoid above that ellipsoid, by the name of the datum.
GRIDS = {
    "EGM84": ("us_nga_egm84_30.tif", "egm84_30.gtx"),
    "EGM96": ("us_nga_egm96_15.tif", "egm96_15.gtx"),
    "EGM2008": ("us_nga_egm08_25.tif", "egm08_25.gtx"),
}
GEOID = (
    'COMPD_CS["geoid",{plane},VERT_CS["geoid",VERT_DATUM["geoid",2005,EXTENSION["PROJ4_GRIDS","{grid}"]],'
    'UNIT["metre",1],AXIS["Up",UP]]]'
)
SPACINGS = (32, 16, 8)  # samples between nodes at most, the first whose error is small enough, or the last
MAX_ERROR_M = 0.01
MARGIN = 2.0  # a bound of the error over that in the middle of two nodes: grids have kinks at any place between them
USER_FOLDERS = {"darwin": "~/Library/Application Support/proj", "win32": "~/AppData/Local/proj"}
SYSTEM_FOLDERS = ("/usr/share/proj", "/usr/local/share/proj")


class ShiftNodes(NamedTuple):
    """Metres to add to a tile's heights, at nodes evenly spread from its first to its last samples.

    Attributes:
        metres: float64 [rows, columns] of nodes.
        size: rows and columns of the tile's samples.
        error_m: largest error between nodes.
    """

    metres: np.ndarray
    size: tuple[int, int]
    error_m: float

    def window(
        self, row: int, rows: int, column: int, columns: int, counts: tuple[int, int] | None = None
    ) -> np.ndarray:
        """Return the metres at a window of samples; a sample's value does not depend on the window.

        counts: rows and columns of an overview if the samples are of one.
        """
        counts = counts or self.size
        # Of each row and column of the window: the node before it, and the fraction of the way to the next one.
        i, t = self._node_positions(0, row, rows, counts[0])
        j, s = self._node_positions(1, column, columns, counts[1])
        nodes = self.metres[i] * (1.0 - t)[:, None] + self.metres[i + 1] * t[:, None]
        return nodes[:, j] * (1.0 - s) + nodes[:, j + 1] * s

    def _node_positions(self, axis: int, first: int, count: int, all_count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the nodes before samples first .. first + count - 1, and the fractions of the way to the next nodes.

        axis: 0 for rows, 1 for columns. all_count: samples of the raster or of its overview along it.
        """
        cells, size = self.metres.shape[axis] - 1, self.size[axis]
        samples = (np.arange(first, first + count) + 0.5) * size / all_count - 0.5  # numbers in the tile itself
        positions = samples * cells / max(size - 1, 1)
        nodes = np.minimum(positions.astype(np.int64), cells - 1)
        return nodes, positions - nodes


class DatumShifts:
    """Conversion of a mosaic's tiles to the datum of `reference`.

    Attributes:
        reference: the first tile that names a datum.
    """

    def __init__(self, reference: SourceTile) -> None:
        """Convert to the datum of a tile."""
        self.reference = reference
        self._nodes: dict[str, ShiftNodes] = {}

    def window(
        self, tile: SourceTile, counts: tuple[int, int], row: int, rows: int, column: int, columns: int
    ) -> np.ndarray | float:
        """Return metres to add to a window of a tile's heights: float64 [rows, columns]; 0.0 if it needs no shift.

        counts: rows and columns of the tile or of its overview. Raises TerrainError where a grid ends.
        """
        nodes = self._shifts_of(tile)
        return 0.0 if nodes is None else nodes.window(row, rows, column, columns, counts)

    def error_of(self, tile: SourceTile) -> float:
        """Return the largest error, metres, of the conversion of a tile's heights to the common datum; 0 without one.

        Raises TerrainError where a grid of PROJ ends.
        """
        nodes = self._shifts_of(tile)
        return 0.0 if nodes is None else nodes.error_m

    def _shifts_of(self, tile: SourceTile) -> ShiftNodes | None:
        """Return the metres to add to a tile's heights, at nodes spread over it; None for a tile that needs no shift.

        They are computed once for each path.
        """
        if tile.datum in ("", self.reference.datum):
            return None
        if tile.path not in self._nodes:
            self._nodes[tile.path] = self._find_nodes(tile)
        return self._nodes[tile.path]

    def _find_nodes(self, tile: SourceTile) -> ShiftNodes:
        """Return the nodes of a tile from PROJ's grids, with the widest of SPACINGS whose error is at most MAX_ERROR_M.

        If no spacing is fine enough, the nodes have the last one. Raises TerrainError where a grid ends.
        """
        for spacing in SPACINGS:
            down, across = (  # every second one is a node, the others measure the error between nodes
                np.linspace(0.0, count - 1, 2 * max(math.ceil((count - 1) / spacing), 1) + 1)
                for count in (tile.height, tile.width)
            )
            columns, rows = np.meshgrid(across, down)
            exact = self.metres_at(tile, columns.ravel(), rows.ravel()).reshape(columns.shape)
            if not np.isfinite(exact).all():
                what = f"PROJ's grid for {shown(tile.datum, 60)} or {shown(self.reference.datum, 60)} ends in"
                raise TerrainError(
                    f"{what} {shown(tile.path)}",
                    fix="remove the grid from PROJ's folder to import without a conversion, or get a larger one",
                )
            error = MARGIN * interpolation_error(exact)  # MARGIN: it may be larger elsewhere than halfway
            if error <= MAX_ERROR_M:
                break
        return ShiftNodes(np.ascontiguousarray(exact[::2, ::2]), (tile.height, tile.width), error)

    def grids(self, tiles: Sequence[SourceTile]) -> list[Path]:
        """Return the files of PROJ's grids that convert the datums of these tiles, once each.

        Heights above the ellipsoid need no grid.
        """
        datums = dict.fromkeys(tile.datum for tile in tiles if tile.datum)
        return [Path(grid) for grid in map(_grid_of, datums) if grid is not None]

    def metres_at(self, tile: SourceTile, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return metres that convert heights at samples of a tile to the common datum: float64 [n], NaN without a grid.

        columns, rows: of the samples, float64 [n].
        """
        x, y = tile.position(columns, rows)
        return _above_ellipsoid(tile.datum, tile.crs, x, y) - _above_ellipsoid(self.reference.datum, tile.crs, x, y)


def find_shifts(tiles: Sequence[SourceTile]) -> DatumShifts | None:
    """Return the shifts to the datum of the first tile that names one.

    None if fewer than two datums are named, or if a grid is missing or does not reach the corners of a tile.
    """
    named = [tile for tile in tiles if tile.datum]
    if len({tile.datum for tile in named}) < 2:
        return None
    shifts = DatumShifts(named[0])
    for tile in named:
        if tile.datum != named[0].datum:
            right, bottom = tile.width - 1.0, tile.height - 1.0
            corners = np.array([0.0, right, 0.0, right]), np.array([0.0, 0.0, bottom, bottom])
            if not np.isfinite(shifts.metres_at(tile, *corners)).all():
                return None
    return shifts


def _above_ellipsoid(datum: str, crs: str, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return metres from the ellipsoid up to the zero surface of a vertical datum; NaN where PROJ has no grid of it.

    crs: name of the system of x and y, arrays of one shape.
    """
    from rasterio.crs import CRS
    from rasterio.warp import transform

    if datum == ELLIPSOID:
        return np.zeros(len(x))
    grid = _grid_of(datum)
    if grid is None:
        return np.full(len(x), np.nan)
    # Let PROJ convert height 0 above the datum, a system defined by the grid of its geoid, to one above the ellipsoid.
    longitude, latitude = projected(crs, GEOGRAPHIC, x, y)
    geoid = GEOID.format(plane=crs_of(GEOGRAPHIC).to_wkt(version="WKT1_GDAL"), grid=grid)
    try:
        transformed = transform(CRS.from_wkt(geoid), crs_of(GEOGRAPHIC_3D), longitude, latitude, np.zeros(len(x)))
    except Exception:  # the grid ends here or is damaged; PROJ raises many kinds
        return np.full(len(x), np.nan)
    return np.where(np.isfinite(transformed[2]), transformed[2], np.nan)


@lru_cache(maxsize=len(GRIDS))
def _grid_of(datum: str) -> str | None:
    """Return the path of a datum's grid in the folders of the user's PROJ, None if there is none.

    The folders are those in the variable GRID_FOLDERS, which holds the parent process's PROJ_DATA, and the usual ones.
    """
    user = os.environ.get("XDG_DATA_HOME", "~/.local/share") + "/proj"
    folders = [*os.environ.get(GRID_FOLDERS, "").split(os.pathsep), USER_FOLDERS.get(sys.platform, user)]
    for folder in filter(None, (*folders, *SYSTEM_FOLDERS)):
        for name in GRIDS.get(datum, ()):
            file = os.path.join(os.path.expanduser(folder), name)
            if os.path.isfile(file) and '"' not in file:  # a quote would end the name in GEOID
                return file
    return None
