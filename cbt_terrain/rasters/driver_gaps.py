# SPDX-License-Identifier: GPL-3.0-or-later
"""Facts in a file that GDAL's driver does not report: units, scales, and coordinates without a known name."""

import re
import struct
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..run.named_file import read_start
from .file_grid import FileGrid
from .rasterio_types import DatasetReader

GRAVITY = 9.80665  # m/s^2: a geopotential divided by it is a height
BT_SCALE_AT, BT_SCALES = 62, (0.0, 1.0)  # offset of the scale in the header of .bt, and scales that mean metres
MAX_HEADER_BYTES = 1 << 16
# Names of the coordinates of a netCDF grid without attributes that GDAL knows.
AXES = (("x", "y"), ("X", "Y"), ("easting", "northing"), ("lon", "lat"), ("longitude", "latitude"))
MAX_UNEVEN = 1e-3  # fraction of a step by which coordinates may differ from even ones


class BandFacts(NamedTuple):
    """What a file says about one band.

    Attributes:
        grid: coordinate system and geotransform.
        unit: name of the unit of values, "" if none.
        factor: a value has to be multiplied by it first.
        notes: warnings.
    """

    grid: FileGrid
    unit: str
    factor: float = 1.0
    notes: tuple[str, ...] = ()


def band_facts(path: Path, dataset: DatasetReader, band: int, grid: FileGrid) -> BandFacts:
    """Return a band's grid and unit, corrected by facts that the driver leaves out. grid: as GDAL reports it."""
    facts = BandFacts(grid, (dataset.units[band - 1] or "").strip())
    correct = _CORRECTIONS.get(dataset.driver)
    return facts if correct is None else correct(path, dataset, band, facts)


def _correct_bt(path: Path, _dataset: DatasetReader, _band: int, facts: BandFacts) -> BandFacts:
    """Read the metres in a unit of heights. GDAL reports only the scales of metres and feet.

    The file has a float32, of which seven digits count. facts: as GDAL reports them.
    """
    (scale,) = struct.unpack_from("<f", read_start(path, 256), BT_SCALE_AT)
    if facts.unit or scale in BT_SCALES or not np.isfinite(scale):
        return facts
    return facts._replace(unit="m", factor=float(f"{scale:.7g}"))


def _correct_saga(path: Path, _dataset: DatasetReader, _band: int, facts: BandFacts) -> BandFacts:
    """Read the unit and the factor of heights in a SAGA grid's header, which GDAL ignores.

    A factor that is 0 or no finite number counts as 1. facts: as GDAL reports them.
    """
    header = path.with_suffix(".sgrd")
    text = read_start(header, MAX_HEADER_BYTES).decode("latin-1")
    entries = dict(re.findall(r"(?m)^\s*(\w+)[ \t]*=[ \t]*(.*?)\s*$", text))
    try:
        factor = float(entries.get("Z_FACTOR") or 1.0)
    except ValueError:
        factor = 1.0
    factor = factor if np.isfinite(factor) and factor != 0.0 else 1.0
    return facts._replace(unit=entries.get("UNIT", ""), factor=factor)


def _correct_grib(_path: Path, dataset: DatasetReader, band: int, facts: BandFacts) -> BandFacts:
    """Read the unit of a GRIB message; geopotentials become heights. facts: as GDAL reports them."""
    unit = dataset.tags(band).get("GRIB_UNIT", "").strip("[] ")
    if unit in ("m^2/s^2", "(m^2)/(s^2)", "m**2/s**2", "m2/s2"):
        return facts._replace(unit="m", factor=1.0 / GRAVITY)
    return facts._replace(unit={"gpm": "m", "-": ""}.get(unit, unit))


def _correct_terragen(_path: Path, _dataset: DatasetReader, _band: int, facts: BandFacts) -> BandFacts:
    """Drop the coordinate system, which is not on Earth, and let the geotransform begin with the northern row.

    GDAL returns the northern row first, but with a geotransform in which y rises from row to row. facts: as GDAL
    reports them.
    """
    assert facts.grid.transform is not None, "the format always has one"
    a, b, c, d, e, f = facts.grid.transform
    return facts._replace(grid=FileGrid(crs=None, transform=(a, b, c, d, -abs(e), f)))


def _correct_netcdf(path: Path, dataset: DatasetReader, band: int, facts: BandFacts) -> BandFacts:
    """Find coordinates without a known name, assume WGS 84 for degrees, and warn about depths.

    facts: as GDAL reports them.
    """
    from rasterio.crs import CRS

    grid, notes = facts.grid, list(facts.notes)
    names, values = next(
        ((pair, coordinates) for pair in AXES if (coordinates := _axes(path, dataset, pair))), ((), ())
    )
    if grid.transform is None and not grid.problem and values:
        grid = grid._replace(transform=_transform(*values))
    units = {text for name, text in dataset.tags().items() if name.endswith("#units")}
    is_degrees = any(unit.startswith("degree") for unit in units) or names[:1] in (("lon",), ("longitude",))
    if grid.transform is not None and grid.crs is None and is_degrees:
        grid = grid._replace(crs=CRS.from_epsg(4326))
        notes.append("The file has longitudes and latitudes and names no datum: WGS 84 was taken.")
    if dataset.tags(band).get("positive") == "down":
        notes.append("The file counts its values downwards, so they are depths: give a height scale of -1.")
    return facts._replace(grid=grid, notes=tuple(notes))


def _axes(path: Path, dataset: DatasetReader, names: tuple[str, str]) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the coordinates of columns and rows in two variables of a netCDF file, float64 [width] and [height].

    Return None unless there are such variables of these lengths with even steps.
    """
    import rasterio

    axes = []
    for name, count in zip(names, (dataset.width, dataset.height), strict=True):
        try:
            with (
                warnings.catch_warnings(action="ignore"),  # it has no georeference
                rasterio.open(f'NETCDF:"{path}":{name}', driver="netCDF", sharing=False) as axis,
            ):
                if axis.shape != (1, count) or count < 2:
                    return None
                values = axis.read(1)[0].astype(np.float64)
        except Exception:  # there is no such variable
            return None
        step = (values[-1] - values[0]) / (count - 1)
        if not (abs(step) > 0.0 and np.abs(np.diff(values) - step).max() <= MAX_UNEVEN * abs(step)):
            return None
        axes.append(values)
    return axes[0], axes[1]


def _transform(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float, float, float, float]:
    """Return the geotransform of cells around samples at these coordinates. GDAL returns the last row first."""
    step_x, step_y = ((axis[-1] - axis[0]) / (len(axis) - 1) for axis in (x, y))
    return step_x, 0.0, x[0] - step_x / 2, 0.0, -step_y, y[-1] + step_y / 2


_CORRECTIONS = {
    "BT": _correct_bt,
    "SAGA": _correct_saga,
    "GRIB": _correct_grib,
    "Terragen": _correct_terragen,
    "netCDF": _correct_netcdf,
}
