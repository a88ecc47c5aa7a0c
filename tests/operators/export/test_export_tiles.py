# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators and commands that write tiles for other programs."""

import json
from types import SimpleNamespace
from unittest.mock import Mock

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.exporting import tileset
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.operators import jobs
from adaptive_terrain.operators.export import export_tiles
from adaptive_terrain.operators.export.export_terrain import ExportTerrain
from adaptive_terrain.operators.export.export_tiles import ExportHeights, ExportHeightTiles, ExportTileset
from adaptive_terrain.operators.export.render_map import RenderMap
from adaptive_terrain.operators.session.polls import invoke_with_file
from land_scenes import add
from modal_runs import RunningOperator, hold, running, to_the_end
from store_exports import run
from tilesets import read_tileset


def test_height_tiles_hold_shaped_land_and_its_masks(terrain, tmp_path):
    """Two tiles a side of 33 samples, with by-products and splat layers."""
    add("scree", depth=80.0)
    for name in ("Meadow", "Cliff"):
        terrain.adaptive_terrain.layers.add().name = name
    options = {"size": "FREE", "free_size": 33, "fit": True, "tiles": (2, 2), "flip": True}
    assert bpy.ops.adaptive_terrain.export_tiles(filepath=str(tmp_path / "land.r32"), **options) == {"FINISHED"}
    index = json.loads((tmp_path / "land.json").read_text())
    assert {mask["name"] for mask in index["masks"]} >= {"scree", "Meadow", "Cliff"}
    found = np.fromfile(tmp_path / "land_x0_y0.r32", "<f4").reshape(33, 33)
    shared = np.fromfile(tmp_path / "land_x1_y0.r32", "<f4").reshape(33, 33)
    assert (found[:, -1] == shared[:, 0]).all() and len(list(tmp_path.glob("land_Meadow_x*_y*.png"))) == 4
    unshaped = open_store(terrain.adaptive_terrain.store).heights()
    assert found[0, 0] == pytest.approx(unshaped[0, 0], abs=81) and np.ptp(found) > 10


def test_an_unknown_suffix_is_refused(terrain, tmp_path):
    with pytest.raises(RuntimeError, match="no format of height tiles; expected tif"):
        bpy.ops.adaptive_terrain.export_tiles(filepath=str(tmp_path / "land.jpg"))


def test_the_command_writes_height_tiles(terrain, tmp_path, capsys):
    argv = ["tiles", "--store", terrain.adaptive_terrain.store, "--out", tmp_path / "new", "--size", "17"]
    assert run(*argv, "--tiles", "3x1", "--overlap", "0", "--masks", "slope") == 0
    assert "3 tiles (3 x 1), 1 mask, heights at most" in capsys.readouterr().out
    assert len(list((tmp_path / "new").glob("terrain*_x?_y0.png"))) == 6
    assert run(*argv, "--pattern", "same") == 1
    assert "expected {name}, {x} and {y}" in capsys.readouterr().err


def test_the_operator_and_the_command_write_the_same_tileset(terrain, tmp_path, capsys):
    path = tmp_path / "a.json"
    options = {"error_m": 6.0, "triangles": 300}
    assert bpy.ops.adaptive_terrain.export_tileset(filepath=str(path), **options) == {"FINISHED"}
    _, tiles = read_tileset(path)
    assert tiles[-1][0] >= 1 and all(mesh is not None for _, _, mesh in tiles)
    (tmp_path / "new").mkdir()
    argv = ["tileset", "--store", terrain.adaptive_terrain.store, "--max-error", "6", "--triangles", "300", "--out"]
    assert run(*argv, tmp_path / "new" / "a.json") == 0
    assert f"{len(tiles)} tiles in " in capsys.readouterr().out
    for file in tmp_path.glob("a*"):
        assert (tmp_path / "new" / file.name).read_bytes() == file.read_bytes()
    assert run(*argv, tmp_path / "none" / "a.json") == 1


NAMES = {
    ExportHeightTiles: "Terrain.png",
    ExportTileset: "Terrain_tileset.json",
    ExportHeights: "Terrain_heights.tif",
    ExportTerrain: "Terrain.ply",
    RenderMap: "Terrain_map.png",
}


@pytest.mark.parametrize("operator_class", NAMES)
def test_the_dialog_proposes_the_terrain_beside_its_source(terrain, operator_class, tmp_path):
    """No two proposals are one name, and none is that of a source."""
    terrain.adaptive_terrain.source, terrain.adaptive_terrain.source_path = "FILE", str(tmp_path / "alps.tif")
    context = SimpleNamespace(
        object=terrain,
        scene=bpy.context.scene,
        evaluated_depsgraph_get=bpy.context.evaluated_depsgraph_get,
        window_manager=SimpleNamespace(fileselect_add=lambda _operator: None),
        blend_data=bpy.data,
    )
    operator = RunningOperator(operator_class=operator_class, filepath="", is_chosen=False)
    assert operator_class.invoke(operator, context, None) == {"RUNNING_MODAL"}
    assert operator.filepath == str(tmp_path / NAMES[operator_class])


def test_an_error_after_the_dialog_is_reported(terrain, tmp_path):
    """The dialog's operator invokes another one, whose error Blender would show as a traceback."""

    class Dialog(SimpleNamespace):
        bl_idname = ExportHeights.bl_idname

    keywords = {"filepath": str(tmp_path / "land.jpg"), "step": 0.0}
    dialog = Dialog(report=Mock(), as_keywords=lambda ignore: keywords)
    assert invoke_with_file(dialog, bpy.context) == {"CANCELLED"}
    [[kind, text]] = [call.args for call in dialog.report.call_args_list]
    assert kind == {"ERROR"} and text.endswith("land.jpg is of no format for heights; expected .tif, .tiff, .exr.")


@pytest.fixture
def export(terrain, tmp_path):
    """Return a function that starts the export of a tileset in a window, after its file is chosen."""
    return lambda: running(
        ExportTileset, terrain, filepath=str(tmp_path / "a.json"), is_chosen=True, error_m=6.0, triangles=300
    )


def test_a_window_exports_beside_its_work(export, tmp_path):
    operator = export()
    assert operator.began == {"RUNNING_MODAL"} and jobs.running == [operator.job]
    assert to_the_end(operator) == {"FINISHED"} and len(read_tileset(tmp_path / "a.json")[1]) > 4
    assert " tiles in " in operator.report.call_args.args[1]


def test_a_cancelled_export_leaves_no_half_tileset(export, tmp_path, monkeypatch):
    """The JSON file of an earlier export would describe tiles of two exports."""
    assert to_the_end(export()) == {"FINISHED"}
    operator, written = export(), tileset.written_beside

    def stop_at_the_third(path):
        if path.name.startswith("a_2_"):
            operator.job.stop()
        return written(path)

    monkeypatch.setattr(tileset, "written_beside", stop_at_the_third)
    assert to_the_end(operator) == {"CANCELLED"} and not jobs.running
    assert not (tmp_path / "a.json").exists() and not list(tmp_path.glob("*partial*"))


def test_an_export_stops_within_a_level(export, monkeypatch):
    operator = export()
    monkeypatch.setattr(Terrain, "update", lambda *_some: [operator.job.stop(), launch.stopping.check()])
    assert to_the_end(operator) == {"CANCELLED"}


@pytest.fixture
def heights(terrain, tmp_path):
    """Return a function that starts the export of heights in a window, to a file with a suffix."""
    options = {"is_chosen": True, "step": 0.0}
    return lambda suffix: running(ExportHeights, terrain, filepath=str(tmp_path / f"land{suffix}"), **options)


@pytest.mark.parametrize("suffix", [".tif", ".exr"])
def test_a_window_exports_heights_beside_its_work(heights, tmp_path, suffix, monkeypatch):
    event, operator = hold(monkeypatch, export_tiles, "export_raster"), heights(suffix)
    assert operator.began == {"RUNNING_MODAL"} and jobs.running == [operator.job]
    event.set()
    assert to_the_end(operator) == {"FINISHED"} and (tmp_path / f"land{suffix}").stat().st_size > 1000
    assert operator.report.call_args.args[1] == f"Written: land{suffix}" and operator.job.fraction == 1.0


@pytest.mark.parametrize("suffix", [".tif", ".exr"])
def test_a_cancelled_export_of_heights_leaves_no_file(heights, tmp_path, suffix, monkeypatch):
    before = sorted(tmp_path.iterdir())
    event, operator = hold(monkeypatch, export_tiles, "export_raster"), heights(suffix)
    operator.job.stop()
    event.set()
    assert to_the_end(operator) == {"CANCELLED"} and sorted(tmp_path.iterdir()) == before
