# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles that a shot sees are found, read in shares and loaded into a job's store, as a local render loads them."""

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store, read_json
from adaptive_terrain.cbt_terrain.importing import refining
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.finer_squares import finer_squares
from adaptive_terrain.cbt_terrain.importing.source_list import names_several
from adaptive_terrain.cbt_terrain.mosaic import finer_plan
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.operators.export import preparing
from adaptive_terrain.operators.export.blend_files import open_scene
from adaptive_terrain.operators.importing import import_terrain, shot_tiles, view_tiles
from adaptive_terrain.operators.importing.imported import imported_of
from mathutils import Vector
from mosaic_files import EAST, NORTH, UTM32, sheet
from rasterio.transform import from_origin
from rasters import hills, write_raster
from tiled_stores import content

FRAMES = 1, 2


class FinishedImport:
    """An import in this process, in place of a child, which would not know the sizes of these tests."""

    def __init__(self, settings, store):
        import_source(settings, Path(store))


def import_source(settings, store, _on_progress=None, part=None):
    """Import in this process."""
    run = run_mosaic_import if names_several(settings) else run_import
    return run(settings, store, part=part)


def test_a_store_that_no_folder_can_have_is_missing():
    store = Path("n" * 300)
    assert preparing.is_missing(store) and not shot_tiles.can_load_tiles(store)


@pytest.fixture
def small_tiles(monkeypatch):
    """Make small tiles, as if each source was large, and import in this process."""
    for name, value in (("FEWEST", 1), ("FACTOR", 2), ("BITS", 4)):
        monkeypatch.setattr(refining, name, value)
    for module in (shot_tiles, preparing):
        monkeypatch.setattr(module, "import_source", import_source)


@pytest.fixture
def shot(scene, add_terrain, tmp_path, small_tiles):
    """Save a scene whose terrain has a first picture; its camera looks down at two places in two frames."""
    place = from_origin(5e5, 5e6, 10, 10)
    source = write_raster(tmp_path / "a.tif", hills(200, 150), crs="EPSG:32632", transform=place)
    obj = add_terrain()
    obj.location, obj.scale = (100.0, 50.0, -200.0), (2.0, 2.0, 1.5)
    settings = obj.adaptive_terrain
    settings.source, settings.source_path, settings.store = "FILE", str(source), str(tmp_path / "own.store")
    run_import(replace(import_terrain.settings_of(obj), quick=600), tmp_path / "own.store")
    settings.render.error_px = open_store(tmp_path / "own.store").max_height  # pixels of less than 1 m
    camera = scene.camera
    camera.rotation_euler, camera.data.angle = (0.0, 0.0, 0.0), 0.5
    bpy.context.view_layer.update()
    for frame, (x, y) in zip(FRAMES, ((-600.0, -300.0), (700.0, 400.0)), strict=True):
        camera.location = obj.matrix_world @ Vector((x, y, 900.0))
        camera.keyframe_insert("location", frame=frame)
    scene.frame_set(1)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    return tmp_path


def terrain():
    return bpy.data.objects["Terrain"]


def prepared(shot, only, frames=FRAMES, share=(1, 1), stores="job"):
    """Run a step of a job on the open scene, and return its last line."""
    said = []
    where = shot / stores if stores else None
    preparing.prepare([terrain()], frames, [only], said.append, lambda _done: None, where, share)
    return said[-1]


def assert_same(store, other):
    (arrays, text), (wanted, wanted_text) = content(store), content(other)
    assert text == wanted_text and all(np.array_equal(arrays[name], wanted[name]) for name in wanted)


def wait_locally(frames, monkeypatch, quick=600):
    """Render frames as with a running import: each waits for its tiles in the terrain's own store."""
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.importing.import_process.ImportJob", FinishedImport)
    monkeypatch.setattr(view_tiles.render_wait, "wait_for_import", lambda _child: None)
    monkeypatch.setattr(FinishedImport, "cancel", lambda _child: None, raising=False)
    monkeypatch.setattr(FinishedImport, "poll", lambda _child: view_tiles.jobs.BackgroundJob, raising=False)
    monkeypatch.setattr(view_tiles.jobs.BackgroundJob, "error", None, raising=False)
    settings = replace(import_terrain.settings_of(terrain()), quick=quick)
    loader = view_tiles.TileLoader(settings, terrain().adaptive_terrain.store)
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        assert loader.wait_for(terrain(), bpy.context.evaluated_depsgraph_get()), "tiles are enough"


def test_a_job_loads_the_tiles_of_a_local_render(shot, monkeypatch):
    own = content(shot / "own.store")[1]
    total = shot_tiles.num_tiles(shot / "own.store")
    found = prepared(shot, "view")
    assert found.endswith(f"of {total:,} are in view") and bpy.context.scene.frame_current == 1
    wanted = int(found.split()[1])
    assert 1 < wanted < total
    shares = [prepared(shot, "tiles", share=(number, 3)) for number in (3, 1, 2)]
    assert sum(int(line.split()[1]) for line in shares) == wanted - 1, "the first step has loaded one"
    said = prepared(shot, "stores")
    assert said.startswith(f"Terrain: {wanted:,} tiles in view are loaded, to 79.6 m of "), (
        "with that of the first step"
    )
    job = shot / "job" / "Terrain.store"
    assert content(shot / "own.store")[1] == own, "the artist's store stays as it was"
    wait_locally(FRAMES, monkeypatch)
    assert_same(job, shot / "own.store")


def test_steps_that_run_again_change_nothing(shot):
    wanted = int(prepared(shot, "view").split()[1])
    prepared(shot, "stores")
    before = (shot / "job" / "Terrain.store" / "store.json").read_bytes()
    assert prepared(shot, "view") == "Terrain: no further tiles are in view"
    assert prepared(shot, "tiles") == "Terrain: 0 tiles read"
    assert prepared(shot, "stores").startswith(f"Terrain: {wanted:,} tiles in view are loaded")
    assert (shot / "job" / "Terrain.store" / "store.json").read_bytes() == before


def test_a_vertical_scale_of_nan_is_refused_by_a_job(shot):
    """Only a driver or a script sets it. A job loaded no tiles, and told nothing."""
    terrain().adaptive_terrain.vertical_scale = np.nan
    for step in ("view", "stores"):
        with pytest.raises(TerrainError, match="The vertical scale nan .*: check both, and drivers"):
            prepared(shot, step)


def test_frames_in_turn_load_the_union_of_their_tiles(shot):
    for frames in ((1,), (2,)):
        prepared(shot, "stores", frames)
    prepared(shot, "stores", stores="whole")
    assert_same(shot / "job" / "Terrain.store", shot / "whole" / "Terrain.store")


def test_frames_that_need_all_samples_get_them(shot):
    terrain().adaptive_terrain.render.error_px = 0.5
    assert "imported, 200 x 150 samples" in prepared(shot, "stores")
    assert not (shot / "job" / "Terrain.store" / "store.json").exists()
    assert imported_of(terrain().adaptive_terrain).raster == (200, 150)
    shot_tiles.use_job_stores([terrain()], shot / "job")
    assert terrain().adaptive_terrain.store == str(shot / "own.store")
    assert prepared(shot, "stores") == "Terrain: its store is there"


def test_a_hidden_terrain_needs_no_tiles(shot):
    terrain().hide_render = True
    assert prepared(shot, "view") == "Terrain: no further tiles are in view"
    assert prepared(shot, "stores").startswith("Terrain: 0 tiles in view are loaded, to 79.6 m of 10 m")
    assert (shot / "job" / "Terrain.store" / "store.json").exists()


def test_a_process_alone_loads_tiles_into_the_own_store(shot):
    assert prepared(shot, "stores", stores=None).startswith("Terrain: ")
    assert refining.loaded_tiles(read_json(shot / "own.store")["provenance"]) and not (shot / "job").exists()


def test_frames_are_made_from_the_job_stores(shot):
    blend = shot / "a.blend"
    with pytest.raises(TerrainError, match="'Terrain' that the frames see are not loaded in .*job: run `prepare`"):
        open_scene(blend, shot / "job")
    open_scene(blend)
    prepared(shot, "stores")
    open_scene(blend, shot / "job")
    assert Path(terrain().adaptive_terrain.store) == shot / "job" / "Terrain.store"


def test_another_first_picture_replaces_the_job_store(shot):
    prepared(shot, "stores")
    terrain().adaptive_terrain.height_offset = 50.0
    with pytest.raises(TerrainError, match="has no first picture of .*a.tif; expected one of the same files"):
        prepared(shot, "view", stores="other")
    run_import(replace(import_terrain.settings_of(terrain()), quick=600), shot / "own.store")
    prepared(shot, "view")
    low = [open_store(store).min_height for store in (shot / "own.store", shot / "job" / "Terrain.store")]
    assert low[0] == low[1]
    assert len(refining.loaded_tiles(read_json(shot / "job" / "Terrain.store")["provenance"])) == 1, "by this step"


@pytest.mark.thorough
def test_frames_that_see_a_city_get_its_finest_files(scene, add_terrain, tmp_path, small_tiles, monkeypatch):
    monkeypatch.setattr(finer_plan, "FEWEST", 1 << 20)
    monkeypatch.setattr(refining, "FACTOR", 4)
    sheet(UTM32, EAST, NORTH, 32.0, 32.0, 400, 300).write(tmp_path / "files" / "a_country.tif")
    sheet(UTM32, EAST + 4000.0, NORTH - 3000.0, 1.0, 1.0, 900, 700, shift=3.0).write(tmp_path / "files" / "b_city.tif")
    obj = add_terrain()
    settings = obj.adaptive_terrain
    settings.source, settings.source_path, settings.store = "FILE", str(tmp_path / "files"), str(tmp_path / "own.store")
    run_mosaic_import(replace(import_terrain.settings_of(obj), quick=8000), tmp_path / "own.store")
    field = open_store(tmp_path / "own.store")
    a, _, c, _, e, f = field.raster.place
    scene.camera.location = (EAST + 4450.0 - c) / a, (NORTH - 3350.0 - f) / e, field.max_height + 300.0
    scene.camera.rotation_euler, scene.camera.data.angle, settings.render.error_px = (0.0, 0.0, 0.0), 0.8, 4.0
    bpy.context.view_layer.update()
    said = prepared(tmp_path, "stores", [scene.frame_current])
    assert "in view and 2 squares with finer files are loaded, to 128 m of 1 m, in 4 tiles to 31.9 m" in said
    job = open_store(tmp_path / "job" / "Terrain.store")
    assert len(finer_squares(job).loaded) == 2 and job.raster.finer is not None
    wait_locally([scene.frame_current], monkeypatch, quick=8000)
    assert_same(tmp_path / "job" / "Terrain.store", tmp_path / "own.store")
