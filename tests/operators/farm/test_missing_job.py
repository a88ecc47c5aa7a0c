# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs of scenes with a missing store: workers share a large import, and one of them does a small one."""

import json
import os
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.importing import import_work, tile_crew
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.source_list import names_several
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.tiling import tile_records
from adaptive_terrain.operators import jobs
from adaptive_terrain.operators.export import preparing
from adaptive_terrain.operators.farm import bundle, submit_to_farm
from adaptive_terrain.operators.importing import import_terrain, shot_import
from farm_jobs import ended, share
from modal_runs import hold, running, to_the_end, turn
from rasters import hills, write_raster
from store_exports import run
from tiled_stores import content, write_tiles

SHARED, ALONE = ["Begin", "Read", "Fill", "Measure"], ["Import", "MapsAndLand", "Meshes", "Verify"]


@pytest.fixture
def small_tiles(monkeypatch):
    """Let any import count as large by its bytes, in tiles of 16 cells a side."""
    for module, name, value in ((import_work, "TILE_BITS", 4), (tile_crew, "MIN_BYTES", 1)):
        monkeypatch.setattr(module, name, value)


@pytest.fixture
def add(add_terrain, tmp_path):
    """Return a function that adds a terrain of a source, without a store."""

    def added(name, source):
        obj = add_terrain(name)
        settings = obj.adaptive_terrain
        settings.source, settings.source_path, settings.store = "FILE", f"//{source}", f"//made/{name}"
        settings.render.error_px = 30.0
        return obj

    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    return added


@pytest.fixture
def missing(scene, add, tmp_path, small_tiles):
    """Save a scene without stores: Hills has 13 x 10 tiles and missing samples, Dunes 6 x 5 tiles."""
    heights = hills(200, 150)
    heights[30:60, 70:120] = np.nan
    np.save(tmp_path / "hills.npy", heights)
    np.save(tmp_path / "dunes.npy", hills(93, 70, seed=4))
    add("Hills", "hills.npy")
    add("Dunes", "dunes.npy").location.y = 500.0
    bpy.ops.wm.save_mainfile()
    return tmp_path


@pytest.fixture
def imports_in_process(monkeypatch):
    """Let `prepare` import in this process, whose tiles are small."""

    def imported(settings, store, _on_progress=None, part=None):
        importing = run_mosaic_import if names_several(settings) else run_import
        return importing(settings, Path(store), part=part)

    for module in (preparing, shot_import):
        monkeypatch.setattr(module, "import_source", imported)


def submit(folder, *arguments):
    """Submit the scene, and return the names of the job's steps and its lists of files."""
    import yaml

    assert run("submit", "--scene", folder / "shot.blend", "--out", folder / "job", "--frames", "1", *arguments) == 0
    steps = yaml.safe_load((folder / "job" / bundle.TEMPLATE).read_text())["steps"]
    assets = json.loads((folder / "job" / bundle.ASSETS).read_text())["assetReferences"]
    return [step["name"] for step in steps], assets


def prepare(folder, part, *arguments):
    """Do a step of a job in this process, and return its exit code."""
    where = "--scene", folder / "shot.blend", "--job-stores", folder / "job" / "stores"
    return run("prepare", *where, "--only", part, *arguments)


def parts_of(store, kind):
    """Return the times of the files of units or tiles that workers have done, by number."""
    files = [file for file in store.glob(f"data-*/{kind}-*.part")]
    return {int(file.stem.partition("-")[2]): file.stat().st_mtime_ns for file in files}


def assert_imported(name, folder, monkeypatch):
    """Compare a terrain's store with that of an import by one process, in one tile."""
    monkeypatch.setattr(import_work, "TILE_BITS", 11)
    settings = import_terrain.settings_of(bpy.data.objects[name])
    importing = run_mosaic_import if names_several(settings) else run_import
    importing(settings, folder / "alone" / name)
    monkeypatch.setattr(import_work, "TILE_BITS", 4)
    (arrays, text), (wanted, wanted_text) = content(folder / "made" / name), content(folder / "alone" / name)
    assert text == wanted_text and arrays.keys() == wanted.keys()
    assert all(arrays[array].tobytes() == wanted[array].tobytes() for array in wanted)


def test_a_job_refuses_names_that_share_a_file(missing, add, capsys):
    """Records of imports are files that are named like the terrains."""
    bpy.data.objects["Hills"].name, bpy.data.objects["Dunes"].name = "a/b", "a_b"
    bpy.ops.wm.save_mainfile()
    assert run("submit", "--scene", missing / "shot.blend", "--out", missing / "job", "--frames", "1") != 0
    assert "'a/b' and 'a_b'" in (said := capsys.readouterr().err) and "rename one of them" in said
    assert not (missing / "job").exists()


def test_workers_share_the_import_of_a_missing_store(missing, start, two_shares, capsys, monkeypatch):
    steps, _ = submit(missing)
    assert steps == [*SHARED, *ALONE]
    lines = capsys.readouterr().out
    assert "Hills: its store is missing; the job first imports all of it, 130 tiles that workers share. All" in lines
    assert "Dunes:" not in lines
    code, report = ended(start("Begin"))
    assert code == 0 and "Hills: the store needs all samples, of which 130 tiles are imported by several" in report
    assert "Dunes:" not in report and not (missing / "made" / "Dunes").exists()
    store = missing / "made" / "Hills"
    for step, kind in (("Read", tile_records.READ), ("Measure", tile_records.MEASURED)):
        code, report = ended(start(step, *share(1)))
        first = parts_of(store, kind)
        assert code == 0 and f"Hills: {step.lower()}, 65 of 130 tiles" in report, report
        again, other = start(step, *share(1)), start(step, *share(2))
        assert ended(again)[0] == ended(other)[0] == 0, "two workers at the same time"
        both = parts_of(store, kind)
        assert list(first) and sorted(first) == list(range(0, len(both), 2)), "each share has other tiles"
        assert sorted(both) == list(range(len(both))) and len(both) > len(first)
        assert both.items() >= first.items(), "finished ones are left as they are"
        if step == "Read":
            assert ended(start("Begin"))[0] == 0 and parts_of(store, kind) == both
            assert ended(start("Fill"))[0] == 0
    code, report = ended(start("Import"))
    assert code == 0 and "Hills: imported, 200 x 150" in report and "Dunes: imported, 93 x 70" in report, report
    for name in ("Hills", "Dunes"):
        assert_imported(name, missing, monkeypatch)
    before = (store / "store.json").read_bytes()
    code, report = ended(start("Verify", "--run-dependencies"))
    assert code == 0 and "1 frames are whole" in report and "Hills: its store is there" in report, report
    assert (store / "store.json").read_bytes() == before


def test_small_imports_keep_the_simple_job(missing, capsys):
    bpy.data.objects.remove(bpy.data.objects["Hills"])
    bpy.ops.wm.save_mainfile()
    steps, assets = submit(missing)
    assert steps == ALONE and "workers share" not in capsys.readouterr().out
    assert str(missing / "dunes.npy") in assets["inputs"]["filenames"]
    assert "const IMPORT_TASKS = 0;" in (missing / "job" / bundle.FLAMENCO).read_text()


def test_files_are_copied_only_without_a_shared_disk(missing):
    """Without it one worker imports the height maps, which go with the job, as farms that copy files need it."""
    _, assets = submit(missing)
    assert str(missing / "hills.npy") not in assets["inputs"]["filenames"]
    assert str(missing / "made" / "Hills") not in assets["outputs"]["directories"]
    assert str(missing / "made" / "Dunes") in assets["outputs"]["directories"], "one worker imports it"
    assert "const IMPORT_TASKS = 16;" in (missing / "job" / bundle.FLAMENCO).read_text(), "130 tiles, 8 a task"
    steps, assets = submit(missing, "--no-shared-disk")
    assert steps == ALONE and "StoresDir" not in (missing / "job" / bundle.OPENJD_VALUES).read_text()
    assert str(missing / "hills.npy") in assets["inputs"]["filenames"]
    assert str(missing / "made" / "Hills") in assets["outputs"]["directories"]
    where = {"folder": str(missing / "other"), "bring": False, "frames": "1"}
    for shared, has_begin in ((True, True), (False, False)):
        assert bpy.ops.adaptive_terrain.submit(**where, shared_disk=shared) == {"FINISHED"}
        assert ("name: Begin" in (missing / "other" / bundle.TEMPLATE).read_text()) == has_begin


@pytest.fixture
def counting(missing, monkeypatch):
    """Start to submit in a window; return the operator, and an event that lets it count the tiles."""
    event = hold(monkeypatch, shot_import, "tiles_to_share")
    options = {"folder": "//job", "frames": "1", "chunk": 4, "shared_disk": True}
    options |= {"render": True, "bring": False, "allow_outside": False, "is_chosen": True}
    yield running(submit_to_farm.SubmitToFarm, bpy.data.objects["Hills"], **options), event
    event.set()


def test_a_window_counts_tiles_beside_its_work(counting, missing):
    operator, event = counting
    assert operator.began == {"RUNNING_MODAL"} and jobs.find(jobs.SUBMIT) == operator.job
    assert turn(operator) == {"PASS_THROUGH"} and not (missing / "job").exists()
    assert not submit_to_farm.SubmitToFarm.poll(operator.context)
    event.set()
    assert to_the_end(operator) == {"FINISHED"}
    assert "name: Begin" in (missing / "job" / bundle.TEMPLATE).read_text()
    notes = [call.args[1] for call in operator.report.call_args_list if call.args[0] == {"WARNING"}]
    assert any("130 tiles that workers share" in note for note in notes)


def test_a_cancelled_submission_writes_no_job(counting, missing):
    operator, event = counting
    operator.job.stop()
    event.set()
    assert to_the_end(operator) == {"CANCELLED"} and not (missing / "job").exists()
    assert operator.report.call_args.args[1] == "Writing a farm job was cancelled; " + jobs.SUBMIT.stays


def test_tiles_in_view_need_a_shared_disk(shot, capsys):
    where = "--scene", shot / "shot.blend", "--out", shot / "job"
    assert run("submit", *where, "--no-shared-disk") == 1
    assert "The store of 'Terrain' is incomplete, and without a shared disk" in capsys.readouterr().err
    assert not (shot / "job").exists()


def test_a_changed_source_ends_a_share_with_one_error(missing, imports_in_process, capsys, monkeypatch):
    assert prepare(missing, "load") == prepare(missing, "read", "--share", "1/2") == 0
    np.save(missing / "hills.npy", hills(200, 150, seed=5))
    os.utime(missing / "hills.npy", ns=(1, 1))
    capsys.readouterr()
    for part in (("read", "--share", "2/2"), ("fill",), ("measure", "--share", "1/2")):
        assert prepare(missing, *part) == 1
        assert "No import of these sources and settings was begun" in (error := capsys.readouterr().err)
        assert "run it from its first step" in error and error.count("\n") == 1
    for part in (("load",), ("read", "--share", "1/1"), ("fill",), ("measure", "--share", "1/1"), ("stores",)):
        assert prepare(missing, *part) == 0
    assert_imported("Hills", missing, monkeypatch)
    assert len(list((missing / "made" / "Hills").glob("data-*"))) == 1, "the earlier work is removed"


@pytest.mark.thorough
def test_changed_settings_are_imported_anew(missing, imports_in_process, capsys, monkeypatch):
    assert prepare(missing, "load") == prepare(missing, "read", "--share", "1/1") == 0
    bpy.data.objects["Hills"].adaptive_terrain.holes = True
    bpy.ops.wm.save_mainfile()
    assert prepare(missing, "fill") == 1 and "No import of these sources" in capsys.readouterr().err
    assert prepare(missing, "stores") == 0, "one worker can do all of it"
    assert_imported("Hills", missing, monkeypatch)


def test_several_kinds_of_terrains_are_shared(
    scene, add, small_tiles, imports_in_process, tmp_path, monkeypatch, capsys
):
    """They are a mosaic, a built-in land, and a file whose store, of a quick import, is that of two terrains."""
    monkeypatch.setattr(tile_crew, "MIN_SAMPLES", 1)
    monkeypatch.setattr(shot_import, "MIN_TILES", 9)
    (tmp_path / "tiles").mkdir()
    write_tiles(tmp_path / "tiles", side=16)
    np.save(tmp_path / "a.npy", hills(50, 40))
    add("Mosaic", "tiles")
    for name in ("One", "Two"):
        obj = add(name, "a.npy")
        obj.adaptive_terrain.store = "//made/One"
    quick = run_import(replace(import_terrain.settings_of(obj), quick=100), tmp_path / "made" / "One")
    assert "loaded" in quick, "it is incomplete, and too small for tiles in view"
    land = add("Land", "")
    land.adaptive_terrain.source, land.adaptive_terrain.island_size = "ISLAND", 40
    bpy.ops.wm.save_mainfile()
    assert submit(tmp_path)[0] == [*SHARED, *ALONE]
    notes = capsys.readouterr().out
    assert "note: One: Loaded to " in notes and "m of 1 m; the job first imports all of it, 12 tiles that" in notes
    assert prepare(tmp_path, "load") == 0
    for step, kind in (("read", tile_records.READ), ("measure", tile_records.MEASURED)):
        for number in (2, 1):
            assert prepare(tmp_path, step, "--share", f"{number}/2") == 0
        for name, min_parts in (("Mosaic", 12), ("One", 12 if step == "measure" else 1), ("Land", 1)):
            assert len(parts_of(tmp_path / "made" / name, kind)) >= min_parts
        if step == "read":
            assert prepare(tmp_path, "fill") == 0
    assert prepare(tmp_path, "stores") == 0
    for name in ("Mosaic", "One", "Land"):
        assert_imported(name, tmp_path, monkeypatch)


def test_sources_that_are_read_whole_are_not_shared(scene, add, small_tiles, tmp_path):
    """Each worker would unpack an archive, and grid points: neither is opened to count its tiles."""
    obj = add("Terrain", "a.zip")
    for source in ("a.zip", "a.tif.gz", "a.laz", "zipped"):
        (tmp_path / "zipped").mkdir(exist_ok=True)
        file = tmp_path / source / "b.zip" if source == "zipped" else tmp_path / source
        file.write_bytes(b"no archive")
        obj.adaptive_terrain.source_path = f"//{source}"
        assert shot_import.shared_tiles(obj) == 0
    heights = hills(200, 150)
    write_raster(tmp_path / "a.tif", heights)
    obj.adaptive_terrain.source_path = "//a.tif"
    assert shot_import.shared_tiles(obj) == 130


@pytest.mark.thorough
def test_tiles_in_view_and_missing_stores_share_a_job(shot, add_terrain, small_tiles, start, two_shares, monkeypatch):
    np.save(shot / "hills.npy", hills(150, 130))
    obj = add_terrain("Hills")
    settings = obj.adaptive_terrain
    settings.source, settings.source_path, settings.store = "FILE", "//hills.npy", "//made/Hills"
    obj.location.x, settings.render.error_px = 3000.0, 30.0
    bpy.ops.wm.save_mainfile()
    steps, _ = submit(shot)
    assert steps == ["View", "Tiles", "Load", *SHARED[1:], *ALONE]
    code, report = ended(start("Verify", "--run-dependencies"))
    assert code == 0 and "1 frames are whole" in report, report
    assert "Terrain: " in report and "tiles in view are loaded, to 79.6 m" in report, report
    for line in ("Hills: the store needs all samples, of which 90 tiles", "Hills: measure, 45 of 90 tiles"):
        assert line in report, report
    assert "Terrain: measure" not in report
    assert_imported("Hills", shot, monkeypatch)
