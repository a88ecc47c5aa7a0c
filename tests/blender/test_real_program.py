# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension in the real Blender program: built, installed, imported into, rendered, exported from and clicked."""

import json
import os
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain.benchmarks.rows import in_program
from hostile_files import source, vrt
from PIL import Image
from real_program import EFFECT, EXTENSION, FRAME, lend_kernels
from window_report import run_in_window


def test_zip_holds_the_package_and_its_wheels_but_no_tests(extension_zip):
    names = zipfile.ZipFile(extension_zip).namelist()
    assert {"__init__.py", "blender_manifest.toml", "operators/registration.py", "LICENSE"} <= set(names)
    assert not [name for name in names if name.startswith(("tests/", "benchmarks/", "tools/"))]
    wheels = {name.split("/")[1].split("-")[0].lower() for name in names if name.startswith("wheels/")}
    assert {"warp_lang", "openexr", "rasterio"} <= wheels
    assert "numpy" not in wheels, "wheels of all extensions share one folder with Blender's own"


def test_a_geotiff_becomes_a_terrain(scene, dem):
    path, report = scene
    [terrain] = report["terrains"].values()
    assert terrain["triangles"] > 1000
    assert terrain["validate"] is False
    low, high = dem["heights"].min(), dem["heights"].max()
    assert low - 1 <= terrain["heights"][0] < terrain["heights"][1] <= high + 1
    assert path.exists()


@pytest.fixture(scope="module")
def others(program, dem, tmp_path_factory):
    """Import the DEM in whole metres and as EXR in one program."""
    path = tmp_path_factory.mktemp("others") / "others.blend"
    return program.script("import_dem.py", path, dem["whole"], dem["exr"])["terrains"]


def test_the_panel_shows_the_rounding_of_whole_metres(others, dem):
    terrain = others[str(dem["whole"])]
    assert "by the source" in [label.strip() for label, _ in terrain["panel"]]


def test_the_world_moves_to_a_camera_far_away(program, dem, tmp_path):
    """Two placed rasters; keyframes and positions are exact at the world's origin."""
    found = program.script("move_world.py", tmp_path / "far.blend", dem["whole"])
    assert found["apart"] == pytest.approx([0.0, 0.0], abs=1e-3), "one file twice is at one place"
    assert found["anchors"] == [[8192.0, -6144.0]] * 2 and found["locations"] == [[0.0, 0.0]] * 2
    assert found["camera"] == pytest.approx([8200.0 - 8192.0, 6144.0 - 6200.0, 8300.0 - 8192.0], abs=1e-3)
    assert found["moved_m"] < 2e-3, "the ground stays below the camera"


def test_an_exr_becomes_a_terrain(others, dem):
    """The OpenEXR wheel is not safe inside the real program; the import reads it in a child process."""
    terrain = others[str(dem["exr"])]
    assert terrain["triangles"] > 1000
    low, high = dem["heights"].min(), dem["heights"].max()
    assert low - 1 <= terrain["heights"][0] < terrain["heights"][1] <= high + 1


def test_height_maps_are_read_in_a_sandboxed_process(program, dem, tmp_path):
    """In the program the sandbox reads EXR headers and PROJ's database, has five drivers and refuses attacks."""
    attack = tmp_path / "attack.vrt"
    attack.write_text(vrt(source("/vsicurl/http://127.0.0.1:9/a.tif", 0)))
    commands = [
        ["info", "--versions"],
        ["info", dem["exr"]],
        ["import", dem["tif"], "--project", "utm", "--store", tmp_path / "utm.store"],
        ["import", dem["tif"], dem["whole"], "--project", "utm", "--store", tmp_path / "two.store"],
        ["import", attack, "--store", tmp_path / "bad.store"],
    ]
    main = "from bl_ext.user_default.adaptive_terrain.operators.cli.command_line import main"
    listed = [[str(word) for word in command] for command in commands]
    report = program.run("-b", "--python-expr", f"{main}; print('CODES', [main(c) for c in {listed}])")
    assert "CODES [0, 0, 0, 0, 1]" in report and "Traceback" not in report
    assert "GDAL drivers: AAIGrid, BT, DTED, EHdr, " in report and ", HFA, " in report and "Blender: " in report
    assert sys.platform != "linux" or "writes: dropped" in report or "kept: this kernel" in report
    assert "format: OpenEXR channel Y" in report
    assert "files: 2" in report and "bounds_against: the mosaic as resampled to EPSG:32616, bilinear" in report
    assert "crs: EPSG:32616" in report and "bounds_against: the raster as reprojected from EPSG:4326" in report
    [line] = [line for line in report.splitlines() if "error: " in line]
    assert "is no regular file here" in line and not (tmp_path / "bad.store").exists()


def test_freed_pages_are_held_and_given_back(program):
    """Freed pages are held and returned with jemalloc (programs before 5.1); later TBB holds them anyway."""
    found = program.script("freed_pages.py")
    if found.pop("version") >= [5, 1]:
        assert max(found.values()) < 1000, (found, "of 30,720 pages")
        return
    assert max(found["held"], found["again"]) < 0.1 * found["before"], found
    assert found["after"] > 0.5 * found["before"] > 10, found


def test_the_benchmark_finds_itself_inside(program):
    """The benchmark's module runs inside the program; other tests check its output with a fake program."""
    call = "bpy = in_program.need_bpy('It'); print('HERE', bpy.app.background, bpy.types.Object.adaptive_terrain)"
    assert "HERE True" in program.run(*in_program.inside(call))


def test_command_line_exports_frames(program, scene, tmp_path):
    export = ["--command", "adaptive_terrain", "export", "--scene", scene[0], "--frames", "1-3", "--format", "npz,ply"]
    program.run(*export, "--out", tmp_path)
    triangles = []
    for frame in (1, 2, 3):
        [path] = tmp_path.glob(f"*_{frame:04d}.npz")
        with np.load(path) as data:
            triangles.append(len(data["triangles"]))
            assert np.isfinite(data["positions"]).all()
            assert data["triangles"].max() == len(data["positions"]) - 1
            info = json.loads(str(data["info"]))
            assert info["limited"] == "" and info["bound_px"] > 0
        assert path.with_suffix(".ply").stat().st_size > 1000
    assert len(set(triangles)) == 3, "the camera moves"


def test_motion_blur_keeps_one_topology_over_the_shutter(program, scene, tmp_path):
    report = program.script("render_motion_blur.py", tmp_path / "frame_", blend=scene[0], timeout=600)
    pictures = sorted(tmp_path.glob("frame_*.png"))
    assert len(pictures) == 3
    assert all(np.asarray(Image.open(path).convert("L")).std() > 5 for path in pictures)
    shown = dict(report["rendered"])
    assert sorted(shown) == [1, 2, 3] and len(set(shown.values())) == 3
    frame = None
    shutter_times = set()
    for number, subframe, mode, triangles, _sum in report["calls"]:
        if mode == "PRE":
            frame = number
        elif mode == "RENDER":
            assert triangles == shown[frame], "a shutter time rebuilt the mesh"
            shutter_times.add((number - frame, subframe))
    assert len(shutter_times) > 1, "motion blur looked at other times than the frame's own"
    assert report["after"] == report["viewport_triangles"] < shown[1], "the viewport gets its own detail back"


def test_clicks_on_the_panel(program, tmp_path):
    kernels = tmp_path / "kernels"
    lend_kernels(kernels, EFFECT, FRAME)  # as in a fresh install, the kernels of every frame are not compiled yet
    moments = ("updated", "sweeping", "reported", "budget", "measured")
    is_first = not list(program.user.rglob("kernels/__pycache__/__init__.*"))
    report = run_in_window(program, "click_panel.py", tmp_path, moments, kernels=kernels)
    assert report["background"] is False
    assert report["preparing_at_start"] == is_first, "after an installation the kernels are compiled at once"
    assert is_first or not report["warp_at_start"], "later starts without a terrain cost little"
    assert is_first or report["preparing_when_added"], "later starts compile them with the first terrain"
    assert not report["preparing_when_visible"]
    houses, modules = zip(*(path.name.split(".kernels.") for path in kernels.glob("*/wp_*")), strict=True)
    assert set(houses) == {f"wp_{EXTENSION}"}, "child processes use the names of the program"
    assert [name for name in modules if name.startswith("mesh.weld_")], "they have compiled the missing kernels"
    assert report["triangles"] > 100
    assert report["last_operation"] == ["MESH_OT_adaptive_terrain_add", True], "its panel outlives the import"
    assert report["live_triangles"] < report["triangles"]
    assert report["not_live_triangles"] == report["live_triangles"]
    assert report["updated_triangles"] > report["live_triangles"]
    assert report["turns_while_measuring"] > 10, "the window lives while errors are measured"
    assert report["could_cancel_measuring"] and report["curve_after_cancel"] == ""
    assert all(len(curve["error"]) > 2 for curve in report["curves"])
    assert not report["report_after_cancel"] and report["meshes_left_by_sweep"] == 0
    assert report["turns_while_sweeping"] > 50, "the window lives while everything is swept"
    assert report["report"][:8] == [".csv", ".html", ".json", ".md", *[".png"] * 4]
    # plots over time, of pixels and of metres, are left out if other programs disturb the runs
    assert report["report"][8:] in [[".svg"] * number for number in (3, 4, 5)]
    budget = report["budget"]
    assert budget["mesh"][0] == pytest.approx(budget["measured"], rel=0.02), "the error of the measured curve"
    assert budget["mesh"][1] == budget["mesh"][0], "with a budget the requested error does not count"
    assert report["interpolations"]["bicubic"] > report["interpolations"]["bilinear"] > report["small_triangles"]
    assert 0 < report["baked"]["True"] < report["baked"]["False"]
    assert 0.0 < report["error_px"] <= 2.0
    assert report["viewport_triangles"] > report["further_triangles"] > 0, "the terrain follows the viewport's own view"
    assert report["cameraless_triangles"] == report["viewport_triangles"], "so does it where the scene has no camera"
    assert report["import_runs_beside"], "an import does not block the window"
    assert report["could_cancel"], report["import_error"]
    assert report["can_import_again"] and report["store_after_cancel"] == report["store"]
    assert min(report["rendered_triangles"]) > report["before_render_triangles"]
    assert len(set(report["drawn_triangles"][:4])) == 4, "a viewport render waits for each frame's mesh"
    picture = Image.open(Path(os.environ.get("ADAPTIVE_TERRAIN_PICTURES", tmp_path)) / "updated.png").convert("L")
    assert np.asarray(picture).std() > 5, "the screen is not blank"


def test_the_view_is_followed_after_any_render(program, tmp_path):
    """A render that begins while a header is drawn leaves Blender's flag against writing set: see bridge/writing.py."""
    report = run_in_window(program, "forbidden_writing.py", tmp_path)
    if report["version"] < "5":  # seen to be mended in 5.2.2
        assert report["writes"][1] is False, "other timers can write no more"
    assert report["writes"][0] and report["writes"][2], "ours can"
    assert report["after"] > report["before"] > 0
    first, second = report["rendered"]
    assert first == second != report["after"], "a later render refines for its camera, too"
