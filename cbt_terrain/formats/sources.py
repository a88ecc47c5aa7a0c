# SPDX-License-Identifier: GPL-3.0-or-later
"""Sources of heights, files and built-in terrains, opened as rasters."""

import dataclasses
import functools
import math
import os
import stat
from pathlib import Path

import numpy as np

from ..errors import TerrainError, shown
from ..field.georeference import Georeference
from ..field.lands import LANDS
from ..rasters.raster import ImportSettings, Raster, blank, cause
from ..rasters.source_formats import FORMATS
from ..run.named_file import blocks_reader
from .archives import archive_of
from .file_options import LAND, ROWS, check_applies, options_of
from .format_choice import format_of
from .header_files import headless_warning, lacks_header

ORDER_ROWS = 256  # rows that are compared in both byte orders
BLOCK_ROWS = 64  # of arrays, that are read at once
WEB = {"http:", "https:", "ftp:", "s3:"}  # parts of the path that Python makes of a web address
SMOOTHER = 4.0  # ratio of roughness beyond which the other byte order is likelier


def open_source(settings: ImportSettings) -> Raster:
    """Open the source that the settings name, in the import's child process; the raster's `close` closes it.

    Raises TerrainError for settings or a file that cannot be used.
    """
    from ..rasters.length_scale import length_warnings, mirror_warnings

    settings.check()
    options = (LAND,) if settings.source in LANDS else options_of(Path(settings.source))
    check_applies(settings, options)
    raster = open_tile_source(settings)
    grid, place, size = raster.read_grid, raster.georeference, (raster.width, raster.height)
    if place is not None and settings.first_row_south:
        raster.close()
        check_applies(settings, {*options} - {ROWS})  # raises
    if grid is not None and place is not None:
        try:
            mirrored, lengths = mirror_warnings(grid, *size), length_warnings(grid, *size, place)
        except Exception as reason:  # GDAL has many classes of errors, and odd systems raise late
            raster.close()
            raise TerrainError(f"{shown(settings.source)} cannot be placed ({cause(reason)})") from reason
        raster.georeference = dataclasses.replace(
            place, warnings=(*place.warnings, *mirrored), size_warnings=(*place.size_warnings, *lengths)
        )
    return raster


def open_tile_source(settings: ImportSettings) -> Raster:
    """Open the source that the settings name, without warnings about wrong lengths and mirrored axes of its system.

    These warnings would take a quarter of the time of reading a header. A mosaic has those of its common grid. Raises
    TerrainError.
    """
    settings.check()
    settings.check_file()
    if settings.source in LANDS:
        return _open_land(settings)
    path = Path(settings.source)
    check_file(path)
    try:
        if lacks_header(path):  # samples alone, such as a .bil without its .hdr
            return open_raw(path, settings)
        form = format_of(path)
        if form is not None:
            return form.load()(path, settings)
    except OSError as reason:
        raise TerrainError(f"{path} cannot be read ({reason.strerror or reason})", fix="check the file") from reason
    raise TerrainError(
        f"{path} is of no known kind of height map",
        expected=f"one of {', '.join(FORMATS)}",
        fix="unpack an archive, and convert other kinds to GeoTIFF (gdal_translate)",
    )


def check_file(path: Path, kind: str = "height map") -> None:
    """Raise TerrainError unless `path` is a readable, non-empty file without a pipe next to it (`check_neighbours`).

    kind: purpose of the file, in errors.
    """
    check_named(path, kind)
    check_neighbours(path)


def check_named(path: Path, kind: str = "height map") -> None:
    """Raise TerrainError unless a path is that of a regular file that can be read and is not empty.

    kind: word for the file in the error.
    """
    expected = f"the file of a {kind}"
    try:
        status = path.stat()
        mode, size = status.st_mode, status.st_size
        what = "is a folder" if stat.S_ISDIR(mode) else "is not a regular file"
    except (FileNotFoundError, NotADirectoryError, ValueError):  # ValueError: the name holds a zero byte
        mode, size, what = 0, 0, "does not exist"
    except OSError as reason:
        message = reason.strerror or reason
        raise TerrainError(f"{shown(path)} cannot be read ({message})", expected=expected) from reason
    if not stat.S_ISREG(mode):
        archive = archive_of(path)  # the .zip that the path leads into, else the path
        fix = f"name the archive ({shown(archive)}), or unpack it" if archive != path else ""
        fix = "download it first, because no import uses the network" if {*path.parts} & WEB else fix  # an address
        raise TerrainError(f"{shown(path)} {what}", expected=expected, fix=fix)
    if not os.access(path, os.R_OK):
        raise TerrainError(f"{path} may not be read by this user", fix="change its permissions")
    if size == 0:
        raise TerrainError(f"{path} is empty", expected=expected, fix="get the file again, or leave it out")


def check_neighbours(path: Path) -> None:
    """Raise TerrainError for a pipe, socket or device beside a file whose name begins like the file's.

    GDAL would open it as a part of the file (.tfw, .aux.xml, .msk, ...) and wait.
    """
    stem, folder = path.stem.casefold(), path.absolute().parent
    starts = f"{stem}.", f"{stem}_"
    try:
        blocking = _blocking_in(str(folder), folder.stat().st_mtime_ns)
    except OSError:
        return
    blocker = next((other for other in blocking if os.path.basename(other).casefold().startswith(starts)), None)
    if blocker is not None:
        raise TerrainError(
            f"{shown(blocker)}, beside {shown(path.name)}, is a pipe, a socket or a device",
            expected="a file",
            fix="remove or rename it",
        )


@functools.lru_cache(maxsize=4)
def _blocking_in(folder: str, _changed_ns: int) -> list[str]:
    """Return the pipes, sockets and devices in a folder, cached: a mosaic of n tiles would search its folder n times.

    _changed_ns: time of its last change, only for the cache.
    """
    with os.scandir(folder) as entries:
        return [e.path for e in entries if not e.is_file(follow_symlinks=False) and blocks_reader(e.path)]


def _open_land(settings: ImportSettings) -> Raster:
    """Return the built-in land that the settings name as a raster of `settings.size` samples a side."""
    land, size = LANDS[settings.source], settings.size

    def read(first: int, count: int) -> np.ndarray:
        """Return `count` rows from row `first` on, float32 metres."""
        rows = np.empty((count, size), np.float32)
        land.rows(size, first, rows, settings.seed)
        return rows

    step = land.side / (size - 1)
    place = Georeference(step, step, first_row_south=True)
    return Raster(size, size, read, stored="float32", format=land.name, georeference=place, block_rows=BLOCK_ROWS)


def open_raw(path: Path, settings: ImportSettings) -> Raster:
    """Open samples without a header.

    Size, type and byte order are those of the settings. A suffix that implies a type, as .r32 does, wins over a type of
    another length. The file is mapped. Raises TerrainError for a file of another size, and if it is to be reprojected.
    """
    if settings.project:
        raise TerrainError(
            f"{shown(path)} has no header beside it, so no coordinate system, and cannot be reprojected",
            fix="put its header there, or import it as it is",
        )
    kind = np.dtype(settings.raw_dtype)
    usual = np.dtype(FORMATS[path.suffix.lower()].raw_dtype or kind)  # by the suffix
    kind = (kind if kind.itemsize == usual.itemsize else usual).newbyteorder("<" if settings.raw_little_endian else ">")
    if kind.itemsize != np.dtype(settings.raw_dtype).itemsize and settings.raw_dtype != ImportSettings.raw_dtype:
        raise TerrainError(
            f"{shown(path)} has samples of {kind.name} by its suffix, not of {settings.raw_dtype}",
            fix="leave the type out (--raw-type), or rename the file to .raw",
        )
    size = path.stat().st_size  # bytes
    samples, rest = divmod(size, kind.itemsize)
    width, height = settings.raw_size or (math.isqrt(samples), math.isqrt(samples))
    if width * height * kind.itemsize != size or rest:
        needed = f"{width} x {height} samples of {kind.name} need {width * height * kind.itemsize}"
        hint = f", or put its header {shown(path.with_suffix('.hdr').name)} beside it" if lacks_header(path) else ""
        raise TerrainError(
            f"{path} has {size} bytes, but {needed}",
            fix=f"give its true size and type (on the command line --raw-size WxH and --raw-type){hint}",
        )
    values = np.memmap(path, kind, "r", shape=(height, width))
    raster = _from_array(values, settings, "RAW")
    if lacks_header(path):
        raster.warnings.append(headless_warning(path))
    raster.warnings += _byte_order_warnings(values)
    return raster


def _byte_order_warnings(values: np.ndarray) -> list[str]:
    """Return a warning about 16-bit integers that are far smoother with their bytes in the other order; else []."""
    if values.dtype.kind not in "iu" or values.itemsize != 2 or values.shape[1] < 2:
        return []
    rows = np.asarray(values[:: -(-len(values) // ORDER_ROWS)])  # at most ORDER_ROWS of them
    given, other = (
        np.abs(np.diff(r.astype(np.int64), axis=1)).mean() for r in (rows, rows.view(rows.dtype.newbyteorder()))
    )
    if given <= SMOOTHER * other:
        return []
    # The other order; this machine's is taken to be little-endian.
    order = "big-endian" if values.dtype.newbyteorder("=") == values.dtype else "little-endian"
    return [
        f"Neighbouring samples differ by {given:,.0f} in the mean, and by {other:,.0f} if the file is {order}: if the "
        "ground is rough where it should be smooth, change the byte order (--big-endian)."
    ]


def open_npy(path: Path, settings: ImportSettings) -> Raster:
    """Map an array of numpy, [rows, columns] with the north first. Raises TerrainError for any other content."""
    try:
        values = np.lib.format.open_memmap(path, mode="r")  # np.load would also open zips and pickles
    except Exception as reason:  # the parser of headers raises errors of many classes
        message = shown(reason).rstrip(".") or type(reason).__name__
        what = f"{path} is not a whole .npy file of numbers ({message})"
        raise TerrainError(what, fix="get the file again") from reason
    if values.ndim != 2 or values.dtype.kind not in "fiu" or values.size == 0:
        raise TerrainError(f"{path} holds {values.dtype} {values.shape}", expected="a 2-D array of real numbers")
    return _from_array(values, settings, "NumPy")


def _from_array(values: np.ndarray, settings: ImportSettings, format_name: str) -> Raster:
    """Return an array, [rows, columns] with the north first, as a raster that is read in bands."""

    def read(first: int, count: int) -> np.ndarray:
        """Return `count` rows from `first` on, in the array's type, or floats with NaN for the no-data value."""
        rows = np.asarray(values[first : first + count])
        return blank(rows.astype(rows.dtype.newbyteorder("=")), settings.no_data)

    height, width = values.shape
    return Raster(width, height, read, stored=values.dtype.name, format=format_name, block_rows=BLOCK_ROWS)
