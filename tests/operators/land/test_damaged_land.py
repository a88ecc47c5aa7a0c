# SPDX-License-Identifier: GPL-3.0-or-later
"""Shaped land that is damaged on disk is built again from its source; a user's files stay as they are."""

import errno
import os
import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field import store_arrays
from adaptive_terrain.cbt_terrain.field.build import build
from adaptive_terrain.cbt_terrain.field.store import Draft, data_folder, open_store
from adaptive_terrain.cbt_terrain.field.store_arrays import BLOCK_BYTES, PAGE_BYTES
from adaptive_terrain.cbt_terrain.height_operators import derived_store, land_folder, requested_tiles
from adaptive_terrain.cbt_terrain.height_operators.tile_cache import TileCache
from adaptive_terrain.cbt_terrain.run import owned_files
from adaptive_terrain.operators.land import shaped_land
from adaptive_terrain.operators.session import session
from land_scenes import add

SHAPING = "Adaptive Terrain: Shaping land"  # begins the lines that say how far it is


def test_shaped_land_that_was_damaged_is_made_again(terrain, shaped):
    """After half a file is lost, a reader that waits makes the land again; Clear Land Cache keeps land in use."""
    samples = next(shaped.glob("data-*/samples.npy"))
    whole = samples.read_bytes()
    session.clear()
    samples.unlink()
    samples.write_bytes(whole[: len(whole) // 2])
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    assert next(shaped.glob("data-*/samples.npy")).read_bytes() == whole


def cut_off(store) -> bytes:
    """Cut the file of samples in half, like an interrupted copy; return its whole content."""
    session.clear()
    samples = next(Path(store).glob("data-*/samples.npy"))
    whole = samples.read_bytes()
    samples.unlink()  # the old one may still be mapped
    samples.write_bytes(whole[: len(whole) // 2])
    return whole


@pytest.mark.parametrize("mode", ["RENDER", "VIEWPORT"])
def test_what_needs_damaged_land_makes_it_again_and_says_so(terrain, shaped, capsys, mode):
    """A render waits for it; a viewport shows its preview meanwhile."""
    whole = cut_off(shaped)
    session.update_object(terrain, mode=mode)
    [line] = [line for line in capsys.readouterr().out.splitlines() if not line.startswith(SHAPING)]
    said = f"The shaped land in {str(shaped)!r} is damaged and is built again from its"
    assert line.startswith(f"Adaptive Terrain: {said}")
    assert "samples.npy is damaged (it has" in line and line.endswith(").")
    state = shaped_land.state_of(terrain)
    assert (state.shown, session.record_of(terrain).status.error) == ("Shaped" if mode == "RENDER" else "Preview", "")
    assert len(list(shaped.glob("data-*"))) == (mode == "RENDER"), "what is damaged takes no room"
    session.update_object(terrain, mode="RENDER")
    assert next(shaped.glob("data-*/samples.npy")).read_bytes() == whole
    assert derived_store.counts["stores"] == 1
    assert all(line.startswith(SHAPING) for line in capsys.readouterr().out.splitlines())


def test_damage_that_only_an_update_finds_is_mended_too(terrain, wide_store, tmp_path):
    """When a store is opened a few blocks of each array are looked at, and this is none of them."""
    shutil.copytree(wide_store, tmp_path / "wide")
    terrain.adaptive_terrain.store = str(tmp_path / "wide")
    terrain.adaptive_terrain.render.error_px, terrain.adaptive_terrain.render.error_m = 0.0, 3.0
    add("relief")
    bpy.ops.adaptive_terrain.shape()
    folder = shaped_land.store_of(terrain)
    session.clear()
    samples = next(Path(folder).glob("data-*/samples.npy"))
    whole = samples.read_bytes()
    first = PAGE_BYTES + BLOCK_BYTES
    samples.unlink()
    samples.write_bytes(whole[:first] + b"\xff" * BLOCK_BYTES + whole[first + BLOCK_BYTES :])  # no numbers
    open_store(folder)
    session.update_object(terrain, mode="RENDER")
    assert derived_store.counts["stores"] == 2
    assert next(Path(folder).glob("data-*/samples.npy")).read_bytes() == whole


def test_damaged_data_of_the_user_is_left_alone(terrain):
    """A source and baked land give an error that names the file."""
    source = terrain.adaptive_terrain.store
    add("scree")
    cut_off(source)
    for mode in ("RENDER", "VIEWPORT"):
        with pytest.raises(session.TerrainError, match=r"hills/data-\w+/samples.npy is damaged .*import the terrain"):
            session.update_object(terrain, mode=mode)
    assert (Path(source) / "store.json").is_file() and derived_store.counts["stores"] == 0


@pytest.mark.parametrize("other", ["Thumbs.db", "data/Thumbs.db", "data/samples.npy/more"])
def test_damaged_land_is_made_again_beside_a_users_file(terrain, shaped, other):
    """What a file browser leaves in a folder, and a folder where an array was: they stay."""
    whole = cut_off(shaped)
    [data] = shaped.glob("data-*")
    file = shaped / other.replace("data", data.name)
    if file.parent.is_file():
        file.parent.unlink()
    file.parent.mkdir(exist_ok=True)
    file.write_text("not ours")
    session.update_object(terrain, mode="RENDER")
    made = open_store(shaped)
    assert (data_folder(made.raster) / "samples.npy").read_bytes() == whole and file.read_text() == "not ours"
    terrain.adaptive_terrain.land.entries[0].on = False
    session.update_object(terrain)
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"}
    assert file.read_text() == "not ours" and not (shaped / "store.json").exists()


def test_land_that_is_cut_off_while_it_is_open_is_made_again(terrain, shaped):
    """The system kills a process that reads a mapped file beyond its end, so none does."""
    session.update_object(terrain, mode="RENDER")
    [file] = shaped.glob("data-*/samples.npy")
    os.truncate(file, PAGE_BYTES)
    session.update_object(terrain, mode="RENDER")
    assert session.record_of(terrain).status.error == "" and derived_store.counts["stores"] == 1


@pytest.mark.parametrize("array", ["error_c", "error_m1"])
def test_a_store_that_is_cut_off_while_open_is_made_again(terrain, array):
    settings = terrain.adaptive_terrain
    settings.interpolation = "bicubic" if array == "error_c" else "bilinear"
    settings.viewport.meshlet = 1 if array == "error_m1" else 0
    session.update_object(terrain)
    session.clear()
    triangles, [file] = session.update_object(terrain).triangles, Path(settings.store).glob(f"data-*/{array}.npy")
    os.truncate(file, PAGE_BYTES)
    bpy.context.scene.camera.location.x += 1.0
    assert abs(session.update_object(terrain).triangles - triangles) < 0.1 * triangles
    assert file.stat().st_size > 2 * PAGE_BYTES


def test_a_source_that_is_cut_off_while_it_is_open_is_an_error(terrain):
    session.update_object(terrain)
    [file] = Path(terrain.adaptive_terrain.store).glob("data-*/ranges.npy")
    whole = file.read_bytes()
    os.truncate(file, len(whole) // 2)
    with pytest.raises(session.TerrainError, match=r"ranges.npy is damaged \(it has \d+ bytes, expected \d+\): import"):
        session.update_object(terrain)
    file.write_bytes(whole)
    session.update_object(terrain)


def test_land_that_can_neither_be_read_nor_removed_is_an_error(terrain, shaped, monkeypatch):
    """As where another user has made it."""
    cut_off(shaped)

    def remove_file(path):
        raise PermissionError(errno.EACCES, "Permission denied")

    with monkeypatch.context() as context:
        context.setattr(owned_files, "remove_file", remove_file)
        with pytest.raises(
            session.TerrainError, match=r"samples.npy is damaged \(it has .*: it is shaped land that cannot"
        ):
            session.update_object(terrain)
    session.update_object(terrain)
    assert shaped_land.state_of(terrain).shown == "Preview"


@pytest.mark.parametrize("action", ["export", "bake"])
def test_damage_to_a_by_product_is_neither_exported_nor_baked(terrain, shaped, tmp_path, action):
    """Meshes do not read it: nothing has found it before."""
    scree = next(shaped.glob("data-*/layer_scree.npy"))
    session.clear()
    whole = scree.read_bytes()
    scree.unlink()
    scree.write_bytes(whole[:PAGE_BYTES] + bytes(len(whole) - PAGE_BYTES))
    if action == "export":
        assert bpy.ops.adaptive_terrain.export_heights(filepath=str(tmp_path / "land.tif")) == {"FINISHED"}
        assert (tmp_path / "land_scree.tif").is_file()
    else:
        assert bpy.ops.adaptive_terrain.bake_land() == {"FINISHED"}
        scree = next(Path(terrain.adaptive_terrain.store).glob("data-*/layer_scree.npy"))
        assert scree.read_bytes() == whole
    assert derived_store.counts["stores"] == 1


def test_what_blender_is_short_of_is_no_damage(terrain, shaped, monkeypatch):
    """With too many files open no store can be read; the land is whole, and is not taken away."""
    file = shaped / "store.json"
    text = file.read_text()
    session.clear()
    short, opened = [True], store_arrays.open_regular

    def open_regular(array):
        if short and array.name == "samples.npy" and file.parent in array.parents:
            raise OSError(errno.EMFILE, "Too many open files")
        return opened(array)

    monkeypatch.setattr(store_arrays, "open_regular", open_regular)
    for mode in ("VIEWPORT", "RENDER"):
        with pytest.raises(session.TerrainError, match="Too many open files"):
            session.update_object(terrain, mode=mode)
    short.clear()
    session.update_object(terrain)
    assert file.read_text() == text and shaped_land.state_of(terrain).shown == "Shaped"


def test_shaped_land_chosen_as_a_source_is_left_alone(terrain, shaped):
    """No stack of the file makes it again."""
    bpy.ops.adaptive_terrain.land_remove()
    terrain.adaptive_terrain.store = str(shaped)
    cut_off(shaped)
    for mode in ("RENDER", "VIEWPORT"):
        with pytest.raises(session.TerrainError, match=r"samples.npy is damaged .*import the terrain"):
            session.update_object(terrain, mode=mode)
    assert (shaped / "store.json").is_file()


@pytest.mark.parametrize("level", ["[[99999, 0.0]]", "[[1e400, 1.0]]", "[" * 20000])
def test_a_damaged_note_of_what_was_asked_for_is_not_read(tmp_path, level):
    """Unknown tiles, values that are no numbers, and unclosed brackets."""
    folder = str(tmp_path / "land")
    requested_tiles.note(folder, [{3: 0.5}])
    assert requested_tiles.with_known(folder, [{0: 0.25}]) == [{3: 0.5, 0: 0.25}]
    Path(f"{folder}.json").write_text(f"[{level}]")
    assert requested_tiles.with_known(folder, [{0: 0.25}]) == [{0: 0.25}]


def test_a_damaged_baked_store_is_an_error(terrain):
    add("scree")
    bpy.ops.adaptive_terrain.bake_land()
    baked = terrain.adaptive_terrain.store
    cut_off(baked)
    with pytest.raises(session.TerrainError, match=r"hills_baked/data-\w+/samples.npy is damaged"):
        session.update_object(terrain, mode="RENDER")
    assert (Path(baked) / "store.json").is_file()


def test_a_folder_in_place_of_store_json_is_refused_and_stays(terrain, shaped):
    file = shaped / "store.json"
    file.unlink()
    (file / "more").mkdir(parents=True)
    session.update_object(terrain)
    assert shaped_land.state_of(terrain).shown == "Preview"
    with pytest.raises(session.TerrainError, match="store.json is a folder; expected a file of Adaptive Terrain"):
        session.update_object(terrain, mode="RENDER")
    assert (file / "more").is_dir()


def test_a_damaged_shaped_store_is_made_again(terrain, shaped):
    file = shaped / "store.json"
    file.write_text("{}")
    session.update_object(terrain)
    assert shaped_land.state_of(terrain).shown == "Preview"
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    assert shaped_land.state_of(terrain).shown == "Shaped"


def test_land_that_another_blender_is_writing_is_not_cleared(terrain, shaped):
    """Its draft stays when the version before is removed, and is published."""
    draft = Draft(shaped)
    samples = draft.allocate("samples", (5, 5), np.float32)
    field = build(samples, 8.0, 8.0, missing=0, allocate=draft.allocate)
    terrain.adaptive_terrain.land.entries[0].on = False
    session.update_object(terrain)
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"}
    assert [entry.name for entry in shaped.iterdir()] == [draft.folder.name]
    draft.publish(field.with_raster(provenance={"shaped": {}}), "", {})
    assert open_store(shaped).samples.shape == (5, 5)
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"} and not shaped.exists()


def test_land_that_another_blender_clears_at_once_is_made_again(terrain, monkeypatch):
    """Between the end of its making and its first look."""
    add("scree")
    noted = requested_tiles.note

    def cleared(folder, wanted):
        monkeypatch.setattr(requested_tiles, "note", noted)
        land_folder.remove(Path(folder))

    monkeypatch.setattr(requested_tiles, "note", cleared)
    session.update_object(terrain, mode="RENDER")
    assert derived_store.counts["stores"] == 2 and shaped_land.state_of(terrain).shown == "Shaped"


def test_tiles_are_kept_though_another_blender_has_cleared_them(tmp_path):
    cache = TileCache(tmp_path / "tiles")
    (tmp_path / "tiles").rmdir()
    cache.take("relief", "0" * 32, (2, 3), lambda: np.ones((2, 3), np.float32))
    cache.take("relief", "0" * 32, (2, 3), lambda: 1 / 0)
    assert cache.kept["relief"] == 1
