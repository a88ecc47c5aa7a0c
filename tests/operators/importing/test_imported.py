# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel says of a store, and which settings ask for another import."""

import dataclasses
import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field import store as stores
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.rasters.source_formats import BAND, RAW
from adaptive_terrain.operators.importing import import_terrain
from adaptive_terrain.operators.importing.imported import (
    Imported,
    changed_settings,
    filled_note,
    imported_of,
    info_lines,
    tag_object,
)
from adaptive_terrain.operators.importing.panel import ImportedPanel, SourcePanel, is_stale
from drawn_panels import DrawnLayout, draw_mocked

pytestmark = pytest.mark.usefixtures("imports_here")


@pytest.fixture(scope="module")
def utm(tmp_path_factory):
    """Write a GeoTIFF of 40 x 30 samples, 25 m apart, in UTM 16 N."""
    import rasterio
    from rasterio.transform import from_origin

    path = tmp_path_factory.mktemp("utm") / "utm.tif"
    profile = {"driver": "GTiff", "width": 40, "height": 30, "count": 1, "dtype": "float32", "crs": "EPSG:32616"}
    with rasterio.open(path, "w", transform=from_origin(700_000.0, 4_050_000.0, 25.0, 25.0), **profile) as tif:
        tif.write(np.random.default_rng(1).random((1, 30, 40), np.float32))
    return path


@pytest.fixture(scope="module")
def imported(utm):
    run_import(ImportSettings(source=str(utm)), utm.with_name("utm.store"))
    return utm.with_name("utm.store")


@pytest.fixture
def terrain(scene, add_terrain, utm, imported, tmp_path):
    """Add a terrain as an import leaves it, with a copy of the store."""
    terrain = add_terrain()
    settings = terrain.adaptive_terrain
    settings.store = str(shutil.copytree(imported, tmp_path / "store"))
    settings.source, settings.source_path = "FILE", str(utm)
    return terrain


def test_the_panel_shows_what_was_imported(terrain):
    assert info_lines(imported_of(terrain.adaptive_terrain)) == [
        ("From", "utm.tif"),
        ("CRS", "EPSG:32616"),
        ("Origin", "700500, 4049625"),
        ("Raster", "40 x 30"),
        ("Extent", "975 x 725 m"),
        ("Spacing", "25 x 25 m"),
        ("Heights", "0.002057 to 0.999 m"),
    ]
    assert len(info_lines(None)) == 7, "as many lines before an import"


def test_the_panel_shows_the_warnings_of_an_import(terrain):
    file = Path(terrain.adaptive_terrain.store) / "store.json"
    content = json.loads(file.read_text())
    assert imported_of(terrain.adaptive_terrain).warnings == ()
    content["report"]["filled"] = 27
    content["report"]["warnings"] = ["Heights are in\nfeet.", "x" * 9_000, *["more"] * 50]
    content["sum"] = stores._sum_of(content)
    file.write_text(json.dumps(content))
    warnings = imported_of(terrain.adaptive_terrain).warnings
    assert warnings[0] == "Heights are in feet." and max(map(len, warnings)) < 600 and len(warnings) < 10
    column = draw_mocked(ImportedPanel, terrain)
    labels = [call.kwargs.get("text") for call in column.box().column().label.mock_calls]
    assert "Heights are in feet." in labels
    filled = "Filled: 27 samples without data. To leave holes, tick Cut Out No-Data and import again."
    assert filled in " ".join(filter(None, labels))
    imported = dataclasses.replace(imported_of(terrain.adaptive_terrain), raster=(200, 300), filled=45_000)
    assert filled_note(imported).startswith("Filled: 75 % of the rectangle, which has no data. To leave holes,")


def test_raw_settings_are_for_files_without_a_header(tmp_path):
    (tmp_path / "a.bil").touch()
    path, has_option = str(tmp_path / "a.bil"), import_terrain.has_option
    assert has_option(path, RAW) and not has_option(path, BAND) and has_option("a.r16", RAW)
    (tmp_path / "a.hdr").touch()
    assert has_option(path, BAND) and not has_option(path, RAW)


RAW_LAYOUT = {"raw_size", "raw_dtype", "raw_little_endian"}


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.tif", {"band", "encoding", "project"}),
        ("a.asc", {"band", "project"}),
        ("a.npy", set()),
        ("a.exr", {"channel"}),
        ("a.laz", {"band", "cell", "project"}),
        ("a.raw", RAW_LAYOUT),
        ("a.raw.gz", RAW_LAYOUT),
        ("a.bil", RAW_LAYOUT),  # without its header
        ("a.zip", {"band", "encoding", "project"}),
    ],
)
def test_only_options_that_apply_are_drawn_and_used(terrain, name, options):
    settings = terrain.adaptive_terrain
    settings.source, settings.source_path = "FILE", f"/nowhere/{name}"
    settings.raw_size, settings.raw_dtype, settings.raw_little_endian = (9, 9), "int8", False
    settings.band, settings.channel, settings.encoding, settings.cell = 2, "Z", "mapbox", 3.0
    settings.project, settings.first_row_south = "utm", True
    every = RAW_LAYOUT | {"band", "channel", "encoding", "cell", "project", "first_row_south"}
    used = import_terrain.settings_of(terrain)
    changed = {field.name for field in dataclasses.fields(used) if getattr(used, field.name) != field.default}
    layout = DrawnLayout()
    SourcePanel.draw(SimpleNamespace(layout=layout, _columns=layout.column), bpy.context)
    drawn = {text.strip("<>") for text in layout.texts}
    assert changed & every == drawn & every == options | {"first_row_south"}


def test_the_object_has_the_properties_of_blendergis(scene, add_terrain, utm, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    terrain = add_terrain()
    settings = terrain.adaptive_terrain
    settings.store, settings.source, settings.source_path = "", "FILE", str(utm)
    assert bpy.ops.adaptive_terrain.import_source() == {"FINISHED"}
    assert not is_stale(terrain)
    assert (terrain["SRID"], terrain["crs x"], terrain["crs y"]) == ("EPSG:32616", 700_500.0, 4_049_625.0)
    terrain.adaptive_terrain.source, terrain.adaptive_terrain.island_size = "ISLAND", 17
    bpy.ops.adaptive_terrain.import_source()
    assert "SRID" not in terrain and "crs x" not in terrain, "an island is nowhere"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("height_scale", 2.5),
        ("height_offset", -3.0),
        ("use_no_data", True),
        ("use_extent", True),
        ("band", 2),
        ("first_row_south", True),
        ("source", "ISLAND"),
        ("source_path", "/nowhere/dem.tif"),
        ("source_path", ""),
    ],
)
def test_changed_settings_ask_for_another_import(terrain, name, value):
    assert not is_stale(terrain)
    before = getattr(terrain.adaptive_terrain, name)
    setattr(terrain.adaptive_terrain, name, value)
    assert is_stale(terrain)
    setattr(terrain.adaptive_terrain, name, before)
    assert not is_stale(terrain)


def test_live_settings_do_not(terrain):
    terrain.adaptive_terrain.vertical_scale, terrain.adaptive_terrain.vertical_offset = 3.0, 10.0
    assert not is_stale(terrain)


def test_a_file_that_moved_is_the_same(tmp_path):
    asked = ImportSettings(source=str(tmp_path / "dem.tif"), extent=(10.0, 20.0), no_data=-9999.0)
    kept = dataclasses.asdict(asked) | {"extent": [10.0, 20.0], "no_data": "-9999.0"}
    store = Imported(kept, "", (0.0, 0.0), (2, 2), (1.0, 1.0), (1.0, 1.0), (0.0, 1.0))
    assert changed_settings(asked, store) == []
    moved = dataclasses.replace(asked, source="/elsewhere/dem.tif")
    assert changed_settings(moved, store) == [], "what was imported is gone from its place"
    (tmp_path / "dem.tif").touch()
    assert changed_settings(moved, store) == ["source"], "two files of one name"
    for recorded, changed in (
        ("dem.tif", []),
        ("../dem.tif", []),
        ("other/dem.tif", ["source"]),
        ("island", ["source"]),
    ):
        older = dataclasses.replace(store, settings=kept | {"source": recorded})
        assert changed_settings(asked, older) == changed, "of a version that recorded relative paths"
    long = f"{'n' * 300}.tif"  # no file can have this name
    older = dataclasses.replace(store, settings=kept | {"source": str(tmp_path / long)})
    assert changed_settings(dataclasses.replace(asked, source=f"/now/{long}"), older) == []
    dotted = dataclasses.replace(asked, source=str(tmp_path / "x" / ".." / "dem.tif"))
    (tmp_path / "x").mkdir()
    assert changed_settings(dotted, store) == []
    del kept["band"]
    assert changed_settings(asked, store) == [], "a setting that an older store does not know has its default"
    assert changed_settings(dataclasses.replace(asked, band=2), store) == ["band"]
    assert changed_settings(asked, dataclasses.replace(store, settings={})) == []


@pytest.mark.parametrize("pair", [[10**400, 3], [-5, 3], [1, 1e300], "many"])
def test_impossible_figures_of_a_store_are_no_error(terrain, pair):
    file = Path(bpy.path.abspath(terrain.adaptive_terrain.store)) / "store.json"
    content = json.loads(file.read_text())
    content["report"] = {"raster": pair, "extent_m": pair, "filled": pair}
    content["crs"] = "\ud800\x1b[2J"
    content["sum"] = stores._sum_of(content)
    file.write_text(json.dumps(content))
    lines = info_lines(imported_of(terrain.adaptive_terrain))
    assert len(lines) == 7 and all(figure.isprintable() and len(figure) < 40 for _, figure in lines)
    tag_object(terrain)


@pytest.mark.parametrize(
    "file,encoding,cell,wanted",
    [
        ("a.png", "AUTO", 2.0, ("", None)),
        ("a.png", "mapbox", 2.0, ("mapbox", None)),
        ("a.hgt", "mapbox", 2.0, ("", None)),
        ("a.laz", "mapbox", 2.0, ("", 2.0)),
        ("a.laz", "AUTO", 0.0, ("", None)),
        ("*.laz", "mapbox", 2.0, ("mapbox", 2.0)),
    ],
)
def test_encoding_and_cell_count_for_their_formats_alone(terrain, file, encoding, cell, wanted):
    obj, settings = terrain, terrain.adaptive_terrain
    settings.source, settings.source_path, settings.encoding, settings.cell = "FILE", f"/tmp/{file}", encoding, cell
    found = import_terrain.settings_of(obj)
    assert (found.encoding, found.cell) == wanted
