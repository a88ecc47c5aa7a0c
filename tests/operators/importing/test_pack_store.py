# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores go beside their .blend file, and are found wherever the file is saved to."""

import shutil
import threading
from pathlib import Path

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.height_operators import derived_store, land_folder, requested_tiles
from adaptive_terrain.operators.importing import import_terrain, pack_plan, pack_store, store_location
from adaptive_terrain.operators.importing.store_location import lies_beside
from adaptive_terrain.operators.land import bake_land, shape_land, shaped_land
from adaptive_terrain.operators.maps import images as map_images
from adaptive_terrain.operators.maps.properties import map_folder
from adaptive_terrain.operators.session import session
from land_scenes import add
from modal_runs import hold, running, to_the_end


def absolute(terrain) -> Path:
    return Path(bpy.path.abspath(terrain.adaptive_terrain.store)).resolve()


def in_another_file(terrain, tmp_path: Path, saved: bool, link: bool) -> tuple:
    """Save and pack a terrain, append it to another file or link it there; return it and its store's folder.

    saved: whether the other file has a path.
    """
    library = tmp_path / "library" / "valley.blend"
    save_and_pack(library.parent)
    folder = absolute(terrain)
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if saved:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    with bpy.data.libraries.load(str(library), link=link) as (_there, here):
        here.objects = ["Terrain"]
    return here.objects[0], folder


def save_and_pack(folder: Path) -> None:
    """Save the open file as valley.blend in a folder, and pack its stores."""
    folder.mkdir(exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "valley.blend"))
    assert bpy.ops.adaptive_terrain.pack_store() == {"FINISHED"}


def test_packing_makes_paths_relative_and_leaves_what_it_copied(scene, add_terrain, store, tmp_path):
    one, two = add_terrain("One"), add_terrain("Two")
    assert not bpy.ops.adaptive_terrain.pack_store.poll(), "an unsaved file has no place"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "valley.blend"))
    assert one.adaptive_terrain.store == store
    assert bpy.ops.adaptive_terrain.pack_store() == {"FINISHED"}
    assert one.adaptive_terrain.store == two.adaptive_terrain.store == "//terrain/valley_One_store"
    assert absolute(one) == (tmp_path / "terrain" / "valley_One_store").resolve()
    assert open_store(absolute(one)).key == open_store(store).key
    assert not bpy.ops.adaptive_terrain.pack_store.poll(), "there is nothing left to pack"


def test_a_name_that_is_too_long_counts_as_free():
    """Copying the store then raises the error that names the folder."""
    assert pack_plan._free_folder(f"/{'n' * 300}", {}, set()) == f"/{'n' * 300}"


def test_shaped_land_is_packed_and_not_made_again(terrain, tmp_path):
    """Also behind a painted mask, and from a folder that was moved, with nothing left of the original."""
    entry = add("scree", depth=80.0)
    image = bpy.data.images.new("Painted", 8, 8, float_buffer=True)
    image.pixels.foreach_set(np.linspace(0, 1, 8 * 8 * 4, dtype=np.float32))
    image.pack()
    entry.mask.kind, entry.mask.image = "IMAGE", image
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    original = Path(terrain.adaptive_terrain.store)
    [shaped] = [path.parent for path in land_folder.folder_beside(str(original)).glob("*/store.json")]
    key, count = open_store(shaped).key, derived_store.counts["stores"]
    save_and_pack(tmp_path / "here")
    packed = land_folder.folder_beside(str(absolute(terrain))) / shaped.name
    assert open_store(packed).key == key and shaped.is_dir()
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.read_homefile(use_empty=True)
    shutil.rmtree(original)
    shutil.rmtree(land_folder.folder_beside(str(original)))
    (tmp_path / "here").rename(tmp_path / "there")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "there" / "valley.blend"))
    opened = bpy.data.objects["Terrain"]
    session.update_object(opened, mode="RENDER")
    assert session.record_of(opened).field.raster.digest == key.raster and derived_store.counts["stores"] == count
    assert shaped_land.state_of(opened).shown == "Shaped"


def folder_of_land(terrain, of_views: bool) -> Path:
    """Copy a terrain's store to the folder of its shaped land, and return the folder."""
    land = shape_land.wanted_land(terrain, bpy.context.evaluated_depsgraph_get())
    folder = (land.of_views_alone if of_views else land).folder
    shutil.copytree(terrain.adaptive_terrain.store, folder)
    return Path(folder)


def test_land_of_a_shot_is_packed_with_its_tiles(terrain, tmp_path):
    add("scree", depth=80.0)
    folder, tiles = folder_of_land(terrain, of_views=True), [{0: 0.5}, {}]
    requested_tiles.note(str(folder), tiles)
    save_and_pack(tmp_path / "here")
    packed = land_folder.folder_beside(str(absolute(terrain))) / folder.name
    assert open_store(packed) and requested_tiles.read_requested(str(packed)) == tiles


def test_baked_maps_are_packed_and_their_images_name_the_copies(terrain, tmp_path):
    assert bpy.ops.adaptive_terrain.bake_maps() == {"FINISHED"}
    image, before = map_images.map_image(terrain, "detail_normal"), map_folder(terrain)
    (tmp_path / "here").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "here" / "valley.blend"))
    assert Path(bpy.path.abspath(image.filepath)).resolve().is_relative_to(before)
    assert bpy.ops.adaptive_terrain.pack_store() == {"FINISHED"}
    after = map_folder(terrain)
    assert after.is_relative_to(tmp_path / "here") and {f.name for f in after.iterdir()} == {
        f.name for f in before.iterdir()
    }
    assert image.filepath.startswith("//") and Path(bpy.path.abspath(image.filepath)).parent == after
    assert map_images.map_image(terrain, "detail_normal") == image


def test_damaged_land_is_no_hindrance(terrain, tmp_path):
    add("scree", depth=80.0)
    [file] = folder_of_land(terrain, of_views=False).glob("data-*/samples.npy")
    file.write_bytes(b"half")
    save_and_pack(tmp_path / "here")
    assert open_store(absolute(terrain)) and not land_folder.folder_beside(str(absolute(terrain))).exists()


def test_a_store_of_another_terrain_in_the_same_place_stays(scene, add_terrain, tmp_path):
    """A terrain that is called like one before it packs into a folder with a number."""
    add_terrain()
    save_and_pack(tmp_path / "here")
    terrain = bpy.data.objects["Terrain"]
    first, key = absolute(terrain), open_store(absolute(terrain)).key
    terrain.name = "Valley"
    other = add_terrain()
    other.adaptive_terrain.island_size, other.adaptive_terrain.source = 33, "ISLAND"
    from adaptive_terrain.cbt_terrain.importing.import_process import import_source
    from adaptive_terrain.operators.importing.import_terrain import settings_of

    import_source(settings_of(other), tmp_path / "elsewhere")
    other.adaptive_terrain.store = str(tmp_path / "elsewhere")
    wanted = tmp_path / "here" / "terrain" / "valley_Terrain_island"
    first.rename(wanted)
    terrain.adaptive_terrain.store = "//terrain/valley_Terrain_island"
    bpy.ops.adaptive_terrain.pack_store()
    assert other.adaptive_terrain.store == "//terrain/valley_Terrain_island_2"
    assert open_store(wanted).key == key != open_store(absolute(other)).key


@pytest.mark.skipif(bpy.app.version < (4, 3, 0), reason="Blender tells of appending from 4.3 on")
@pytest.mark.parametrize("saved", [True, False])
def test_an_appended_terrain_finds_its_store(scene, add_terrain, tmp_path, saved):
    appended, folder = in_another_file(add_terrain(), tmp_path, saved, link=False)
    assert appended.adaptive_terrain.store.startswith("//") is saved and absolute(appended) == folder


@pytest.mark.parametrize("saved", [True, False])
def test_a_linked_terrain_made_local_finds_its_store(scene, add_terrain, tmp_path, saved):
    linked, folder = in_another_file(add_terrain(), tmp_path, saved, link=True)
    bpy.context.scene.collection.objects.link(linked)
    bpy.context.view_layer.update()
    assert linked.adaptive_terrain.store == "//terrain/valley_Terrain_store", "the library's own path"
    bpy.context.view_layer.objects.active = linked
    linked.select_set(True)
    assert bpy.ops.object.make_local(type="SELECT_OBDATA") == {"FINISHED"}
    bpy.context.view_layer.update()
    local = bpy.data.objects["Terrain"]
    assert local.library is None and local.adaptive_terrain.store.startswith("//") is saved
    assert absolute(local) == folder


def test_a_terrain_that_is_copied_and_pasted_keeps_its_path(scene, add_terrain, tmp_path):
    """Blender appends it from a file elsewhere, beside which there is no store."""
    terrain, buffer = add_terrain(), tmp_path / "buffer" / "copybuffer.blend"
    save_and_pack(tmp_path)
    buffer.parent.mkdir()
    bpy.data.libraries.write(str(buffer), {terrain})
    with bpy.data.libraries.load(str(buffer)) as (_there, here):
        here.objects = ["Terrain"]
    assert here.objects[0] != terrain and here.objects[0].adaptive_terrain.store == terrain.adaptive_terrain.store


def test_an_absolute_path_beside_the_file_becomes_relative(scene, add_terrain, tmp_path):
    terrain = add_terrain()
    save_and_pack(tmp_path)
    folder = absolute(terrain)
    terrain.adaptive_terrain.store = str(folder)
    assert bpy.ops.adaptive_terrain.pack_store() == {"FINISHED"}
    assert terrain.adaptive_terrain.store.startswith("//terrain/") and absolute(terrain) == folder
    assert len(list((tmp_path / "terrain").iterdir())) == 1, "nothing was copied"


@pytest.mark.parametrize("place", ["data", "temporary"])
def test_blenders_own_folders_below_the_file_are_not_beside(scene, add_terrain, store, tmp_path, monkeypatch, place):
    """A file in the home folder, which holds the data folder and perhaps the temporary one."""
    own = tmp_path / ".config" / "stores"
    if place == "data":
        monkeypatch.setattr(store_location, "data_folder", lambda: own)
    else:
        monkeypatch.setattr("tempfile.tempdir", str(own))
    shutil.copytree(store, own / "hills")
    terrain = add_terrain()
    for path in (str(own / "hills"), "//.config/stores/hills"):  # the second one as earlier versions packed it
        terrain.adaptive_terrain.store = path
        save_and_pack(tmp_path)
        assert terrain.adaptive_terrain.store == "//terrain/valley_Terrain_store"
        assert absolute(terrain) == tmp_path.resolve() / "terrain" / "valley_Terrain_store"
        assert open_store(absolute(terrain)).key == open_store(own / "hills").key
    monkeypatch.undo()
    terrain.adaptive_terrain.store = "//.config/stores/hills"
    assert lies_beside(terrain.adaptive_terrain), "a folder of the user's"


def test_a_missing_store_is_told_and_no_path_changes(scene, add_terrain, tmp_path):
    terrain = add_terrain()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "valley.blend"))
    terrain.adaptive_terrain.store = "/nowhere/store"
    with pytest.raises(RuntimeError, match="no terrain store at /nowhere/store"):
        bpy.ops.adaptive_terrain.pack_store()
    assert terrain.adaptive_terrain.store == "/nowhere/store" and session.record_of(terrain).status.error == ""


def test_saved_elsewhere_the_store_is_still_found(scene, add_terrain, tmp_path):
    """Save As, a copy, and a reload of both: each file names the same store by a different relative path."""
    (tmp_path / "there" / "deep").mkdir(parents=True)
    add_terrain()
    save_and_pack(tmp_path)
    terrain = bpy.data.objects["Terrain"]
    folder = absolute(terrain)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "there" / "copy.blend"), copy=True)
    assert terrain.adaptive_terrain.store.startswith("//terrain/"), "the open file stays where it is"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "there" / "deep" / "moved.blend"))
    assert absolute(terrain) == folder and terrain.adaptive_terrain.store.startswith("//..")
    for name in ("there/copy.blend", "there/deep/moved.blend"):
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / name))
        assert absolute(bpy.data.objects["Terrain"]) == folder
        assert bpy.data.objects["Terrain"].adaptive_terrain.store.startswith("//")
    assert not lies_beside(bpy.data.objects["Terrain"].adaptive_terrain)
    assert bpy.ops.adaptive_terrain.pack_store() == {"FINISHED"}
    assert absolute(bpy.data.objects["Terrain"]).is_relative_to(tmp_path / "there" / "deep")


def test_height_maps_are_found_after_a_save_elsewhere(scene, add_terrain, tmp_path):
    """Save As to a folder with another map of the same name, and a copy."""
    (tmp_path / "there").mkdir()
    for folder in (tmp_path, tmp_path / "there"):
        (folder / "a.tif").touch()
    settings = add_terrain().adaptive_terrain
    save_and_pack(tmp_path)
    settings.source_path, settings.more_sources.add().path = "//a.tif", "//more/b.tif"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "there" / "copy.blend"), copy=True)
    assert (settings.source_path, settings.more_sources[0].path) == ("//a.tif", "//more/b.tif")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "there" / "moved.blend"))
    assert (settings.source_path, settings.more_sources[0].path) == ("//../a.tif", "//../more/b.tif")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "there" / "copy.blend"))
    assert bpy.data.objects["Terrain"].adaptive_terrain.source_path == "//../a.tif"


def test_undo_after_a_save_elsewhere_keeps_the_store(scene, add_terrain, tmp_path):
    (tmp_path / "there").mkdir()
    add_terrain()
    save_and_pack(tmp_path)
    folder = absolute(bpy.data.objects["Terrain"])
    for height in (1.0, 2.0):
        bpy.data.objects["Terrain"].location.z = height
        bpy.ops.ed.undo_push(message="Moved")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "there" / "moved.blend"))
    for step in (bpy.ops.ed.undo, bpy.ops.ed.redo, bpy.ops.ed.undo):
        assert step() == {"FINISHED"}
        assert absolute(bpy.data.objects["Terrain"]) == folder
    assert bpy.data.objects["Terrain"].location.z == 1.0


@pytest.mark.parametrize("job", ["import", "pack", "bake"])
def test_a_job_ends_in_a_file_that_was_saved_elsewhere(scene, add_terrain, store, tmp_path, monkeypatch, job):
    """Save As to another folder while the job runs: its store stays beside the earlier file."""
    (tmp_path / "there").mkdir()
    terrain, saved = add_terrain(), threading.Event()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "valley.blend"))
    if job == "import":
        terrain.adaptive_terrain.store, terrain.adaptive_terrain.island_size = "", 65
        operator = running(import_terrain.ImportTerrain, terrain)
    elif job == "pack":
        saved = hold(monkeypatch, pack_plan, "copy_store")
        operator = running(pack_store.PackStore, terrain, save_again=False)
    else:
        shutil.copytree(store, tmp_path / "data" / "hills")  # a folder that other files may use
        monkeypatch.setattr(store_location, "data_folder", lambda: tmp_path / "data")
        terrain.adaptive_terrain.store = str(tmp_path / "data" / "hills")
        bpy.context.view_layer.objects.active = terrain
        add("scree")
        assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
        saved = hold(monkeypatch, bake_land, "copy_store")
        operator = running(bake_land.BakeLand, terrain)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "there" / "moved.blend"))
    saved.set()
    assert to_the_end(operator) == {"FINISHED"}
    path = terrain.adaptive_terrain.store
    assert path.startswith("//../terrain/valley_Terrain_") and open_store(absolute(terrain))
    assert (job == "bake") is path.endswith("_baked")


def test_the_panel_asks_once_at_the_first_save(scene, add_terrain, tmp_path, monkeypatch):
    offered = []
    monkeypatch.setattr(pack_store, "bpy", _with_a_window(offered))
    add_terrain()
    for name in ("a.blend", "a.blend", "b.blend"):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / name))
    assert offered == [pack_store._ask_to_pack]


def _with_a_window(offered: list):
    """bpy as `pack_store` would see it with a window."""

    class App:
        background = False

        class timers:
            @staticmethod
            def register(function, first_interval):
                offered.append(function)

    class Bpy:
        app = App

        def __getattr__(self, name):
            return getattr(bpy, name)

    return Bpy()
