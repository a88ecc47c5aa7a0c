# SPDX-License-Identifier: GPL-3.0-or-later
"""The TIFF tag Orientation, in files written here byte by byte."""

import struct

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.rasters.tiff_orientation import orientation_of
from rasterio.transform import Affine
from rasters import hills, imported, write_raster

SHAPE = 5, 7
# By orientation: a picture as it is to be seen, of an array as it is stored (TIFF 6.0, page 36).
SEEN = {
    1: lambda stored: stored,
    2: lambda stored: stored[:, ::-1],
    3: lambda stored: stored[::-1, ::-1],
    4: lambda stored: stored[::-1],
    5: lambda stored: stored.T,
    6: lambda stored: np.rot90(stored, -1),
    7: lambda stored: stored[::-1, ::-1].T,
    8: lambda stored: np.rot90(stored),
}


def tiff(path, stored, orientation, order="<", big=False):
    """Write a TIFF of one strip of float32 values."""
    data = stored.astype(order + "f4").tobytes()
    size, wide = (20, "Q") if big else (12, "I")
    head = struct.pack(order + "2sHHHQ", b"", 43, 8, 0, 16) if big else struct.pack(order + "2sHI", b"", 42, 8)
    head = (b"II" if order == "<" else b"MM") + head[2:]
    entries = [(256, stored.shape[1]), (257, stored.shape[0]), (258, 32), (259, 1), (262, 1), (273, None)]
    entries += [(274, orientation), (277, 1), (278, stored.shape[0]), (279, len(data)), (339, 3)]
    number = struct.pack(order + ("Q" if big else "H"), len(entries))
    start = len(head) + len(number) + size * len(entries) + struct.calcsize(wide)
    body = b""
    for tag, value in entries:
        kind, code = (4, "I") if value is None or tag == 279 else (3, "H")
        text = struct.pack(order + code, start if value is None else value)
        body += struct.pack(order + "HH" + wide, tag, kind, 1) + text.ljust(struct.calcsize(wide), b"\0")
    path.write_bytes(head + number + body + struct.pack(order + wide, 0) + data)
    return path


@pytest.mark.parametrize("orientation", SEEN)
def test_pictures_are_laid_out_as_they_are_seen(tmp_path, orientation):
    stored = hills(SHAPE[1], SHAPE[0])
    field, report = imported(tmp_path, tiff(tmp_path / "a.tif", stored, orientation))
    assert np.array_equal(field.heights(), SEEN[orientation](stored)[::-1])
    assert all(warning.startswith("The relief, ") for warning in report["warnings"])
    rows, columns = SEEN[orientation](stored).shape
    assert report["extent_m"] == [columns - 1, rows - 1]
    _, report = imported(tmp_path, tmp_path / "a.tif", extent=(240.0, 120.0))
    assert report["step_m"] == [240.0 / (columns - 1), 120.0 / (rows - 1)]


@pytest.mark.parametrize("big", [False, True], ids=["TIFF", "BigTIFF"])
@pytest.mark.parametrize("order", ["<", ">"], ids=["little", "big"])
def test_the_tag_is_found_in_every_kind_of_tiff(tmp_path, order, big):
    stored = hills(SHAPE[1], SHAPE[0])
    source = tiff(tmp_path / "a.tif", stored, 6, order, big)
    assert orientation_of(source) == 6
    field, _ = imported(tmp_path, source)
    assert np.array_equal(field.heights(), np.rot90(stored, -1)[::-1])


def test_files_without_a_valid_tag_have_the_usual_orientation(tmp_path):
    stored = hills(SHAPE[1], SHAPE[0])
    assert orientation_of(write_raster(tmp_path / "plain.tif", stored)) == 1
    assert orientation_of(tiff(tmp_path / "a.tif", stored, 9)) == 1
    content = tiff(tmp_path / "a.tif", stored, 6).read_bytes()
    for length in range(0, 8 + 2 + 12 * 11):  # cut off anywhere before the end of the directory
        (tmp_path / "cut.tif").write_bytes(content[:length])
        assert orientation_of(tmp_path / "cut.tif") in (1, 6)
    (tmp_path / "far.tif").write_bytes(struct.pack("<2sHHHQ", b"II", 43, 8, 0, 2**64 - 1))
    assert orientation_of(tmp_path / "far.tif") == 1


def test_a_geotransform_is_that_of_the_stored_rows(tmp_path):
    """As in every other reader: where each sample lies is known, so that the tag has nothing to say."""
    stored = hills(SHAPE[1], SHAPE[0])
    source = write_raster(tmp_path / "a.tif", stored, crs="EPSG:32632", transform=Affine(10, 0, 6e5, 0, -10, 5e6))
    content = bytearray(source.read_bytes())
    offset = struct.unpack_from("<I", content, 4)[0]
    entries = range(offset + 2, offset + 2 + 12 * content[offset], 12)
    planar = next(at for at in entries if struct.unpack_from("<H", content, at)[0] == 284)
    struct.pack_into("<HHIHH", content, planar, 274, 3, 1, 4, 0)  # in place of PlanarConfiguration, by default 1
    source.write_bytes(content)
    assert orientation_of(source) == 4
    field, report = imported(tmp_path, source)
    assert np.array_equal(field.heights(), stored[::-1]) and report["step_m"] == [10.0, 10.0]


def test_masks_are_turned_as_well(tmp_path):
    from adaptive_terrain.cbt_terrain.height_operators.mask_image import load_image

    stored = np.linspace(0.0, 1.0, 35, dtype=np.float32).reshape(SHAPE)
    image = load_image(str(tiff(tmp_path / "a.tif", stored, 6)), tmp_path)
    assert np.array_equal(image, np.rot90(stored, -1)[::-1])


def test_a_turned_picture_has_no_size_of_the_file(tmp_path):
    source = tiff(tmp_path / "a.tif", hills(SHAPE[1], SHAPE[0]), 6)
    [warning] = imported(tmp_path, source)[1]["warnings"]
    assert "The file names no size, so a sample is 1 m" in warning
    [warning] = imported(tmp_path, source, extent=(8.0, 6.0))[1]["warnings"]
    assert "The file names no size" not in warning and "if that length is wrong" in warning
    place = Affine(1.0, 0.0, 6e5, 0.0, -1.0, 5e6)
    [warning] = imported(tmp_path, write_raster(tmp_path / "b.tif", hills(7, 5), transform=place))[1]["warnings"]
    assert "if that length is wrong" in warning


@pytest.mark.parametrize("orientation", [1, 6])
def test_a_mosaic_of_turned_pictures_warns(tmp_path, orientation):
    """As GDAL does, it takes the rows as they are stored."""
    stored = hills(SHAPE[1], SHAPE[0])
    tiff(tmp_path / "a.tif", stored, orientation)
    text = (
        f'<VRTDataset rasterXSize="{SHAPE[1]}" rasterYSize="{SHAPE[0]}">{{}}<VRTRasterBand dataType="Float32" band="1">'
        '<SimpleSource><SourceFilename relativeToVRT="1">a.tif</SourceFilename></SimpleSource></VRTRasterBand>'
        "</VRTDataset>"
    )
    for place, is_placed in ("", False), ("<GeoTransform>6e5,1000,0,5e6,0,-1000</GeoTransform>", True):
        (tmp_path / "a.vrt").write_text(text.format(place))
        field, report = imported(tmp_path, tmp_path / "a.vrt")
        found = [warning for warning in report["warnings"] if "Orientation" in warning]
        assert len(found) == (orientation != 1 and not is_placed) and all("a.tif" in warning for warning in found)
        assert np.array_equal(field.heights(), stored[::-1])
