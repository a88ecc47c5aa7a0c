# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs of scenes with an incomplete store: openjd-cli imports the tiles that the frames see, and then makes these."""

import json
import runpy
from dataclasses import replace

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import read_json
from adaptive_terrain.cbt_terrain.importing import refining, view_needs
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.tiling import tile_records
from adaptive_terrain.operators.cli import parser
from adaptive_terrain.operators.farm import bundle
from adaptive_terrain.operators.importing import import_terrain, shot_tiles
from farm_jobs import ended, num_parts, share
from openjd.model import decode_job_template
from store_exports import run
from tiled_stores import content


def test_workers_load_the_tiles_in_view_of_a_shot(shot, start, capsys, two_shares):
    assert run("submit", "--scene", shot / "shot.blend", "--out", shot / "job", "--frames", "1-4") == 0
    total = shot_tiles.num_tiles(shot / "own.store")
    note = (
        f"Terrain: Loaded to 79.6 m of 10 m; the job first imports the tiles that its frames see, at most {total}, or"
    )
    assert note in capsys.readouterr().out
    code, report = ended(start("View"))
    assert code == 0, report
    ahead = shot / "job" / "stores" / "Terrain.store" / "ahead"
    wanted = json.loads((ahead / "wanted.json").read_text())
    first = refining.loaded_tiles(read_json(ahead.parent)["provenance"])
    assert len(first) == 1 and first.isdisjoint(wanted), "the neediest tile is loaded"
    assert 2 < len(wanted) < total
    killed, other = start("Tiles", *share(1), DIE="ahead"), start("Tiles", *share(2))
    assert ended(killed)[0] != 0 and ended(other)[0] == 0, "two workers at the same time"
    there = {int(file.stem) for file in ahead.glob("*.tile")}
    assert there == {wanted[0], *wanted[1::2]}, "the killed one has read one tile"
    code, report = ended(start("Verify", "--run-dependencies"))
    assert code == 0 and "4 frames are whole" in report, report
    assert f"Terrain: {len(wanted)} further tiles of {total} are in view" in report, "View is done again"
    assert f"Terrain: {len(wanted) + 1} tiles in view are loaded" in report, "with that of View"
    job = shot / "job" / "frames"
    assert json.loads((job / "frame_0001.json").read_text())["terrains"][0]["loaded"].startswith(
        "to 79.6 m of 10 m, in"
    )
    assert not refining.loaded_tiles(read_json(shot / "own.store")["provenance"]), "the artist's store is as it was"

    settings = replace(
        import_terrain.settings_of(bpy.data.objects["Terrain"]), quick=600, loaded_tiles=(*first, *wanted)
    )
    run_import(settings, shot / "own.store")  # as a local render that has waited for its tiles
    out = "--format", "npz", "--out", shot / "local"
    assert run("export", "--scene", shot / "shot.blend", "--frames", "1,4", *out) == 0
    for name in ("Terrain_0001.npz", "Terrain_0004.npz"):
        with np.load(job / name) as mesh, np.load(shot / "local" / name) as expected:
            arrays = [array for array in expected.files if array != "info"]
            assert all(np.array_equal(mesh[array], expected[array]) for array in arrays)


def whole_store(shot, name="whole.store"):
    """Import all samples into another store, in one tile."""
    run_import(import_terrain.settings_of(bpy.data.objects["Terrain"]), shot / name)
    return shot / name


@pytest.mark.thorough
def test_workers_share_the_import_of_all_samples(shot, start, two_shares):
    bpy.data.objects["Terrain"].adaptive_terrain.render.error_px = 1.0
    bpy.ops.wm.save_mainfile()
    assert run("submit", "--scene", shot / "shot.blend", "--out", shot / "job", "--frames", "1-4") == 0
    code, report = ended(start("Load", "--run-dependencies"))
    assert code == 0 and "the frames need all samples, of which 130 tiles are imported by several" in report, report
    for step, kind, total in (("Read", tile_records.READ, 8), ("Measure", tile_records.MEASURED, 130)):
        killed, other = start(step, *share(1), DIE=kind), start(step, *share(2))
        assert ended(killed)[0] != 0
        code, report = ended(other)
        assert code == 0 and f"Terrain: {step.lower()}, 65 of 130 tiles" in report, "two workers at the same time"
        there = num_parts(shot / "own.store", kind)
        assert there == total // 2 + 1, "the killed one has done one"
        code, report = ended(start(step, *share(1)))
        assert code == 0 and num_parts(shot / "own.store", kind) == total, report
        if step == "Read":
            assert ended(start("Fill"))[0] == 0
    for step, line in (
        ("Import", "Terrain: imported"),
        ("MapsAndLand", ""),
        ("Meshes", ""),
        ("Verify", "4 frames are"),
    ):
        code, report = ended(start(step))
        assert code == 0 and line in report, report
    assert not (shot / "job" / "stores" / "Terrain.store").exists()
    (arrays, text), (wanted, wanted_text) = content(shot / "own.store"), content(whole_store(shot))
    assert all(np.array_equal(arrays[name], wanted[name]) for name in wanted)
    assert text == wanted_text
    bpy.data.objects["Terrain"].adaptive_terrain.store = "//whole.store"
    bpy.ops.wm.save_as_mainfile(filepath=str(shot / "local.blend"))
    out = "--format", "npz", "--out", shot / "local"
    assert run("export", "--scene", shot / "local.blend", "--frames", "1,4", *out) == 0
    for name in ("Terrain_0001.npz", "Terrain_0004.npz"):
        with np.load(shot / "job" / "frames" / name) as mesh, np.load(shot / "local" / name) as expected:
            arrays = [array for array in expected.files if array != "info"]
            assert all(np.array_equal(mesh[array], expected[array]) for array in arrays)


@pytest.mark.thorough
def test_one_tile_shows_that_tiles_are_not_enough(shot, start, two_shares):
    obj = bpy.data.objects["Terrain"]
    obj.adaptive_terrain.render.error_px = 100.0
    bpy.ops.wm.save_mainfile()
    store, lands, tiles = shot_tiles.find_tiles(obj, (2, 3), shot / "all_tiles")
    assert 2 < len(tiles) < shot_tiles.NEARLY_ALL * shot_tiles.num_tiles(store)
    run_import(replace(import_terrain.settings_of(obj), quick=600, loaded_tiles=tiles), store)
    assert not view_needs.is_fine_enough(store, lands), "all tiles in view are loaded for nothing"

    assert run("submit", "--scene", shot / "shot.blend", "--out", shot / "job", "--frames", "2-3") == 0
    code, report = ended(start("View"))
    assert code == 0 and "the frames need all samples, of which 130 tiles are imported by several" in report, report
    assert not (shot / "job" / "stores" / "Terrain.store").exists()
    for step in ("Tiles", "Load"):
        code, report = ended(start(step))
        assert code == 0 and "tiles in view" not in report, report
        assert not (shot / "job" / "stores" / "Terrain.store").exists()
    assert num_parts(shot / "own.store", tile_records.READ) == 0
    code, report = ended(start("View"))
    assert code == 0 and "Terrain: the frames need all samples" in report, "done again, it has begun"


def test_only_incomplete_stores_need_these_steps(shot, capsys):
    where = "--scene", shot / "shot.blend", "--out", shot / "job"
    assert run("submit", *where, "--render", "--min-memory", "2") == 0
    template = (shot / "job" / bundle.TEMPLATE).read_text()
    import yaml

    decode_job_template(template=yaml.safe_load(template), supported_extensions=["TASK_CHUNKING"])
    steps = yaml.safe_load(template)["steps"]
    first = ["View", "Tiles", "Load", "Read", "Fill", "Measure"]
    assert [step["name"] for step in steps] == [*first, "Import", "MapsAndLand", "Render", "Verify"]
    assert all("hostRequirements" in step for step in steps)
    with_stores = [step["name"] for step in steps if "--job-stores" in step["script"]["actions"]["onRun"]["args"]]
    assert with_stores == [*first, "Import", "MapsAndLand", "Render"]
    assets = json.loads((shot / "job" / bundle.ASSETS).read_text())["assetReferences"]
    assert str(shot / "own.store") in assets["inputs"]["directories"]
    assert str(shot / "a.tif") not in assets["inputs"]["filenames"], "workers share its disk"
    assert str(shot / "job" / "stores") in assets["outputs"]["directories"]
    assert "const IMPORT_TASKS = 2;" in (shot / "job" / bundle.FLAMENCO).read_text(), "12 tiles, 8 a task"
    capsys.readouterr()
    run_import(import_terrain.settings_of(bpy.data.objects["Terrain"]), shot / "own.store")
    assert run("submit", *where, "--render") == 0 and "first imports" not in capsys.readouterr().out
    template = (shot / "job" / bundle.TEMPLATE).read_text()
    steps = yaml.safe_load(template)["steps"]
    assert [step["name"] for step in steps] == ["Import", "MapsAndLand", "Render", "Verify"]
    assert (
        "StoresDir" not in (shot / "job" / bundle.OPENJD_VALUES).read_text() and "@" not in template.split("steps:")[1]
    )


def test_the_guard_uses_the_stores_of_a_job(shot, monkeypatch, capsys):
    """A farm with its own command for Blender renders from them, and fails where an incomplete store has none."""
    stores = shot / "stores"
    monkeypatch.setattr("sys.argv", ["blender", "--", "--job-stores", str(stores)])
    with pytest.raises(SystemExit):
        runpy.run_path(bundle.HERE / bundle.GUARD)
    text = capsys.readouterr().out
    assert "openjd_fail: The tiles of 'Terrain' that the frames see are not loaded in" in text
    assert run("prepare", "--scene", shot / "shot.blend", "--frames", "2", "--job-stores", stores) == 0
    bpy.ops.wm.open_mainfile(filepath=str(shot / "shot.blend"))
    obj = bpy.data.objects["Terrain"]
    assert obj.adaptive_terrain.store == "//own.store"
    runpy.run_path(bundle.HERE / bundle.GUARD)
    assert obj.adaptive_terrain.store == str(stores / "Terrain.store")


@pytest.mark.thorough
def test_a_share_is_one_of_several(capsys):
    parse = parser.build_parser().parse_args
    options = ["prepare", "--scene", "a.blend", "--only", "tiles", "--share"]
    assert parse([*options, "3/16"]).share == (3, 16)
    for text in ("0/4", "5/4", "3", "a/b", "/"):
        with pytest.raises(SystemExit):
            parse([*options, text])
    assert run("prepare", "--scene", "a.blend", "--share", "1/2") == 2
    assert "--share belongs to --only tiles and --only read and --only measure" in capsys.readouterr().err
    assert run("prepare", "--scene", "a.blend", "--only", "load") == 2
    assert "--only load needs --job-stores" in capsys.readouterr().err
    assert run("export", "--store", "a", "--job-stores", "b", "--frames", "1", "--format", "npz", "--out", "c") == 2
