# SPDX-License-Identifier: GPL-3.0-or-later
"""Files beside a raster: .aux.xml, world files, .prj. They are read, and nothing is ever written there."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.formats.sources import open_source
from adaptive_terrain.cbt_terrain.importing import earlier_import
from adaptive_terrain.cbt_terrain.importing.earlier_import import source_digest
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.rasters.sidecars import MAX_BYTES, is_alone, sidecars
from rasterio.crs import CRS
from rasterio.shutil import copy
from rasterio.transform import from_origin
from rasters import hills, imported, write_raster
from sandboxed_reads import read_in_sandbox

WIDTH, HEIGHT = 6, 5
UTM = "EPSG:32632"
WKT = CRS.from_epsg(32632).to_wkt()
WORLD = "10\n0\n0\n-20\n600005\n5199990\n"
PLACE = "<GeoTransform> 600000, 10, 0, 5200000, 0, -20</GeoTransform>"
SYSTEM = f"<SRS dataAxisToSRSAxisMapping='1,2'>{WKT}</SRS>"


RPB_POLYNOMIALS = ("lineNum", "lineDen", "sampNum", "sampDen")
MASKED = {"PNG": "png", "AAIGrid": "asc", "HFA": "img", "EHdr": "bil", "JP2OpenJPEG": "jp2", "netCDF": "nc"}


def heights_16_bit():
    return np.round(hills(WIDTH, HEIGHT)).astype(np.uint16)


def ascii_grid(path):
    rows = "\n".join(" ".join(map(str, row)) for row in heights_16_bit())
    path.write_text(f"ncols {WIDTH}\nnrows {HEIGHT}\nxllcorner 600000\nyllcorner 5199900\ndx 10\ndy 20\n{rows}\n")
    return path


def bare(tmp_path, name):
    """Write a raster without a position, or an ASCII grid without a coordinate system."""
    path = tmp_path / name
    return ascii_grid(path) if path.suffix == ".asc" else write_raster(path, heights_16_bit())


def aux(source, content):
    path = source.with_name(source.name + ".aux.xml")
    path.write_text(f"<PAMDataset>{content}</PAMDataset>")
    return path


def everything_below(folder):
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


@pytest.mark.parametrize("name", ["a.tif", "a.png", "a.asc"])
@pytest.mark.parametrize("system", [SYSTEM, f"<SRS>{UTM}</SRS>"], ids=["WKT", "EPSG"])
def test_an_aux_file_is_read_beside_any_raster_and_none_written(tmp_path, name, system):
    (tmp_path / "in").mkdir()
    source = bare(tmp_path / "in", name)
    no_data = -9999 if name == "a.asc" else int(heights_16_bit()[2, 3])  # GDAL reads those of ASCII grids alone
    band = f"<NoDataValue>{no_data}</NoDataValue><Offset>-7</Offset><Scale>0.5</Scale><UnitType>m</UnitType>"
    aux(source, f'{system}{PLACE}<PAMRasterBand band="1">{band}</PAMRasterBand>')
    before = everything_below(tmp_path / "in")
    field, report = imported(tmp_path, source, holes=True)
    missing = heights_16_bit() == no_data
    assert (report["step_m"], report["crs"], report["cut_out"]) == ([10.0, 20.0], UTM, missing.sum())
    found = field.heights()[::-1]
    assert np.array_equal(found[~missing], (heights_16_bit() * 0.5 - 7.0)[~missing])
    _, projected = imported(tmp_path, source, project="EPSG:25832")
    assert projected["crs"] == "EPSG:25832" and everything_below(tmp_path / "in") == before


@pytest.mark.parametrize("name", ["a.tif", "a.png", "a.asc"])
def test_a_raster_without_an_aux_file_gets_none(tmp_path, name):
    (tmp_path / "in").mkdir()
    source = bare(tmp_path / "in", name)
    before = everything_below(tmp_path / "in")
    imported(tmp_path, source)
    assert everything_below(tmp_path / "in") == before


def test_control_points_of_an_aux_file_are_used(tmp_path):
    source = bare(tmp_path, "a.png")
    corners = ((0, 0), (WIDTH, 0), (0, HEIGHT))
    points = "".join(f'<GCP Id="" Pixel="{c}" Line="{r}" X="{6e5 + 10 * c}" Y="{5.2e6 - 20 * r}"/>' for c, r in corners)
    aux(source, f'<GCPList Projection="{UTM}">{points}</GCPList>')
    assert imported(tmp_path, source)[1]["step_m"] == [10.0, 20.0]


HARMFUL = {
    "entities": ('<!DOCTYPE a [<!ENTITY b "c">]><PAMDataset/>', "a document type"),
    "not XML": ("<PAMDataset>", "no well-formed XML"),
    "another file": ('<PAMDataset><Metadata><MDI key="OVERVIEW_FILE">b.tif</MDI></Metadata></PAMDataset>', "names"),
    "deep": ("<PAMDataset>" + "<a>" * 70, "elements more than 64 deep"),
    "large": (f"<PAMDataset>{' ' * MAX_BYTES}</PAMDataset>", "more than 16 MB"),
}


@pytest.mark.parametrize("name", HARMFUL)
def test_a_harmful_aux_file_is_not_read_but_warned_about(tmp_path, name):
    content, problem = HARMFUL[name]
    source = bare(tmp_path, "a.tif")
    (tmp_path / "a.tif.aux.xml").write_text(content)
    warnings = imported(tmp_path, source, height_scale=1.0)[1]["warnings"]
    [warning] = [warning for warning in warnings if not warning.startswith("The relief, ")]
    assert problem in warning and "a.tif.aux.xml is not read" in warning and warning.endswith("are not used.")


@pytest.mark.parametrize("name", ["a.tif.msk.AUX.XML", "a.tif.msk.ovr.aux.xml", "a.tif.ovr.ovr.aux.xml"])
def test_a_harmful_aux_file_of_a_mask_is_warned_about(tmp_path, name):
    source = bare(tmp_path, "a.tif")
    aux(source, PLACE)
    (tmp_path / name).write_text(HARMFUL["another file"][0])
    _, report = imported(tmp_path, source, height_scale=1.0)
    assert report["step_m"] == [1.0, 1.0] and f"{name} is not read" in report["warnings"][0]


def test_a_mask_beside_any_raster_counts(tmp_path):
    """The process that reads keeps GDAL's driver of masks, whatever the raster's own driver is."""
    heights, mask = heights_16_bit(), np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[1, 2:4] = 0
    write_raster(tmp_path / "heights.tif", heights, crs=UTM, transform=from_origin(6e5, 5.2e6, 10, 10))
    with rasterio.open(write_raster(tmp_path / "mask.tif", mask), "r+") as file:
        file.update_tags(INTERNAL_MASK_FLAGS_1="2")  # one mask for all bands
    files = []
    for driver, suffix in MASKED.items():
        files.append(tmp_path / f"a.{suffix}")
        options = {"QUALITY": "100", "REVERSIBLE": "YES"} if driver == "JP2OpenJPEG" else {}
        copy(tmp_path / "heights.tif", files[-1], driver=driver, **options)
        shutil.copy(tmp_path / "mask.tif", f"{files[-1]}.msk")
    wanted = ["read", [WIDTH, HEIGHT, float(heights[mask > 0].sum()), 2]]
    assert dict(zip(MASKED, read_in_sandbox(files), strict=True)) == dict.fromkeys(MASKED, wanted)


def test_flags_of_a_mask_in_its_aux_file_count(tmp_path):
    """They tell GDAL that a file is a mask."""
    heights, mask = heights_16_bit(), np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[1, 2:4] = 0
    for n in range(2):
        place = from_origin(6e5 + 10 * WIDTH * n, 5.2e6, 10, 10)
        write_raster(tmp_path / f"{n}.tif", heights, crs=UTM, transform=place)
        write_raster(tmp_path / "mask.tif", mask).rename(tmp_path / f"{n}.tif.msk")
    digests = {source_digest(ImportSettings(str(tmp_path / "0.tif")))}
    flags = '<PAMDataset><Metadata><MDI key="INTERNAL_MASK_FLAGS_1">2</MDI></Metadata></PAMDataset>'
    (tmp_path / "0.tif.msk.aux.xml").write_text(flags)
    digests.add(source_digest(ImportSettings(str(tmp_path / "0.tif"))))
    assert len(digests) == 2
    [(kind, (*_, missing))] = read_in_sandbox([tmp_path / "0.tif"])
    assert (kind, missing) == ("read", 2)
    report = run_mosaic_import(ImportSettings(str(tmp_path), holes=True), tmp_path / "store")
    assert report["cut_out"] == 2


@pytest.mark.parametrize("kind", ["no flags", "damaged", "empty", "mask"])
def test_a_mask_that_is_not_read_is_warned_about(tmp_path, kind):
    place = {"crs": UTM, "transform": from_origin(6e5, 5.2e6, 10, 10)}
    source = write_raster(tmp_path / "a.tif", heights_16_bit(), nodata=0, **place)
    mask = write_raster(tmp_path / "mask.tif", np.zeros((HEIGHT, WIDTH), np.uint8))
    if kind == "mask":
        with rasterio.open(mask, "r+") as file:
            file.update_tags(INTERNAL_MASK_FLAGS_1="2")
    cut = {"damaged": 100, "empty": 0}.get(kind)
    (tmp_path / "a.tif.msk").write_bytes(mask.read_bytes()[:cut])
    raster = open_source(ImportSettings(str(source)))
    assert np.isnan(raster.read(0, HEIGHT)).all() == (kind == "mask")
    expected = [] if kind == "mask" else ["a.tif.msk hides no samples"]
    assert [text.split(",")[0] for text in raster.warnings] == expected


def test_a_vrt_warns_of_masks_beside_its_sources(tmp_path):
    """GDAL's VRTs of masked files name these masks, but a VRT must not lead to files that were not checked."""
    place = {"crs": UTM, "transform": from_origin(6e5, 5.2e6, 10, 10)}
    source = write_raster(tmp_path / "a.tif", heights_16_bit(), **place)
    copy(source, tmp_path / "b.vrt", driver="VRT")
    assert not open_source(ImportSettings(str(tmp_path / "b.vrt"))).warnings
    write_raster(tmp_path / "mask.tif", np.ones((HEIGHT, WIDTH), np.uint8)).rename(f"{source}.msk")
    [warning] = open_source(ImportSettings(str(tmp_path / "b.vrt"))).warnings
    assert warning.startswith("The mask a.tif.msk is beside the VRT or its sources, and such files are not read")


def test_stores_that_ignore_a_mask_are_replaced(tmp_path, monkeypatch):
    """Older versions ignored most masks. Stores of files without one stay as they are."""
    plain = write_raster(tmp_path / "plain.tif", heights_16_bit())
    masked = write_raster(tmp_path / "masked.png", heights_16_bit())
    write_raster(tmp_path / "mask.tif", np.ones((HEIGHT, WIDTH), np.uint8)).rename(f"{masked}.msk")
    now = [source_digest(ImportSettings(str(source))) for source in (plain, masked)]
    monkeypatch.setattr(earlier_import, "MASKS", 0)
    before = [source_digest(ImportSettings(str(source))) for source in (plain, masked)]
    assert now[0] == before[0] and now[1] != before[1]
    several = ImportSettings(str(plain), more_sources=(str(masked),))
    files = Path(f"{masked}.msk"), masked
    before = [source_digest(several, files[n:]) for n in range(2)]
    monkeypatch.undo()
    assert source_digest(several, files) != before[0] and source_digest(several, files[1:]) == before[1]


def test_a_system_of_an_aux_file_names_no_file(tmp_path):
    (tmp_path / "system.wkt").write_text(WKT)
    for name in ("a.tif", "a.asc"):
        source = bare(tmp_path, name)
        for content in (f"<SRS>{tmp_path / 'system.wkt'}</SRS>", f'<GCPList Projection="{tmp_path}/system.wkt"/>'):
            aux(source, content + PLACE)
            _, report = imported(tmp_path, source)
            assert report["crs"] == "" and "names no coordinate system" in report["warnings"][0]


@pytest.mark.parametrize("name, world", [("a.png", "pgw"), ("a.png", "PNGW"), ("a.tif", "tfw"), ("a.tif", "wld")])
@pytest.mark.parametrize("system", [".prj", ".PRJ"])
def test_world_files_and_systems_are_read(tmp_path, name, world, system):
    source = bare(tmp_path, name)
    source.with_suffix("." + world).write_text(WORLD)
    assert imported(tmp_path, source)[1]["crs"] == ""
    source.with_suffix(system).write_text(CRS.from_epsg(32632).to_wkt(version="WKT1_ESRI"))
    field, report = imported(tmp_path, source)
    assert (report["step_m"], report["crs"], report["warnings"]) == ([10.0, 20.0], UTM, [])
    assert field.origin.tolist() == [600030.0, 5199950.0, 0.0]


def test_a_prj_without_a_system_is_warned_about(tmp_path):
    source = bare(tmp_path, "a.png")
    source.with_suffix(".pgw").write_text(WORLD)
    source.with_suffix(".prj").write_bytes(b"no \xff system")
    [warning] = imported(tmp_path, source)[1]["warnings"]
    assert "a.prj is not read" in warning


def test_sidecars_are_found_in_any_case_and_count(tmp_path):
    source = bare(tmp_path, "Map.PNG")
    settings = ImportSettings(str(source))
    digests = {source_digest(settings)}
    for name in ("Map.PGW", "map.prj", "Map.PNG.aux.xml"):
        (tmp_path / name).write_text(WORLD)
        digests.add(source_digest(settings))
    (tmp_path / "Map2.prj").write_text(WKT)
    digests.add(source_digest(settings))
    assert [path.name for path in sidecars(source)] == ["Map.PGW", "Map.PNG.aux.xml", "map.prj"] and len(digests) == 4


@pytest.mark.parametrize("name", ["a_RPC.TXT", "a_rpc.txt", "a.RPB"])
def test_rational_polynomials_beside_a_file_count(tmp_path, name):
    source, numbers = bare(tmp_path, "a.tif"), {}
    before = source_digest(ImportSettings(str(source)))
    coefficients = [1.0, *[0.0] * 19]
    if name.endswith("RPB"):
        for key in ("line", "samp", "lat", "long", "height"):
            numbers |= {f"{key}Offset": "1", f"{key}Scale": "1"}
        numbers |= {f"{key}Coef": f"({', '.join(map(str, coefficients))})" for key in RPB_POLYNOMIALS}
        lines = "".join(f"{key} = {number};\n" for key, number in numbers.items())
        text = f'satId = "QB02";\nBEGIN_GROUP = IMAGE\n{lines}END_GROUP = IMAGE\nEND;\n'
    else:
        for key in ("LINE", "SAMP", "LAT", "LONG", "HEIGHT"):
            numbers |= {f"{key}_OFF": 1, f"{key}_SCALE": 1}
        for key in ("LINE_NUM", "LINE_DEN", "SAMP_NUM", "SAMP_DEN"):
            numbers |= {f"{key}_COEFF_{k}": number for k, number in enumerate(coefficients, 1)}
        text = "".join(f"{key}: {number}\n" for key, number in numbers.items())
    (tmp_path / name).write_text(text)
    assert sidecars(source) == [tmp_path / name]
    digest = source_digest(ImportSettings(str(source)))
    (tmp_path / name).write_text(text + "\n")
    assert len({before, digest, source_digest(ImportSettings(str(source)))}) == 3, "it was added, then changed"
    assert "rational polynomials" in " ".join(imported(tmp_path, source)[1]["warnings"])


def test_a_raster_is_alone_without_files_of_its_name(tmp_path):
    for name in ("dem.tif", "dem_1.tif", "dem1.tif", "DEM.2.tif", "n46.tif"):
        (tmp_path / name).touch()
    assert is_alone(tmp_path / "n46.tif") and is_alone(tmp_path / "dem_1.tif")
    assert not is_alone(tmp_path / "dem.tif"), "DEM.2.tif may belong to it"
    (tmp_path / "n47.tif").touch()
    (tmp_path / "n47_RPC.TXT").touch()
    assert not is_alone(tmp_path / "n47.tif")
    (tmp_path / "a.bil").touch()
    (tmp_path / "a.bilw").touch()
    assert sidecars(tmp_path / "a.bil") == [tmp_path / "a.bilw"]
    for name in ("N46.TFW", "dem_1.tif.msk", "dem1.tif.xml"):
        assert is_alone(tmp_path / f"{name.lower().split('.')[0]}.tif")
        (tmp_path / name).touch()
        os.utime(tmp_path, ns=(0, os.stat(tmp_path).st_mtime_ns + 1))  # two files may come within a clock tick
        assert not is_alone(tmp_path / f"{name.lower().split('.')[0]}.tif")
    assert not is_alone(tmp_path / "missing" / "a.tif")


@pytest.mark.parametrize("name", ["a.tif.aux.xml", "a.tfw", "a.TFW", "a.prj"])
def test_a_pipe_beside_a_raster_is_refused_at_once(tmp_path, name):
    source = bare(tmp_path, "a.tif")
    os.mkfifo(tmp_path / name)
    with pytest.raises(TerrainError, match=f"{name}, beside a.tif, is a pipe, a socket or a device"):
        open_source(ImportSettings(str(source)))


@pytest.mark.parametrize(
    ("raster", "name"), [("up.tif", "up.tif.AUX.XML"), ("cam.tif", "CAM.TIF.aux.xml"), ("Map.PNG", "map.png.aux.xml")]
)
def test_an_aux_file_in_other_letters_is_warned_about(tmp_path, raster, name):
    source = bare(tmp_path, raster)
    band = '<PAMRasterBand band="1"><UnitType>ft</UnitType></PAMRasterBand>'
    (tmp_path / name).write_text(f"<PAMDataset>{band}</PAMDataset>")
    [warning] = [text for text in imported(tmp_path, source)[1]["warnings"] if "named otherwise" in text]
    assert f"rename it to {raster}.aux.xml" in warning and name in warning
    (tmp_path / name).rename(tmp_path / f"{raster}.aux.xml")
    assert "Heights are in ft in the file" in imported(tmp_path, source)[1]["warnings"][0]


def test_the_exact_aux_file_wins_over_other_letters(tmp_path):
    source = bare(tmp_path, "a.tif")
    (tmp_path / "A.TIF.AUX.XML").write_text("<PAMDataset/>")
    band = '<PAMRasterBand band="1"><UnitType>ft</UnitType></PAMRasterBand>'
    aux(source, band)
    assert "Heights are in ft in the file" in imported(tmp_path, source)[1]["warnings"][0]
    aux(source, '<Metadata><MDI key="OVERVIEW_FILE">b.tif</MDI></Metadata>' + band)  # GDAL must not see it
    warnings = imported(tmp_path, source)[1]["warnings"]
    assert "a.tif.aux.xml is not read" in warnings[0] and not any("Heights are in ft" in text for text in warnings)
