# SPDX-License-Identifier: GPL-3.0-or-later
"""The formats of height maps, by the suffixes of their files."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pkgutil import resolve_name

GDAL = "gdal_source:open_raster"
RAW, BAND, CHANNEL = "raw", "band", "channel"


@dataclass(frozen=True)
class SourceFormat:
    """A format of height maps.

    Attributes:
        title: name of the format for users.
        opener: "module:function" of this package, for the import's child process. The function returns the Raster of a
            path and ImportSettings.
        driver: GDAL's driver, "" for formats that GDAL does not read. Such a file can say where on Earth it is.
        in_mosaic: whether a VRT may name such files.
        has_header: whether an ESRI header beside a file describes its samples.
        is_raw_alone: whether a file without its header is read as RAW.
        options: settings that apply to the format only, of RAW, BAND and CHANNEL.
        library: module that must be imported before the child process gives up its rights.
    """

    title: str
    opener: str = GDAL
    driver: str = ""
    in_mosaic: bool = False
    has_header: bool = False
    is_raw_alone: bool = False
    options: tuple[str, ...] = (BAND,)
    library: str = ""

    def load(self) -> Callable:
        """Import and return the function that opens a file."""
        if self.library:
            import_module(self.library)
        return resolve_name(f"{__package__}.{self.opener}")


_TIFF = SourceFormat("GeoTIFF", driver="GTiff", in_mosaic=True)
_BIL = SourceFormat("BIL", driver="EHdr", has_header=True, is_raw_alone=True)
_RAW = SourceFormat("RAW", "sources:open_raw", options=(RAW,))
FORMATS = {
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".hgt": SourceFormat("SRTM", driver="SRTMHGT", in_mosaic=True),
    ".png": SourceFormat("PNG", driver="PNG", in_mosaic=True),
    ".asc": SourceFormat("ASCII grid", driver="AAIGrid", in_mosaic=True),
    ".vrt": SourceFormat("VRT", driver="VRT", in_mosaic=True),
    ".bil": _BIL,
    ".bip": _BIL,
    ".bsq": _BIL,
    ".flt": _BIL,
    ".dem": SourceFormat("GTOPO30", driver="EHdr", has_header=True),  # without a header most often a text of the USGS
    ".exr": SourceFormat("OpenEXR", "exr_source:open_exr", options=(CHANNEL,), library="OpenEXR"),
    ".npy": SourceFormat("NumPy", "sources:open_npy", options=()),
    ".raw": _RAW,
    ".r16": _RAW,
    ".r32": _RAW,
    ".bin": _RAW,
}


def suffixes_with(option: str) -> tuple[str, ...]:
    """Return the suffixes of files that an option of RAW, BAND and CHANNEL applies to."""
    return tuple(suffix for suffix, form in FORMATS.items() if option in form.options)
