# SPDX-License-Identifier: GPL-3.0-or-later
"""Steps between samples in metres, and the position of a raster's middle in units of its CRS, from a georeference."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..errors import TerrainError
from ..view.linear import length

# Semi-major axis in metres and inverse flattening.
WGS84 = (6378137.0, 298.257223563)
# Limits of an extent, metres, within which float32 coordinates have full precision.
SMALLEST_EXTENT, LARGEST_EXTENT = 1e-30, 1e30
# Smallest relative error of lengths at the border that is worth a warning.
MIN_SHOWN_ERROR = 1e-3
Transform = tuple[float, float, float, float, float, float]
# (a, b, c, d, e, f) maps metres in the terrain's space to coordinates of its CRS: a x + b y + c and d x + e y + f.
Place = tuple[float, float, float, float, float, float]
_EPSG = re.compile(r"EPSG:\d{1,7}")
_ELLIPSOID = re.compile(r'(?:SPHEROID|ELLIPSOID)\["[^"]*",\s*([\d.eE+]+),\s*([\d.eE+]+)')

# Skew per cell, in cells, that counts as rounding.
MAX_SKEW = 1e-6

# Warning of older stores, whose report has no `rotation_deg`.
ROTATED = "The raster is rotated against its coordinate system; it is laid out along its own rows."


@dataclass(frozen=True)
class Georeference:
    """Spacing of samples in metres, and the position of the raster's middle (x, y) in units of its CRS.

    Attributes:
        first_row_south, first_column_east: whether the file's first sample is in the south, in the east.
        transposed: whether the file's rows run along y and its columns along x.
        rotation_deg: degrees from x of the CRS to x of the terrain, counterclockwise.
        across, up: differences of CRS coordinates (x, y) between samples along x and along y of the terrain; None
            without a geotransform.
        size_warnings: warnings that do not apply if the user gives an extent in metres.
    """

    step_x: float = 1.0
    step_y: float = 1.0
    middle: tuple[float, float] = (0.0, 0.0)
    crs: str = ""
    first_row_south: bool = False
    first_column_east: bool = False
    transposed: bool = False
    rotation_deg: float = 0.0
    across: tuple[float, float] | None = None
    up: tuple[float, float] | None = None
    warnings: tuple[str, ...] = ()
    size_warnings: tuple[str, ...] = ()

    @property
    def place(self) -> Place | None:
        """Return the affine map from the terrain's space to the CRS, None without a geotransform.

        (x, y) in metres from the raster's middle becomes (a x + b y + c, d x + e y + f) in units of the CRS.
        """
        if self.across is None or self.up is None:
            return None
        (a, d), (b, e) = (v / self.step_x for v in self.across), (v / self.step_y for v in self.up)
        return a, b, self.middle[0], d, e, self.middle[1]

    def with_steps_times(self, along_x: float, along_y: float) -> "Georeference":
        """Return the georeference of a raster with the same middle and steps times `along_x` and `along_y`."""
        across, up = (
            None if step is None else (step[0] * ratio, step[1] * ratio)
            for step, ratio in ((self.across, along_x), (self.up, along_y))
        )
        return replace(self, step_x=self.step_x * along_x, step_y=self.step_y * along_y, across=across, up=up)

    def in_file_order(self, heights: np.ndarray) -> np.ndarray:
        """Return a view of `heights` [y, x], row 0 south, whose rows and columns are those of the file."""
        heights = heights if self.first_row_south else heights[::-1]
        heights = heights[:, ::-1] if self.first_column_east else heights
        return heights.T if self.transposed else heights


def known_place(place: Place | None, crs: str, origin: Sequence[float] | np.ndarray) -> Place | None:
    """Return the affine map from a terrain's space, metres, to its CRS; None if that is unknown.

    place: the map that the store records, or None. Without one and without a CRS, the map adds the origin; without one,
    but with a CRS, it is unknown, as is the CRS's unit. crs: name of the system, "" without one. origin: CRS
    coordinates of the terrain's middle.
    """
    return place if place or crs else (1.0, 0.0, float(origin[0]), 0.0, 1.0, float(origin[1]))


def move_place(place: Place, x: float, y: float) -> Place:
    """Return the place of the same terrain in a space whose origin is at (x, y), metres."""
    (east,), (north,) = to_crs(place, np.array([[x, y]])).T
    return place[0], place[1], float(east), place[3], place[4], float(north)


def to_crs(place: Place, positions: np.ndarray) -> np.ndarray:
    """Return CRS coordinates, float64 [n, 2], of positions in the terrain's space, metres.

    place: the map to the CRS.
    """
    (x, y), (a, b, c, d, e, f) = np.asarray(positions, np.float64).T, place
    return np.stack([a * x + b * y + c, d * x + e * y + f], axis=1)


def from_crs(place: Place, coordinates: np.ndarray) -> np.ndarray:
    """Return positions in the terrain's space, float64 [n, 2] metres, of CRS coordinates. place: the map to the CRS."""
    a, b, c, d, e, f = place
    x, y = np.asarray(coordinates, np.float64).T - np.array([[c], [f]])
    return np.stack([e * x - b * y, a * y - d * x], axis=1) / (a * e - b * d)


def ellipsoid_of(wkt: str) -> tuple[float, float]:
    """Return semi-major axis (metres) and inverse flattening (0: a sphere) from a CRS's WKT; WGS 84 if it has none."""
    match = _ELLIPSOID.search(wkt)
    return (float(match[1]), float(match[2])) if match else WGS84


def degree_lengths(latitude: float, ellipsoid: tuple[float, float] = WGS84) -> tuple[float, float]:
    """Return the metres in a degree of longitude and in a degree of latitude at `latitude` (degrees).

    They follow from the ellipsoid's radii of curvature in the prime vertical and in the meridian.
    """
    semi_major, inverse_flattening = ellipsoid
    flattening = 1.0 / inverse_flattening if inverse_flattening else 0.0
    eccentricity2 = flattening * (2.0 - flattening)
    sine = math.sin(math.radians(latitude))
    factor = 1.0 - eccentricity2 * sine * sine
    prime_vertical = semi_major / math.sqrt(factor)
    meridian = semi_major * (1.0 - eccentricity2) / factor**1.5
    return math.radians(prime_vertical * math.cos(math.radians(latitude))), math.radians(meridian)


def border_error(latitude: float, borders: list[float], ellipsoid: tuple[float, float] = WGS84) -> float:
    """Return how wrong lengths become at the latitudes `borders` where the length of a degree at `latitude` is used.

    The result is the largest relative error, infinity if a border is at or beyond a pole; all latitudes are degrees.
    ellipsoid: semi-major axis in metres, and inverse flattening (0 for a sphere).
    """
    used = degree_lengths(latitude, ellipsoid)
    true = [degree_lengths(border, ellipsoid) for border in borders if abs(border) < 90.0]
    if len(true) < len(borders):
        return math.inf
    return max(abs(used[axis] / lengths[axis] - 1.0) for lengths in true for axis in (0, 1))


def without_rounded_skew(transform: Transform) -> Transform:
    """Return a geotransform whose skew is 0 where it is rounding: less than MAX_SKEW cells per cell along both axes.

    If rows run along y, the skew is in a and e. Raises TerrainError for numbers that are not finite and for cells
    without an area, whose rows and columns have one direction.
    """
    a, b, c, d, e, f = transform
    area, lengths = abs(a * e - b * d), length((a, d)) * length((b, e))
    if not math.isfinite(lengths) or area <= MAX_SKEW * lengths:
        raise TerrainError(
            f"The raster's georeference {tuple(transform)} gives its cells no size", fix="give the extent in metres"
        )
    if abs(b) < MAX_SKEW * abs(a) and abs(d) < MAX_SKEW * abs(e):
        b = d = 0.0
    elif abs(a) < MAX_SKEW * abs(b) and abs(e) < MAX_SKEW * abs(d):
        a = e = 0.0
    return a, b, c, d, e, f


def is_sheared(transform: Transform, metres_x: float, metres_y: float) -> bool:
    """Return whether rows and columns are not perpendicular on the ground. metres_x, metres_y: in a unit of x and y."""
    a, b, _, d, e, _ = transform
    column, row = (a * metres_x, d * metres_y), (b * metres_x, e * metres_y)
    return abs(column[0] * row[0] + column[1] * row[1]) > MAX_SKEW * length(column) * length(row)


def from_transform(
    transform: Transform,
    width: int,
    height: int,
    *,
    crs: str = "",
    degrees: float = 0.0,
    metres: float = 1.0,
    ellipsoid: tuple[float, float] = WGS84,
) -> Georeference:
    """Return the georeference of a raster of `width` x `height` samples.

    Samples are in the middle of cells: of a pixel-is-area raster by definition, of a pixel-is-point raster because GDAL
    moves its corner by exactly half a cell.

    Args:
        transform: (a, b, c, d, e, f) maps column and row of a cell's *corner* to x = a col + b row + c and
            y = d col + e row + f.
        degrees: degrees in the CRS's unit if that is an angle, else 0.
        metres: metres in the CRS's unit if it is a length; not used for an angle.
        crs: its name, "" if the file has none.
        ellipsoid: semi-major axis in metres, and inverse flattening (0: a sphere).

    Warnings about sizes are separate (`size_warnings`), since they do not apply to an extent that the user gives.
    Raises TerrainError for cells without an area, and for a middle that is not finite or lies near a pole.
    """
    a, b, c, d, e, f = without_rounded_skew(transform)
    x, y = a * width / 2 + b * height / 2 + c, d * width / 2 + e * height / 2 + f
    if not (math.isfinite(x) and math.isfinite(y)):
        raise TerrainError(
            f"The raster's middle is at ({x}, {y})", expected="finite numbers", fix="give the extent in metres"
        )
    size_warnings = []
    metres_x = metres_y = metres
    if degrees:
        metres_x, metres_y = _metres_of_degrees(y, degrees, ellipsoid)
        borders = [degrees * (d * column + e * row + f) for column in (0, width) for row in (0, height)]
        size_warnings += _border_warnings(y * degrees, borders, ellipsoid)
    elif not crs and max(map(abs, (a, b, d, e))) < 0.1 and abs(x) <= 180.0 and abs(y) <= 90.0:
        # Cells of less than 0.1 at a possible longitude and latitude are more likely degrees than metres.
        size_warnings.append(
            f"The file names no coordinate system and its cells measure {length((a, d)):.6g}: taken as metres. If "
            "these are degrees, give the extent in metres."
        )
    # Metres between samples along the file's rows and along its columns. Below, `across` and `up` are the steps in
    # units of the CRS from a sample to the next one in the east and in the north of the terrain.
    along, down = length((a * metres_x, d * metres_y)), length((b * metres_x, e * metres_y))
    georeference = partial(Georeference, middle=(x, y), crs=crs, size_warnings=tuple(size_warnings))
    if a == e == 0.0:  # rows run along y
        georeference = partial(georeference, across=(abs(b), 0.0), up=(0.0, abs(d)))
        return georeference(down, along, first_row_south=d > 0.0, first_column_east=b < 0.0, transposed=True)
    if b == d == 0.0:
        georeference = partial(georeference, across=(abs(a), 0.0), up=(0.0, abs(e)))
        return georeference(along, down, first_row_south=e > 0.0, first_column_east=a < 0.0)
    # A counterclockwise turn from rows to columns means that the first row is south.
    rotation = math.degrees(math.atan2(d * metres_y, a * metres_x))
    warning = _rotation_warning(rotation, crs, bool(degrees))
    is_south = a * e > b * d
    georeference = partial(georeference, across=(a, d), up=(b, e) if is_south else (-b, -e))
    return georeference(along, down, first_row_south=is_south, rotation_deg=rotation, warnings=(warning,))


def _metres_of_degrees(y: float, degrees: float, ellipsoid: tuple[float, float]) -> tuple[float, float]:
    """Return metres in a unit of a geographic CRS along x and y.

    y: the raster's middle, in that unit. degrees: degrees of a unit. ellipsoid: its semi-major axis, metres, and
    inverse flattening. Raises TerrainError within a tenth of a degree of a pole.
    """
    latitude = y * degrees
    if abs(latitude) > 89.9:
        raise TerrainError(
            f"The raster's middle is at latitude {latitude:.6g} degrees, where a degree of longitude has no length",
            fix="project it first, or give the extent in metres",
        )
    along_x, along_y = degree_lengths(latitude, ellipsoid)
    return degrees * along_x, degrees * along_y


def _border_warnings(latitude: float, borders: list[float], ellipsoid: tuple[float, float]) -> list[str]:
    """Return a warning if lengths at the latitudes `borders` are off by MIN_SHOWN_ERROR or more, else [].

    latitude: of the raster's middle; all are degrees. ellipsoid: semi-major axis in metres and inverse flattening.
    """
    error = border_error(latitude, borders, ellipsoid)
    if error < MIN_SHOWN_ERROR:
        return []
    off = f"by up to {100.0 * error:.2g} %" if error < 10.0 else "many times over, since a pole is near"
    return [
        f"The raster is in degrees, and their length at its middle latitude is used everywhere: at its border, "
        f"lengths are off {off}. To have them right, import it with utm or EPSG:n as Reproject (--project)."
    ]


def _rotation_warning(rotation: float, crs: str, geographic: bool) -> str:
    """Return the warning about a rotated raster, with the remedy.

    rotation: degrees. crs: name of the coordinate system, "" if the file has none. geographic: whether it has
    degrees instead of metres.
    """
    straighten = f"import it with --project {crs if _EPSG.fullmatch(crs) and not geographic else 'utm'}"
    if not crs:
        straighten = "write its coordinate system into the file and import it with --project"
    return (
        f"The raster is rotated by {rotation:.6g} degrees against {'its' if crs else 'an unnamed'} coordinate system "
        f"and is laid out along its own rows. To straighten it, {straighten}."
    )
