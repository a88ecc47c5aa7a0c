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
from program_window import read_screen, wait_for, window
from real_program import EFFECT, EXTENSION, FRAME, SCRIPTS, lend_kernels


def test_zip_holds_the_package_and_its_wheels_but_no_tests(extension_zip):
    names = zipfile.ZipFile(extension_zip).namelist()
    assert {"__init__.py", "blender_manifest.toml", "operators/registration.py", "LICENSE"} <= set(names)
    assert not [name for name in names if name.startswith(("tests/", "benchmarks/", "tools/"))]
    wheels = {name.split("/")[1].split("-")[0].lower() for name in names if name.startswith("wheels/")}
    assert {"warp_lang", "openexr", "rasterio"} <= wheels
    assert "numpy" not in wheels, "wheels of all extensions share one folder with Blender's own"


def test_a_geotiff_becomes_a_terrain(scene, dem):
    path, said = scene
    [terrain] = said["terrains"].values()
    assert terrain["triangles"] > 1000
    assert terrain["validate"] is False
    low, high = dem["heights"].min(), dem["heights"].max()
    assert low - 1 <= terrain["heights"][0] < terrain["heights"][1] <= high + 1
    assert path.exists()


@pytest.fixture(scope="module")
def others(program, dem, tmp_path_factory):
    """The same DEM of whole metres and as EXR, by one program."""
    path = tmp_path_factory.mktemp("others") / "others.blend"
    return program.script("import_dem.py", path, dem["whole"], dem["exr"])["terrains"]


def test_the_panel_shows_the_rounding_of_whole_metres(others, dem):
    terrain = others[str(dem["whole"])]
    assert "by the source" in [label.strip() for label, _ in terrain["panel"]]


def test_an_exr_becomes_a_terrain(others, dem):
    """The OpenEXR wheel is not safe inside the real program; the import reads it in a child process."""
    terrain = others[str(dem["exr"])]
    assert terrain["triangles"] > 1000
    low, high = dem["heights"].min(), dem["heights"].max()
    assert low - 1 <= terrain["heights"][0] < terrain["heights"][1] <= high + 1


def test_height_maps_are_read_by_a_process_that_has_given_up_the_rest(program, dem, tmp_path):
    """Also in the program's own Python: an EXR's header, PROJ's database, five drivers, and an attack is one line."""
    attack = tmp_path / "attack.vrt"
    attack.write_text(vrt(source("/vsicurl/http://127.0.0.1:9/a.tif", 0)))
    commands = [
        ["info", "--versions"],
        ["info", dem["exr"]],
        ["import", dem["tif"], "--project", "utm", "--store", tmp_path / "utm.store"],
        ["import", attack, "--store", tmp_path / "bad.store"],
    ]
    main = "from bl_ext.user_default.adaptive_terrain.operators.cli.command_line import main"
    listed = [[str(word) for word in command] for command in commands]
    said = program.run("-b", "--python-expr", f"{main}; print('CODES', [main(c) for c in {listed}])")
    assert "CODES [0, 0, 0, 1]" in said and "Traceback" not in said
    assert "GDAL drivers: AAIGrid, GTiff, PNG, SRTMHGT, VRT" in said and "Blender: " in said
    assert sys.platform != "linux" or "writes: dropped" in said or "kept: this kernel" in said
    assert "format: OpenEXR channel Y" in said
    assert "crs: EPSG:32616" in said and "bounds_against: the raster as reprojected from EPSG:4326" in said
    [line] = [line for line in said.splitlines() if "error: " in line]
    assert "is no regular file here" in line and not (tmp_path / "bad.store").exists()


def test_freed_pages_are_held_and_given_back(program):
    """The program's allocator is jemalloc before 5.1, that of the bpy module glibc's. Then it is TBB's, which gives
    nothing back."""
    found = program.script("freed_pages.py")
    if found.pop("version") >= [5, 1]:
        assert max(found.values()) < 1000, (found, "of 30,720 pages")
        return
    assert max(found["held"], found["again"]) < 0.1 * found["before"], found
    assert found["after"] > 0.5 * found["before"] > 10, found


def test_the_benchmark_finds_itself_inside(program):
    """Its rows take more than a minute there; that they are printed and read is tested with a program that is none."""
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
    said = program.script("render_motion_blur.py", tmp_path / "frame_", blend=scene[0], timeout=600)
    pictures = sorted(tmp_path.glob("frame_*.png"))
    assert len(pictures) == 3
    assert all(np.asarray(Image.open(path).convert("L")).std() > 5 for path in pictures)
    shown = dict(said["rendered"])
    assert sorted(shown) == [1, 2, 3] and len(set(shown.values())) == 3
    frame = None
    shutter_times = set()
    for number, subframe, mode, triangles, _sum in said["calls"]:
        if mode == "PRE":
            frame = number
        elif mode == "RENDER":
            assert triangles == shown[frame], "a shutter time rebuilt the mesh"
            shutter_times.add((number - frame, subframe))
    assert len(shutter_times) > 1, "motion blur looked at other times than the frame's own"
    assert said["after"] == said["viewport_triangles"] < shown[1], "the viewport gets its own detail back"


def test_clicks_on_the_panel(program, tmp_path):
    pictures = Path(os.environ.get("ADAPTIVE_TERRAIN_PICTURES", tmp_path))
    pictures.mkdir(parents=True, exist_ok=True)
    arguments = ["--python", str(SCRIPTS / "click_panel.py"), "--", str(tmp_path)]
    # As in a fresh install: what every frame needs is not compiled yet.
    kernels = tmp_path / "kernels"
    lend_kernels(kernels, EFFECT, FRAME)
    with window(program, arguments, tmp_path, kernels) as blender:
        try:
            for moment in ("updated", "sweeping", "reported", "budget", "measured"):
                wait_for(tmp_path / moment, blender, ended=tmp_path / "done.json")
                read_screen(tmp_path).save(pictures / f"{moment}.png")
                (tmp_path / f"{moment}_pictured").touch()
            wait_for(tmp_path / "done.json", blender)
        finally:
            read_screen(tmp_path).save(pictures / "end.png")
    said = json.loads((tmp_path / "done.json").read_text())
    assert "error" not in said, said["error"]
    assert said["background"] is False
    assert said["preparing_at_start"] and not said["preparing_when_visible"]
    houses, modules = zip(*(path.name.split(".kernels.") for path in kernels.glob("*/wp_*")), strict=True)
    assert set(houses) == {f"wp_{EXTENSION}"}, "child processes use the names of the program"
    assert [name for name in modules if name.startswith("mesh.weld_")], "they have compiled what was not lent"
    assert said["triangles"] > 100
    assert said["last_operation"] == ["MESH_OT_adaptive_terrain_add", True], "its panel outlives the import"
    assert said["live_triangles"] < said["triangles"]
    assert said["not_live_triangles"] == said["live_triangles"]
    assert said["updated_triangles"] > said["live_triangles"]
    assert said["turns_while_measuring"] > 10, "the window lives while errors are measured"
    assert said["could_cancel_measuring"] and said["curve_after_cancel"] == ""
    assert all(len(curve["error"]) > 2 for curve in said["curves"])
    assert not said["report_after_cancel"] and said["meshes_left_by_sweep"] == 0
    assert said["turns_while_sweeping"] > 50, "the window lives while everything is swept"
    assert said["report"][:8] == [".csv", ".html", ".json", ".md", *[".png"] * 4]
    # The plots over time, of pixels and of metres, are left out where other programs disturb the runs.
    assert said["report"][8:] in [[".svg"] * number for number in (3, 4, 5)]
    budget = said["budget"]
    assert budget["mesh"][0] == pytest.approx(budget["measured"], rel=0.02), "the error of the measured curve"
    assert budget["mesh"][1] == budget["mesh"][0], "with a budget the error asked for does not count"
    assert said["interpolations"]["bicubic"] > said["interpolations"]["bilinear"] > said["small_triangles"]
    assert 0 < said["baked"]["True"] < said["baked"]["False"]
    assert 0.0 < said["error_px"] <= 2.0
    assert said["viewport_triangles"] > said["further_triangles"] > 0, "the terrain follows the viewport's own view"
    assert said["cameraless_triangles"] == said["viewport_triangles"], "so does it where the scene has no camera"
    assert said["import_started_s"] < 0.5, "an import does not hold the window up"
    assert said["could_cancel"], said["import_error"]
    assert said["can_import_again"] and said["store_after_cancel"] == said["store"]
    assert min(said["rendered_triangles"]) > said["before_render_triangles"]
    assert len(set(said["drawn_triangles"][:4])) == 4, "a viewport render waits for each frame's mesh"
    shown = Image.open(pictures / "updated.png").convert("L")
    assert np.asarray(shown).std() > 5, "the screen is not blank"
