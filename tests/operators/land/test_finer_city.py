# SPDX-License-Identifier: GPL-3.0-or-later
"""Shaped land of a terrain with finer tiles in Blender: meshes, previews, exports, and the source again."""

import json
import shutil
import time

import bpy
import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.field.store import open_store, read_json
from adaptive_terrain.cbt_terrain.height_operators import derived_store, land_folder
from adaptive_terrain.operators.land import resting_land, shaped_land
from adaptive_terrain.operators.session import live, session
from blender_meshes import positions
from fields import reference_heights
from finer_fields import dense_field, dense_heights, dense_raster, finer_store
from land_scenes import add
from live_windows import show_window
from store_exports import run


@pytest.fixture(scope="module")
def city_store(tmp_path_factory):
    """Return a store of 33 x 33 samples of 32 m with a finer tile of 2 m in its north-east."""
    return finer_store(tmp_path_factory.mktemp("finer") / "city", 33, 33, 4, [(1, 1)])


@pytest.fixture
def city(scene, add_terrain, city_store, tmp_path):
    """Return a terrain with a private copy of the store, turned and scaled."""
    shutil.copytree(city_store, tmp_path / "city")
    obj = add_terrain()
    obj.adaptive_terrain.store = str(tmp_path / "city")
    obj.location, obj.scale, obj.rotation_euler = (300.0, -50.0, 20.0), (2.0, 2.0, 1.5), (0.0, 0.0, 0.7)
    scene.camera.location = (500.0, 300.0, 420.0)
    bpy.context.view_layer.objects.active = obj
    bpy.context.view_layer.update()
    derived_store.forget()
    derived_store.counts.update(previews=0, stores=0)
    return obj


def in_city(vertices):
    """Return which vertices are inside the known tile."""
    return np.abs(vertices[:, :2] - 256.0).max(axis=1) < 250.0


def test_the_source_comes_back_after_a_preview_and_shaped_land(city):
    session.update_object(city)
    before, key = positions(city), session.record_of(city).field.key
    entry = add("relief", wave=400.0, plains=0.3)
    session.update_object(city)
    state, field = shaped_land.state_of(city), session.record_of(city).field
    assert state.shown == "Preview" and field.raster.finer is None
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    session.update_object(city)
    field, vertices = session.record_of(city).field, positions(city).astype(np.float64)
    assert shaped_land.state_of(city).shown == "Shaped" and field.raster.finer is not None
    assert np.abs(vertices[:, 2] - reference_heights(dense_field(field), vertices[:, :2])).max() < 1e-3
    source = session.open_field(city.adaptive_terrain.store)
    inner = vertices[in_city(vertices)]
    moved = inner[:, 2] - reference_heights(dense_field(source), inner[:, :2])
    assert len(inner) > 500 and np.abs(moved).max() > 1.0
    entry.on = False
    session.update_object(city)
    assert session.record_of(city).field.key == key and (positions(city) == before).all()
    entry.on = True
    session.update_object(city)
    assert (positions(city) == vertices).all()
    assert bpy.ops.adaptive_terrain.land_remove() == {"FINISHED"}
    session.update_object(city)
    assert session.record_of(city).field.key == key and (positions(city) == before).all()
    assert derived_store.counts["stores"] == 1


def test_a_render_waits_for_the_tiles_in_view(city):
    city.adaptive_terrain.land.where = "SEEN"
    city.adaptive_terrain.render.smooth_transitions = False
    add("relief", wave=400.0, plains=0.3)
    session.update_object(city, mode="RENDER")
    field, vertices = session.record_of(city).field, positions(city).astype(np.float64)
    assert derived_store.counts["stores"] == 1 and field.raster.finer is not None
    assert np.abs(vertices[:, 2] - reference_heights(dense_field(field), vertices[:, :2])).max() < 1e-3
    assert in_city(vertices).sum() > 500


def test_shaped_heights_are_exported_and_baked_with_the_tiles(city, tmp_path):
    source = open_store(city.adaptive_terrain.store)
    add("snow", line=-900.0)
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    shaped = open_store(shaped_land.store_of(city))
    expected = dense_heights(source) + dense_raster(shaped, 4) - dense_raster(source, 4)
    assert bpy.ops.adaptive_terrain.export_heights(filepath=str(tmp_path / "a.tif"), step=2.0) == {"FINISHED"}
    with rasterio.open(tmp_path / "a.tif") as file:
        assert np.abs(file.read(1)[::-1] - expected).max() < 1e-4
    with rasterio.open(tmp_path / "a_snow.tif") as file:
        assert file.read(1).max() > 1.0
    assert bpy.ops.adaptive_terrain.bake_land() == {"FINISHED"}
    baked = city.adaptive_terrain.store
    assert read_json(land_folder.Path(baked))["version"] == 7 and not city.adaptive_terrain.land.entries
    session.update_object(city)
    assert session.record_of(city).field.key == shaped.key


def test_the_command_line_shapes_and_describes_the_tiles(city, tmp_path, capsys):
    stack, store, out = tmp_path / "stack.json", city.adaptive_terrain.store, tmp_path / "out"
    stack.write_text(json.dumps({"version": 1, "entries": [{"effect": "snow", "parameters": {"line": -900}}]}))
    assert run("shape", "--store", store, "--stack", stack, "--out", out, "--export", tmp_path / "a.tif") == 0
    capsys.readouterr()
    assert run("info", out, "--verify") == 0
    found = capsys.readouterr().out
    assert "every checksum holds" in found and "finer_step_m: 2.0, 2.0" in found and "format: shaped" in found
    one, other = open_store(store), open_store(out)
    change = dense_raster(other, 4) - dense_raster(one, 4)
    assert change.min() > 0.5 and np.abs(dense_heights(other) - dense_heights(one) - change).max() < 1e-4


def test_a_farm_prepares_land_with_the_tiles(city, tmp_path, capsys):
    add("snow", line=-900.0)
    city.adaptive_terrain.live = False
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    assert run("prepare", "--scene", tmp_path / "shot.blend", "--only", "land") == 0
    assert "its land is shaped" in capsys.readouterr().out
    [made] = (tmp_path / "city_land").glob("*/store.json")
    assert read_json(made.parent)["version"] == 7


@pytest.mark.thorough
def test_a_resting_viewport_makes_the_tiles_in_view(scene, add_terrain, tmp_path, monkeypatch):
    """A preview is shown first; other views then find the measured tiles."""
    obj = add_terrain()
    known = [(column, row) for column in (2, 3) for row in (2, 3)]
    obj.adaptive_terrain.store = str(finer_store(tmp_path / "wide", 600, 650, 2, known, step=16.0))
    derived_store.forget()
    add("relief", wave=100.0, plains=0.3)
    scene.camera.location, scene.camera.rotation_euler = (-2000.0, -1700.0, 460.0), (0.0, 0.0, 0.0)
    show_window(monkeypatch)
    for name in ("REST_S", "LOOK_S"):
        monkeypatch.setattr(resting_land, name, 0.0)
    bpy.context.view_layer.update()
    live.mark_dirty()
    end, shown = time.monotonic() + 300.0, []
    while not shown or shown[-1] != "Shaped":
        assert time.monotonic() < end, session.record_of(obj).status.error
        live.tick()
        shown.append(shaped_land.state_of(obj).shown)
        time.sleep(0.005)
    resting_land.stop()
    assert "Preview" in shown
    state, folder = shaped_land.state_of(obj), shaped_land.store_of(obj)
    assert 0 < state.tiles[0] < state.tiles[1] and land_folder.is_of_views(folder)
    source, shaped = open_store(obj.adaptive_terrain.store), open_store(folder)
    expected = dense_heights(source) + dense_raster(shaped, 2) - dense_raster(source, 2)
    assert np.abs(dense_heights(shaped) - expected).max() < 1e-4
    assert session.record_of(obj).field.raster.finer is not None
