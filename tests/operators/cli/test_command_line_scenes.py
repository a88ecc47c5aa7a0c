# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line over scenes and Blender's formats."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.mesh.archive import read_npz
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.morph import SMOOTH
from adaptive_terrain.operators.cli import command_line
from adaptive_terrain.operators.terrain.overrides import Overrides


@pytest.mark.parametrize("form", ["ply", "obj", "glb", "stl", "blend"])
def test_blenders_formats_hold_the_same_mesh(export, form):
    bpy = pytest.importorskip("bpy")
    code, printed, folder = export("--frames", "2", "--format", f"npz,{form}")
    assert code == 0, printed.err
    mesh = read_npz(folder / "terrain_0002.npz")
    path = str(folder / f"terrain_0002.{form}")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if form == "blend":
        bpy.ops.wm.open_mainfile(filepath=path)
    elif form == "glb":
        bpy.ops.import_scene.gltf(filepath=path)
    else:
        getattr(bpy.ops.wm, f"{form}_import")(filepath=path)
    [obj] = [obj for obj in bpy.data.objects if obj.type == "MESH"]
    corners = np.array([obj.matrix_world @ vertex.co for vertex in obj.data.vertices])
    assert len(obj.data.polygons) == len(mesh["triangles"])
    assert np.allclose(corners.min(0), mesh["positions"].min(0), atol=1e-3)
    assert np.allclose(corners.max(0), mesh["positions"].max(0), atol=1e-3)
    assert {path.suffix for path in folder.iterdir()} == {".json", ".npz", f".{form}"}
    assert len(list(folder.iterdir())) == 3


def test_what_a_command_asks_replaces_animated_settings(scene, add_terrain, tmp_path, capsys):
    import bpy

    settings = add_terrain("Hills").adaptive_terrain
    for frame, (error, interpolation) in ((1, (6.0, "bilinear")), (3, (3.0, "bicubic"))):
        settings.render.error_px, settings.interpolation = error, interpolation
        settings.render.keyframe_insert("error_px", frame=frame)
        settings.keyframe_insert("interpolation", frame=frame)
    blend, out = tmp_path / "scene.blend", tmp_path / "out"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    argv = ["export", "--scene", str(blend), "--frames", "1-3:2", "--format", "npz", "--out", str(out)]
    for more, errors, interpolations in (
        ((), [6.0, 3.0], ["bilinear", "bicubic"]),
        (("--pixel-error", "4"), [4.0, 4.0], ["bilinear", "bicubic"]),
        (("--interpolation", "bicubic", "--meshlet", "1"), [6.0, 3.0], ["bicubic", "bicubic"]),
    ):
        assert command_line.main([*argv, *more]) == 0, capsys.readouterr().err
        infos = [read_npz(out / f"Hills_{frame:04d}.npz")["info"] for frame in (1, 3)]
        assert [info["asked"]["error_px"] for info in infos] == errors
        assert [info["interpolation"] for info in infos] == interpolations


OPTIONS = {
    ("--edge", "30"): {"edge_px": 30.0},
    ("--area", "250"): {"area_px": 250.0},
    ("--metres", "2"): {"error_m": 2.0},
    ("--guard", "30"): {"guard_deg": 30.0},
    ("--off-screen", "2"): {"off_screen_factor": 2.0},
    ("--occlusion", "8"): {"hidden_factor": 8.0},
    ("--shading-floor", "0.875"): {"shading_floor": 0.875},
    ("--pixel-error", "0", "--edge", "30"): {"error_px": 0.0, "edge_px": 30.0},
    ("--pixel-error", "3", "--budget", "900"): {"error_px": 3.0, "limit_triangles": True, "max_triangles": 900},
    ("--meshlet", "1", "--no-morph"): {"meshlet": 1, "smooth_transitions": False},
}


def test_an_option_gives_the_mesh_of_its_setting(scene, add_terrain, tmp_path, capsys):
    import bpy

    detail = add_terrain("Hills").adaptive_terrain.render
    detail.error_px = 6.0  # smooth_transitions is on, as in every new terrain's render
    scene.camera.location.z = 80.0  # from low down, hills hide others
    before = {name: getattr(detail, name) for values in OPTIONS.values() for name in values}

    def exported(name: str, *more) -> dict:
        argv = ["export", "--scene", str(tmp_path / f"{name}.blend"), "--frames", "1", "--format", "npz"]
        assert command_line.main([*argv, "--out", str(tmp_path / "out"), *more]) == 0, capsys.readouterr().err
        return read_npz(tmp_path / "out" / "Hills_0001.npz")

    for number, values in enumerate([{}, *OPTIONS.values()]):
        for name, value in {**before, **values}.items():
            setattr(detail, name, value)
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / f"{number}.blend"), copy=True)
    plain = exported("0")
    for number, options in enumerate(OPTIONS, 1):
        given, wanted = exported("0", *options), exported(str(number))
        assert given["info"] == wanted["info"] and given["info"]["asked"] != plain["info"]["asked"]
        assert given["info"]["asked"]["morph"] == (1.0 if "--no-morph" in options else SMOOTH)
        for array in ("positions", "triangles", "normals"):
            assert given[array].tobytes() == wanted[array].tobytes(), options
        assert given["positions"].tobytes() != plain["positions"].tobytes(), options


def test_options_of_a_store_are_the_criterion(export, store):
    given = "--edge", "40", "--metres", "3", "--guard", "9", "--off-screen", "4", "--occlusion", "2", "--area", "500"
    code, printed, folder = export("--frames", "2", "--format", "npz", "--pixel-error", "0", *given)
    assert code == 0, printed.err
    asked = read_npz(folder / "terrain_0002.npz")["info"]["asked"]
    wanted = Criterion(0.0, 40.0, 500.0, 3.0, guard_deg=9.0, off_screen_factor=4.0, hidden_factor=2.0)
    assert asked == dataclasses.asdict(wanted)
    for more, morph in ((), 1.0), (("--morph",), SMOOTH), (("--no-morph",), 1.0):
        _, _, folder = export("--frames", "2", "--format", "npz", "--pixel-error", "4", *more)
        assert read_npz(folder / "terrain_0002.npz")["info"]["asked"]["morph"] == morph
    code, printed, _ = export("--frames", "2", "--format", "npz", "--pixel-error", "0")
    assert code == 1 and "Every criterion is 0: ask for" in printed.err


def test_an_error_replaces_a_time_budget(scene, add_terrain):
    import bpy
    from adaptive_terrain.operators.terrain.request import RENDER, gather

    terrain = add_terrain("Hills")
    terrain.adaptive_terrain.render.limit_time = True
    for criterion, replaced in (({"error_px": 3.0}, True), ({"error_m": 3.0}, True), ({"edge_px": 9.0}, False)):
        request = gather(terrain, bpy.context.evaluated_depsgraph_get(), RENDER, overrides=Overrides(criterion))
        assert (request.max_ms is None, request.note == "") == (replaced, replaced)


def test_an_exported_scene_finds_its_pictures(scene, add_terrain, tmp_path, capsys):
    """Relative to the folder in which it ends up, whatever the one in which it is written."""
    import bpy

    add_terrain("Hills")
    (tmp_path / "textures").mkdir()
    image = bpy.data.images.new("Rock", 4, 4)
    image.filepath_raw, image.file_format = str(tmp_path / "textures" / "rock.png"), "PNG"
    image.save()
    image.use_fake_user = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.file.make_paths_relative()
    bpy.ops.wm.save_mainfile()
    out = tmp_path / "far" / "out"
    argv = ["export", "--scene", str(tmp_path / "scene.blend"), "--frames", "1", "--format", "blend", "--out", str(out)]
    assert command_line.main(argv) == 0, capsys.readouterr().err
    assert sorted(path.name for path in out.iterdir()) == ["frame_0001.json", "scene_0001.blend"]
    bpy.ops.wm.open_mainfile(filepath=str(out / "scene_0001.blend"))
    assert bpy.data.images["Rock"].filepath == "//../../textures/rock.png"


def test_a_scene_is_exported_as_its_camera_sees_it(scene, add_terrain, tmp_path, capsys):
    import bpy

    terrain = add_terrain("Hills")
    terrain.adaptive_terrain.render.error_px = 3.0
    camera = scene.camera
    for frame, y in ((1, -900.0), (3, -300.0)):
        camera.location.y = y
        camera.keyframe_insert("location", frame=frame)
    other = bpy.data.objects.new("Other", bpy.data.cameras.new("Other"))
    scene.collection.objects.link(other)
    other.location, other.data.clip_end = (0.0, 0.0, 5000.0), 1e5
    blend, out = tmp_path / "scene.blend", tmp_path / "out"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))

    def run(*arguments):
        argv = ["export", "--scene", blend, "--frames", "1-3", "--out", out, *arguments]
        assert command_line.main([str(argument) for argument in argv]) == 0, capsys.readouterr().err
        return [read_npz(out / f"Hills_{frame:04d}.npz") for frame in (1, 2, 3)]

    meshes = run("--format", "npz,ply")
    assert len({mesh["info"]["triangles"] for mesh in meshes}) == 3
    assert all(mesh["info"]["bound_px"] <= 3.0 for mesh in meshes)
    assert meshes[0]["info"]["views"][0]["resolution"] == [640, 360]
    assert {path.suffix for path in out.iterdir()} == {".npz", ".ply", ".json"}
    finer = run("--format", "npz", "--pixel-error", "1", "--resolution", "1280x720")
    assert all(a["info"]["triangles"] > b["info"]["triangles"] for a, b in zip(finer, meshes, strict=True))
    above = run("--format", "npz", "--camera", "Other")
    assert above[0]["info"]["views"] == above[2]["info"]["views"]
    argv = ["export", "--scene", str(blend), "--frames", "1", "--format", "npz", "--out", str(out), "--camera", "None"]
    assert command_line.main(argv) == 1
    assert "has no camera 'None'; it has Camera, Other" in capsys.readouterr().err


def test_the_process_ends_well_after_blender_was_used(store, flight, tmp_path):
    """The bpy module crashes at exit while classes are registered; exit codes must survive that."""
    pytest.importorskip("bpy")
    export = [sys.executable, "-m", "adaptive_terrain.operators.cli.command_line", "export", "--store", store]
    argv = [*export, "--path", flight, "--frames", "1", "--format", "stl", "--out", tmp_path]
    result = subprocess.run(argv, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert len(result.stdout.splitlines()) == 1
