# SPDX-License-Identifier: GPL-3.0-or-later
"""From a raster's georeference to metres: how far apart its samples are, and where its middle lies."""

import math
import re
from dataclasses import dataclass

from ..ask.linear import length
from ..errors import TerrainError

# Semi-major axis in metres and inverse flattening.
WGS84 = (6378137.0, 298.257223563)
# Metres; a surface's coordinates are float32, which holds a terrain between these with all its digits.
SMALLEST_EXTENT, LARGEST_EXTENT = 1e-30, 1e30
# A part of a length by which degrees are said to be off, from here on.
SHOWN_RIM_ERROR = 1e-3
_ELLIPSOID = re.compile(r'(?:SPHEROID|ELLIPSOID)\["[^"]*",\s*([\d.eE+]+),\s*([\d.eE+]+)')

# What is said of a raster whose rows are not along x of its coordinate system.
ROTATED = "The raster is rotated against its coordinate system; it is laid out along its own rows."


@dataclass(frozen=True)
class Georeference:
    """Distances of samples in metres; `middle` is the CRS position (x, y) of the raster's middle, in the CRS's unit.
    `size_warnings` are those that an extent in metres makes needless."""

    step_x: float = 1.0
    step_y: float = 1.0
    middle: tuple[float, float] = (0.0, 0.0)
    crs: str = ""
    first_row_south: bool = False
    first_column_east: bool = False
    warnings: tuple[str, ...] = ()
    size_warnings: tuple[str, ...] = ()


def ellipsoid_of(wkt: str) -> tuple[float, float]:
    """Semi-major axis (metres) and inverse flattening (0: a sphere) named in a CRS's WKT; WGS 84 if there is none."""
    found = _ELLIPSOID.search(wkt)
    return (float(found[1]), float(found[2])) if found else WGS84


def degree_lengths(latitude: float, ellipsoid: tuple[float, float] = WGS84) -> tuple[float, float]:
    """Metres in a degree of longitude and in a degree of latitude at `latitude` (degrees).

    The radii of curvature of the ellipsoid in the prime vertical and in the meridian.
    """
    semi_major, inverse_flattening = ellipsoid
    flattening = 1.0 / inverse_flattening if inverse_flattening else 0.0
    squared = flattening * (2.0 - flattening)
    sine = math.sin(math.radians(latitude))
    bend = 1.0 - squared * sine * sine
    prime_vertical = semi_major / math.sqrt(bend)
    meridian = semi_major * (1.0 - squared) / bend**1.5
    return math.radians(prime_vertical * math.cos(math.radians(latitude))), math.radians(meridian)


def rim_error(latitude: float, rims: list[float], ellipsoid: tuple[float, float] = WGS84) -> float:
    """How far off lengths are at the latitudes `rims` (degrees) at most, as a part of the true ones, where a degree is
    taken to be as long as at `latitude`; infinite at a pole."""
    taken = degree_lengths(latitude, ellipsoid)
    true = [degree_lengths(rim, ellipsoid) for rim in rims if abs(rim) < 90.0]
    if len(true) < len(rims):
        return math.inf
    return max(abs(taken[axis] / lengths[axis] - 1.0) for lengths in true for axis in (0, 1))


def from_transform(
    transform: tuple[float, float, float, float, float, float],
    width: int,
    height: int,
    *,
    crs: str = "",
    degrees: float = 0.0,
    metres: float = 1.0,
    ellipsoid: tuple[float, float] = WGS84,
) -> Georeference:
    """The georeference of a raster of `width` x `height` samples.

    transform: (a, b, c, d, e, f) takes column and row of a cell's *corner* to x = a col + b row + c and
    y = d col + e row + f. Samples lie in the middle of cells: of a pixel-is-area raster by definition, of a
    pixel-is-point raster because GDAL has moved its corner by half a cell, so that both differ by half a cell, exactly.
    degrees: degrees in the CRS's unit if that is an angle, else 0. metres: metres in the CRS's unit if it is a length.
    """
    a, b, c, d, e, f = transform
    x, y = a * width / 2 + b * height / 2 + c, d * width / 2 + e * height / 2 + f
    along, down = length((a, d)), length((b, e))
    if not all(map(math.isfinite, (x, y, along, down))) or along == 0.0 or down == 0.0:
        raise TerrainError(f"The raster's georeference {transform} gives its cells no size: give the extent in metres.")
    warnings, size_warnings = [], []
    if degrees:
        latitude = y * degrees
        if abs(latitude) > 89.9:
            raise TerrainError(
                f"The raster's middle is at latitude {latitude:.6g} degrees, where a degree of longitude has no "
                "length: project it first, or give the extent in metres."
            )
        per_x, per_y = (degrees * length for length in degree_lengths(latitude, ellipsoid))
        rims = [degrees * (d * column + e * row + f) for column in (0, width) for row in (0, height)]
        error = rim_error(latitude, rims, ellipsoid)
        if error >= SHOWN_RIM_ERROR:
            off = f"by up to {100.0 * error:.2g} %" if error < 10.0 else "many times over, since a pole is near"
            size_warnings.append(
                f"The raster is in degrees, whose length at its middle latitude is taken everywhere: at its rim, "
                f"lengths are off {off}. To have them right, import it with a projection (utm, or EPSG:n)."
            )
    else:
        per_x = per_y = metres
        if not crs and max(along, down) < 0.1 and abs(x) <= 180.0 and abs(y) <= 90.0:
            size_warnings.append(
                f"The file names no coordinate system and its cells measure {along:.6g}: taken as metres. If these are "
                "degrees, give the extent in metres."
            )
    if b or d:
        warnings.append(ROTATED)
    south, east = (e > 0.0, a < 0.0) if not (b or d) else (False, False)
    steps = along * per_x, down * per_y
    return Georeference(*steps, (x, y), crs, south, east, tuple(warnings), tuple(size_warnings))
