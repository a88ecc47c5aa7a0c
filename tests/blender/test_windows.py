# SPDX-License-Identifier: GPL-3.0-or-later
"""Scripts that click, drag, type and wait in a window of the real program."""

import shutil

import numpy as np
import pytest
from PIL import Image
from program_window import WHOLE
from rasterio.transform import Affine
from rasters import hills, write_raster
from window_report import run_in_window

pytestmark = pytest.mark.thorough


def test_the_asset_browser_lists_the_library(program, tmp_path):
    shutil.rmtree(program.user / "extensions/.user/user_default/adaptive_terrain/assets")
    report = run_in_window(program, "asset_library.py", tmp_path, ("browser", "dropped"))
    assert report["wheels"], "the process that writes the library leaves the extension's wheels in place"
    assert report["files"] == ["adaptive_terrain.blend", "blender_assets.cats.txt", "version.txt"]
    assert report["assets"] == {"materials": 6, "node_groups": 3, "collections": 5}
    assert report["dragged"] == ["Terrain Material"]
    assert report["after_disable"] == [[["Mine", str(tmp_path)]], []]


def test_a_click_picks_and_kept_objects_follow(program, tmp_path):
    report = run_in_window(program, "click_ground.py", tmp_path, ("ground",), place=WHOLE)
    assert report["picked"] == pytest.approx(report["clicked"], abs=1.5), "the cursor is under the mouse"
    for x, y, z, ground in report["kept"]:
        assert z == pytest.approx(ground, abs=1e-3), (x, y)


def test_jobs_are_cancelled_finish_and_end_with_the_file(program, tmp_path):
    found, log = run_in_window(program, "background_jobs.py", tmp_path), (tmp_path / "blender.log").read_text()
    assert "Traceback" not in log, (found, log[-4000:])
    assert found["baking"] == ["RUNNING_MODAL"] and found["cancel"] == ["FINISHED"]
    assert found["cancelled"] == [7, []], "the scene is at its frame again, and no map is left"
    assert found["maps"] > 0 and found["store"].startswith("//")
    assert found["proposed"] == "Terrain_tileset.json" and found["tileset"] == [".glb", ".json"]
    assert found["asking"] == ["RUNNING_MODAL"], "then Enter writes the job"
    assert found["after_opening"] == [0, []] and found["after_disabling"] == [0, []]


def test_a_map_is_rendered_beside_the_window(program, tmp_path):
    """It has the pixels of a script's map, and opens no window."""
    report = run_in_window(program, "render_map.py", tmp_path)
    assert report["texts"] == [f"Rendering a map: Picture {number} of 2; Esc: cancel" for number in (1, 2)]
    for name in ("x0_y0", "x1_y0"):
        script, ours = (np.asarray(Image.open(tmp_path / f"{kind}_{name}.png")) for kind in ("script", "window"))
        assert script.shape == (200, 100, 4) and (script == ours).all() and script[:, :, :3].std() > 1.0
        assert (tmp_path / f"window_{name}.tif").exists()
    assert (report["windows"], report["border"]) == (1, False)


def test_esc_cancels_the_land_of_a_render(program, tmp_path):
    report = run_in_window(program, "cancel_render.py", tmp_path)
    assert not report["rendering_while_shaping"] and not report["rendered_after_esc"], "F12 shapes before it renders"
    assert report["job_ends_s"] < 10.0 and report["wait_ends_s"] < 10.0
    [[message]] = report["said"]
    assert message == "The render was cancelled while land was shaped: render again: finished tiles are reused."
    print({name: report[name] for name in ("job_ends_s", "wait_ends_s")})
    assert report["ended"][-1] == "render_complete" and report["shaped"] == "Shaped"


def test_land_is_shaped_in_the_background(program, tmp_path):
    report = run_in_window(program, "click_land.py", tmp_path, ("preview", "shaping", "shaped", "finer"))
    assert report["preview"] < report["source"] - 1.0, "rivers cut: the mean of the mesh sinks"
    assert abs(report["shaped"] - report["preview"]) < 0.5 * abs(report["preview"] - report["source"]) + 20.0
    assert report["previews_a_step"] == 1 and report["tiles"] is None
    assert report["progress"] and report["after_cancel"] == "Preview"
    assert report["tiles_shaped"][0] == report["tiles_shaped"][1] > 1, "without views all tiles are built"
    assert "press Shape Now" in report["not_baked"], "it would block the window"
    assert report["baked"] == [True, 0] and report["baked_differs_m"] == 0.0
    assert report["stores_for_undo"] == 0, "what was shaped before is found again"
    assert report["hidden_cost"] == [0, 0] and report["shown_cost"] == [1, 0]
    assert report["slider_ends_it"], "and the whole island then costs less than the tiles of this view"
    assert report["tiles_of_views"][0] == report["tiles_of_views"][1] > 1
    times = ("slider_s", "longest_turn_s", "longest_turn_shaping_s", "shaped_s", "longest_turn_resting_s", "finer_s")
    print({name: report[name] for name in times})


def test_a_dropped_file_and_a_click_make_a_scene(program, tmp_path):
    write_raster(tmp_path / "dem.png", (hills(129, 97) * 60).astype("uint16"))
    report = run_in_window(program, "set_up_scene.py", tmp_path, ("set_up",))
    assert report["before"] == ["Camera", "Cube", "Light", "dem"]
    assert report["triangles"] > 1000, "the viewport shows the land in detail although the camera is inside the ground"
    assert report["followed"] == [True, False, True], "after the import, Set Up Scene and its undo"
    assert report["unturned"], "the import moves the viewport without turning it"
    assert report["after"] == ["Camera", "Terrain Sun", "dem"]
    assert max(report["camera_off"]) < 1e-4, "the camera looks from where the viewport looks, also after a change"
    assert report["sun"] == pytest.approx(np.sin([0.3, 0.5, 0.3, 1.0]), abs=1e-5)
    assert report["looks"] == [*["CAMERA"] * 5, "PERSP"], "it leaves the camera at Undo of the first click"
    assert report["undone"] == report["before"], "one step for Undo a click"


def test_a_store_replaced_by_a_second_program_is_shown(program, tmp_path):
    """It is twice as wide; the ground stays at its coordinates."""
    both = hills(80, 30)
    for name, heights in (("west", both[:, :40]), ("both", both)):
        corner = Affine(10, 0, 6e5, 0, -10, 5.2e6)
        write_raster(tmp_path / f"{name}.tif", heights, crs="EPSG:32632", transform=corner)
    report = run_in_window(program, "replaced_store.py", tmp_path)
    assert report["second"] == 0 and report["before"][:2] == pytest.approx([600005.0, 600395.0], abs=0.1)
    assert report["after"][:2] == pytest.approx([600005.0, 600795.0], abs=0.1) and report["moved"] == 200.0
    assert report["after"][2:] == pytest.approx([both.min(), both.max()], abs=5.0)


def test_a_restored_terrain_is_imported_again(program, tmp_path):
    """A terrain undone and redone, or deleted and undone, during its import gets its height map.

    Adding and importing are then one step of Undo.
    """
    report = run_in_window(program, "undo_import.py", tmp_path)
    assert report["undone"] == report["deleted"] == ["", 1], "no store yet, one import"
    assert report["imported"] and report["left"] == [0, 0]
    assert report["one_step"] == [True, True, 0], "the store and the camera's range are back, and nothing is imported"
