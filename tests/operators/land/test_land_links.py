# SPDX-License-Identifier: GPL-3.0-or-later
"""Land folders of a stranger: links into the user's folders, stores of other terrains, files of the user."""

import json
import os
import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field import store as stores
from adaptive_terrain.cbt_terrain.height_operators import derived_store, land_folder, requested_tiles
from adaptive_terrain.operators.land import request as land_request
from adaptive_terrain.operators.land import shaped_land
from adaptive_terrain.operators.session import session
from land_scenes import add

pytestmark = pytest.mark.skipif(os.name != "posix", reason="Windows lets only some users make symbolic links")


@pytest.fixture
def precious(tmp_path):
    """Create a folder of the user as the target of links."""
    folder = tmp_path / "precious"
    for name in ("mine.txt", "thesis/1.tex", "store.json", f"{'0' * 32}.npy"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("mine")
    return folder


def content(folder) -> dict:
    """Return names, bytes and times of all files below a folder."""
    files = [file for file in Path(folder).rglob("*") if file.is_file()]
    return {str(file): (file.read_bytes(), file.stat().st_mtime_ns) for file in files}


def folder_of_land(terrain) -> Path:
    """Return the folder of the terrain's shaped store."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return Path(land_request.land_of(terrain, terrain.evaluated_get(depsgraph), depsgraph, waits=True).folder)


def put_link(path: Path, target: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(target)
    session.clear()


def mask_by(terrain) -> None:
    image = bpy.data.images.new("Paint", 4, 4)
    mask = terrain.adaptive_terrain.land.entries[0].mask
    mask.kind, mask.image = "IMAGE", image


@pytest.mark.parametrize("at", ["", "NAME", "NAME_views", "tiles", "masks"])
@pytest.mark.parametrize("mode", ["RENDER", "VIEWPORT"])
def test_a_link_in_place_of_a_land_folder_is_refused(terrain, precious, at, mode):
    add("scree")
    folder, before = folder_of_land(terrain), content(precious)
    link = folder.parent / at.replace("NAME", folder.name)
    put_link(link, precious)
    with pytest.raises(session.TerrainError, match=rf"{link.name} is a link; expected a folder .*: move it away"):
        session.update_object(terrain, mode=mode)
    if at == "masks":
        mask_by(terrain)
        with pytest.raises(session.TerrainError, match="masks is a link"):
            session.update_object(terrain, mode=mode)
    assert content(precious) == before and link.is_symlink() and derived_store.counts["stores"] == 0


@pytest.mark.parametrize("at", ["store.json", "data", "data/samples.npy", "data/layer_scree.npy", "../tiles/FIRST"])
def test_a_link_in_shaped_land_is_refused(terrain, shaped, precious, at):
    """It is not repaired: its target is no damaged land."""
    [data] = shaped.glob("data-*")
    if at.endswith("FIRST"):
        path = next((shaped.parent / "tiles").glob("*.npy"))
        shutil.rmtree(shaped)
    else:
        path = shaped / at.replace("data", data.name)
    target = precious / "mine.txt"
    if path.is_dir():
        target = precious / "arrays"
        shutil.copytree(path, target)
    before = content(precious)
    put_link(path, target)
    with pytest.raises(session.TerrainError, match=rf"{path.name} is a link; expected .* of Adaptive Terrain"):
        session.update_object(terrain, mode="RENDER")
        depsgraph = bpy.context.evaluated_depsgraph_get()
        land = land_request.land_of(terrain, terrain.evaluated_get(depsgraph), depsgraph, waits=True)
        derived_store.raster_of("", land, session.open_field, verified=True)  # as an export of heights reads it
    assert content(precious) == before and path.is_symlink()


@pytest.mark.parametrize("at", ["", "NAME", "tiles", "NAME/data"])
def test_clear_land_cache_removes_nothing_behind_a_link(terrain, shaped, precious, at):
    [data] = shaped.glob("data-*")
    link = shaped.parent / at.replace("NAME", shaped.name).replace("data", data.name)
    shutil.copytree(link, precious / "copy")
    before = content(precious)
    put_link(link, precious / "copy")
    terrain.adaptive_terrain.land.entries[0].on = False
    session.update_object(terrain)
    if at == "NAME/data":  # the land's own file goes, the link stays
        assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"}
    else:
        with pytest.raises(RuntimeError, match=f"{link.name} is a link"):
            bpy.ops.adaptive_terrain.land_clear()
    assert content(precious) == before and link.is_symlink()


def test_a_land_folder_that_is_a_file_is_refused(terrain):
    add("scree")
    beside = folder_of_land(terrain).parent
    shutil.rmtree(beside, ignore_errors=True)
    beside.write_text("mine")
    with pytest.raises(session.TerrainError, match="hills_land is a file; expected a folder"):
        session.update_object(terrain, mode="RENDER")
    assert beside.read_text() == "mine"


def test_the_store_of_another_terrain_is_not_land(terrain):
    """A valid store under the land's name: refused, and not shown."""
    add("scree")
    folder = folder_of_land(terrain)
    shutil.copytree(terrain.adaptive_terrain.store, folder)
    before = content(folder)
    session.update_object(terrain)
    assert shaped_land.state_of(terrain).shown == "Preview"
    with pytest.raises(session.TerrainError, match="holds the store of another terrain; expected land"):
        session.update_object(terrain, mode="RENDER")
    terrain.adaptive_terrain.land.entries[0].on = False
    session.update_object(terrain)
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"}
    assert content(folder) == before


def rewrite(store: Path, change) -> None:
    """Change a store's record of its shaping and its digest, with a valid checksum."""
    content = json.loads((store / "store.json").read_text()) | {"digest": ""}
    change(content["provenance"]["shaped"])
    content["sum"] = stores._sum_of(content)
    (store / "store.json").write_text(json.dumps(content))
    session.clear()


@pytest.mark.parametrize("older", ["without a record", "where some views looked"])
def test_land_that_records_less_is_made_again(terrain, shaped, older):
    def change(record):
        record["everywhere"] = False
        if older == "without a record":
            del record["land"], record["everywhere"]

    rewrite(shaped, change)
    session.update_object(terrain)
    assert shaped_land.state_of(terrain).shown == "Preview"
    session.update_object(terrain, mode="RENDER")
    assert derived_store.counts["stores"] == 1 and shaped_land.state_of(terrain).shown == "Shaped"
    assert len(list(shaped.glob("data-*"))) == 1


def test_land_of_another_stack_is_refused_under_this_name(terrain, shaped):
    """A folder that was renamed: its record has the other name."""
    rewrite(shaped, lambda record: record.update(land="f" * 16))
    before = content(shaped)
    with pytest.raises(session.TerrainError, match="holds the store of another terrain"):
        session.update_object(terrain, mode="RENDER")
    assert content(shaped) == before


def test_use_of_land_does_not_touch_what_a_link_leads_to(terrain, precious):
    """The time of use is noted by the folder's own time."""
    add("scree")
    folder = folder_of_land(terrain)
    put_link(folder, precious)
    os.utime(precious, (1, 1))
    derived_store.forget()
    with pytest.raises(session.TerrainError):
        folder_of_land(terrain)
    assert precious.stat().st_mtime == 1


def test_a_note_of_tiles_behind_a_link_is_not_read(tmp_path):
    requested_tiles.note(str(tmp_path / "other"), [{3: 0.5}])
    (tmp_path / "land.json").symlink_to(tmp_path / "other.json")
    assert requested_tiles.read_requested(str(tmp_path / "land")) == []
    with pytest.raises(session.TerrainError, match="land.json is a link"):
        requested_tiles.remove_record(str(tmp_path / "land"))
    assert requested_tiles.read_requested(str(tmp_path / "other")) == [{3: 0.5}]


def test_a_mask_behind_a_link_is_not_read(terrain, precious):
    add("scree")
    mask_by(terrain)
    masks = folder_of_land(terrain).parent / land_folder.MASKS
    [mask] = masks.iterdir()
    np.save(precious / "white.npy", np.ones((4, 4), np.float32))
    put_link(mask, precious / "white.npy")
    before = content(precious)
    with pytest.raises(session.TerrainError, match=f"{mask.name} is a link; expected a file"):
        session.update_object(terrain, mode="RENDER")
    assert content(precious) == before
