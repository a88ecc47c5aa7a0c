# SPDX-License-Identifier: GPL-3.0-or-later
"""The catalogue of a mosaic's headers: accepted sources, refused sources, and the part that a store keeps."""

import json
import os
import sqlite3
import struct
from pathlib import Path

import numpy as np
import pytest
import rasterio.shutil
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.field.store_folder import named_folder
from adaptive_terrain.cbt_terrain.formats import vrt_source
from adaptive_terrain.cbt_terrain.formats.sources import open_source
from adaptive_terrain.cbt_terrain.importing import build_store, earlier_import, source_list
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.importing.source_list import files_of
from adaptive_terrain.cbt_terrain.mosaic import catalogue, index_files
from adaptive_terrain.cbt_terrain.mosaic.catalogue import build_catalogue, keep_catalogue
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.mosaic.index_files import paths_in
from adaptive_terrain.cbt_terrain.mosaic.mosaic_source import open_composite
from adaptive_terrain.cbt_terrain.rasters import length_scale
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from mosaic_files import DEGREES, EAST, NORTH, UTM32, settings_of, sheet
from rasters import hills, write_raster


def tiles(folder, count=3, crs=UTM32):
    """Write tiles from west to east."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 20 * count, 20)
    return [whole.write(folder / f"t{n}.tif", first_column=20 * n, columns=20, crs=crs) for n in range(count)]


def test_a_folder_gives_its_height_maps_by_name(tmp_path):
    tiles(tmp_path)
    hidden = tmp_path / "inner"
    hidden.mkdir()
    os.link(tmp_path / "t0.tif", hidden / "other.tif")
    os.symlink(tmp_path / "t0.tif", tmp_path / "link.tif")
    os.symlink(tmp_path / "missing.tif", tmp_path / "broken.tif")
    os.mkfifo(tmp_path / "pipe.tif")
    write_raster(tmp_path / "preview.png", np.zeros((4, 4), np.uint8))
    (tmp_path / "all.vrt").write_text("<VRTDataset/>")
    (tmp_path / "t0.tif.aux.xml").write_text("<PAMDataset/>")
    names = [path.name for path in files_of(settings_of(tmp_path))]
    assert names == ["link.tif", "t0.tif", "t1.tif", "t2.tif"]
    assert [path.name for path in files_of(settings_of(tmp_path / "**" / "*.tif"))][0] == "other.tif"
    # Named again later, a file has its last position.
    assert [p.name for p in files_of(settings_of(tmp_path, tmp_path / "t0.tif"))][-1] == "t0.tif"


def geopackage(path, names, column="location"):
    with sqlite3.connect(path) as base:
        base.execute(f'CREATE TABLE tiles (fid INTEGER PRIMARY KEY, geom BLOB, "{column}" TEXT)')
        base.executemany("INSERT INTO tiles VALUES (NULL, NULL, ?)", [(name,) for name in names])
    base.close()


VRT = """<VRTDataset rasterXSize="20" rasterYSize="20"><SRS>EPSG:32632</SRS>
<GeoTransform>572000, 10, 0, 5540500, 0, -10</GeoTransform><VRTRasterBand dataType="Float32" band="1"><SimpleSource>
<SourceFilename relativeToVRT="1">{}</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand>
</VRTDataset>"""


def shapefile(path, names):
    """Write the table of a shapefile with one column of texts."""
    field = b"location".ljust(11, b"\0") + b"C" + bytes(4) + bytes([80, 0]) + bytes(14)
    head = struct.pack("<4BIHH20x", 3, 126, 1, 1, len(names), 32 + 32 + 1, 81)
    rows = b"".join(b" " + name.encode().ljust(80) for name in names)
    path.with_suffix(".dbf").write_bytes(head + field + b"\r" + rows)
    path.write_bytes(bytes(100))


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["gti.gpkg", "shp", "gti"])
def test_tile_indexes_give_paths_only(tmp_path, kind):
    files = tiles(tmp_path / "tiles")
    names = [f"tiles/{file.name}" for file in files[::-1]]
    index = tmp_path / f"index.{kind}"
    if kind == "shp":
        shapefile(index, names)
    elif kind == "gti":
        geopackage(tmp_path / "base.sqlite", names, "where")
        index.write_text(
            "<GDALTileIndexDataset><IndexDataset>base.sqlite</IndexDataset>"
            "<LocationField>where</LocationField></GDALTileIndexDataset>"
        )
    else:
        geopackage(index, names)
    assert paths_in(index) == files[::-1]
    report = import_source(ImportSettings(str(index)), tmp_path / "store")
    assert report["raster"] == [60, 20] and report["filled"] == 0


def test_paths_in_an_index_begin_at_its_folder(tmp_path):
    """As with GDAL 3.10 the folder of the XML counts, not that of the database that it names."""
    files = tiles(tmp_path / "tiles")
    names = [f"../tiles/{file.name}" for file in files]
    for folder in ("xml", "other/bases"):
        (tmp_path / folder).mkdir(parents=True)
    geopackage(tmp_path / "other" / "bases" / "index.gpkg", names)
    with pytest.raises(TerrainError, match=r"index.gpkg names the source '\S+other/tiles/t0.tif', which is no regular"):
        paths_in(tmp_path / "other" / "bases" / "index.gpkg")
    text = "<GDALTileIndexDataset><IndexDataset>../other/bases/index.gpkg</IndexDataset></GDALTileIndexDataset>"
    (tmp_path / "xml" / "index.gti").write_text(text)
    assert paths_in(tmp_path / "xml" / "index.gti") == files
    both = build_catalogue(settings_of(tmp_path / "tiles", tmp_path / "xml" / "index.gti"), None)
    assert [tile.path for tile in both.tiles] == list(map(str, files)), "a file that is named in two ways counts once"


def test_dots_after_a_link_lead_from_its_target(tmp_path):
    files = tiles(tmp_path / "away" / "tiles")
    (tmp_path / "away" / "index").mkdir()
    geopackage(tmp_path / "away" / "index" / "index.gpkg", [f"../tiles/{file.name}" for file in files])
    os.symlink(tmp_path / "away" / "index", tmp_path / "link")
    found = paths_in(tmp_path / "link" / "index.gpkg")
    assert found == [tmp_path / "link" / ".." / "tiles" / file.name for file in files]
    assert [path.resolve() for path in found] == [path.resolve() for path in files]


def test_an_index_may_name_files_of_small_formats(tmp_path):
    """The import's sandboxed process has their drivers; large parsers are refused from their names."""
    west, east = tiles(tmp_path / "tiles", 2)
    rasterio.shutil.copy(west, tmp_path / "tiles" / "west.img", driver="HFA")
    geopackage(tmp_path / "index.gpkg", ["tiles/west.img", f"tiles/{east.name}"])
    report = import_source(ImportSettings(str(tmp_path / "index.gpkg")), tmp_path / "store")
    assert report["raster"] == [40, 20] and report["filled"] == 0
    for name in ("a.nc", "a.jp2", "a.laz"):
        (tmp_path / name).write_bytes(b"a")
        geopackage(tmp_path / f"{name}.gpkg", [name])
        with pytest.raises(TerrainError, match="names the source .*; expected one of .tif, .*[.]img"):
            paths_in(tmp_path / f"{name}.gpkg")


@pytest.mark.parametrize("name", ["/vsicurl/http://a/b.tif", "missing.tif", "secret.txt", ".", "https://a/b.tif"])
def test_an_index_may_name_files_of_known_kinds_only(tmp_path, name):
    (tmp_path / "secret.txt").write_text("secret")
    geopackage(tmp_path / "index.gpkg", [name])
    with pytest.raises(TerrainError, match="index.gpkg names the source"):
        paths_in(tmp_path / "index.gpkg")


@pytest.mark.parametrize(
    "content", [b"", b"\0" * 100, b"SQLite format 3\0" + b"\1" * 4000, b"<a>", b"<!DOCTYPE a><a/>"]
)
def test_a_damaged_index_is_refused(tmp_path, content):
    (tmp_path / "index.gti").write_bytes(content)
    with pytest.raises(TerrainError, match="cannot be read as a tile index"):
        paths_in(tmp_path / "index.gti")


def test_impossible_sources_are_refused_from_headers(tmp_path, monkeypatch):
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.mosaic.composite.Composite.read", None)
    files = tiles(tmp_path)
    nameless = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 20, 20).write(tmp_path / "nameless.tif", crs=None)
    with pytest.raises(TerrainError, match=r"nameless.tif names no coordinate system; expected one in every file"):
        open_composite(settings_of(*files, nameless), None)
    far = sheet(DEGREES, 170.0, -40.0, 0.001, 0.001, 20, 20).write(tmp_path / "far.tif")
    with pytest.raises(TerrainError, match=r"far.tif in EPSG:4326 has no place in EPSG:32632|would have"):
        open_composite(settings_of(*files, far, step=0.01), None)
    east = sheet(UTM32, EAST + 1e5, NORTH, 10.0, 10.0, 20, 20).write(tmp_path / "east.tif")
    with pytest.raises(TerrainError) as refusal:
        open_composite(settings_of(*files, east, step=5e-5), None)
    assert refusal.value.what.startswith("The mosaic would have 2,003,800,001 x 3,800,001 samples")
    step = float(refusal.value.fix.partition("--step ")[2].partition(")")[0])
    assert open_composite(settings_of(*files, east, step=step), None).grid.width < 2**30
    flat = write_raster(tmp_path / "flat.tif", hills(9, 9))
    with pytest.raises(TerrainError, match=r"flat.tif cannot be a part of a mosaic \(it has no position\)"):
        open_composite(settings_of(*files, flat), None)
    with pytest.raises(TerrainError, match="An extent in metres is of one file"):
        open_composite(settings_of(*files, extent=(10.0, 10.0)), None)


def test_files_without_any_system_form_a_mosaic(tmp_path):
    files = tiles(tmp_path, crs=None)
    grid = open_composite(settings_of(*files), None).grid
    assert (grid.crs, grid.width, grid.height) == ("", 60, 20)


def test_lengths_of_the_systems_of_tiles_are_not_measured(tmp_path, monkeypatch):
    """They took a quarter of the time of a header, and a mosaic warns about its own grid."""
    files, measured = tiles(tmp_path, crs="EPSG:3857"), []
    degrees = length_scale._degrees
    monkeypatch.setattr(length_scale, "_degrees", lambda *given: measured.append(1) or degrees(*given))
    assert len(build_catalogue(settings_of(tmp_path), None).tiles) == 3 and not measured
    raster = open_source(ImportSettings(str(files[0])))
    raster.close()
    assert measured and "Lengths in EPSG:3857 are not those" in raster.georeference.size_warnings[0]
    warnings = run_mosaic_import(settings_of(tmp_path), tmp_path / "store")["warnings"]
    assert sum("Lengths in EPSG:3857 are not those" in text for text in warnings) == 1


def test_a_kept_catalogue_spares_reading_headers(tmp_path, monkeypatch):
    files = tiles(tmp_path / "tiles")
    settings, store = settings_of(tmp_path / "tiles"), tmp_path / "store"
    run_mosaic_import(settings, store)
    read = []
    real = catalogue._read_tile
    monkeypatch.setattr(catalogue, "_read_tile", lambda path, *more: read.append(path.name) or real(path, *more))
    before = build_catalogue(settings, store)
    assert read == [] and before == build_catalogue(settings, None) and read == ["t0.tif", "t1.tif", "t2.tif"]
    read.clear()
    os.utime(files[1], ns=(1, 1))
    build_catalogue(settings, store)
    assert read == ["t1.tif"]
    read.clear()
    files[0].with_suffix(".tfw").write_text("1\n0\n0\n-1\n0\n0\n")  # a file that belongs to the first
    build_catalogue(settings, store)
    assert read == ["t0.tif", "t1.tif"]
    read.clear()
    for changed in ({"no_data": 5.0}, {"encoding": "plain"}, {"cell": 2.0}):
        build_catalogue(settings_of(tmp_path / "tiles", **changed), store)
        assert len(read) == 3
        read.clear()


@pytest.mark.parametrize("kind", ["folder", "pattern", "files"])
def test_an_older_store_of_a_path_with_dots_is_found(tmp_path, monkeypatch, kind):
    names = [path.name for path in tiles(tmp_path / "maps", 2)]
    (tmp_path / "inner").mkdir()
    monkeypatch.chdir(tmp_path / "inner")
    sources = {"folder": ["../maps"], "pattern": ["../maps/*.tif"], "files": [f"../maps/{name}" for name in names]}[
        kind
    ]
    with monkeypatch.context() as older:  # these versions recorded sources, and paths of files, as they were written
        for module in (earlier_import, build_store):
            older.setattr(module, "absolute_source", lambda source: source)
        older.setattr(source_list, "absolute_source", lambda source: str(Path(source).absolute()))
        run_mosaic_import(settings_of(*sources), tmp_path / "store")
    recorded = json.loads((tmp_path / "store" / "store.json").read_text())["provenance"]["settings"]
    assert [recorded["source"], *recorded["more_sources"]] == sources
    monkeypatch.chdir(tmp_path)
    sources = [source.removeprefix("../") for source in sources]
    assert run_mosaic_import(settings_of(*sources), tmp_path / "store").get("unchanged")
    os.utime(tmp_path / "maps" / names[1], (0, 0))
    assert not run_mosaic_import(settings_of(*sources), tmp_path / "store").get("unchanged")


@pytest.mark.parametrize(("kind", "source"), [("vrt", "maps"), ("index", "maps"), ("index", "../inner/maps")])
def test_an_older_store_of_files_that_name_others_is_found(tmp_path, monkeypatch, kind, source):
    """Older versions recorded the paths in a tile index or a VRT with their dots."""
    names = [path.name for path in tiles(tmp_path / "tiles", 2)]
    other = tiles(tmp_path / "other", 3)[2]
    (tmp_path / "inner" / "maps").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "inner")
    if kind == "vrt":
        (tmp_path / "inner" / "maps" / "a.vrt").write_text(VRT.format(f"../../tiles/{names[0]}"))
    else:
        geopackage(tmp_path / "inner" / "maps" / "a.gpkg", [f"../../tiles/{name}" for name in names])
    named = "a.vrt" if kind == "vrt" else "a.gpkg"
    with monkeypatch.context() as older:
        for module in (earlier_import, build_store):
            older.setattr(module, "absolute_source", lambda source: source)
        older.setattr(source_list, "absolute_source", lambda source: str(Path(source).absolute()))
        for module in (index_files, vrt_source):
            older.setattr(module, "without_dots", lambda path: path)
        run_mosaic_import(settings_of(f"{source}/{named}", other), tmp_path / "store")
    written = (tmp_path / "store" / "store.json").read_text()
    settings = settings_of(tmp_path / "inner" / "maps" / named, other)
    assert run_mosaic_import(settings, tmp_path / "store").get("unchanged")
    assert (tmp_path / "store" / "store.json").read_text() == written
    os.utime(tmp_path / "tiles" / names[0], (0, 0))
    assert not run_mosaic_import(settings, tmp_path / "store").get("unchanged")
    assert run_mosaic_import(settings, tmp_path / "store").get("unchanged")


def test_a_damaged_catalogue_is_built_again(tmp_path):
    tiles(tmp_path / "tiles")
    settings, store = settings_of(tmp_path / "tiles"), tmp_path / "store"
    run_mosaic_import(settings, store)
    wanted, file = build_catalogue(settings, store), named_folder(store) / catalogue.FILE_NAME
    content, random = file.read_bytes(), np.random.default_rng(1)
    for _ in range(60):
        damaged = bytearray(content)
        for at in random.integers(0, len(content), 3):
            damaged[at] = random.integers(0, 256)
        file.write_bytes(bytes(damaged[: random.integers(1, len(content) + 1)]))
        assert build_catalogue(settings, store) == wanted
    # Whole, with its checksum, but with impossible numbers.
    for name, value in (("width", -1), ("transform", [1, 2]), ("scale", None), ("crs", "/etc/hosts"), ("stored", "x")):
        entries = json.loads(json.loads(content)["content"])
        entries["tiles"][1][name] = value
        text = json.dumps(entries)
        file.write_text(json.dumps({"sum": catalogue._sum(text), "content": text}))
        assert build_catalogue(settings, store) == wanted
    keep_catalogue(wanted.tiles, settings, file.parent)
    assert file.read_bytes() == content


def test_a_file_that_changes_during_the_import_is_one_error(tmp_path):
    files = tiles(tmp_path / "tiles")
    changed = []

    def change(done, _message, *_more):
        if done > 0.2 and not changed:
            changed.append(files[0])
            tiles(tmp_path / "other", 1)[0].replace(files[0])

    with pytest.raises(TerrainError, match="t0.tif has changed while it was imported") as error:
        run_mosaic_import(settings_of(tmp_path / "tiles"), tmp_path / "store", change)
    assert error.value.code == "source.changed" and not (tmp_path / "store" / "store.json").exists()


def test_units_differ_by_file(tmp_path):
    feet = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 20, 20, unit=0.3048)
    metres = sheet(UTM32, EAST + 200, NORTH, 10.0, 10.0, 20, 20)
    file = feet.write(tmp_path / "a.tif", unit=0.3048)
    import rasterio

    with rasterio.open(file, "r+") as opened:
        opened.units = ("ft",)
    composite = open_composite(settings_of(file, metres.write(tmp_path / "b.tif")), None)
    heights, _ = composite.read(0, 20)
    assert np.abs(heights[:, :20] - feet.heights).max() < 1e-9
    assert np.array_equal(heights[:, 20:], metres.heights)


def test_the_sandboxed_process_imports_a_folder(tmp_path):
    tiles(tmp_path / "tiles")
    report = import_source(ImportSettings(str(tmp_path / "tiles")), tmp_path / "store")
    again = import_source(ImportSettings(str(tmp_path / "tiles")), tmp_path / "store")
    assert report["raster"] == [60, 20] and "unchanged" not in report and again["unchanged"]
    assert open_store(tmp_path / "store").samples.shape == (20, 60)
