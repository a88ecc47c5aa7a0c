# SPDX-License-Identifier: GPL-3.0-or-later
"""Height maps of many formats, written byte by byte from their specifications; formats with large writers by GDAL.

Writers take `heights`, float [rows, columns] with row 0 in the north and NaN where a sample is missing, and `west`,
`south`, `step`: the position of the south-western sample and the distance of samples.
"""

import struct

import numpy as np
import rasterio.shutil
from rasterio.transform import from_origin
from rasters import hills, write_raster


def write_dted(path, heights, west, south, step):
    """Write DTED level 1 in degrees: columns from the west, each from the south; signed magnitudes."""
    rows, columns = heights.shape
    interval = round(step * 36_000)
    uhl = f"UHL1{_angle(west, 3)}{_angle(south, 3)}{interval:04d}{interval:04d}NA  U  {'':12}{columns:04d}{rows:04d}0"
    dsi = bytearray(b"DSI" + b" " * 645)
    dsi[59:64], dsi[87:89], dsi[141:146] = b"DTED1", b"01", b"MSL  "
    dsi[144:149] = b"WGS84"
    dsi[185:204] = f"{_angle(south, 2)[:-2]:0>7}".encode()[:7] + b".0N" + b" " * 9
    dsi[273:281] = f"{interval:04d}{interval:04d}".encode()
    dsi[281:289] = f"{rows:04d}{columns:04d}".encode()
    data = bytearray(uhl.ljust(80).encode() + dsi + b"ACC".ljust(2700))
    values = np.where(np.isnan(heights), -32767, np.nan_to_num(heights)).astype(int)
    for column in range(columns):
        record = struct.pack(">BBHHH", 0xAA, 0, column, column, 0)
        for value in values[::-1, column]:
            record += struct.pack(">H", abs(int(value)) | (0x8000 if value < 0 else 0))
        data += record + struct.pack(">I", sum(record))
    path.write_bytes(data)
    return path


def _angle(degrees, digits):
    """Return an angle as DDDMMSSH."""
    seconds = round(abs(degrees) * 3600)
    letter = ("E" if degrees >= 0 else "W") if digits == 3 else ("N" if degrees >= 0 else "S")
    return f"{seconds // 3600:03d}{seconds // 60 % 60:02d}{seconds % 60:02d}{letter}"


def write_netcdf(
    path, heights, west, south, step, names=("x", "y", "z"), units=None, attributes=(), south_first=True, offset=None
):
    """Write a classic netCDF (CDF-1) grid as GMT does: coordinates of samples, and z with its own attributes.

    units: of the three variables; attributes: further ones of z, pairs of a name and a text or a float; offset: 0 or 1,
    GMT's node_offset, with the actual ranges of nodes or of pixels' sides.
    """
    rows, columns = heights.shape
    x, y = west + step * np.arange(columns), south + step * np.arange(rows)
    z = heights[::-1] if south_first else heights
    values = [x.astype(">f8"), (y if south_first else y[::-1]).astype(">f8"), z.astype(">f4")]
    sizes = [8 * columns, 8 * rows, 4 * rows * columns]

    def text(name):
        return struct.pack(">I", len(name)) + name.encode().ljust(-(-len(name) // 4) * 4, b"\0")

    def attribute(name, value):
        if isinstance(value, str):
            return text(name) + struct.pack(">I", 2) + text(value)
        if isinstance(value, int):
            return text(name) + struct.pack(">IIi", 4, 1, value)
        if isinstance(value, tuple):
            return text(name) + struct.pack(">II2d", 6, 2, *value)
        return text(name) + struct.pack(">IIf", 5, 1, value)

    def listed(tag, items):
        return struct.pack(">II", tag if items else 0, len(items)) + b"".join(items)

    dimensions = listed(10, [text(names[0]) + struct.pack(">I", columns), text(names[1]) + struct.pack(">I", rows)])
    of_file = [attribute("Conventions", "CF-1.7"), *([attribute("node_offset", offset)] if offset is not None else [])]
    of_file = listed(12, of_file)

    def head(offsets):
        variables = []
        for n, (axes, kind) in enumerate((((0,), 6), ((1,), 6), ((1, 0), 5))):
            own = [attribute("units", units[n])] if units and units[n] else []
            if offset is not None and n < 2:
                ends, half = (x, y)[n][[0, -1]], offset * step / 2
                own.append(attribute("actual_range", (ends[0] - half, ends[1] + half)))
            own += [attribute("_FillValue", float("nan")), *(attribute(*pair) for pair in attributes)] if n == 2 else []
            axes = struct.pack(f">I{len(axes)}I", len(axes), *axes)
            layout = struct.pack(">III", kind, sizes[n], offsets[n])
            variables.append(text(names[n]) + axes + listed(12, own) + layout)
        return b"CDF\1\0\0\0\0" + dimensions + of_file + listed(11, variables)

    first = len(head([0, 0, 0]))
    offsets = [first, first + sizes[0], first + sizes[0] + sizes[1]]
    path.write_bytes(head(offsets) + b"".join(array.tobytes() for array in values))
    return path


def write_usgs_dem(path, heights, west, south, step, unit=2, resolution=1.0, missing=-32767):
    """Write a USGS DEM in UTM zone 12, NAD 27 (or what GDAL makes of it). unit: of heights, 1 feet, 2 metres."""
    rows, columns = heights.shape
    east, north = west + step * (columns - 1), south + step * (rows - 1)
    finite = heights[np.isfinite(heights)]

    def real(value):
        return f"{value:24.15E}".replace("E", "D")

    head = "A TEST".ljust(144) + f"{1:6d}{1:6d}{1:6d}{12:6d}" + real(0.0) * 15
    head += f"{2:6d}{unit:6d}{4:6d}"
    head += "".join(map(real, (west, south, west, north, east, north, east, south, finite.min(), finite.max(), 0.0)))
    head += f"{0:6d}{step:12.6E}{step:12.6E}{resolution:12.6E}{1:6d}{columns:6d}"
    text = head.ljust(864).ljust(1024)
    values = np.where(np.isnan(heights), missing, np.rint(np.nan_to_num(heights) / resolution)).astype(int)
    for column in range(columns):
        own = values[::-1, column]
        record = f"{1:6d}{column + 1:6d}{rows:6d}{1:6d}" + real(west + step * column) + real(south) + real(0.0)
        record += real(float(own.min())) + real(float(own.max()))
        words = "".join(f"{value:6d}" for value in own)
        record += words[: 146 * 6]
        record, words = record.ljust(1024), words[146 * 6 :]
        while words:
            record, words = record + words[: 170 * 6].ljust(1024), words[170 * 6 :]
        text += record
    path.write_bytes(text.encode())
    return path


def write_xyz(path, heights, west, south, step, separator=" ", header="", south_first=False):
    """Write one line a sample; missing samples have no line."""
    rows, columns = heights.shape
    lines = [header] if header else []
    for row in range(rows)[:: -1 if south_first else 1]:
        for column in np.flatnonzero(np.isfinite(heights[row])):
            place = west + step * column, south + step * (rows - 1 - row)
            lines.append(separator.join(f"{value:.10g}" for value in (*place, heights[row, column])))
    path.write_text("\n".join(lines) + "\n")
    return path


def write_bt(path, heights, west, south, step, scale=1.0, units=1, zone=12):
    """Write a VTP binary terrain 1.3 with float32 heights in UTM on WGS 84; missing samples are -32768."""
    rows, columns = heights.shape
    half = step / 2
    borders = west - half, west + (columns - 0.5) * step, south - half, south + (rows - 0.5) * step
    head = b"binterr1.3" + struct.pack("<iihhhhh4dhf", columns, rows, 4, 1, units, zone, 6326, *borders, 0, scale)
    columns_first = np.where(np.isnan(heights), -32768, heights)[::-1].T.astype("<f4")
    path.write_bytes(head.ljust(256, b"\0") + columns_first.tobytes())
    return path


def write_terragen(path, values, spacing, height_scale, base):
    """Write a Terragen heightfield of int16 `values`, row 0 north; heights are (base + value * scale / 65536) units."""
    rows, columns = values.shape
    data = b"TERRAGENTERRAIN " + b"SIZE" + struct.pack("<hh", min(rows, columns) - 1, 0)
    data += b"XPTS" + struct.pack("<hh", columns, 0) + b"YPTS" + struct.pack("<hh", rows, 0)
    data += b"SCAL" + struct.pack("<3f", spacing, spacing, spacing) + b"CRAD" + struct.pack("<f", 6370)
    data += b"CRVM" + struct.pack("<I", 0) + b"ALTW" + struct.pack("<2h", height_scale, base)
    path.write_bytes(data + values[::-1].astype("<i2").tobytes() + b"EOF ")
    return path


def write_saga(path, heights, west, south, step, north_first=False, factor=1.0, unit=""):
    """Write a SAGA grid: float32 rows from the south, unless `north_first`, and its header."""
    rows, columns = heights.shape
    values = np.where(np.isnan(heights), -99999.0, heights).astype("<f4")
    path.write_bytes((values if north_first else values[::-1]).tobytes())
    path.with_suffix(".sgrd").write_text(
        f"NAME\t= a\nDESCRIPTION\t=\nUNIT\t= {unit}\nDATAFORMAT\t= FLOAT\nDATAFILE_OFFSET\t= 0\n"
        "BYTEORDER_BIG\t= FALSE\n"
        f"POSITION_XMIN\t= {west}\nPOSITION_YMIN\t= {south}\nCELLCOUNT_X\t= {columns}\nCELLCOUNT_Y\t= {rows}\n"
        f"CELLSIZE\t= {step}\nZ_FACTOR\t= {factor}\nNODATA_VALUE\t= -99999\n"
        f"TOPTOBOTTOM\t= {'TRUE' if north_first else 'FALSE'}\n"
    )
    return path


BLANK = 1.70141e38  # of Surfer's grids


def write_surfer6(path, heights, west, south, step):
    """Write a Surfer 6 binary grid: float32 rows from the south."""
    rows, columns = heights.shape
    limits = west, west + step * (columns - 1), south, south + step * (rows - 1), np.nanmin(heights), np.nanmax(heights)
    values = np.where(np.isnan(heights), BLANK, heights)[::-1].astype("<f4")
    path.write_bytes(b"DSBB" + struct.pack("<hh6d", columns, rows, *limits) + values.tobytes())
    return path


def write_surfer7(path, heights, west, south, step):
    """Write a Surfer 7 binary grid: float64 rows from the south."""
    rows, columns = heights.shape
    values = np.where(np.isnan(heights), BLANK, heights)[::-1].astype("<f8").tobytes()
    grid = struct.pack("<ii", rows, columns) + struct.pack("<4d", west, south, step, step)
    grid += struct.pack("<4d", np.nanmin(heights), np.nanmax(heights), 0.0, BLANK)
    sections = (b"DSRB", struct.pack("<i", 1)), (b"GRID", grid), (b"DATA", values)
    path.write_bytes(b"".join(name + struct.pack("<i", len(data)) + data for name, data in sections))
    return path


def write_surfer_text(path, heights, west, south, step):
    """Write a Surfer ASCII grid: rows from the south."""
    rows, columns = heights.shape
    values = np.where(np.isnan(heights), BLANK, heights)[::-1]
    lines = [f"{west} {west + step * (columns - 1)}", f"{south} {south + step * (rows - 1)}"]
    lines = ["DSAA", f"{columns} {rows}", *lines, f"{np.nanmin(heights)} {np.nanmax(heights)}"]
    path.write_text("\n".join([*lines, *("\n".join(map(str, row)) + "\n" for row in values)]) + "\n")
    return path


METRES, DEGREES = (500_010.0, 4_000_020.0, 30.0), (7.0, 46.0, 1 / 1200)  # west, south, step
ROWS, COLUMNS = 13, 21


def heights():
    """Whole metres, one below 0 in the north-western corner, and one missing sample."""
    found = np.rint(hills(COLUMNS, ROWS)).astype(np.float64)
    found[0, 0], found[3, 4] = -7.0, np.nan
    return found


def through_gdal(driver, place, **options):
    """Return a writer that copies a GeoTIFF to a driver of GDAL."""

    def write(path, values, west, south, step):
        crs = "EPSG:4326" if place is DEGREES else "EPSG:32612"
        corner = from_origin(west - step / 2, south + (len(values) - 0.5) * step, step, step)
        kind = np.int16 if driver == "JP2OpenJPEG" else np.float32
        plain = np.where(np.isnan(values), -9999, values).astype(kind)
        original = write_raster(path.parent / "original.tif", plain, crs=crs, transform=corner, nodata=-9999)
        # An import in this process may have switched off .aux.xml files and, for a mosaic, the listing of folders.
        with rasterio.Env(GDAL_PAM_ENABLED="YES", GDAL_DISABLE_READDIR_ON_OPEN="FALSE"):
            rasterio.shutil.copy(original, path, driver=driver, **options)
        return path

    return write


# By name: the writer, the place, and the coordinate system that the file names.
WRITERS = {
    "a.dt1": (write_dted, DEGREES, "EPSG:4326"),
    "a.DT2": (write_dted, DEGREES, "EPSG:4326"),
    "gmt.grd": (write_netcdf, METRES, ""),
    "a.nc": (through_gdal("netCDF", METRES, FORMAT="NC4"), METRES, "EPSG:32612"),
    "surfer6.grd": (write_surfer6, METRES, ""),
    "surfer7.grd": (write_surfer7, METRES, ""),
    "text.grd": (write_surfer_text, METRES, ""),
    "a.img": (through_gdal("HFA", METRES), METRES, "EPSG:32612"),
    "a.jp2": (through_gdal("JP2OpenJPEG", METRES, REVERSIBLE="YES", QUALITY="100"), METRES, "EPSG:32612"),
    "a.dem": (write_usgs_dem, METRES, "EPSG:26712"),
    "a.xyz": (write_xyz, METRES, ""),
    "a.bt": (write_bt, METRES, "EPSG:32612"),
    "a.sdat": (write_saga, METRES, ""),
    "a.grb": (through_gdal("GRIB", DEGREES), DEGREES, "EPSG:4326"),
    "b.grb2": (through_gdal("GRIB", DEGREES), DEGREES, "EPSG:4326"),
    "a.flt": (through_gdal("EHdr", METRES), METRES, "EPSG:32612"),
}
