# SPDX-License-Identifier: GPL-3.0-or-later
"""Warnings about a band that may not hold heights, and a guess at a file that GDAL refuses."""

from pathlib import Path

from ..run.named_file import read_start
from .raster import ImportSettings
from .rasterio_types import DatasetReader

# First bytes of files, and their kinds.
CONTENTS = (
    (b"\x89PNG", "PNG"), (b"\xff\xd8\xff", "JPEG"), (b"II*\0", "TIFF"), (b"MM\0*", "TIFF"), (b"II+\0", "BigTIFF"),
    (b"MM\0+", "BigTIFF"), (b"\x76\x2f\x31\x01", "OpenEXR"), (b"PK\x03\x04", "ZIP"), (b"\x1f\x8b", "gzip"),
    (b"\x89HDF", "HDF5"), (b"CDF", "netCDF"), (b"\x93NUMPY", "NumPy"), (b"<VRTDataset", "VRT"),
    (b"\0\0\0\x0cjP", "JPEG 2000"), (b"%PDF", "PDF"), (b"<!DOCTYPE", "HTML"), (b"<html", "HTML"), (b"BM", "BMP"),
    (b"EHFA", "Erdas Imagine"), (b"GRIB", "GRIB"), (b"DSBB", "Surfer"), (b"DSRB", "Surfer"), (b"DSAA", "Surfer"),
    (b"UHL1", "DTED"), (b"binterr", "binary terrain"), (b"TERRAGEN", "Terragen"), (b"LASF", "LAS"), (b"GIF8", "GIF"),
    (b"RIFF", "WebP"), (b"8BPS", "Photoshop"), (b"DDS ", "DDS"),
)  # fmt: skip
BOM = b"\xef\xbb\xbf"
DRIVER_KINDS = {
    "GTiff": ("TIFF", "BigTIFF"), "PNG": ("PNG",), "HFA": ("Erdas Imagine",), "GRIB": ("GRIB",), "DTED": ("DTED",),
    "netCDF": ("netCDF", "HDF5"), "JP2OpenJPEG": ("JPEG 2000",), "WEBP": ("WebP",), "BT": ("binary terrain",),
    "Terragen": ("Terragen",), **dict.fromkeys(("GSBG", "GS7BG", "GSAG"), ("Surfer",)),
}  # fmt: skip
WHOLE_FILE = "a whole file of that kind"


def band_notes(dataset: DatasetReader, band: int, driver: str) -> list[str]:
    """Return warnings about a band that may not hold heights, or only coarse ones.

    They are about other bands or channels in the file, colours of a palette, and 8 bits a sample. dataset: of rasterio.
    driver: GDAL's name of the format.
    """
    from rasterio.enums import ColorInterp

    notes, is_picture = [], driver == "PNG"
    others = [n for n, kind in enumerate(dataset.colorinterp, 1) if n != band and kind != ColorInterp.alpha]
    if others and band == 1 or (is_picture and dataset.count > 1):  # another band than 1 was chosen by the user
        what = f"The PNG has {dataset.count} channels" if is_picture else f"The file has {dataset.count} bands"
        notes.append(f"{what}; band {band} is taken as the height. If another one is, give its number (--band).")
    if notes and len(others) >= 2 and all(kind == "uint8" for kind in dataset.dtypes[:3]):
        notes[-1] += " If heights are coded in its colours, name the encoding (--encoding terrarium or mapbox)."
    if dataset.colorinterp[band - 1] == ColorInterp.palette:
        notes.append("The file's samples are numbers of colours in a palette, not heights: save it as grey values.")
    if dataset.dtypes[band - 1] in ("uint8", "int8"):
        notes.append("The file has 8 bits a sample: heights in at most 256 steps.")
    return notes


def is_picture(dataset: DatasetReader, settings: ImportSettings) -> bool:
    """Return whether a file is a picture by its bands: 3 or 4 of 8 bits.

    A band or an encoding in the settings says that it holds heights. dataset: of rasterio.
    """
    is_chosen = settings.band != 1 or bool(settings.encoding)
    return not is_chosen and dataset.count in (3, 4) and all(kind == "uint8" for kind in dataset.dtypes)


def float_alpha(dataset: DatasetReader, band: int) -> int:
    """Return the number of an alpha band that GDAL ignores because its type is neither uint8 nor uint16; 0 if none."""
    from rasterio.enums import ColorInterp

    for n, (kind, stored) in enumerate(zip(dataset.colorinterp, dataset.dtypes, strict=True), 1):
        if kind == ColorInterp.alpha and n != band and stored not in ("uint8", "uint16"):
            return n
    return 0


def content_hint(path: Path, driver: str) -> dict[str, str]:
    """Return the fields `expected` and `fix` of the error about a file that GDAL refuses, by its first bytes.

    driver: GDAL's name of the format.
    """
    try:
        head = read_start(path, 16)
    except OSError:
        head = b""
    # What the content is, if it begins like a known kind; DRIVER_KINDS are those that a driver reads.
    kind = next((name for start, name in CONTENTS if head.startswith(start)), "")
    if kind and kind not in DRIVER_KINDS.get(driver, ()):
        expected = f"a file of that kind, and by its content it is {kind}"
        return {"expected": expected, "fix": "give it that suffix, or convert it to GeoTIFF"}
    if head.startswith(BOM):
        expected = "a text that does not begin with a byte order mark"
        return {"expected": expected, "fix": "save it as plain text (UTF-8 without BOM)"}
    if driver == "SRTMHGT":
        return {"expected": "a name like N36W085.hgt and 1201 x 1201 or 3601 x 3601 samples of 2 bytes"}
    return {"expected": WHOLE_FILE}
