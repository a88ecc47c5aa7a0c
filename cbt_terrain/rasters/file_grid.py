# SPDX-License-Identifier: GPL-3.0-or-later
"""The grid of a GDAL dataset: its coordinate system and its geotransform, if the file has them."""

import functools
import json
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..field.georeference import Transform, degree_lengths, ellipsoid_of, is_sheared, without_rounded_skew
from ..view.linear import lengths, product
from .rasterio_types import CRS, DatasetReader
from .units import plane_metres

# Largest distance, cells, of ground control points from the straight grid that replaces them.
MAX_GCP_CELLS = 0.05
REPORTED = 20  # positions that GDAL reports as errors for each pair of systems, before it returns infinity


class FileGrid(NamedTuple):
    """Coordinate system and geotransform of a file.

    Attributes:
        crs: a rasterio CRS or None.
        transform: from columns and rows of cells' corners to x and y; None if the file does not place its samples.
        problem: why `transform` is None, as a clause after the file's name; "" for a file without any georeference.
        tool: GDAL command that places the raster.
    """

    crs: CRS | None = None
    transform: Transform | None = None
    problem: str = ""
    tool: str = ""

    @property
    def name(self) -> str:
        """Return the name of the coordinate system, "" if there is none."""
        return self.crs.to_string() if self.crs is not None else ""

    @property
    def placed(self) -> Transform:
        """Return the transform of a grid that places its samples."""
        assert self.transform is not None, self.problem
        return self.transform

    def positions(self, columns: ArrayLike, rows: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return x and y of columns and rows, float64, counted from the raster's corner."""
        (a, b, c, d, e, f), columns, rows = self.placed, np.asarray(columns), np.asarray(rows)
        return a * columns + b * rows + c, d * columns + e * rows + f


def grid_of(dataset: DatasetReader) -> FileGrid:
    """Return the grid of a rasterio dataset. Raises TerrainError for a geotransform without an area.

    GDAL returns the identity for a file without a geotransform. A skew that is only rounding becomes 0.
    """
    if not dataset.transform.is_identity:
        return FileGrid(dataset.crs, without_rounded_skew(tuple(dataset.transform)[:6]))
    points, crs = dataset.gcps
    if points:
        return _from_control_points(points, crs)
    if dataset.rpcs is not None:
        return FileGrid(dataset.crs, problem="places its samples by rational polynomials (RPC)", tool="gdalwarp -rpc")
    if dataset.crs is not None:
        problem = f"names the coordinate system {FileGrid(dataset.crs).name[:80]}, but not the position of its samples"
        return FileGrid(dataset.crs, problem=problem, tool="gdal_edit.py -a_ullr")
    return FileGrid()


def _from_control_points(points: list, crs: CRS) -> FileGrid:
    """Return the straight grid through ground control points, by least squares.

    If it misses one by more than MAX_GCP_CELLS, return a grid without a transform, with a `problem` that says why.
    points: rasterio's GroundControlPoints. crs: their system.
    """
    pixels = np.array([(point.col, point.row, 1.0) for point in points], np.float64)
    ground = np.array([(point.x, point.y) for point in points], np.float64)
    if np.isfinite(pixels).all() and np.isfinite(ground).all():
        # Differences from the means make the least squares accurate. The column of ones stays as it is.
        mean_pixel, shift = pixels.mean(axis=0) * (1.0, 1.0, 0.0), ground.mean(axis=0)
        # fit: [3, 2], x and y for a column, for a row, and the constant.
        fit, _, rank, _ = np.linalg.lstsq(pixels - mean_pixel, ground - shift, rcond=None)
        if rank == 3:  # the points are not on one line
            # How far the grid misses each point, [2, n]: the second fit turns differences on the ground into cells.
            offsets = np.linalg.lstsq(fit[:2].T, (product(pixels - mean_pixel, fit) + shift - ground).T, rcond=None)[0]
            if lengths(offsets).max() <= MAX_GCP_CELLS:
                # The constant for coordinates that are no differences: ground = fit(pixel - mean_pixel) + shift.
                (a, d), (b, e), (c, f) = fit[0], fit[1], fit[2] + shift - product(mean_pixel[None, :2], fit[:2])[0]
                a, b, c, d, e, f = (float(f"{number:.13g}") for number in (a, b, c, d, e, f))  # more digits are noise
                return FileGrid(crs, without_rounded_skew((a, b, c, d, e, f)))
    problem = f"places its samples by {len(points)} ground control point(s) that fit no straight grid"
    return FileGrid(crs, problem=problem, tool="gdalwarp -tps")


def unit_of(crs: CRS | None) -> dict:
    """Return the unit of a coordinate system, as arguments of `from_transform`.

    They are {"degrees": degrees in a unit, "ellipsoid": semi-major axis in metres and inverse flattening} of a
    geographic system, else {"metres": metres in a unit}; {} without a system, whose unit is the metre.
    """
    if crs is not None and crs.is_geographic:
        return {"degrees": math.degrees(crs.units_factor[1]), "ellipsoid": ellipsoid_of(crs.to_wkt())}
    return {"metres": plane_metres(crs)} if crs is not None else {}


def unit_lengths(crs: CRS | None, y: float) -> tuple[float, float]:
    """Return the metres in a unit of x and of y of a coordinate system, 1 without one.

    y: coordinate of the position, by whose latitude degrees have their length.
    """
    unit = unit_of(crs)
    if "degrees" not in unit:
        return (unit.get("metres", 1.0),) * 2
    along_x, along_y = degree_lengths(y * unit["degrees"], unit["ellipsoid"])
    return along_x * unit["degrees"], along_y * unit["degrees"]


def has_shear(grid: FileGrid, width: int, height: int) -> bool:
    """Return whether the rows and columns of a placed raster are not perpendicular on the ground.

    width, height: samples of the raster.
    """
    unit = unit_of(grid.crs)
    if "degrees" not in unit:
        return is_sheared(grid.placed, metres_x=1.0, metres_y=1.0)
    # unit["degrees"]: degrees in one unit of the coordinates
    latitude = unit["degrees"] * float(grid.positions(width / 2, height / 2)[1])
    along_x, along_y = degree_lengths(latitude, unit["ellipsoid"])
    return is_sheared(grid.placed, along_x, along_y)


def find_positions(source: CRS, target: CRS, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions in another coordinate system, float64 [n] each, not finite where there are none.

    Raises rasterio's errors for systems without a common one. target: the other system.
    """
    from rasterio.errors import CRSError
    from rasterio.warp import transform

    # GDAL raises an error for the first REPORTED positions that it cannot transform, and returns infinity for others.
    for attempt in range(REPORTED + 1):
        try:
            found = transform(source, target, x, y)
            break
        except Exception as reason:  # perhaps at one of those positions, so try again
            if attempt == REPORTED or isinstance(reason, CRSError):
                raise
    return np.array(found[0]), np.array(found[1])


def base_crs(crs: CRS) -> CRS | None:
    """Return the geographic system below a projected one, None if it has none."""
    return _base_of(crs.to_wkt())


@functools.lru_cache(maxsize=64)
def _base_of(wkt: str) -> CRS | None:
    """Return the geographic system on which the projected system of a WKT is based; None without one.

    The result is cached, because the files of a mosaic share a few systems.
    """
    from rasterio.crs import CRS

    parts = [CRS.from_wkt(wkt).to_dict(projjson=True)]
    while parts:  # compound and bound systems have others inside
        part = parts.pop()
        if "base_crs" in part:
            return CRS.from_user_input(json.dumps(part["base_crs"]))
        parts += [*part.get("components", ()), *filter(None, [part.get("source_crs")])]
    return None
