# SPDX-License-Identifier: GPL-3.0-or-later
"""Shaped land that becomes a store, and its heights as files."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.height_operators import land_folder
from adaptive_terrain.operators import jobs
from adaptive_terrain.operators.importing.import_terrain import ImportTerrain
from adaptive_terrain.operators.land import bake_land
from adaptive_terrain.operators.land import cache as land_cache
from adaptive_terrain.operators.land.bake_land import BakeLand
from adaptive_terrain.operators.session import session
from land_scenes import add
from modal_runs import hold, running, to_the_end


def test_baked_land_needs_no_stack(terrain):
    add("scree", depth=80.0)
    before = open_store(terrain.adaptive_terrain.store).key
    source = terrain.adaptive_terrain.store
    assert bpy.ops.adaptive_terrain.bake_land() == {"FINISHED"}
    baked = terrain.adaptive_terrain.store
    assert baked == source + "_baked" and not terrain.adaptive_terrain.land.entries
    assert open_store(source).key == before != open_store(baked).key
    beside = land_folder.folder_beside(source)
    assert (beside / "tiles").is_dir() and str(beside) in land_cache.describe_cache(baked), "for Undo"
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"}
    assert not land_folder.shaped_stores(source) and not (beside / "tiles").exists() and Path(source).is_dir()
    session.update_object(terrain)
    assert session.record_of(terrain).field.raster.digest == open_store(baked).raster.digest
    with pytest.raises(RuntimeError, match="nothing to bake: the list is empty"):
        bpy.ops.adaptive_terrain.bake_land()


def test_an_import_after_a_bake_says_which_land_it_leaves(terrain):
    add("scree", depth=80.0)
    bpy.ops.adaptive_terrain.bake_land()
    baked = terrain.adaptive_terrain.store
    texts = imported_anew(terrain)
    message = f"The terrain has its imported heights again; its baked land stays in {baked}"
    assert terrain.adaptive_terrain.store != baked and [text for text in texts if "baked" in text] == [message]
    assert texts[-1] == message, "the status bar shows the last message only"
    assert not any("baked" in text for text in imported_anew(terrain))


def imported_anew(terrain) -> list[str]:
    """Return the messages of an import in a window."""
    operator = running(ImportTerrain, terrain)
    if operator.began == {"RUNNING_MODAL"}:  # an import that is up to date may be so at once
        to_the_end(operator)
    return [call.args[1] for call in operator.report.call_args_list]


@pytest.fixture
def bake(terrain, monkeypatch):
    """Start to bake shaped land in a window; return the operator, and an event that lets it copy."""
    add("scree", depth=80.0)
    bpy.ops.adaptive_terrain.shape()
    event = hold(monkeypatch, bake_land, "copy_store")
    return running(BakeLand, terrain), event


def test_a_window_bakes_land_beside_its_work(bake, terrain):
    source, (operator, event) = terrain.adaptive_terrain.store, bake
    assert operator.began == {"RUNNING_MODAL"} and jobs.find(jobs.BAKE_LAND, terrain) == operator.job
    assert terrain.adaptive_terrain.land.entries and not BakeLand.poll(operator.context)
    event.set()
    assert to_the_end(operator) == {"FINISHED"} and not terrain.adaptive_terrain.land.entries
    assert open_store(terrain.adaptive_terrain.store).path == Path(source + "_baked")


def test_a_cancelled_bake_leaves_list_and_store(bake, terrain):
    source, (operator, event) = terrain.adaptive_terrain.store, bake
    operator.job.stop()
    event.set()
    assert to_the_end(operator) == {"CANCELLED"} and len(terrain.adaptive_terrain.land.entries) == 1
    assert terrain.adaptive_terrain.store == source and not Path(source + "_baked").exists()


def test_a_list_that_changes_during_a_bake_stays(bake, terrain):
    source, (operator, event) = terrain.adaptive_terrain.store, bake
    add("relief")
    event.set()
    to_the_end(operator)
    assert operator.report.call_args.args[0] == {"WARNING"} and len(terrain.adaptive_terrain.land.entries) == 2
    assert terrain.adaptive_terrain.store == source and open_store(source + "_baked")


def test_saving_elsewhere_during_a_bake_changes_no_list(terrain, tmp_path, monkeypatch):
    """Blender rewrites the store's path for the new folder, with `..`."""
    (tmp_path / "second").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    terrain.adaptive_terrain.store = "//hills"
    add("scree", depth=80.0)
    bpy.ops.adaptive_terrain.shape()
    event = hold(monkeypatch, bake_land, "copy_store")
    operator = running(BakeLand, terrain)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "second" / "b.blend"))
    assert terrain.adaptive_terrain.store == "//../hills"
    event.set()
    assert to_the_end(operator) == {"FINISHED"} and operator.report.call_args.args[0] == {"INFO"}
    assert terrain.adaptive_terrain.store == "//../hills_baked" and not terrain.adaptive_terrain.land.entries


def test_a_window_refuses_to_bake_unshaped_land(terrain):
    add("scree")
    operator = running(BakeLand, terrain)
    assert operator.began == {"CANCELLED"} and "press Shape Now" in operator.report.call_args.args[1]


def test_a_path_that_is_too_long_does_not_exist_yet():
    """Copying the land then raises the error that names the folder."""
    assert bake_land.unused_path(f"/{'n' * 300}") == f"/{'n' * 300}"


def test_heights_are_exported_with_what_the_stack_leaves(terrain, tmp_path):
    import rasterio

    add("scree", depth=80.0)
    assert bpy.ops.adaptive_terrain.export_heights(filepath=str(tmp_path / "land.tif")) == {"FINISHED"}
    shaped = open_store(land_folder.folder_beside(terrain.adaptive_terrain.store) / only_shaped(terrain))
    with rasterio.open(tmp_path / "land.tif") as file:
        assert np.array_equal(file.read(1)[::-1], shaped.heights())
    assert sorted(path.name for path in tmp_path.glob("land_*.tif")) == [f"land_{n}.tif" for n in sorted(shaped.layers)]
    with pytest.raises(RuntimeError, match="is of no format"):
        bpy.ops.adaptive_terrain.export_heights(filepath=str(tmp_path / "land.png"))


def only_shaped(terrain) -> str:
    [folder] = {path.parent for path in land_folder.folder_beside(terrain.adaptive_terrain.store).glob("*/store.json")}
    return folder.name
