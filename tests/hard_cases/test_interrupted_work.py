# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 65: interrupts (INT, TERM, KILL) at random times; a rerun gives the same bytes, no leftovers, no hang.

The suite draws 12, `make fuzz` 300. The number in a test's name is its random seed. Signals are sent after Python
itself has started.
"""

import csv
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain.operators.cli import command_line
from flights import hills_flight
from real_program import processes

CASES = 300 if int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) >= 10_000 else 12
GUARD_S, STOP_S = 600, 120  # end a hang; a stop takes at most 5 s, on a busy machine longer
# The commands of this test, with smaller inputs where they would take minutes.
PROGRAM = """
import os, sys
if sys.argv[1] == "accuracy":
    from adaptive_terrain.cbt_terrain.accuracy.sweep_settings import Setting
    from adaptive_terrain.operators.accuracy import subject as accuracy_subject
    few = [Setting("px", 4.0), Setting("px", 1.0, meshlet=1), Setting("m", 2.0, interpolation="bicubic")]
    accuracy_subject.settings_for = lambda heights, frame, morph: few
if sys.argv[1] == "demo":
    from adaptive_terrain.operators.demo import demo
    demo.SIZE, demo.FRAMES, demo.PICTURE_FRAMES, demo.LEVELS_FRAME = 129, range(1, 4), (1,), 2
    demo.RESOLUTION, demo.PLAN_RESOLUTION = (64, 36), (48, 48)
if sys.argv[1] in ("bake", "export"):
    from adaptive_terrain.operators.export import exporting
from adaptive_terrain.operators.cli.command_line import program
os.write(2, b"begun\\n")
program()
"""
TOKEN = "ADAPTIVE_TERRAIN_TEST_TOKEN"
WITHOUT_BPY = "import", "bake", "bake bicubic", "export"  # commands that run as they are
# The relative frequency of each command. Commands that import bpy or measure take longer.
WEIGHTS = {"import": 4, "bake": 3, "export": 4}
if CASES > 12:
    WEIGHTS |= {"bake ply": 1, "bake bicubic": 1, "export formats": 1, "accuracy": 1, "demo": 1}

pytestmark = pytest.mark.skipif(os.name != "posix" or not Path("/proc").exists(), reason="signals, and /proc to look")


class Work:
    """A command that works in a separate folder with a copy of the store."""

    def __init__(self, kind: str, template: Path, folder: Path):
        self.kind, self.folder, self.token = kind, folder, f"{folder}"
        shutil.copytree(template, folder)
        store, out = folder / "hills.store", folder / "out"
        whole = ["--store", store, "--max-error", "0.5"]
        flight = ["--store", store, "--path", folder / "flight.json", "--resolution", "640x360"]
        self.arguments = {
            "import": ["import", "island", "--size", "513", "--store", folder / "new.store"],
            "bake": ["bake", *whole, "--out", folder / "mesh.npz"],
            "bake ply": ["bake", *whole, "--out", folder / "mesh.ply"],
            "bake bicubic": ["bake", *whole, "--interpolation", "bicubic", "--out", folder / "mesh.npz"],
            "export": ["export", *flight, "--frames", "1-8", "--format", "npz", "--out", out],
            "export formats": ["export", *flight, "--frames", "1-2", "--format", "ply,obj,blend", "--out", out],
            "accuracy": ["accuracy", "--store", store, "--resolution", "64x36", "--out", out],
            "demo": ["demo", "--out", out],
        }[kind]

    def start(self, *more: str) -> subprocess.Popen:
        """Start the command in a new process group, as a shell does."""
        command = [sys.executable, "-c", PROGRAM, *map(str, self.arguments), *more]
        environment = os.environ | {TOKEN: self.token, "TMPDIR": str(self.folder)}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        process = subprocess.Popen(command, env=environment, process_group=0, **pipes)
        assert process.stderr.readline() == "begun\n"
        return process

    def complete(self, *more: str) -> float:
        """Run to the end and return the duration in seconds."""
        process = self.start(*more)
        begun = time.monotonic()
        stderr = process.communicate(timeout=GUARD_S)[1]
        assert process.returncode == 0, stderr
        return time.monotonic() - begun

    def again(self, *more: str) -> None:
        """Run to the end once more, in this process where the command needs no changes."""
        if self.kind in WITHOUT_BPY:
            assert command_line.main([*map(str, self.arguments), *more]) == 0
        else:
            self.complete(*more)

    def processes(self) -> list[int]:
        """Return the ids of living processes that this work started."""
        return processes(f"{TOKEN}={self.token}\0")

    def result(self) -> dict:
        """Return the contents of the folder by name, without times and random names."""
        return {name: content(path) for name, path in self.files().items()}

    def files(self) -> dict[str, Path]:
        found = {}
        for path in sorted(self.folder.rglob("*")):
            parts = path.relative_to(self.folder).parts
            if not parts[0].startswith("blender_"):  # Blender's own folder of temporary files
                name = "/".join("data" if part.startswith("data-") else part for part in parts)
                assert name not in found, f"{path} beside {found[name]}"
                found[name] = path
        return found


def content(path: Path):
    """Return the content of a file that depends on the input alone."""
    if path.is_dir() or path.suffix in (".html", ".md", ".svg", ".blend"):
        return None  # pages show times, and a .blend file holds memory addresses
    if path.name == "accuracy.json":
        return None  # repeats the rows of the CSV
    if path.suffix == ".json":
        return without_times(json.loads(path.read_text()))
    if path.suffix == ".csv":
        with path.open() as file:
            return [{k: v for k, v in row.items() if not k.startswith(("ms_", "mb"))} for row in csv.DictReader(file)]
    if path.suffix == ".png":
        from PIL import Image

        return np.asarray(Image.open(path)).tobytes()
    return path.read_bytes()


def without_times(value):
    """Drop times, checksums and sizes of .blend files, which differ between runs, from JSON."""
    if not isinstance(value, dict):
        return [without_times(v) for v in value] if isinstance(value, list) else value
    drop = ("ms", "elapsed_ms", "seconds", "data", "sum", "checksum")  # checksums cover the times
    return {k: without_times(v) for k, v in value.items() if k not in drop and not k.endswith(".blend")}


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """Make a small store and a flight over it."""
    folder = tmp_path_factory.mktemp("template")
    hills_flight(folder)
    return folder


@pytest.fixture(scope="module")
def undisturbed(template, tmp_path_factory):
    """Return a function that gives the result and the seconds of an undisturbed run, by kind of work."""
    known = {}

    def run(kind):
        if kind not in known:
            work = Work(kind, template, tmp_path_factory.mktemp("undisturbed") / "work")
            seconds = work.complete()
            known[kind] = work.result(), seconds
        return known[kind]

    return run


def disturb(process: subprocess.Popen, draw: random.Random, seconds: float) -> tuple[int, str]:
    """Send a signal at a random time to the process or, as a terminal does, to its group, and sometimes a second one.

    Return the signal and the stderr of the process.
    """
    number = draw.choice([signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
    again = draw.choice([None, None, 0.01, 1.0])
    send = draw.choice([os.kill, os.killpg])
    try:
        process.wait(draw.uniform(0.0, seconds))
    except subprocess.TimeoutExpired:
        send(process.pid, number)
    if again is not None:
        try:
            process.wait(again)
        except subprocess.TimeoutExpired:
            send(process.pid, number)
    return number, process.communicate(timeout=STOP_S)[1]


@pytest.mark.parametrize("case", [0, *(pytest.param(k, marks=pytest.mark.thorough) for k in range(1, CASES))])
def test_case_65_interrupted_at_a_random_time(case, template, undisturbed, tmp_path):
    """After INT, TERM or KILL at a random time the command ends soon, and a rerun gives the same bytes, no leftovers.

    A stopped command prints one line and returns the signal's exit code. No process stays alive, and every file with
    a final name is whole.
    """
    draw = random.Random(f"interrupt {case}")
    kind = draw.choices(list(WEIGHTS), WEIGHTS.values())[0]
    if kind in ("bake ply", "export formats", "demo"):
        pytest.importorskip("bpy")
    expected, seconds = undisturbed(kind)
    work = Work(kind, template, tmp_path / "work")
    number, stderr = disturb(process := work.start(), draw, seconds)
    assert "Traceback" not in stderr, stderr
    if process.returncode not in (0, -number):
        assert process.returncode == 128 + number and number != signal.SIGKILL, (process.returncode, stderr)
        assert stderr.count("stopped") == 1 == len(stderr.splitlines()), stderr
    deadline = time.monotonic() + STOP_S
    while work.processes() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not work.processes()
    # A process that ends at once cannot remove its folder of temporary files.
    if number == signal.SIGKILL or "stopped at once" in stderr:
        for left in work.folder.glob("tmp????????"):
            shutil.rmtree(left)
    stopped_cleanly = "terrain: stopped\n" in stderr
    for name, path in work.files().items():
        assert name in expected or (not stopped_cleanly and ("/.partial-" in f"/{name}" or "/lock" in name)), name
        if path.suffix in (".npz", ".ply", ".obj", ".csv") and name in expected:
            assert content(path) == expected[name], f"{name} is half-written"
    work.again(*(["--resume"] if kind.startswith("export") and draw.random() < 0.5 else []))
    assert work.result() == expected
