# SPDX-License-Identifier: GPL-3.0-or-later
"""A worker of Open Job Description runs a job of `submit` in the real program.

Tested are import, chunks, cancelling, resuming, single frames, pictures and guards.
"""

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytestmark = pytest.mark.thorough

FRAMES = "1-4,15-19:2,30"
NUMBERS = [1, 2, 3, 4, 15, 17, 19, 30]
# Lines that a strict check of Deadline's Blender adaptor (`strict_error_checking`) takes for a failure.
STRICT = re.compile(r".*Exception:.*|.*Error:.*|.*Warning.*")
BLENDERS_OWN = "Falling back to the standard locale"
# The terrain is rotated and stretched, and has a stack and a material that reads a layer of it and a map. Store and map
# are missing, and the file allows stale frames.
PREPARE = """
import bpy
scene = bpy.context.scene
terrain = scene.objects["Terrain"]
settings = terrain.adaptive_terrain
settings.viewport.error_px, settings.render.error_px = 40.0, 12.0
terrain.rotation_euler, terrain.scale = (0.1, 0.0, 0.4), (0.8, 1.1, 1.2)
scene.adaptive_terrain.stop_stale_renders = False
scene.camera.animation_data_clear()
for frame, y in ((1, -9000.0), (30, -7000.0)):
    scene.camera.location = (0, y, 3000)
    scene.camera.keyframe_insert("location", frame=frame)
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 320, 180, 50
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
bpy.context.view_layer.objects.active = terrain
bpy.ops.adaptive_terrain.land_add(effect="snow")
settings.land.entries[0].snow.line = 0.0
material = bpy.data.materials.new("Ground")
material.use_nodes = True
nodes, link = material.node_tree.nodes, material.node_tree.links.new
snow, normal = nodes.new("ShaderNodeAttribute"), nodes.new("ShaderNodeTexImage")
snow.attribute_name, normal.image = "snow", bpy.data.images.new("normal", 1, 1)
link(snow.outputs["Fac"], nodes["Principled BSDF"].inputs["Roughness"])
link(normal.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
terrain.data.materials.append(material)
bpy.ops.wm.save_as_mainfile(filepath=PATH)
settings.store = "//dem.store"
settings.maps.folder, settings.maps.mark = "//maps/", "Terrain_shot"
normal.image.source, normal.image.filepath = "FILE", "//maps/Terrain_shot/detail_normal.png"
bpy.ops.wm.save_mainfile()
"""


class Farm:
    """One folder with a scene and its job of meshes. `run` is a worker with the user folder `user`."""

    def __init__(self, program, folder: Path):
        self.program, self.folder = program, folder
        self.blend, self.store = folder / "shot.blend", folder / "dem.store"
        self.blender = folder / "blender"
        self.blender.write_text(f'#!/bin/sh\nexec {program.wrapper} blender "$@"\n')
        self.blender.chmod(0o755)

    def submit(self, name: str, *arguments) -> Path:
        """Submit a new job and return its folder."""
        where = "--scene", self.blend, "--out", self.folder / name
        self.program.run("--command", "adaptive_terrain", "submit", *where, *arguments)
        return self.folder / name

    def environment(self, user: Path) -> dict[str, str]:
        user.mkdir(exist_ok=True)
        return self.program.environment() | {"BLENDER_USER_RESOURCES": str(user), "BIND": str(self.program.user)}

    def start(self, job: Path, step: str, *arguments: str, user: Path, **changed) -> subprocess.Popen:
        report = json.loads((job / "parameter_values.yaml").read_text())["parameterValues"]
        values = {item["name"]: str(item["value"]) for item in report} | {"Blender": str(self.blender)} | changed
        command = [sys.executable, "-c", "from openjd.cli import main; main()", "run", job / "template.yaml"]
        command += ["--step", step, *arguments, "--job-param", json.dumps(values)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        return subprocess.Popen(command, env=self.environment(user), **pipes)

    def run(self, *arguments: str, **options) -> tuple[int, str]:
        process = self.start(*arguments, **options)
        report = process.communicate(timeout=900)[0]
        return process.returncode, report


@pytest.fixture(scope="module")
def farm(program, scene, dem, tmp_path_factory):
    folder = tmp_path_factory.mktemp("farm")
    new_farm = Farm(program, folder)
    script = PREPARE.replace("PATH", repr(str(new_farm.blend)))
    program.run("-b", scene[0], "--python-exit-code", "1", "--python-expr", script)
    return new_farm


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("*.npz")}


def test_meshes_cancelled_resumed_and_made_again(farm):
    """A worker without the extension gets it for this job, and imports the missing store."""
    job = farm.submit("meshes", "--frames", FRAMES, "--chunk", "4", "--extension", "installed")
    out, bare = job / "frames", farm.folder / "bare"
    process = farm.start(job, "Verify", "--run-dependencies", user=bare)
    deadline = time.monotonic() + 600
    while not (out / "frame_0002.json").exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    report = process.communicate(timeout=300)[0]
    assert process.returncode != 0 and "imported, 403 x 344 samples" in report, report
    assert "Terrain: its land is shaped" in report and "Terrain: 1 image baked, 0 kept" in report, report
    assert "openjd_env: BLENDER_USER_RESOURCES=" in report and not (bare / "extensions").exists()
    before = contents(out)
    assert 2 <= len(list(out.glob("frame_*.json"))) < len(NUMBERS)

    code, report = farm.run(job, "Verify", "--run-dependencies", user=farm.program.user, ExtensionZip="")
    assert code == 0, report
    assert report.count("complete before") >= 2 and "its store is there" in report
    assert (
        "Terrain: 0 images baked, 1 kept" in report and len(list(farm.folder.glob("dem.store_land/*/store.json"))) == 1
    )
    with np.load(out / "Terrain_0001.npz") as mesh:
        assert mesh["snow"].max() > 0.1, "what the stack leaves is in the frames"
    assert f"openjd_status: {len(NUMBERS)} frames are whole" in report
    assert {int(path.stem[-4:]) for path in out.iterdir()} == set(NUMBERS), "nothing is left of what was cancelled"
    strict = [line for line in report.splitlines() if STRICT.match(line) and BLENDERS_OWN not in line]
    assert strict == []
    whole = contents(out)
    assert len(set(whole.values())) == len(NUMBERS) and whole.items() >= before.items()

    for path in out.glob("*_0015.*"):
        path.unlink()
    task = json.dumps([{"Frame": "15"}])
    assert farm.run(job, "Meshes", "--tasks", task, user=farm.program.user, ExtensionZip="")[0] == 0
    assert contents(out) == whole, "a frame alone, in another process, is the same bytes"


@pytest.fixture(scope="module")
def pictures(farm):
    """Submit a job of two pictures, whose store the job of meshes makes."""
    return farm.submit("pictures", "--frames", "4,22", "--render")


def test_pictures_are_those_of_a_plain_render(farm, pictures, tmp_path):
    code, report = farm.run(pictures, "Render", user=farm.program.user)
    assert code == 0 and "openjd_status: frame 22: " in report, report
    guarded = "--python-exit-code", "1", "--python", pictures / "guard.py"
    farm.program.run("-b", farm.blend, *guarded, "--render-output", tmp_path / "frame_####", "-f", "4,22")
    for frame in (4, 22):
        made, plain = (
            np.asarray(Image.open(folder / f"frame_{frame:04d}.png")) for folder in (pictures / "frames", tmp_path)
        )
        assert made.shape == (90, 160, 4) and np.array_equal(made, plain)
        summary = json.loads((pictures / "frames" / f"frame_{frame:04d}.json").read_text())
        [terrain] = summary["terrains"]
        assert terrain["bound_px"] <= 12.0 and terrain["triangles"] > 100


def test_a_worker_that_would_render_stale_terrains_fails(farm, pictures, tmp_path):
    """A missing extension, another version or a missing store gives exit code 1 and one line, and no frame."""
    code, report = farm.run(pictures, "Import", user=farm.folder / "without")
    assert code != 0 and "openjd_fail: the extension Adaptive Terrain is not enabled" in report
    guard = (pictures / "guard.py").read_text()
    (tmp_path / "other.py").write_text(re.sub('VERSION = ".*"', 'VERSION = "0.0.1"', guard, count=1))
    away = farm.store.with_name("away")
    for script, why in (
        (tmp_path / "other.py", "the job was made with 0.0.1"),
        (pictures / "guard.py", "the store of Terr"),
    ):
        if script.parent == pictures:
            shutil.move(farm.store, away)
        output = "--render-output", tmp_path / "frame_####"
        command = farm.program.command("-b", farm.blend, "--python", script, *output, "-f", "4")
        environment = farm.program.environment() | {"BIND": f"{farm.program.user} {tmp_path}"}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600)
        assert done.returncode == 1 and "openjd_fail: " in done.stdout and why in done.stdout, done
    out = "--out", farm.folder / "none", "--progress", "openjd"
    command = farm.program.command(
        "--command", "adaptive_terrain", "render", "--scene", farm.blend, "--frames", "4", *out
    )
    done = subprocess.run(command, env=farm.program.environment(), capture_output=True, text=True, timeout=600)
    shutil.move(away, farm.store)
    assert done.returncode == 1 and "openjd_fail: There is no terrain store at" in done.stdout, done
    assert not list(tmp_path.glob("frame_*")) and not list(farm.folder.glob("none/*"))
