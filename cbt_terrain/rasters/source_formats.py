# SPDX-License-Identifier: GPL-3.0-or-later
"""The formats of height maps, by the suffixes of their files."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pkgutil import resolve_name

from ..errors import TerrainError

GDAL = "gdal_source:open_raster"
POINT_PACKAGES = '"laspy[lazrs]"'
RAW, BAND, CHANNEL, ENCODING, CELL = "raw", "band", "channel", "encoding", "cell"
OPENERS = f"{__package__.rpartition('.')[0]}.formats"  # the room of the modules that openers name


@dataclass(frozen=True)
class SourceFormat:
    """A format of height maps.

    Attributes:
        title: name of the format for users.
        opener: "module:function" of `formats`, for the import's child process. The function returns the Raster of a
            path and ImportSettings.
        driver: GDAL's driver for the file or its grid, "" for formats that GDAL does not read. Files with a driver can
            say where on Earth they are.
        in_mosaic: whether a VRT may name such files.
        has_header: whether an ESRI header beside a file describes its samples.
        is_raw_alone: whether a file without its header is read as RAW.
        options: settings that apply to the format only, of RAW, BAND, CHANNEL, ENCODING and CELL.
        library: modules that must be imported before the child process gives up its rights.
        starts: first bytes that tell one of `others`; () for plain text.
        others: further formats with the same suffix (format_choice.py).
        is_large: whether its parser is so large that it runs only where the child gives up all rights (guard.py).
        max_bytes: largest size of a file; 0 for no limit.
        raw_dtype: type of RAW samples, unless the settings give another one of that size; "" for theirs.
        is_archive: whether a file holds another one that has to be unpacked first (archives.py).
    """

    title: str
    opener: str = GDAL
    driver: str = ""
    in_mosaic: bool = False
    has_header: bool = False
    is_raw_alone: bool = False
    options: tuple[str, ...] = (BAND,)
    library: str = ""
    starts: tuple[bytes, ...] = ()
    others: "tuple[SourceFormat, ...]" = ()
    is_large: bool = False
    max_bytes: int = 0
    raw_dtype: str = ""
    is_archive: bool = False

    @property
    def may_be_indexed(self) -> bool:
        """Return whether a tile index may name such files: GDAL has one small parser for them, and needs no package."""
        return bool(self.driver) and not (self.is_large or self.library or self.others)

    def load(self) -> Callable:
        """Import and return the function that opens a file. Raises TerrainError without the format's library."""
        for name in self.library.split():
            try:
                import_module(name)
            except ImportError:
                raise TerrainError(
                    f"{self.title} files are read by the Python package {name}, which is not installed",
                    fix=f'run: "{sys.executable}" -m pip install {POINT_PACKAGES}',
                ) from None
        return resolve_name(f"{OPENERS}.{self.opener}")


_IMAGE = (BAND, ENCODING)
_TIFF = SourceFormat("GeoTIFF", driver="GTiff", in_mosaic=True, options=_IMAGE)
_BIL = SourceFormat("BIL", driver="EHdr", has_header=True, is_raw_alone=True)
_RAW = SourceFormat("RAW", "sources:open_raw", options=(RAW,))
_DTED = SourceFormat("DTED", driver="DTED")
_NETCDF = SourceFormat("netCDF", driver="netCDF", is_large=True)
_GRIB = SourceFormat("GRIB", driver="GRIB", is_large=True)
_SURFER = (
    SourceFormat("Surfer 6", driver="GSBG", starts=(b"DSBB",)),
    SourceFormat("Surfer 7", driver="GS7BG", starts=(b"DSRB",)),
    SourceFormat("Surfer text", driver="GSAG", starts=(b"DSAA",)),
)
_USGS_DEM = SourceFormat("USGS DEM", driver="USGSDEM")
_POINTS = SourceFormat(
    "LAS or LAZ", "point_cloud:open_points", driver="GTiff", options=(BAND, CELL), library="laspy lazrs"
)
_ARCHIVE = SourceFormat("archive of one", "archives:open_archive", options=_IMAGE, is_archive=True)
FORMATS = {
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".hgt": SourceFormat("SRTM", driver="SRTMHGT", in_mosaic=True),
    ".png": SourceFormat("PNG", driver="PNG", in_mosaic=True, options=_IMAGE),
    ".asc": SourceFormat("ASCII grid", driver="AAIGrid", in_mosaic=True),
    ".vrt": SourceFormat("VRT", driver="VRT", in_mosaic=True),
    ".bil": _BIL,
    ".bip": _BIL,
    ".bsq": _BIL,
    ".flt": _BIL,
    ".dem": SourceFormat("GTOPO30", driver="EHdr", has_header=True, others=(_USGS_DEM,)),
    ".img": SourceFormat("Erdas Imagine", driver="HFA"),
    ".dt0": _DTED,
    ".dt1": _DTED,
    ".dt2": _DTED,
    ".nc": _NETCDF,
    ".grd": SourceFormat("GMT grid", driver="netCDF", is_large=True, others=_SURFER),
    ".grb": _GRIB,
    ".grb2": _GRIB,
    ".jp2": SourceFormat("JPEG 2000", driver="JP2OpenJPEG", is_large=True, options=_IMAGE),
    ".webp": SourceFormat("WebP", driver="WEBP", options=_IMAGE),
    ".xyz": SourceFormat("XYZ", driver="XYZ", max_bytes=1 << 29),
    ".bt": SourceFormat("Binary terrain", driver="BT"),
    ".ter": SourceFormat("Terragen", driver="Terragen"),
    ".sdat": SourceFormat("SAGA", driver="SAGA"),
    ".exr": SourceFormat("OpenEXR", "exr_source:open_exr", options=(CHANNEL,), library="OpenEXR"),
    ".npy": SourceFormat("NumPy", "sources:open_npy", options=()),
    ".raw": _RAW,
    ".r16": _RAW,
    ".r32": SourceFormat("RAW", "sources:open_raw", options=(RAW,), raw_dtype="float32"),
    ".bin": _RAW,
    ".las": _POINTS,
    ".laz": _POINTS,
    ".zip": _ARCHIVE,
    ".gz": _ARCHIVE,
}


def suffixes_with(option: str) -> tuple[str, ...]:
    """Return the suffixes of files that an option of RAW, BAND, CHANNEL, ENCODING and CELL applies to."""
    return tuple(suffix for suffix, form in FORMATS.items() if option in form.options)


def all_drivers() -> set[str]:
    """Return the GDAL drivers of all formats of height maps. A process that reads one keeps `drivers_of` alone."""
    forms = {form for listed in FORMATS.values() for form in (listed, *listed.others)}
    return {form.driver for form in forms} - {""}


def drivers_of(form: SourceFormat) -> set[str]:
    """Return the GDAL drivers that a file of a format needs: its own, or those of all files that a VRT may name.

    GTiff is among them, for a mask beside the file (.msk) and for heights that are decoded from colours.
    """
    if form.driver == "VRT":
        return {other.driver for other in FORMATS.values() if other.in_mosaic}
    return {form.driver, "GTiff"} if form.driver else set()
