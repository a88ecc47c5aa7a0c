# SPDX-License-Identifier: GPL-3.0-or-later
"""Files as programs write them: dialects of formats, names, sparse and packed samples, coordinates in the millions."""

import shutil
import struct
import zlib

import numpy as np
import OpenEXR
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from rasters import hills, imported, png_chunk, write_raster

SIZE = {"extent": (390.0, 290.0)}
HEADER = ["ncols 40", "nrows 30", "xllcorner 1000", "yllcorner 2000", "cellsize 5"]
CENTRED = ["ncols 40", "nrows 30", "xllcenter 1000", "yllcenter 2000", "cellsize 5"]


def sampled(heights, transform, places):
    """Return heights between the middles of cells at places in the raster's coordinates, by numpy alone."""
    a, _, c, _, e, f = transform
    column, row = (places[:, 0] - c) / a - 0.5, (places[:, 1] - f) / e - 0.5
    j, i = np.floor(column).astype(int), np.floor(row).astype(int)
    s, t, v = column - j, row - i, np.asarray(heights, np.float64)
    return (v[i, j] * (1 - s) + v[i, j + 1] * s) * (1 - t) + (v[i + 1, j] * (1 - s) + v[i + 1, j + 1] * s) * t


def check_places(field, heights, transform, tolerance=1e-3):
    """Compare 50 heights at places in the raster's coordinates."""
    rows, columns = np.shape(heights)
    at = np.random.default_rng(5).uniform(0.6, 1.0, (50, 2)) * (columns - 1, rows - 1)
    places = at * (transform[0], transform[4]) + (transform[2], transform[5])
    found = ground_at(field, places - field.origin[:2]).heights
    np.testing.assert_allclose(found, sampled(heights, transform, places), atol=tolerance)


def write_grid(path, heights, header, separator=" ", line_end="\n", form="{:.3f}"):
    rows = [separator.join(form.format(value) for value in row) for row in heights]
    path.write_bytes((line_end.join([*header, *rows]) + line_end).encode())
    return path


@pytest.mark.parametrize(
    ("name", "header", "options"),
    [
        ("plain.asc", HEADER, {}),
        ("windows.asc", HEADER, {"line_end": "\r\n"}),
        ("mac.asc", HEADER, {"line_end": "\r"}),
        ("TABS.ASC", [line.upper().replace(" ", "\t") for line in HEADER], {"separator": "\t"}),
        ("centre.asc", CENTRED, {}),
        ("two_sizes.asc", [*HEADER[:4], "dx 5", "dy 5"], {}),
        ("order.asc", [*HEADER[:2], HEADER[4], *HEADER[2:4]], {}),
        ("exponents.asc", HEADER, {"form": "{:.6e}"}),
    ],
)
def test_dialects_of_ascii_grids(tmp_path, name, header, options):
    heights = np.round(hills(), 3)
    field, report = imported(tmp_path, write_grid(tmp_path / name, heights, header, **options))
    half = 2.5 if header is CENTRED else 0.0
    check_places(field, heights, (5.0, 0.0, 1000.0 - half, 0.0, -5.0, 2150.0 - half))
    assert report["filled"] == 0 and report["step_m"] == [5.0, 5.0]


@pytest.mark.parametrize(
    ("word", "header"), [("-9999", "-9999.0"), ("-9999.00", "-9999"), ("null", "null"), ("nan", "nan")]
)
def test_missing_samples_of_ascii_grids(tmp_path, word, header):
    heights = np.round(hills(), 3)
    heights[3:9, 4:12] = np.nan
    path = write_grid(tmp_path / "a.asc", heights, [*HEADER, f"NODATA_value {header}"])
    path.write_text(path.read_text().replace(" nan", f" {word}"))
    assert imported(tmp_path, path)[1]["filled"] == 48


def test_decimals_after_rows_of_whole_numbers_are_kept(tmp_path):
    """GDAL guesses the type from the first 100 kB: sea first, then land."""
    heights = np.zeros((260, 500), np.float32)
    heights[230:] = np.round(hills(500, 30), 2)
    header = ["ncols 500", "nrows 260", "xllcorner 0", "yllcorner 0", "cellsize 1"]
    lines = [*header, *[" ".join(["0"] * 500)] * 230, *(" ".join(f"{v:.2f}" for v in row) for row in heights[230:])]
    (tmp_path / "sea.asc").write_text("\n".join(lines) + "\n")
    field, _ = imported(tmp_path, tmp_path / "sea.asc")
    np.testing.assert_allclose(field.heights()[::-1], heights, atol=1e-4)


def write_png(path, samples, color_type, extra=b""):
    """Write a PNG of 16 bits by hand; extra: chunks before the samples."""
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in samples)
    header = struct.pack(">IIBBBBB", samples.shape[1], samples.shape[0], 16, color_type, 0, 0, 0)
    chunks = (
        png_chunk(b"IHDR", header)
        + b"".join(png_chunk(*item) for item in extra)
        + png_chunk(b"IDAT", zlib.compress(rows))
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunks + png_chunk(b"IEND", b""))
    return path


@pytest.mark.parametrize("extra", [[], [(b"gAMA", struct.pack(">I", 45455)), (b"sRGB", b"\0")], [(b"sBIT", b"\x0c")]])
def test_colour_chunks_of_a_png_change_no_height(tmp_path, extra):
    samples = np.round(hills() * 60).astype(np.uint16)
    field, _ = imported(tmp_path, write_png(tmp_path / "a.png", samples, 0, extra), height_scale=1.0, **SIZE)
    assert np.array_equal(field.heights()[::-1], samples.astype(np.float32))


def test_the_alpha_of_a_gray_png_masks_samples(tmp_path):
    samples = np.round(hills() * 60).astype(np.uint16)
    alpha = np.full_like(samples, 65535)
    alpha[:, :13] = 0
    source = write_png(tmp_path / "a.png", np.stack([samples, alpha], -1), 4)
    field, report = imported(tmp_path, source, height_scale=1.0, **SIZE)
    assert report["filled"] == 30 * 13
    assert np.array_equal(field.heights()[::-1, 13:], samples[:, 13:].astype(np.float32))


@pytest.mark.parametrize("kind", ["window", "from below", "tiled"])
def test_windows_and_layouts_of_an_exr(tmp_path, kind):
    heights, header = hills(), {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if kind == "window":  # 40 x 30 samples at (10, 20) of a picture of 100 x 100
        header["dataWindow"] = (np.array([10, 20], np.int32), np.array([49, 49], np.int32))
        header["displayWindow"] = (np.array([0, 0], np.int32), np.array([99, 99], np.int32))
    elif kind == "from below":
        header["lineOrder"] = OpenEXR.DECREASING_Y
    else:
        header |= {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    OpenEXR.File(header, {"Y": heights}).write(str(tmp_path / "a.exr"))
    field, _ = imported(tmp_path, tmp_path / "a.exr", **SIZE)
    assert np.array_equal(field.heights()[::-1], heights)


@pytest.mark.parametrize("kind", ["int8", "uint8", "uint32", "int32", "int64", "uint64", "float64"])
def test_types_of_samples(tmp_path, kind):
    heights = (hills() / 10.0).astype(kind)
    field, _ = imported(tmp_path, write_raster(tmp_path / "a.tif", heights), height_scale=1.0, **SIZE)
    assert np.array_equal(field.heights()[::-1], heights.astype(np.float32))


def test_whole_numbers_beyond_2_to_the_53(tmp_path):
    heights = np.round(hills().astype(np.float64) * 1e15).astype(np.int64)
    field, _ = imported(tmp_path, write_raster(tmp_path / "a.tif", heights), height_scale=1e-15, **SIZE)
    np.testing.assert_allclose(field.heights()[::-1], hills(), rtol=1e-6)


@pytest.mark.parametrize("no_data", [-9999, None])
def test_missing_tiles_of_a_sparse_tiff(tmp_path, no_data):
    """They have no data; where the file declares none, GDAL's 0."""
    heights = hills(96, 64)
    options = {"tiled": True, "blockxsize": 32, "blockysize": 32, "SPARSE_OK": "TRUE", "nodata": no_data}
    with rasterio.open(tmp_path / "a.tif", "w", width=96, height=64, count=1, dtype="float32", **options) as file:
        file.write(heights[32:], 1, window=rasterio.windows.Window(0, 32, 96, 32))
    field, report = imported(tmp_path, tmp_path / "a.tif", **SIZE)
    assert report["filled"] == (96 * 32 if no_data else 0)
    assert np.array_equal(field.heights()[:32], heights[:31:-1]) and (no_data or not field.heights()[33:].any())


def test_no_data_differs_between_bands_of_a_mosaic(tmp_path):
    for number in (1, 2):
        heights = hills() + number
        heights[:, : 9 * number] = -number
        write_raster(tmp_path / f"{number}.tif", heights)
    bands = (
        f'<VRTRasterBand dataType="Float32" band="{n}"><NoDataValue>{-n}</NoDataValue><SimpleSource><SourceFilename '
        f'relativeToVRT="1">{n}.tif</SourceFilename></SimpleSource></VRTRasterBand>'
        for n in (1, 2)
    )
    (tmp_path / "a.vrt").write_text(f'<VRTDataset rasterXSize="40" rasterYSize="30">{"".join(bands)}</VRTDataset>')
    field, report = imported(tmp_path, tmp_path / "a.vrt", band=2, **SIZE)
    assert report["filled"] == 540 and np.array_equal(field.heights()[::-1, 18:], (hills() + 2)[:, 18:])


def test_a_mosaic_that_lacks_a_tile_has_no_data_there(tmp_path):
    """Tiles of a folder above, as gdalbuildvrt and QGIS name them."""
    heights, sources = hills(80, 60), ""
    for row, column in ((0, 0), (0, 1), (1, 0)):
        part = heights[30 * row : 30 * row + 30, 40 * column : 40 * column + 40]
        write_raster(tmp_path / f"{row}{column}.tif", part)
        sources += (
            f'<ComplexSource><SourceFilename relativeToVRT="1">../{row}{column}.tif</SourceFilename><SrcRect xOff="0" '
            f'yOff="0" xSize="40" ySize="30"/><DstRect xOff="{40 * column}" yOff="{30 * row}" xSize="40" ySize="30"/>'
            "<NODATA>-9999</NODATA></ComplexSource>"
        )
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a.vrt").write_text(
        '<VRTDataset rasterXSize="80" rasterYSize="60"><VRTRasterBand dataType="Float32" band="1"><NoDataValue>-9999'
        f'</NoDataValue><Metadata><MDI key="STATISTICS_MAXIMUM">7</MDI></Metadata>{sources}</VRTRasterBand>'
        "</VRTDataset>"
    )
    field, report = imported(tmp_path, tmp_path / "sub" / "a.vrt", **SIZE)
    assert report["filled"] == 1200 and np.array_equal(field.heights()[30:], heights[29::-1])


@pytest.mark.parametrize(
    ("crs", "cell", "corner"),
    [
        ("EPSG:2056", 0.5, (2683141.0, 1247863.5)),
        ("EPSG:4647", 0.25, (32601234.125, 5801234.375)),
        ("EPSG:32632", 0.01, (512345.67, 5400987.65)),
    ],
)
def test_small_cells_keep_their_places_in_the_millions(tmp_path, crs, cell, corner):
    heights, transform = hills(), (cell, 0.0, corner[0], 0.0, -cell, corner[1])
    field, report = imported(tmp_path, write_raster(tmp_path / "a.tif", heights, crs=crs, transform=transform))
    assert report["step_m"] == pytest.approx([cell, cell], rel=1e-6)
    steepest = max(np.abs(np.diff(heights, axis=axis)).max() for axis in (0, 1)) / cell
    check_places(field, heights, transform, tolerance=steepest * 1e-8 * max(corner))  # two doubles of such a size


NAMES = ["höhe Ätna.tif", "地形 01.tif", "a b  c.tif", "100% & more.tif", 'it\'s "quoted".tif', "semi;colon,comma.tif"]
NAMES += ["#hash?q=1.tif", "-dash.tif", "new\nline.tif", "UPPER.TIF", "dot.in.name.tiff", "e\u0301 decomposed.tif"]


@pytest.mark.parametrize("name", NAMES)
def test_files_of_any_name(tmp_path, name):
    write_raster(tmp_path / "plain.tif", hills())
    shutil.copy(tmp_path / "plain.tif", tmp_path / name)
    assert np.array_equal(imported(tmp_path, tmp_path / name, **SIZE)[0].heights()[::-1], hills())


def test_a_file_behind_a_link_and_a_broken_link(tmp_path):
    write_raster(tmp_path / "plain.tif", hills())
    (tmp_path / "link.tif").symlink_to(tmp_path / "plain.tif")
    (tmp_path / "broken.tif").symlink_to(tmp_path / "nowhere.tif")
    assert np.array_equal(imported(tmp_path, tmp_path / "link.tif", **SIZE)[0].heights()[::-1], hills())
    with pytest.raises(TerrainError, match=r"broken\.tif"):
        imported(tmp_path, tmp_path / "broken.tif", **SIZE)


@pytest.mark.parametrize(
    ("name", "content", "advice"),
    [
        ("srtm.hgt", np.zeros(1201 * 1201, ">i2").tobytes(), "N36W085.hgt"),
        ("N46E007.hgt", np.zeros(601 * 601, ">i2").tobytes(), "1201"),
        ("N46E007.hgt.zip", b"PK\3\4", "unpack"),
        ("N46E007.hgt.gz", b"\x1f\x8b", "unpack"),
    ],
)
def test_what_cannot_be_read_is_refused_with_advice(tmp_path, name, content, advice):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(TerrainError) as error:
        imported(tmp_path, tmp_path / name)
    assert advice.lower() in str(error.value).lower()
