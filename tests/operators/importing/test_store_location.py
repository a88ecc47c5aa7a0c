# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores are beside saved files or in a data folder, and those that earlier versions left elsewhere are moved there."""

import os
import shutil
from pathlib import Path

import bpy
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators.importing import store_location, store_paths
from adaptive_terrain.operators.importing.import_terrain import settings_of
from adaptive_terrain.operators.land import bake_land, shape_land
from land_scenes import add


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Create the old and the new data folder for this test alone."""
    old = tmp_path / "extensions" / ".user" / "user_default" / "adaptive_terrain" / "stores"
    new = tmp_path / "datafiles" / "adaptive_terrain" / "stores"
    old.mkdir(parents=True)
    for module in (store_location, store_paths):
        monkeypatch.setattr(module, "data_folder", lambda: new)
        monkeypatch.setattr(module, "deleted_folder", lambda: tmp_path / "extensions" / ".user")
    monkeypatch.setattr(store_paths, "notices", {})
    return old, new


def test_the_data_folder_survives_an_uninstall():
    """Blender removes only files below the folder of extensions."""
    extensions = Path(bpy.utils.user_resource("EXTENSIONS"))
    assert not store_location.data_folder().is_relative_to(extensions)
    assert store_location.data_folder().is_relative_to(Path(bpy.utils.user_resource("DATAFILES")))


def test_a_file_names_its_store_where_it_was_moved(scene, add_terrain, store, folders, tmp_path, capsys):
    old, new = folders
    shutil.copytree(store, old / "hills")
    (old / "hills_maps" / "mark").mkdir(parents=True)
    terrain, image = add_terrain(), bpy.data.images.new("snow", 4, 4)
    terrain.adaptive_terrain.store = str(old / "hills")
    image.filepath_raw, image.file_format = str(old / "hills_maps" / "mark" / "snow.png"), "PNG"
    image.save()
    image.source, image.use_fake_user = "FILE", True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "valley.blend"), relative_remap=False)
    key = open_store(old / "hills").key
    store_paths.move_old_stores()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "valley.blend"))
    assert bpy.data.objects["Terrain"].adaptive_terrain.store == str(new / "hills")
    assert open_store(new / "hills").key == key and not old.exists()
    assert bpy.data.images["snow"].filepath == str(new / "hills_maps" / "mark" / "snow.png")
    output = capsys.readouterr().out
    for expected in (f"Stores were moved out of {old}", f"into {new}: hills.", f"that of Terrain in {new / 'hills'}"):
        assert expected in output and expected in " ".join(store_paths.notices.values())
    bpy.ops.wm.read_homefile(use_empty=True)
    assert store_paths.FOUND not in store_paths.notices, "it is about the file that was open"


def test_a_path_that_cannot_exist_stops_no_other(scene, add_terrain, store, folders):
    old, new = folders
    shutil.copytree(store, new / "hills")
    long, terrain = add_terrain("Long"), add_terrain()
    long.adaptive_terrain.store = str(old / ("n" * 300))
    terrain.adaptive_terrain.store = str(old / "hills")
    store_paths.find_moved_stores()
    assert terrain.adaptive_terrain.store == str(new / "hills")


def test_an_appended_terrain_finds_its_moved_store(scene, add_terrain, store, folders, tmp_path):
    old, new = folders
    shutil.copytree(store, new / "hills")
    add_terrain().adaptive_terrain.store = str(old / "hills")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend")) as (_there, here):
        here.objects = ["Terrain"]
    if bpy.app.version >= (4, 3, 0):
        assert here.objects[0].adaptive_terrain.store == str(new / "hills")


def test_stores_that_cannot_be_moved_are_named(scene, store, folders, monkeypatch, capsys):
    old, new = folders
    shutil.copytree(store, old / "hills")

    def refuse(*_given):
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(os, "rename", refuse)
        store_paths.move_old_stores()
    assert open_store(old / "hills") and "could not be moved" in capsys.readouterr().out
    store_paths.move_old_stores()
    assert open_store(new / "hills") and "hills." in capsys.readouterr().out


def test_a_lost_store_is_not_imported_where_it_would_be_deleted(scene, add_terrain, folders):
    old, new = folders
    terrain = add_terrain()
    terrain.adaptive_terrain.store, terrain.adaptive_terrain.island_size = str(old / "island"), 17
    store_paths.find_moved_stores()
    assert terrain.adaptive_terrain.store == str(new / "island") and not store_paths.notices


def test_a_missing_store_of_another_place_is_left_alone(scene, add_terrain, store, folders):
    _old, new = folders
    shutil.copytree(store, new / "hills")
    terrain = add_terrain()
    terrain.adaptive_terrain.store = "/nowhere/stores/hills"
    store_paths.find_moved_stores()
    assert terrain.adaptive_terrain.store == "/nowhere/stores/hills"


def test_a_read_only_folder_sends_imports_to_the_data_folder(scene, add_terrain, folders, tmp_path, monkeypatch):
    _old, new = folders
    terrain = add_terrain()
    terrain.adaptive_terrain.island_size = 33
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "valley.blend"))
    assert store_location.store_folder(terrain, settings_of(terrain)) == "//terrain/valley_Terrain_island"
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path)
    assert bpy.ops.adaptive_terrain.import_source() == {"FINISHED"}
    folder = terrain.adaptive_terrain.store
    assert Path(folder).parent == new and open_store(folder)
    [warning] = store_location.location_warnings(folder)
    assert str(tmp_path) in warning and folder in warning and "Pack Store Beside File" in warning
    assert not (tmp_path / "terrain").exists()


@pytest.mark.parametrize("saved", [True, False])
@pytest.mark.parametrize("place", ["old", "new"])
def test_baked_land_avoids_the_folder_that_blender_deletes(terrain, folders, tmp_path, monkeypatch, saved, place):
    """Use a copy of the store as the shaped land."""
    old, new = folders
    add("scree")
    lent = (old if place == "old" else new) / "hills"
    shutil.copytree(terrain.adaptive_terrain.store, lent)
    terrain.adaptive_terrain.store = str(lent)
    land = shape_land.wanted_land(terrain, bpy.context.evaluated_depsgraph_get())
    shutil.copytree(lent, land.folder)
    monkeypatch.setattr(bake_land.derived_store, "raster_of", lambda *_given, **_named: None)
    if saved:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "valley.blend"))
    assert bpy.ops.adaptive_terrain.bake_land() == {"FINISHED"}
    baked = terrain.adaptive_terrain.store
    assert baked == ("//terrain/valley_Terrain_store_baked" if saved else str(new / "hills_baked"))
    assert open_store(bpy.path.abspath(baked))
    assert sorted(entry.name for entry in old.iterdir()) == (["hills", "hills_land"] if place == "old" else [])


def test_no_import_replaces_another_terrains_store(scene, add_terrain, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "valley.blend"))
    settings = ImportSettings(source="dem.tif")
    names = ["Terrain", "Nord S\u00fcd", "Nord S\u00e6d"]
    found = []
    for name in names:
        terrain = add_terrain(name)
        terrain.adaptive_terrain.store = store_location.store_folder(terrain, settings)
        found.append(terrain.adaptive_terrain.store)
        assert store_location.store_folder(terrain, settings) == found[-1], "a second import replaces its own store"
    assert found[1:] == ["//terrain/valley_Nord_S_d_dem", "//terrain/valley_Nord_S_d_dem_2"]
    bpy.data.objects["Terrain"].name = "Old"
    assert store_location.store_folder(add_terrain(), settings) == f"{found[0]}_2"
    copy = bpy.data.objects["Old"].copy()
    bpy.data.objects["Terrain"].name, copy.name = "Other", "Terrain"
    assert store_location.store_folder(copy, settings) == found[0], "a duplicate and its original share their store"
