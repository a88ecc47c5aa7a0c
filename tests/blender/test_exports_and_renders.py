# SPDX-License-Identifier: GPL-3.0-or-later
"""Exports of the real program are right in every format, and stale renders are refused."""

import json
import subprocess

import numpy as np
import pytest
import rasterio
from mesh_files import read_mesh
from tilesets import read_tileset

FORMATS = ("glb", "npz", "stl", "obj", "ply", "blend")
# The terrain is rotated and stretched, and the render is much finer than the viewport.
PREPARE = """
import bpy, sys
scene = bpy.context.scene
terrain = scene.objects["Terrain"]
terrain.adaptive_terrain.viewport.error_px, terrain.adaptive_terrain.render.error_px = 40.0, 12.0
terrain.rotation_euler, terrain.scale = (0.1, 0.0, 0.4), (0.8, 1.1, 1.2)
scene.render.resolution_x, scene.render.resolution_y = 480, 270
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
scene.frame_start, scene.frame_end = 1, 4
"""


@pytest.fixture(scope="module")
def prepared(program, scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("prepared") / "shot.blend"
    save = f"bpy.ops.wm.save_as_mainfile(filepath={str(path)!r})"
    program.run("-b", scene[0], "--python-exit-code", "1", "--python-expr", f"{PREPARE}\n{save}")
    return path


def in_world(path, info):
    """Return the triangle corners of a file in the world, float64 [T, 3, 3]; `info` comes from the frame's .npz."""
    points, triangles = read_mesh(path)
    if path.suffix == ".npz":
        place = np.array(info["placement"])
        points = points @ place[:3, :3].T + place[:3, 3]
    return points[triangles]


def test_every_format_holds_the_render_mesh_of_its_frame(program, prepared, tmp_path):
    export = ["--command", "adaptive_terrain", "export", "--scene", prepared, "--frames", "3,2", "--out", tmp_path]
    report = program.run(*export, "--format", ",".join(FORMATS)).splitlines()
    assert [line.split(":")[0] for line in report if "locale" not in line] == ["frame 3", "frame 2"], report
    triangles = []
    for frame in (2, 3):
        with np.load(tmp_path / f"Terrain_{frame:04d}.npz") as data:
            info = json.loads(str(data["info"]))
        assert info["frame"] == frame and info["asked"]["error_px"] == 12.0
        triangles.append(info["triangles"])
        wanted = in_world(tmp_path / f"Terrain_{frame:04d}.npz", info)
        for form in FORMATS[:-1]:
            found = in_world(tmp_path / f"Terrain_{frame:04d}.{form}", info)
            assert found.shape == wanted.shape == (info["triangles"], 3, 3), form
            assert np.allclose(found, wanted, atol=1e-5 * np.ptp(wanted)), form
    count = "--python-expr", "import bpy; print('HOLDS', len(bpy.data.objects['Terrain'].data.polygons))"
    report = program.run("-b", tmp_path / "shot_0002.blend", *count, tmp_path / "shot_0003.blend", *count).splitlines()
    assert [line for line in report if "HOLDS" in line] == [f"HOLDS {number}" for number in triangles]
    assert len(set(triangles)) == 2, "the camera moves"


@pytest.fixture(scope="module")
def written(program, prepared, tmp_path_factory):
    """Return a folder with what operators have written in one program: a mesh of frame 3, tiles and maps."""
    folder = tmp_path_factory.mktemp("written")
    script = f"""
import bpy
out = {str(folder)!r}
ops = bpy.ops.adaptive_terrain
bpy.context.scene.frame_set(3)
for form in ("glb", "npz"):
    assert ops.export(filepath=out + "/shot." + form) == {{"FINISHED"}}
bpy.context.view_layer.objects.active = bpy.data.objects["Terrain"]
bpy.data.objects["Terrain"].rotation_euler = (0.0, 0.0, 0.4)
for form in ("png", "tif"):
    path = out + "/h_" + form + "." + form
    assert ops.export_tiles(filepath=path, size="FREE", free_size=65, fit=True, tiles=(2, 2)) == {{"FINISHED"}}
assert ops.export_tileset(filepath=out + "/land.json", error_m=5.0, triangles=2000) == {{"FINISHED"}}
assert ops.map_camera(use_metres=True, metres=200.0) == {{"FINISHED"}}
assert ops.render_map(filepath=out + "/map.png", tiles=(2, 1)) == {{"FINISHED"}}
"""
    program.run("-b", prepared, "--python-exit-code", "1", "--python-expr", script)
    return folder


def test_the_operator_writes_the_same_glb(written):
    with np.load(written / "shot.npz") as data:
        info = json.loads(str(data["info"]))
    wanted = in_world(written / "shot.npz", info)
    assert np.allclose(in_world(written / "shot.glb", info), wanted, atol=1e-5 * np.ptp(wanted))


def test_tiles_and_maps_are_written_and_read_back(written):
    """Child processes of the program write GeoTIFF files, which clash with Blender's own libraries."""
    coding = json.loads((written / "h_png.json").read_text())["heights"]
    for tile in ("x0_y0", "x1_y1"):
        with rasterio.open(written / f"h_png_{tile}.png") as png, rasterio.open(written / f"h_tif_{tile}.tif") as tif:
            decoded = coding["offset"] + coding["scale"] * png.read(1)
            assert abs(decoded - tif.read(1)).max() <= coding["max_error"] + 1e-4 and np.ptp(decoded) > 10
    _, tiles = read_tileset(written / "land.json")
    assert max(level for level, _, _ in tiles) >= 1
    with rasterio.open(written / "map_x1_y0.tif") as file:
        lines = [float(line) for line in (written / "map_x1_y0.pgw").read_text().split()]
        assert file.xy(0, 0) == pytest.approx(lines[4:], rel=1e-12) and file.read(1).max() > 0


def test_an_export_of_a_store_leaves_the_extension_whole(program, scene, tmp_path):
    """Blender deletes the wheels of an extension that factory settings switch off."""
    [terrain] = scene[1]["terrains"].values()
    bake = ["--command", "adaptive_terrain", "bake", "--store", terrain["store"], "--max-error", "50", "--out"]
    wheels = set((program.user / "extensions").glob(".local/lib/*/site-packages/*"))
    program.run(*bake, tmp_path / "dem.ply")
    assert wheels and set((program.user / "extensions").glob(".local/lib/*/site-packages/*")) == wheels
    assert len(read_mesh(tmp_path / "dem.ply")[1]) > 100


def test_the_extension_offers_no_benchmarks(program):
    report = program.run("--command", "adaptive_terrain", "--help")
    assert "accuracy" in report and "bench" not in report


@pytest.mark.parametrize(
    ("change", "how", "frames", "why"),
    [
        ("terrain.adaptive_terrain.camera_source = 'CHOSEN'", ["-f", "2"], [], "No camera is chosen"),
        ("flatten(); movie()", ["-a"], "1-4", "frame 3 is not rendered"),
        ("flatten(); scene.adaptive_terrain.stop_stale_renders = False", ["-f", "2,3"], [2, 3], ""),
        *(
            pytest.param(*change, marks=pytest.mark.thorough)
            for change in (
                ("terrain.adaptive_terrain.store = '/gone'", ["-a"], [], "There is no terrain store at '/gone'"),
                ("flatten(); scene.view_layers.new('More')", ["-f", "1,2,3,4"], [1, 2], "frame 3 is not rendered"),
            )
        ),
    ],
)
def test_a_render_that_would_be_stale_ends(program, prepared, tmp_path, change, how, frames, why):
    """Hard case 68 in the real program: one line, exit code 1, no stale frame, and a closed movie."""
    script = f"""
import bpy
scene = bpy.context.scene
terrain = scene.objects["Terrain"]
def flatten():
    for frame, scale in ((2, 1.0), (3, 0.0), (4, 1.0)):
        terrain.scale.z = scale
        terrain.keyframe_insert("scale", index=2, frame=frame)
def movie():
    if bpy.app.version >= (5, 0):
        scene.render.image_settings.media_type = "VIDEO"
    scene.render.image_settings.file_format = "FFMPEG"
    scene.render.ffmpeg.format = "MPEG4"
{change}
scene.render.resolution_x, scene.render.resolution_y = 64, 36
scene.render.filepath = {str(tmp_path / "frame_")!r}
"""
    command = program.command("-b", prepared, "--python-exit-code", "2", "--python-expr", script, *how)
    done = subprocess.run(command, env=program.environment(), capture_output=True, text=True, timeout=200)
    report = [line for line in (done.stdout + done.stderr).splitlines() if line.startswith("Adaptive Terrain:")]
    assert done.returncode == (1 if why else 0), done.stdout + done.stderr
    assert len(report) == 1 and (why in report[0] if why else "is rendered with a stale mesh" in report[0])
    if frames == "1-4":
        [movie] = tmp_path.glob("frame_*")
        assert b"moov" in movie.read_bytes(), "a movie that is not closed has no index"
    else:
        assert sorted(int(path.stem[-4:]) for path in tmp_path.glob("frame_*.png")) == frames
