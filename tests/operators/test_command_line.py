# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: what it writes, what it says, and how it fails."""

import json
import subprocess
import sys

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.ask.morph import SMOOTH
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.heightfield import with_detail
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.mesh.archive import read_npz
from adaptive_terrain.operators.cli import command_line
from adaptive_terrain.operators.cli.verbs import print_fields
from adaptive_terrain.operators.output.formats import parse_formats, parse_frames
from adaptive_terrain.operators.text.console import Progress, duration
from fields import reference_heights

FLIGHT = {
    "fov": 50,
    "clip": [1, 50000],
    "keyframes": [
        {"frame": 1, "eye": [0, -900, 300], "target": [0, 0, 0]},
        {"frame": 4, "eye": [300, -300, 120], "target": [0, 200, 0]},
    ],
}


@pytest.fixture
def flight(tmp_path):
    path = tmp_path / "flight.json"
    path.write_text(json.dumps(FLIGHT))
    return path


@pytest.fixture
def export(store, flight, tmp_path, capsys):
    """Run `export` of the small store; returns the exit code, what it printed, and the folder."""

    def run(*arguments, out="out", path=flight):
        folder = tmp_path / out
        argv = ["export", "--store", store, "--path", path, "--resolution", "640x360", "--out", folder, *arguments]
        code = command_line.main([str(argument) for argument in argv])
        return code, capsys.readouterr(), folder

    return run


def bytes_of(folder, pattern="*.npz"):
    return {path.name: path.read_bytes() for path in folder.glob(pattern)}


def test_a_text_from_outside_cannot_command_the_terminal(capsys):
    print_fields({"crs": "\x1b]0;name\x07EPSG:1\n\ud800", "warnings": ["\x9b2J"], "middle": ["\x1b", 2]})
    assert capsys.readouterr().out == "crs: ?]0;name?EPSG:1 ?\nwarning: ?2J\nmiddle: ?, 2\n"


def test_a_frame_is_arrays_with_what_they_mean(export):
    code, said, folder = export("--frames", "2", "--format", "npz", "--pixel-error", "2")
    assert code == 0
    mesh = read_npz(folder / "terrain_0002.npz")
    info = mesh.pop("info")
    shapes = {name: (array.dtype.name, array.shape[1:]) for name, array in mesh.items()}
    assert shapes == {
        "positions": ("float32", (3,)),
        "origin": ("float64", ()),
        "triangles": ("int32", (3,)),
        "edges": ("int32", (2,)),
        "normals": ("float32", (3,)),
        "uv": ("float32", (2,)),
        "terrain_level": ("int32", ()),
        "tree": ("uint8", ()),
    }
    assert info["triangles"] == len(mesh["triangles"]) > 100
    assert len(mesh["positions"]) - len(mesh["edges"]) + len(mesh["triangles"]) == 1
    assert 0 < info["bound_px"] <= 2 == info["asked"]["error_px"]
    assert info["units"]["positions"] == "m"
    assert info["views"][0]["resolution"] == [640, 360]
    assert '"ms"' not in json.dumps(info)


def test_a_summary_line_for_each_frame(export):
    code, said, folder = export("--frames", "1-3:2", "--format", "npz")
    lines = said.out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["frame 1", "frame 3"]
    assert all(" triangles, bound " in line and " px, " in line and line.endswith(" ms in all") for line in lines)
    assert said.err == ""
    summary = json.loads((folder / "frame_0003.json").read_text())
    assert summary["files"] == {"terrain_0003.npz": (folder / "terrain_0003.npz").stat().st_size}
    assert summary["terrains"][0]["ms"]["total"] > 0


def test_a_frame_does_not_depend_on_those_before(export):
    export("--frames", "1-4", "--format", "npz", out="all")
    export("--frames", "3", "--format", "npz", out="one")
    _, _, played = export("--frames", "1-4", "--format", "npz", out="all")
    _, _, alone = export("--frames", "3", "--format", "npz", out="one")
    assert bytes_of(alone)["terrain_0003.npz"] == bytes_of(played)["terrain_0003.npz"]


def test_resume_leaves_complete_frames(export):
    _, _, folder = export("--frames", "1-4", "--format", "npz")
    before = bytes_of(folder)
    (folder / "terrain_0002.npz").write_bytes(b"half")
    (folder / "frame_0003.json").unlink()
    kept = [(folder / f"terrain_000{frame}.npz").stat().st_mtime_ns for frame in (1, 4)]
    code, said, _ = export("--frames", "1-4", "--format", "npz", "--resume")
    assert code == 0
    assert [line.endswith("complete before") for line in said.out.splitlines()] == [True, False, False, True]
    assert bytes_of(folder) == before
    assert [(folder / f"terrain_000{frame}.npz").stat().st_mtime_ns for frame in (1, 4)] == kept


def test_resume_makes_frames_of_other_settings_again(export):
    export("--frames", "1", "--format", "npz", "--pixel-error", "4")
    _, said, folder = export("--frames", "1", "--format", "npz", "--pixel-error", "1", "--resume")
    assert "complete before" not in said.out
    assert read_npz(folder / "terrain_0001.npz")["info"]["asked"]["error_px"] == 1


def test_budget_and_meshlet(export):
    _, said, folder = export("--frames", "4", "--format", "npz", "--budget", "3000", "--meshlet", "1")
    info = read_npz(folder / "terrain_0004.npz")["info"]
    assert info["triangles"] <= 3000 and info["triangles"] == 4 * info["leaves"]
    assert info["limited"] == "max_triangles" and info["relaxed"] > 1 and info["bound_px"] > 1
    assert sum(info["terms_px"].values()) == pytest.approx(info["bound_px"])
    assert info["terms_m"] is info["bound_m"] is info["bound_edge_px"] is info["bound_area_px"] is None
    [figures] = json.loads((folder / "frame_0004.json").read_text())["terrains"]
    assert {name: figures[name] for name in ("terms_px", "terms_m")} == {n: info[n] for n in ("terms_px", "terms_m")}
    assert "held back by the triangle limit" in said.out


def test_a_smooth_surface_may_be_asked_for(export):
    _, _, flat = export("--frames", "2", "--format", "npz", "--pixel-error", "0.5", out="flat")
    code, _, smooth = export("--frames", "2", "--format", "npz", "--pixel-error", "0.5", "--interpolation", "bicubic")
    infos = [read_npz(folder / "terrain_0002.npz")["info"] for folder in (flat, smooth)]
    assert code == 0 and [info["interpolation"] for info in infos] == ["bilinear", "bicubic"]
    assert infos[1]["triangles"] > infos[0]["triangles"] and infos[1]["height_field"] != infos[0]["height_field"]


def test_a_detail_may_be_asked_for(export, store, tmp_path):
    asked = Detail(2.0, 60.0)
    code, _, folder = export("--frames", "2", "--format", "npz", "--pixel-error", "2", "--detail", "2,60")
    baked = tmp_path / "hills.npz"
    argv = ["bake", "--store", store, "--max-error", "1", "--detail", "2,60", "--out", str(baked)]
    assert code == 0 == command_line.main(argv)
    field = with_detail(open_store(store), asked)
    for mesh in map(read_npz, (folder / "terrain_0002.npz", baked)):
        assert mesh["info"]["height_field"].endswith(asked.key)
        points = mesh["positions"].astype(np.float64)
        assert np.abs(points[:, 2] - reference_heights(field, points[:, :2])).max() < 1e-4
    middles = points[mesh["triangles"]].mean(1)
    assert np.abs(middles[:, 2] - reference_heights(field, middles[:, :2])).max() <= mesh["info"]["bound_m"] <= 1.0


@pytest.mark.parametrize("form", ["ply", "obj", "glb", "stl", "blend"])
def test_blenders_formats_hold_the_same_mesh(export, form):
    bpy = pytest.importorskip("bpy")
    code, said, folder = export("--frames", "2", "--format", f"npz,{form}")
    assert code == 0, said.err
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


def test_bake_holds_its_error(store, tmp_path, capsys):
    code = command_line.main(["bake", "--store", store, "--max-error", "0.5", "--out", str(tmp_path / "hills.npz")])
    assert code == 0
    info = read_npz(tmp_path / "hills.npz")["info"]
    assert 0 < info["bound_m"] <= 0.5 and info["bound_px"] is None and info["views"] == []
    assert info["terms_px"] is None and info["terms_m"].keys() == {"geometric", "precision", "source"}
    assert capsys.readouterr().out.startswith(f"hills.npz: {info['triangles']:,} triangles, bound 0.")


def test_a_bake_of_a_smooth_surface_cannot_be_fitted(store, tmp_path, capsys):
    bake = ["bake", "--store", store, "--max-error", "2", "--interpolation", "bicubic", "--out"]
    assert command_line.main([*bake, str(tmp_path / "smooth.npz")]) == 0
    assert read_npz(tmp_path / "smooth.npz")["info"]["interpolation"] == "bicubic"
    assert command_line.main([*bake, str(tmp_path / "fitted.npz"), "--fit"]) == 1
    assert "bilinear" in capsys.readouterr().err and not (tmp_path / "fitted.npz").exists()


def test_a_fitted_bake_holds_its_error_with_fewer_triangles(store, tmp_path, capsys):
    bake = ["bake", "--store", store, "--max-error", "5", "--out"]
    assert command_line.main([*bake, str(tmp_path / "plain.npz")]) == 0
    assert command_line.main([*bake, str(tmp_path / "fitted.npz"), "--fit"]) == 0
    plain, fitted = (read_npz(tmp_path / f"{name}.npz") for name in ("plain", "fitted"))
    info = fitted["info"]
    assert info["fitted"] is True and "fitted" not in plain["info"]
    assert 2.5 < info["measured_max_m"] <= info["bound_m"] <= 5 == info["asked"]["error_m"]
    assert info["triangles"] == len(fitted["triangles"]) <= 0.85 * len(plain["triangles"])
    assert f"fitted.npz: {info['triangles']:,} triangles, bound " in capsys.readouterr().out
    first = (tmp_path / "fitted.npz").read_bytes()
    assert command_line.main([*bake, str(tmp_path / "again.npz"), "--fit"]) == 0
    assert (tmp_path / "again.npz").read_bytes() == first


def test_import_info_and_export_by_words(tmp_path, flight, capsys):
    heights = np.fromfunction(lambda y, x: 30 * np.sin(x / 9) + y, (60, 90), dtype=np.float32)
    np.save(tmp_path / "hills.npy", heights)
    store = tmp_path / "hills.store"
    source = str(tmp_path / "hills.npy")
    assert command_line.main(["import", source, "--store", str(store), "--extent", "900x600"]) == 0
    assert f"{store} is ready" in capsys.readouterr().out
    assert command_line.main(["info", str(store)]) == 0
    assert "raster: 90, 60" in capsys.readouterr().out.splitlines()
    assert command_line.main(["info", source]) == 0
    assert "raster: 90, 60" in capsys.readouterr().out.splitlines()
    heights.astype("<f4").tofile(tmp_path / "hills.raw")
    assert command_line.main(["info", str(tmp_path / "hills.raw")]) == 1
    assert "--raw-size" in capsys.readouterr().err
    raw = ["info", str(tmp_path / "hills.raw"), "--raw-size", "90x60", "--raw-type", "float32"]
    assert command_line.main(raw) == 0
    assert "raster: 90, 60" in capsys.readouterr().out.splitlines()
    bake = ["bake", "--store", str(store), "--max-error", "1", "--out", str(tmp_path / "hills.npz")]
    assert command_line.main(bake) == 0
    capsys.readouterr()
    assert command_line.main(["info", str(tmp_path / "hills.npz")]) == 0
    assert "bound_m: " in capsys.readouterr().out


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


@pytest.mark.parametrize("source", ["scene", "store"])
def test_smooth_transitions_may_be_asked_for_and_refused(source, export, scene, add_terrain, tmp_path, capsys):
    """A scene has them on in its render settings, a store has none."""
    import bpy

    def morph(*more) -> float:
        if source == "store":
            _, _, folder = export("--frames", "2", "--format", "npz", "--pixel-error", "4", *more)
            return read_npz(folder / "terrain_0002.npz")["info"]["asked"]["morph"]
        argv = ["export", "--scene", str(tmp_path / "a.blend"), "--frames", "1", "--format", "npz", *more]
        assert command_line.main([*argv, "--out", str(tmp_path)]) == 0, capsys.readouterr().err
        return read_npz(tmp_path / "Hills_0001.npz")["info"]["asked"]["morph"]

    if source == "scene":
        add_terrain("Hills").adaptive_terrain.render.error_px = 4.0
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    assert [morph(), morph("--morph"), morph("--no-morph")] == [SMOOTH if source == "scene" else 1.0, SMOOTH, 1.0]


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


@pytest.mark.parametrize(
    ("argv", "code", "message"),
    [
        ([], 2, "required: VERB"),
        (["fly"], 2, "invalid choice: 'fly'"),
        (["import"], 2, "required: source, --store"),
        (["import", "no.tif", "--store", "x"], 1, "no.tif does not exist"),
        (["info", "nothing"], 1, "nothing does not exist"),
        (["bake", "--store", "x", "--max-error", "0", "--out", "a.ply"], 2, "0 is not more than 0"),
        (["bake", "--store", "x", "--max-error", "1", "--out", "a.doc"], 2, "no known format"),
        (["bake", "--store", "x", "--max-error", "1", "--detail", "2", "--out", "a.npz"], 2, "argument --detail"),
        (["bake", "--store", "x", "--max-error", "1", "--detail", "0,2", "--out", "a.npz"], 2, "argument --detail"),
        (["bake", "--store", "x", "--max-error", "1", "--out", "a.npz"], 1, "no terrain store at x"),
        (["export", "--frames", "1", "--format", "npz", "--out", "x"], 2, "--scene --store is required"),
        (["export", "--store", "x", "--frames", "1", "--format", "npz", "--out", "x"], 2, "needs --path"),
        (["export", "--store", "x", "--scatter", "--frames", "1", "--format", "npz", "--out", "x"], 2, "to --scene"),
        (["export", "--store", "x", "--frames", "5-1", "--format", "npz", "--out", "x"], 2, "go backwards"),
        (["export", "--store", "x", "--frames", "1", "--format", "doc", "--out", "x"], 2, "'doc' is not one of"),
        (["export", "--scene", "x", "--path", "y", "--frames", "1", "--format", "npz", "--out", "x"], 2, "has cameras"),
        (["export", "--store", "x", "--path", "y", "--frames", "1", "--format", "npz", "--out", "x"], 1, "path y"),
    ],
)
def test_exit_codes(argv, code, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert command_line.main(argv) == code
    said = capsys.readouterr()
    assert message in said.err and said.out == ""
    if code == 1:
        assert len(said.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_npz_needs_no_bpy(store, flight, tmp_path):
    """In a Python where bpy cannot be imported, an export of .npz works and one of .ply says what is missing."""
    out = tmp_path / "out"
    script = f"""
import sys
sys.modules["bpy"] = None
from adaptive_terrain.operators.cli.command_line import main
common = ["export", "--store", {store!r}, "--path", {str(flight)!r}, "--frames", "1", "--out", {str(out)!r}]
assert main([*common, "--format", "npz"]) == 0
sys.exit(main([*common, "--format", "ply"]))
"""
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert result.returncode == 1, result.stderr
    assert "This format needs Blender's Python module" in result.stderr.splitlines()[-1]
    assert (out / "terrain_0001.npz").exists()


def test_the_process_ends_well_after_blender_was_used(store, flight, tmp_path):
    """The bpy module crashes at exit while classes are registered; exit codes must survive that."""
    pytest.importorskip("bpy")
    argv = [
        "export",
        "--store",
        store,
        "--path",
        str(flight),
        "--frames",
        "1",
        "--format",
        "stl",
        "--out",
        str(tmp_path),
    ]
    result = subprocess.run(
        [sys.executable, "-m", "adaptive_terrain.operators.cli.command_line", *argv], capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    assert len(result.stdout.splitlines()) == 1


def test_frames_and_formats():
    assert parse_frames("7") == (7,)
    assert parse_frames("1-9:4") == (1, 5, 9)
    assert parse_frames("-2-1") == (-2, -1, 0, 1)
    assert parse_frames("-5--3") == (-5, -4, -3)
    assert parse_frames("1,3,7-20:2") == (1, 3, 7, 9, 11, 13, 15, 17, 19)
    assert parse_frames("9, 1-9:4,1-3") == (9, 1, 5, 2, 3), "in the order given, each once"
    for text, wrong in (
        ("1,,3", "'' are"),
        ("1,4-2", "'4-2' go"),
        ("1,5;", "'5;' are"),
        ("2,9999999", "'9999999' are not within"),
    ):
        with pytest.raises(ValueError, match=f"frames {wrong}"):
            parse_frames(text)
    with pytest.raises(ValueError, match="more than 1,000,000"):
        parse_frames("0-999998,0-5")
    assert parse_formats("ply, npz,ply") == ("ply", "npz")
    for text in ("", "a", "3-1", "1-5:0", "1:2", "1,", "0-99999999"):
        with pytest.raises(ValueError):
            parse_frames(text)


def test_progress_shows_the_time_left(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    bar = Progress(10, "export", show=True)
    bar.to(4, worked=False)
    assert bar.left_s() is None
    now[0] = 30.0
    bar.to(6)
    assert bar.left_s() == pytest.approx(60.0)
    bar.say("frame 6")
    bar.close()
    said = capsys.readouterr()
    assert said.out == "frame 6\n"
    assert " 60%  1:00 min left" in said.err and said.err.endswith("\r\x1b[K")


def test_a_farm_is_told_in_lines(capsys):
    bar = Progress(3, "export", show="openjd")
    bar.to(1)
    bar.to(1.001)
    bar.say("frame 6")
    bar.to(3)
    bar.close()
    said = capsys.readouterr()
    told = ["openjd_progress: 0", "openjd_progress: 33", "openjd_status: frame 6", "openjd_progress: 100"]
    assert said.out.splitlines() == told and said.err == ""


def test_no_bar_where_no_terminal_is(capsys):
    bar = Progress(2, "export")
    bar.to(1)
    bar.close()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("seconds", "text"), [(0.2, "0 s"), (59, "59 s"), (125, "2:05 min"), (3725, "1:02 h")])
def test_durations(seconds, text):
    assert duration(seconds) == text


def test_a_file_where_a_folder_is_expected(export, tmp_path, capsys):
    (tmp_path / "out").write_text("something")
    code, said, _ = export("--frames", "1", "--format", "npz")
    assert code == 1 and "expected a folder" in said.err and len(said.err.splitlines()) == 1
    code, said, _ = export("--frames", "1", "--format", "npz", out="out/below")
    assert code == 1 and "expected a folder" in said.err
    pytest.importorskip("bpy")
    assert command_line.main(["demo", "--out", str(tmp_path / "out")]) == 1
    assert "expected a folder" in capsys.readouterr().err


def test_a_fit_that_saves_nothing_says_so(tmp_path, capsys):
    heights = np.random.default_rng(0).uniform(0.0, 100.0, (20, 31)).astype(np.float32)
    np.save(tmp_path / "noise.npy", heights)
    store = str(tmp_path / "noise.store")
    assert command_line.main(["import", str(tmp_path / "noise.npy"), "--store", store]) == 0
    bake = ["bake", "--store", store, "--max-error", "0.5", "--budget", "2", "--fit"]
    assert command_line.main([*bake, "--out", str(tmp_path / "noise.npz")]) == 0
    assert "the fit saved no triangles" in capsys.readouterr().out
