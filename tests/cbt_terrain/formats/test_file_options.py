# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings that have no effect on their source are refused."""

import gzip
import zipfile

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.formats.sources import open_source
from adaptive_terrain.cbt_terrain.importing.source_info import describe_source
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from rasterio.transform import from_origin
from rasters import hills, imported, write_raster

PLACE = {"crs": "EPSG:32632", "transform": from_origin(600_000, 5_200_000, 10, 10)}
RAW = ({"raw_size": (9, 9)}, {"raw_dtype": "int16"}, {"raw_little_endian": False})
UNUSED = {
    "a.tif": [*RAW, {"channel": "Z"}, {"cell": 2.0}, {"size": 9}, {"seed": 3}],
    "a.asc": [*RAW, {"channel": "Z"}, {"cell": 2.0}, {"encoding": "mapbox"}],
    "a.npy": [*RAW, {"channel": "Z"}, {"cell": 2.0}, {"encoding": "mapbox"}, {"band": 2}],
    "a.raw": [{"channel": "Z"}, {"cell": 2.0}, {"encoding": "mapbox"}, {"band": 2}],
    "island": [*RAW, {"band": 2}, {"no_data": 0.0}, {"holes": True}, {"first_row_south": True}],
}


def write_source(folder, name):
    heights = hills(9, 9).astype(np.uint16)
    if name == "a.npy":
        np.save(folder / name, heights)
    elif name == "a.raw":
        heights.tofile(folder / name)
    elif name != "island":
        write_raster(folder / name, heights)
    return name if name == "island" else str(folder / name)


@pytest.mark.parametrize("name", UNUSED)
def test_settings_of_other_sources_are_refused(tmp_path, name):
    source = write_source(tmp_path, name)
    small = {"size": 9} if name == "island" else {}
    for setting in UNUSED[name]:
        with pytest.raises(TerrainError, match=f"has no effect on .*{name}; expected .*: leave it out") as caught:
            imported(tmp_path, source, **setting | small)
        for option in setting:
            label = {"raw_dtype": "raw-type", "raw_little_endian": "big-endian"}.get(option, option.replace("_", "-"))
            assert f"--{label}" in caught.value.what
    assert not (tmp_path / "store").exists()
    imported(tmp_path, source, **small)


def test_a_description_refuses_them_too(tmp_path):
    with pytest.raises(TerrainError, match="has no effect on .*a.tif"):
        describe_source(ImportSettings(write_source(tmp_path, "a.tif"), raw_size=(9, 9)))


def test_a_header_decides_whether_a_layout_applies(tmp_path):
    hills(9, 9).astype("<i2").tofile(tmp_path / "a.bil")
    given = {"raw_size": (9, 9), "raw_dtype": "int16"}
    assert imported(tmp_path, tmp_path / "a.bil", **given)[1]["raster"] == [9, 9]
    with pytest.raises(TerrainError, match=r"A band \(--band\) has no effect"):
        imported(tmp_path, tmp_path / "a.bil", **given, band=2)
    (tmp_path / "a.hdr").write_text("nrows 9\nncols 9\nnbits 16\npixeltype signedint\n")
    assert imported(tmp_path, tmp_path / "a.bil")[1]["raster"] == [9, 9]
    with pytest.raises(TerrainError, match="The layout .* has no effect"):
        imported(tmp_path, tmp_path / "a.bil", **given)


def test_the_file_in_an_archive_decides(tmp_path):
    data = hills(9, 4).astype("<u2").tobytes()
    (tmp_path / "a.raw.gz").write_bytes(gzip.compress(data))
    with zipfile.ZipFile(tmp_path / "b.zip", "w") as archive:
        archive.writestr("b.raw", data)
    for name in ("a.raw.gz", "b.zip"):
        assert imported(tmp_path, tmp_path / name, raw_size=(9, 4))[1]["raster"] == [9, 4]
        with pytest.raises(TerrainError, match="A band .* has no effect on"):
            imported(tmp_path, tmp_path / name, raw_size=(9, 4), band=2)


def test_the_order_of_rows_is_of_files_without_a_position(tmp_path):
    path = write_raster(tmp_path / "a.tif", hills(9, 9), **PLACE)
    with pytest.raises(TerrainError, match="An order of rows .*; expected one file that does not state where north is"):
        open_source(ImportSettings(str(path), first_row_south=True))


def test_several_files_refuse_what_none_of_them_has(tmp_path):
    paths = [str(write_raster(tmp_path / f"{name}.tif", hills(9, 9), **PLACE)) for name in "ab"]
    with zipfile.ZipFile(tmp_path / "tiles.zip", "w") as archive:
        for path in paths:
            archive.write(path, path.rpartition("/")[2])
    of_all = [*RAW, {"channel": "Z"}, {"first_row_south": True}, {"seed": 3}]
    for source, unused in ((paths[0], [*of_all, {"cell": 2.0}]), (str(tmp_path / "tiles.zip"), of_all)):
        more = tuple(paths[1:]) if source == paths[0] else ()
        for setting in unused:
            with pytest.raises(TerrainError, match="has no effect on"):
                run_mosaic_import(ImportSettings(source, more_sources=more, **setting), tmp_path / "store")
        run_mosaic_import(ImportSettings(source, more_sources=more, no_data=-1.0), tmp_path / "store")


def test_a_type_of_another_length_than_that_of_r32_is_refused(tmp_path):
    hills(9, 9).astype("<f4").tofile(tmp_path / "a.r32")
    imported(tmp_path, tmp_path / "a.r32")
    with pytest.raises(TerrainError, match="samples of float32 by its suffix, not of int16: leave the type out"):
        imported(tmp_path, tmp_path / "a.r32", raw_dtype="int16")


def test_a_band_of_coded_heights_is_refused(tmp_path):
    path = tmp_path / "a.png"
    with rasterio.open(path, "w", driver="PNG", width=9, height=9, count=3, dtype="uint8") as file:
        file.write(np.full((3, 9, 9), 128, np.uint8))
    imported(tmp_path, path, encoding="terrarium")
    with pytest.raises(TerrainError, match="in the colours of all its bands, not in band 2: leave the band out"):
        imported(tmp_path, path, encoding="terrarium", band=2)
    imported(tmp_path, path, encoding="plain", band=2)
