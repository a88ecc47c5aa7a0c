# SPDX-License-Identifier: GPL-3.0-or-later
"""Long work in the real program, in short runs: nothing crashes, and memory and handles do not grow.

`ADAPTIVE_TERRAIN_FUZZ=10000` flies and renders 1,000 frames, repeats the rest 200 to 400 times, and prints the results.
In a short run only counts are distinguishable from noise.
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
from real_program import PATHS, SCRIPTS, processes

FUZZ = int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0"))
SCRIPT = SCRIPTS / "long_runs.py"
SAMPLES = 100  # of a long run, as in the script
SIZE = 0, 0, 480, 360  # of the window, which is drawn by software
# A small island in the factory scene, coarse in the viewport, saved so that its store is beside the file.
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
    """Return the number of repetitions: `short`, or `of_a_thousand` per thousand frames of a long run."""
    return max(short, FUZZ * of_a_thousand // 10_000)


@pytest.fixture(scope="module")
def prepared(program, tmp_path_factory):
    path = tmp_path_factory.mktemp("prepared") / "shot.blend"
    program.run("-b", "--python-exit-code", "1", "--python-expr", f"PATH = {str(path)!r}\n{PREPARE}")
    return path


@pytest.fixture
def shot(prepared, tmp_path):
    """Copy the scene and its store into the test's folder."""
    shutil.copytree(prepared.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / prepared.name


def found(folder, acts) -> dict:
    """Read the script's samples by act, and assert that it ended without an error."""
    end = folder / "done.json"
    assert not end.exists() or "error" not in json.loads(end.read_text()), json.loads(end.read_text())["error"]
    return {act: json.loads((folder / f"{act}.json").read_text()) for act in acts}


def must_be_flat(act: str, report: dict) -> None:
    """Assert that, after a warm-up of one third, counts do not grow and memory has no trend.

    The minimum of each third counts, since a thread or a file may exist for a moment. A short run is all warm-up, in
    which Blender may start one more thread of its pool; a leak at every step is still found.
    """
    samples = report["samples"]
    third = len(samples) // 3
    middle, end = samples[third : 2 * third], samples[2 * third :]
    lowest = {name: [min(sample[name] for sample in part) for part in (middle, end)] for name in COUNTED}
    steps, memory = (np.array([sample[name] for sample in samples[third:]], float) for name in ("step", "memory_kb"))
    trend = float(np.polyfit(steps, memory, 1)[0])
    megabytes = [round(memory[at] / 1024) for at in (0, -1)]
    print(
        f"{act}, {samples[-1]['step']} times, {report['cpu_s']:.0f} s: {megabytes} MB, {trend:.1f} KB a step; {lowest}"
    )
    late = 1 if len(samples) < SAMPLES else 0
    assert all(before + late >= after for before, after in lowest.values()), (act, lowest)
    assert len(samples) < SAMPLES or trend < MEMORY_KB_A_STEP, (act, trend)


@pytest.mark.parametrize(
    ("what", "leaks"), [("files", lambda step: step // 30), ("memory_kb", lambda step: 25 * step), ("", lambda _: 0)]
)
def test_a_leak_is_found(what, leaks):
    """A file every thirty steps and 25 kilobytes a step are found; memory that only varies is not."""
    noise = np.random.default_rng(1).integers(-2000, 2000, SAMPLES)
    samples = [{"step": i + 1, "memory_kb": int(noise[i])} | dict.fromkeys(COUNTED, 5) for i in range(SAMPLES)]
    for sample in samples:
        sample["step"] *= 4
        if what:
            sample[what] += leaks(sample["step"])
    with pytest.raises(AssertionError) if what else nullcontext():
        must_be_flat("it", {"samples": samples, "cpu_s": 0.0})


def in_a_window(program, shot, counts: dict[str, int]) -> int:
    """Run the script's acts that many times in a window, and return the exit code if it quits."""
    folder = shot.parent
    arguments = [shot, "--python", SCRIPT, "--", folder, json.dumps(counts)]
    with window(program, arguments, folder, place=SIZE) as blender:
        while blender.poll() is None and not (folder / "done.json").exists():
            time.sleep(0.1)
        return blender.poll()


@pytest.mark.thorough
def test_a_long_day_in_the_window(program, shot):
    """Undo, opened files, changing collections, layers and drivers, and a flight with renders leak nothing."""
    counts = {"undo": times(6, 300), "load": times(6, 400), "arrange": times(6, 400), "fly": times(16, 1000)}
    in_a_window(program, shot, counts)
    report = found(shot.parent, counts)
    for act, figures in report.items():
        must_be_flat(act, figures)
    assert len({sample["triangles"] for sample in report["fly"]["samples"]}) > 1, "the terrain follows its camera"


@pytest.mark.parametrize("number", range(max(1, FUZZ // 1000)))
def test_quit_while_importing(program, shot, number):
    """Blender quits with code 0 during an import, without a remaining process or partial file."""
    assert in_a_window(program, shot, {"quit_importing": 1}) == 0, (shot.parent / "blender.log").read_text()[-4000:]
    assert not processes(str(shot.parent))
    [store] = (shot.parent / "terrain").iterdir()
    assert len(list(store.glob("data-*"))) == 1


@pytest.mark.thorough
def test_one_program_renders_while_another_imports(program, shot, tmp_path):
    """Frames with motion blur render from a store that another program keeps rewriting."""
    counts = {"render": {"render": times(12, 1000)}, "write": {"write": times(6, 200)}}
    running = {}
    for name, acts in counts.items():
        (tmp_path / name).mkdir()
        command = program.command(
            "-b", shot, "--python-expr", PATHS, "--python", SCRIPT, "--", tmp_path / name, json.dumps(acts)
        )
        log = open(tmp_path / name / "log", "w")
        running[name] = subprocess.Popen(command, env=program.environment(), stdout=log, stderr=subprocess.STDOUT)
    for name, process in running.items():
        assert process.wait() == 0, (tmp_path / name / "log").read_text()[-4000:]
        must_be_flat(name, found(tmp_path / name, [name])[name])
