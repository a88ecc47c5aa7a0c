# SPDX-License-Identifier: GPL-3.0-or-later
"""Hours of work in the real program, in small: nothing crashes, and what the process holds does not grow.

`ADAPTIVE_TERRAIN_FUZZ=10000` flies and renders 1,000 frames, does the rest 200 to 400 times, and prints what it found.
In a short run only what is counted can be told from noise.
"""

import json
import os
import shutil
import subprocess
import time
from contextlib import nullcontext

import numpy as np
import pytest
from program_window import window
from real_program import SCRIPTS, processes

FUZZ = int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0"))
SCRIPT = SCRIPTS / "long_runs.py"
SAMPLES = 100  # of a long run, as in the script
SIZE = 0, 0, 480, 360  # of the window, which is drawn by software
# A small island in the factory scene, coarse in the viewport. It is saved, so that its store lies beside it.
PREPARE = """
import bpy
scene = bpy.context.scene
bpy.data.objects.remove(bpy.data.objects["Cube"])
bpy.ops.wm.save_as_mainfile(filepath=PATH)
terrain = bpy.data.objects.new("Terrain", bpy.data.meshes.new("Terrain"))
bpy.context.collection.objects.link(terrain)
bpy.context.view_layer.objects.active = terrain
settings = terrain.adaptive_terrain
settings.enabled, settings.island_size, settings.use_extent, settings.extent = True, 257, True, (20.0, 20.0)
settings.viewport.error_px, settings.render.error_px, settings.height_scale = 8.0, 4.0, 20.0 / 8192.0
scene.render.use_lock_interface = True
assert bpy.ops.adaptive_terrain.import_source() == {"FINISHED"}
for frame, x in ((1, 7.0), (25, 9.0), (49, 7.0)):
    scene.camera.location.x = x
    scene.camera.keyframe_insert("location", frame=frame)
scene.render.resolution_x, scene.render.resolution_y = 192, 108
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
scene.render.filepath = "//picture"
bpy.ops.wm.save_mainfile()
"""
COUNTED = "files", "threads", "mapped_arrays", "datablocks", "records", "fields"
MEMORY_KB_A_STEP = 20.0  # its trend; it goes up and down by some megabytes all the time


def times(short: int, of_a_thousand: int) -> int:
    """How often something is done: in a short run, and for each thousand frames of a long one."""
    return max(short, FUZZ * of_a_thousand // 10_000)


@pytest.fixture(scope="module")
def prepared(program, tmp_path_factory):
    path = tmp_path_factory.mktemp("prepared") / "shot.blend"
    program.run("-b", "--python-exit-code", "1", "--python-expr", f"PATH = {str(path)!r}\n{PREPARE}")
    return path


@pytest.fixture
def shot(prepared, tmp_path):
    """The scene and the store beside it, in a folder of the test's own."""
    shutil.copytree(prepared.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / prepared.name


def found(folder, acts) -> dict:
    """What the script has written of its acts, after a look at how it ended."""
    end = folder / "done.json"
    assert not end.exists() or "error" not in json.loads(end.read_text()), json.loads(end.read_text())["error"]
    return {act: json.loads((folder / f"{act}.json").read_text()) for act in acts}


def must_be_flat(act: str, said: dict) -> None:
    """After the first third, to warm up, counts do not grow and memory has no trend. Of counts the least of each third
    is looked at: for a moment there may be a thread or a file more. A short run is all warm-up: Blender may start one
    more thread of its pool in it, but what leaks at every step is found."""
    samples = said["samples"]
    third = len(samples) // 3
    middle, end = samples[third : 2 * third], samples[2 * third :]
    least = {name: [min(sample[name] for sample in part) for part in (middle, end)] for name in COUNTED}
    steps, memory = (np.array([sample[name] for sample in samples[third:]], float) for name in ("step", "memory_kb"))
    trend = float(np.polyfit(steps, memory, 1)[0])
    megabytes = [round(memory[at] / 1024) for at in (0, -1)]
    print(f"{act}, {samples[-1]['step']} times, {said['cpu_s']:.0f} s: {megabytes} MB, {trend:.1f} KB a step; {least}")
    late = 1 if len(samples) < SAMPLES else 0
    assert all(before + late >= after for before, after in least.values()), (act, least)
    assert len(samples) < SAMPLES or trend < MEMORY_KB_A_STEP, (act, trend)


@pytest.mark.parametrize(
    ("what", "leaks"), [("files", lambda step: step // 30), ("memory_kb", lambda step: 25 * step), ("", lambda _: 0)]
)
def test_what_leaks_is_found(what, leaks):
    """A file every thirty steps, 25 kilobytes a step; and nothing, under memory that goes up and down."""
    noise = np.random.default_rng(1).integers(-2000, 2000, SAMPLES)
    samples = [{"step": i + 1, "memory_kb": int(noise[i])} | dict.fromkeys(COUNTED, 5) for i in range(SAMPLES)]
    for sample in samples:
        sample["step"] *= 4
        if what:
            sample[what] += leaks(sample["step"])
    with pytest.raises(AssertionError) if what else nullcontext():
        must_be_flat("it", {"samples": samples, "cpu_s": 0.0})


def in_a_window(program, shot, counts: dict[str, int]) -> int:
    """Do that often what the script can; returns its exit code if it quits."""
    folder = shot.parent
    arguments = [shot, "--python", SCRIPT, "--", folder, json.dumps(counts)]
    with window(program, arguments, folder, place=SIZE) as blender:
        while blender.poll() is None and not (folder / "done.json").exists():
            time.sleep(0.1)
        return blender.poll()


def test_a_long_day_in_the_window(program, shot):
    """Undo and Redo; files that are opened; collections, view layers, instances and drivers that come and go; a flight
    with live update, motion blur and renders."""
    counts = {"undo": times(6, 300), "load": times(6, 400), "arrange": times(6, 400), "fly": times(16, 1000)}
    in_a_window(program, shot, counts)
    said = found(shot.parent, counts)
    for act, figures in said.items():
        must_be_flat(act, figures)
    assert len({sample["triangles"] for sample in said["fly"]["samples"]}) > 1, "the terrain follows its camera"


@pytest.mark.parametrize("number", range(max(1, FUZZ // 1000)))
def test_quit_while_importing(program, shot, number):
    """Blender quits as it should, no process of it is left, nor anything of the import that it was at."""
    assert in_a_window(program, shot, {"quit_importing": 1}) == 0, (shot.parent / "blender.log").read_text()[-4000:]
    assert not processes(str(shot.parent))
    [store] = (shot.parent / "terrain").iterdir()
    assert len(list(store.glob("data-*"))) == 1


def test_one_program_renders_what_another_imports_anew(program, shot, tmp_path):
    """Frames with motion blur, from a store that another program writes meanwhile, again and again."""
    counts = {"render": {"render": times(12, 1000)}, "write": {"write": times(6, 200)}}
    running = {}
    for name, asked in counts.items():
        (tmp_path / name).mkdir()
        command = program.command("-b", shot, "--python", SCRIPT, "--", tmp_path / name, json.dumps(asked))
        log = open(tmp_path / name / "log", "w")
        running[name] = subprocess.Popen(command, env=program.environment(), stdout=log, stderr=subprocess.STDOUT)
    for name, process in running.items():
        assert process.wait() == 0, (tmp_path / name / "log").read_text()[-4000:]
        must_be_flat(name, found(tmp_path / name, [name])[name])
