# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs for render farms, read by the library of Open Job Description, and the commands that such a job calls.

tests/blender/test_farm.py runs one.
"""

import json
import os
import re
import runpy
import shlex
import shutil
import subprocess
import zipfile
from pathlib import Path

import bpy
import numpy as np
import pytest
import yaml
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.height_operators import derived_store
from adaptive_terrain.operators.cli import parser
from adaptive_terrain.operators.export import preparing
from adaptive_terrain.operators.export.formats import range_text
from adaptive_terrain.operators.farm import bundle
from openjd.cli._common import get_job_params, read_job_template
from openjd.model import IntRangeExpr, create_job, decode_job_template, preprocess_job_parameters
from store_exports import run

MANAGER = Path(__file__).resolve().parents[2] / "support" / "flamenco_manager.js"


@pytest.fixture
def shot(scene, add_terrain, store, tmp_path):
    """Save a scene with two rotated terrains: Hills has a store, Dunes a height map and no store."""
    shutil.copytree(store, tmp_path / "shot" / "hills")
    heights = np.random.default_rng(2).normal(0.0, 3.0, (70, 93)).cumsum(0).astype(np.float32)
    np.save(tmp_path / "shot" / "dunes.npy", heights)
    path = tmp_path / "shot" / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    hills, dunes = add_terrain("Hills"), add_terrain("Dunes")
    hills.adaptive_terrain.store = "//hills"
    settings = dunes.adaptive_terrain
    settings.store, settings.source, settings.source_path = "//made/dunes", "FILE", "//dunes.npy"
    settings.use_extent, settings.extent, settings.height_scale = True, (900.0, 700.0), 2.0
    dunes.location = (0.0, 800.0, 0.0)
    for obj in (hills, dunes):
        obj.adaptive_terrain.viewport.error_px, obj.adaptive_terrain.render.error_px = 24.0, 8.0
        obj.rotation_euler, obj.scale = (0.1, 0.0, 0.4), (0.8, 1.1, 1.2)
    scene.frame_start, scene.frame_end = 5, 8
    scene.render.engine, scene.render.resolution_x, scene.render.resolution_y = "BLENDER_WORKBENCH", 96, 54
    bpy.ops.wm.save_mainfile()
    return path


def read(job: Path) -> tuple[dict, dict, dict]:
    """Read the template, the values and the assets of a bundle as YAML."""
    names = bundle.TEMPLATE, bundle.VALUES, bundle.ASSETS
    template, values, assets = (yaml.safe_load((job / name).read_text(encoding="utf-8")) for name in names)
    values = {item["name"]: str(item["value"]) for item in values["parameterValues"]}
    return template, values, assets["assetReferences"]


def job_of(path: Path, values: dict, template=None):
    """Create the job of a bundle, or of a template that was read from it, with Open Job Description."""
    template = template or decode_job_template(template=read(path)[0], supported_extensions=["TASK_CHUNKING"])
    folders = {"job_template_dir": path, "current_working_dir": path}
    checked = preprocess_job_parameters(job_template=template, job_parameter_values=values, **folders)
    return create_job(job_template=template, job_parameter_values=checked)


@pytest.mark.parametrize(
    ("frames", "text"),
    [
        ([7], "7"),
        ([4, 1, 2, 3, 2], "1-4"),
        (range(1, 25, 2), "1-23:2"),
        ([1, 5], "1,5"),
        ([-3, -2, -1, 4, 8, 9, 12, 16, 20], "-3--1,4,8-9,12-20:4"),
    ],
)
def test_frames_are_written_as_the_standard_reads_them(frames, text):
    assert range_text(frames) == text
    assert list(IntRangeExpr.from_str(text)) == sorted(set(frames))


def test_any_frames_come_back():
    rng = np.random.default_rng(5)
    for _ in range(200):
        frames = rng.integers(-40, 40, rng.integers(1, 30)).tolist()
        assert list(IntRangeExpr.from_str(range_text(frames))) == sorted(set(frames))


@pytest.mark.parametrize("frames", ["-5--1", "-10--1:3,0", "-5,3"])
def test_frames_below_0_are_no_options(tmp_path, capsys, frames):
    """A job's steps pass negative frames as separate words."""
    assert run("verify", tmp_path, "--frames", frames) == 1
    assert f"frames {frames} are missing" in capsys.readouterr().err


def made(folder: Path, stem: str):
    """Write a job of pictures of a file with this name, and read it with Open Job Description."""
    blend = folder / f"{stem}.blend"
    job = bundle.FarmJob(f"{stem} pictures", blend, [-3, -2, -1, 7], 2, (), folder / "out", "1", None, [], [], [])
    bundle.write_bundle(job, folder)
    return job_of(folder, read(folder)[1])


def test_invalid_names_of_jobs_are_cleaned(tmp_path):
    job = made(tmp_path, 'two\nlines\t\x85 {{Param.X}} %d "山"')
    assert job.name == 'two lines {{Param.X}} %d "山" pictures'
    assert job.parameters["BlenderFile"].value.endswith('two\nlines\t\x85 {{Param.X}} %d "山".blend')
    with pytest.raises(TerrainError, match="A path of the job is not UTF-8 .*rename"):
        made(tmp_path, "latin\udce9")


def test_a_job_brings_the_stores_and_all_that_blender_lists(shot, tmp_path, capsys):
    texture = tmp_path / "rock.1001.png"
    for tile in (texture, tmp_path / "rock.1002.png"):
        image = bpy.data.images.new("rock", 2, 2)
        image.filepath_raw, image.file_format = str(tile), "PNG"
        image.save()
    image.source, image.filepath, image.use_fake_user = "TILED", str(tmp_path / "rock.<UDIM>.png"), True
    bpy.data.objects["Hills"].adaptive_terrain.land.entries.add()
    (shot.parent / "dunes.prj").write_text("")
    bpy.ops.wm.save_mainfile()
    out = tmp_path / "out"
    frames = "--frames", "3,9,1-2", "--chunk", "3", "--format", "npz,glb"
    assert run("submit", "--scene", shot, "--out", out, *frames) == 0
    message = capsys.readouterr().out
    assert "4 frames" in message and "workers need the extension of this version" in message
    template, values, assets = read(out)
    folder = shot.parent
    assert set(assets["inputs"]["filenames"]) >= {
        *(str(folder / name) for name in ("shot.blend", "dunes.npy", "dunes.prj")),
        *(str(tmp_path / f"rock.{number}.png") for number in (1001, 1002)),
    }
    assert assets["inputs"]["directories"] == [str(folder / "hills")]
    made = {folder / "hills_land", folder / "made" / "dunes", out / "frames"}
    assert set(assets["outputs"]["directories"]) == set(map(str, made))
    assert values["Frames"] == "1-3,9" and values["Format"] == "npz,glb" and values["ExtensionZip"] == ""
    job = job_of(out, values)
    assert [step.name for step in job.steps] == ["Import", "MapsAndLand", "Meshes", "Verify"]
    assert job.parameters["OutputDir"].value == str(out / "frames")
    [guard] = job.jobEnvironments[0].script.embeddedFiles
    assert guard.data == (out / "guard.py").read_text() and 'VERSION = "0' in guard.data
    compile(guard.data, "guard.py", "exec")


def write_zip(path: Path, content: str | bytes, name: str = "blender_manifest.toml") -> None:
    """Write a zip of one file."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(name, content)


def test_a_job_of_pictures_with_its_zip(shot, tmp_path, capsys):
    shot.parent.joinpath("ext.zip").write_text("no zip")
    where = "--scene", shot, "--out", tmp_path / "out", "--render", "--extension"
    assert run("submit", *where, shot.parent / "ext.zip") == 1
    assert run("submit", *where, "installed") == 1
    if hasattr(os, "mkfifo"):
        os.mkfifo(shot.parent / "pipe.zip")
        assert run("submit", *where, shot.parent / "pipe.zip") == 1, "it is not waited for"
    message = capsys.readouterr().err.splitlines()
    assert "is no zip" in message[0] and "not installed from a zip" in message[1]
    assert all("is no zip" in line for line in message[2:])
    for name, content in ("other", ""), ("blender_manifest.toml", "platforms = ["), ("blender_manifest.toml", b"\xff"):
        write_zip(shot.parent / "ext.zip", content, name)
        assert run("submit", *where, shot.parent / "ext.zip") == 1
        assert "is not the extension's zip" in capsys.readouterr().err
    write_zip(shot.parent / "ext.zip", "")
    assert run("submit", *where, shot.parent / "ext.zip") == 0
    _, values, assets = read(tmp_path / "out")
    assert all(step.hostRequirements is None for step in job_of(tmp_path / "out", values).steps)
    assert values["Frames"] == "5-8" and values["ExtensionZip"] in assets["inputs"]["filenames"]
    assert [step.name for step in job_of(tmp_path / "out", values).steps][2:] == ["Render", "Verify"]


def test_a_zip_goes_to_workers_of_its_platform(shot, tmp_path):
    write_zip(shot.parent / "ext.zip", 'platforms = ["macos-arm64"]')
    where = "--scene", shot, "--out", tmp_path / "out", "--extension", shot.parent / "ext.zip"
    assert run("submit", *where, "--min-memory", "12.5") == 0
    for step in job_of(tmp_path / "out", read(tmp_path / "out")[1]).steps:
        attributes = {item.name: item.anyOf for item in step.hostRequirements.attributes}
        assert attributes == {"attr.worker.os.family": ["macos"], "attr.worker.cpu.arch": ["arm64"]}
        [memory] = step.hostRequirements.amounts
        assert (memory.name, memory.min) == ("amount.worker.memory", 12_800)


def test_the_printed_command_is_one_that_openjd_takes(shot, tmp_path, capsys):
    """The worker's parser reads the template and the values from the shell's words."""
    assert run("submit", "--scene", shot, "--out", tmp_path / "out dir's", "--frames", "6,5") == 0
    [line] = [line for line in capsys.readouterr().out.splitlines() if line.startswith("to run it on this machine: ")]
    words = shlex.split(line.split(": ", 1)[1])
    assert words[:2] == ["openjd", "run"] and words[3:6] == ["--step", "Verify", "--run-dependencies"]
    template = read_job_template(Path(words[2]), supported_extensions=["TASK_CHUNKING"])
    values = get_job_params([words[words.index("--job-param") + 1]])
    job = job_of(Path(words[2]).parent, values, template)
    assert job.parameters["Frames"].value == "5-6" and job.parameters["BlenderFile"].value == str(shot)


def test_frames_in_too_many_pieces_are_refused(shot, tmp_path, capsys):
    frames = ",".join(str(n * n) for n in range(1, 400))
    assert run("submit", "--scene", shot, "--out", tmp_path / "out", "--frames", frames) == 1
    assert "too many gaps" in capsys.readouterr().err


def test_a_terrain_without_store_and_height_map_has_no_job(shot, tmp_path, capsys):
    (shot.parent / "dunes.npy").unlink()
    assert run("submit", "--scene", shot, "--out", tmp_path / "out") == 1
    assert "'Dunes' has neither its store" in capsys.readouterr().err and not (tmp_path / "out").exists()
    bpy.data.objects["Dunes"].adaptive_terrain.source_path = f"//{'n' * 300}.npy"  # no file can have this name
    bpy.ops.wm.save_mainfile()
    assert run("submit", "--scene", shot, "--out", tmp_path / "out") == 1
    assert "'Dunes' has neither its store" in capsys.readouterr().err


def test_the_operator_writes_a_job(shot, tmp_path):
    submit = bpy.ops.adaptive_terrain.submit
    asked = {"folder": str(tmp_path / "out"), "bring": False, "frames": "6,5", "chunk": 1}
    with pytest.raises(RuntimeError, match="frames '6-5'"):
        submit(**asked | {"frames": "6-5"})
    with pytest.raises(RuntimeError, match="no folder"):
        submit(**asked | {"folder": ""})
    assert submit(**asked) == {"FINISHED"}
    assert read(tmp_path / "out")[1]["Frames"] == "5-6"


def test_the_guard_looks_at_the_scene_that_is_rendered(shot, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["blender"])
    with pytest.raises(SystemExit):
        runpy.run_path(bundle.HERE / bundle.GUARD)
    assert "openjd_fail: the store of Dunes is missing" in capsys.readouterr().out
    dunes = bpy.data.objects["Dunes"]
    bpy.context.scene.collection.objects.unlink(dunes)
    bpy.data.scenes.new("Another").collection.objects.link(dunes)
    runpy.run_path(bundle.HERE / bundle.GUARD)


def test_prepare_makes_each_thing_once(shot, capsys):
    entry = bpy.data.objects["Dunes"].adaptive_terrain.land.entries.add()
    entry.effect = "scree" if "scree" in entry.bl_rna.properties else entry.effect
    bpy.ops.wm.save_mainfile()
    made = dict(derived_store.counts)
    assert run("prepare", "--scene", shot, "--progress", "openjd") == 0
    message = capsys.readouterr().out.splitlines()
    assert "openjd_status: Dunes: imported, 93 x 70 samples, " in "".join(message)[:4000]
    assert {"openjd_status: Hills: its store is there", "openjd_status: Dunes: its land is shaped"} <= set(message)
    assert message[-1] == "openjd_progress: 100"
    assert derived_store.counts["stores"] == made["stores"] + 1
    assert len(list((shot.parent / "made" / "dunes_land").glob("*/store.json"))) == 1
    before = (shot.parent / "made" / "dunes" / "store.json").read_bytes()
    assert run("prepare", "--scene", shot) == 0
    assert "Dunes: its store is there" in capsys.readouterr().out
    assert derived_store.counts["stores"] == made["stores"] + 1
    assert (shot.parent / "made" / "dunes" / "store.json").read_bytes() == before


def test_pictures_are_made_resumed_and_verified(shot, tmp_path, capsys):
    assert run("prepare", "--scene", shot, "--only", "stores") == 0
    out = tmp_path / "{blend_name} %d # {x}"  # which newer Blenders would fill in
    frames = "--scene", shot, "--out", out, "--frames"
    assert run("render", *frames, "7") == 0
    first = (out / "frame_0007.png").read_bytes()
    assert first.startswith(b"\x89PNG") and {p.name for p in out.iterdir()} == {"frame_0007.png", "frame_0007.json"}
    assert run("render", *frames, "6,7", "--resume") == 0
    message = capsys.readouterr().out
    assert "frame 7: " in message and message.count("complete before") == 1
    summary = json.loads((out / "frame_0006.json").read_text())
    assert {terrain["name"] for terrain in summary["terrains"]} == {"Hills", "Dunes"}
    assert all(terrain["bound_px"] <= 8.0 and terrain["triangles"] > 10 for terrain in summary["terrains"])
    assert run("verify", out, "--frames", "6,7") == 0
    assert "2 frames are whole" in capsys.readouterr().out
    if hasattr(os, "mkfifo"):
        os.mkfifo(out / "frame_0005.png")
        assert run("render", *frames, "5") == 1
        assert "frame_0005.png is a device or a pipe" in capsys.readouterr().err
        assert (out / "frame_0005.png").is_fifo() and not (out / "frame_0005.json").exists()


def test_a_frame_that_would_be_stale_is_no_picture(shot, tmp_path, capsys):
    """It is refused even if the file allows stale renders."""
    assert run("prepare", "--scene", shot, "--only", "stores") == 0
    hills = bpy.data.objects["Hills"]
    for frame, scale in ((6, 1.0), (7, 0.0)):
        hills.scale.z = scale
        hills.keyframe_insert("scale", index=2, frame=frame)
    bpy.context.scene.adaptive_terrain.stop_stale_renders = False
    bpy.ops.wm.save_mainfile()
    out = tmp_path / "pictures"
    where = "--scene", shot, "--out", out, "--frames", "6-7"
    assert run("render", *where, "--progress", "openjd") == 1
    captured = capsys.readouterr()
    assert "openjd_fail: Frame 7 is not rendered" in captured.out and "'Hills' has a scale of 0" in captured.err
    assert {path.name for path in out.iterdir()} == {"frame_0006.png", "frame_0006.json"}


def offer_movies(image_settings) -> None:
    """Select the medium of movies, which Blender has since 5.0."""
    if bpy.app.version >= (5, 0):
        image_settings.media_type = "VIDEO"


def test_a_movie_is_refused(shot, tmp_path, capsys):
    assert run("prepare", "--scene", shot, "--only", "stores") == 0
    offer_movies(bpy.context.scene.render.image_settings)
    bpy.context.scene.render.image_settings.file_format = "FFMPEG"
    bpy.ops.wm.save_mainfile()
    assert run("render", "--scene", shot, "--out", tmp_path / "out", "--frames", "6") == 1
    assert "expected a picture a frame" in capsys.readouterr().err


def test_parts_of_preparing_are_those_of_the_command():
    with pytest.raises(SystemExit):
        parser.build_parser().parse_args(["prepare", "--scene", "a.blend", "--only", "nothing"])
    for part in preparing.PARTS:
        parser.build_parser().parse_args(["prepare", "--scene", "a.blend", "--only", part])


def movie_formats(image_settings) -> set[str]:
    """Return the movie formats of this Blender."""
    render, found = image_settings.id_data.render, set()
    offer_movies(image_settings)
    for name in [item.identifier for item in image_settings.bl_rna.properties["file_format"].enum_items_static]:
        try:
            image_settings.file_format = name
        except TypeError:
            continue  # not in this build
        found |= {name} if render.is_movie_format else set()
    return found


@pytest.fixture
def compiled(shot, tmp_path):
    """Submit the scene; return a function that runs its job type for these frames, this format and number of tasks."""
    if shutil.which("node") is None:
        pytest.skip("there is no node, which runs the job type of Flamenco")
    assert run("submit", "--scene", shot, "--out", tmp_path / "out") == 0
    command = ["node", MANAGER, tmp_path / "out" / bundle.FLAMENCO]
    return lambda *arguments: subprocess.run([*command, *arguments], capture_output=True, text=True)


def test_flamenco_prepares_and_then_renders_guarded_chunks(compiled, tmp_path):
    for frames in ("-5", "1-4, -2", "-3-8", "-4..-1"):
        refused = compiled(frames, "PNG")
        assert refused.returncode == 1 and f'The frames "{frames}" go below 0' in refused.stderr
    message = json.loads(compiled("1-10,20", "PNG").stdout)
    assert {"frames", "chunk_size", "render_output_path", "blendfile", "format"} <= set(message["defaults"])
    assert message["defaults"]["import_tasks"] == 0, "all stores are complete"
    prepare, *chunks = message["tasks"]
    assert prepare["commands"][0]["parameters"]["args"][:3] == ["--command", "adaptive_terrain", "prepare"]
    assert [(task["name"], *task["after"]) for task in chunks] == [("render-1-10", "prepare"), ("render-20", "prepare")]
    arguments = chunks[0]["commands"][0]["parameters"]["args"]
    assert arguments[-2:] == ["--render-frame", "1..10"]
    assert arguments[arguments.index("--render-output") + 1] == "/o local 1970-01-01T00:00:00.000Z/{x}/#"
    assert arguments[arguments.index("--python-expr") + 1] == (tmp_path / "out" / "guard.py").read_text()


def test_flamenco_shares_the_import_of_incomplete_stores(compiled):
    """Each step waits for all tasks of the step before, and frames are made from the stores of the job."""
    tasks = json.loads(compiled("3-8", "PNG", "2").stdout)["tasks"]
    steps = [["view"], ["tiles-1", "tiles-2"], ["load"], ["read-1", "read-2"], ["fill"], ["measure-1", "measure-2"]]
    steps += [["prepare"], ["render-3-8"]]
    after = {task["name"]: task["after"] for task in tasks}
    assert after == {name: before for before, step in zip([[], *steps], steps, strict=False) for name in step}
    stores = "/o local 1970-01-01T00:00:00.000Z/{x}/stores"
    for task in tasks[:-1]:
        parts = task["commands"][0]["parameters"]["args"]
        parsed = parser.build_parser().parse_args(parts[2:])
        step, _, share = task["name"].partition("-")
        assert (parsed.verb, parsed.only) == ("prepare", None if step == "prepare" else step)
        assert parsed.share == ((int(share), 2) if share else None) and str(parsed.job_stores) == stores
        assert list(parsed.frames) == list(range(3, 9)) and str(parsed.scene) == "/x/a.blend"
    assert tasks[-1]["commands"][0]["parameters"]["args"][-3:] == ["--", "--job-stores", stores]


def test_flamenco_refuses_a_movie(compiled):
    movies = movie_formats(bpy.context.scene.render.image_settings)
    assert "FFMPEG" in movies
    for movie in movies:
        refused = compiled("1-4", movie)
        assert refused.returncode == 1 and f"a movie ({movie}); expected a picture a frame" in refused.stderr


def test_flamenco_renders_the_frames_of_the_scene(scene):
    template = (Path(bundle.__file__).parent / "flamenco.js").read_text()
    [rule] = re.findall(r'key: "frames".*?eval: "([^"]*)"', template, re.DOTALL)
    scene.frame_start, scene.frame_end = 2, 9
    assert eval(rule, {"C": bpy.context}) == "2-9"
    scene.frame_step = 3
    assert eval(rule, {"C": bpy.context}) == "2, 5, 8"
