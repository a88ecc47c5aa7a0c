# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles of a known land in several systems, and an independent sampler of them.

The sampler knows the arrays that tiles were cut from, and takes every position through PROJ by itself.
"""

from dataclasses import dataclass

import numpy as np
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from rasterio.transform import from_origin
from rasterio.warp import transform
from rasters import write_raster

UTM32, UTM33, DEGREES = "EPSG:32632", "EPSG:32633", "EPSG:4326"
EAST, NORTH = 572_000.0, 5_540_500.0  # a place at 50 degrees north in UTM zone 32


def settings_of(*sources, **more) -> ImportSettings:
    """Return the settings for one terrain from several files."""
    return ImportSettings(str(sources[0]), more_sources=tuple(map(str, sources[1:])), **more)


def land(x, y):
    """Return heights in metres at coordinates of UTM zone 32."""
    return 800.0 + 90.0 * np.sin(x / 310.0) * np.cos(y / 270.0) + 12.0 * np.sin(x / 41.0 + y / 57.0)


def moved(source, target, x, y):
    """Return coordinates in another system, exact, in the shape of the given ones."""
    x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
    if source == target:  # PROJ would return the same numbers, through lists of Python
        return x.copy(), y.copy()
    found = transform(source, target, x.ravel(), y.ravel())
    return np.array(found[0]).reshape(x.shape), np.array(found[1]).reshape(x.shape)


@dataclass
class Sheet:
    """Heights of one kind of file: float64 [rows, columns] in metres, north first, pixel corners at west and north."""

    crs: str
    west: float
    north: float
    step_x: float
    step_y: float
    heights: np.ndarray

    def indices(self, crs, x, y):
        """Return columns and rows of positions."""
        x, y = moved(crs, self.crs, x, y)
        return (x - self.west) / self.step_x - 0.5, (self.north - y) / self.step_y - 0.5

    def at(self, crs, x, y):
        """Return bilinear heights at positions, NaN outside of the samples and beside missing ones."""
        u, v = self.indices(crs, x, y)
        rows, columns = self.heights.shape
        inside = (u > -1e-7) & (u < columns - 1 + 1e-7) & (v > -1e-7) & (v < rows - 1 + 1e-7)
        p, q = np.clip(np.floor(u), 0, columns - 2).astype(int), np.clip(np.floor(v), 0, rows - 2).astype(int)
        s, t = u - p, v - q
        z = (self.heights[q, p] * (1 - s) + self.heights[q, p + 1] * s) * (1 - t)
        z = z + (self.heights[q + 1, p] * (1 - s) + self.heights[q + 1, p + 1] * s) * t
        return np.where(inside, z, np.nan)

    def write(self, path, first_row=0, rows=None, first_column=0, columns=None, *, unit=1.0, kind="float32", **options):
        """Write a part as a GeoTIFF. unit: metres in one of its values."""
        rows = self.heights.shape[0] - first_row if rows is None else rows
        columns = self.heights.shape[1] - first_column if columns is None else columns
        part = self.heights[first_row : first_row + rows, first_column : first_column + columns] / unit
        part = np.where(np.isnan(part), -9999.0, np.rint(part) if "int" in kind else part).astype(kind)
        place = from_origin(
            self.west + first_column * self.step_x, self.north - first_row * self.step_y, self.step_x, self.step_y
        )
        options = {"crs": self.crs, "transform": place, "nodata": -9999.0} | options
        path.parent.mkdir(parents=True, exist_ok=True)
        return write_raster(path, part, **options)


def sheet(crs, west, north, step_x, step_y, columns, rows, shift=0.0, unit=1.0):
    """Return the land in a system, rounded as a float32 of a unit stores it. shift: metres added."""
    i, j = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    x, y = moved(crs, UTM32, west + i * step_x, north - j * step_y)
    stored = ((land(x, y) + shift) / unit).astype(np.float32)
    return Sheet(crs, west, north, step_x, step_y, stored.astype(np.float64) * unit)


def top(sheets, crs, x, y):
    """Return heights of the last sheet that has one at each position."""
    heights = np.full(np.shape(x), np.nan)
    for one in sheets:
        found = one.at(crs, x, y)
        heights = np.where(np.isnan(found), heights, found)
    return heights
