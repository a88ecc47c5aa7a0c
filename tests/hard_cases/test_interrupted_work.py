# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 65: interrupts (INT, TERM, KILL) at random times; a rerun gives the same bytes, no leftovers, no hang.

A dozen here, 300 by `make fuzz`. Each is drawn by its own number, which its test's name has. Signals come after the
process has begun: what comes while Python itself starts is not ours.
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
from flights import hills_flight

CASES = 300 if int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) >= 10_000 else 12
# Only so that a hang ends; a stop takes 5 s at most, on a loaded machine a little longer.
GUARD_S, STOP_S = 240, 30
# The commands of this test: what takes minutes is smaller, the path through the program is the same.
PROGRAM = """
import os, sys
if sys.argv[1] == "accuracy":
    from adaptive_terrain.cbt_terrain.accuracy.sweep_settings import Setting
    from adaptive_terrain.operators.report import accuracy_subject
    few = [Setting("px", 4.0), Setting("px", 1.0, meshlet=1), Setting("m", 2.0, interpolation="bicubic")]
    accuracy_subject.settings_for = lambda heights, frame, morph: few
if sys.argv[1] == "demo":
    from adaptive_terrain.operators.demo import demo
    demo.SIZE, demo.FRAMES, demo.PICTURE_FRAMES, demo.LEVELS_FRAME = 129, range(1, 4), (1,), 2
    demo.RESOLUTION, demo.PLAN_RESOLUTION = (64, 36), (48, 48)
if sys.argv[1] in ("bake", "export"):
    from adaptive_terrain.operators.output import exporting
from adaptive_terrain.operators.cli.command_line import program
os.write(2, b"begun\\n")
program()
"""
TOKEN = "ADAPTIVE_TERRAIN_TEST_TOKEN"
# How often each is drawn; what imports bpy, or measures, takes longer.
WEIGHTS = {"import": 4, "bake": 3, "export": 4}
if CASES > 12:
    WEIGHTS |= {"bake ply": 1, "bake bicubic": 1, "export formats": 1, "accuracy": 1, "demo": 1}

pytestmark = pytest.mark.skipif(os.name != "posix" or not Path("/proc").exists(), reason="signals, and /proc to look")


class Work:
    """A command that works in a folder of its own, beside a copy of the store."""

    def __init__(self, kind: str, template: Path, folder: Path):
        self.folder, self.token = folder, f"{folder}"
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
        """In a process group of its own, as a shell does it."""
        command = [sys.executable, "-c", PROGRAM, *map(str, self.arguments), *more]
        environment = os.environ | {TOKEN: self.token, "TMPDIR": str(self.folder)}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        process = subprocess.Popen(command, env=environment, process_group=0, **pipes)
        assert process.stderr.readline() == "begun\n"
        return process

    def complete(self, *more: str) -> float:
        """Run to the end; returns the seconds that it took."""
        process = self.start(*more)
        begun = time.monotonic()
        said = process.communicate(timeout=GUARD_S)[1]
        assert process.returncode == 0, said
        return time.monotonic() - begun

    def processes(self) -> list[int]:
        """Those that live and were started by this work."""
        mark, found = f"{TOKEN}={self.token}\0".encode(), []
        for process in Path("/proc").glob("[0-9]*"):
            try:
                if mark in (process / "environ").read_bytes():
                    found.append(int(process.name))
            except OSError:
                continue
        return found

    def result(self) -> dict:
        """Everything that stands in the folder, by name, without times and random names."""
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
    """What a file holds that is a function of the input alone."""
    if path.is_dir() or path.suffix in (".html", ".md", ".svg", ".blend"):
        return None  # pages of times; a scene has addresses of memory in it
    if path.name == "accuracy.json":
        return None  # has the rows of the CSV
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
    """JSON without what differs from run to run; sizes of .blend files do."""
    if not isinstance(value, dict):
        return [without_times(v) for v in value] if isinstance(value, list) else value
    drop = ("ms", "elapsed_ms", "seconds", "data", "sum", "checksum")  # the last two are of all entries, times too
    return {k: without_times(v) for k, v in value.items() if k not in drop and not k.endswith(".blend")}


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """A small store and a flight over it."""
    folder = tmp_path_factory.mktemp("template")
    hills_flight(folder)
    return folder


@pytest.fixture(scope="module")
def undisturbed(template, tmp_path_factory):
    """By kind of work: what stands after it, and the seconds that it takes."""
    known = {}

    def run(kind):
        if kind not in known:
            work = Work(kind, template, tmp_path_factory.mktemp("undisturbed") / "work")
            seconds = work.complete()
            known[kind] = work.result(), seconds
        return known[kind]

    return run


def disturb(process: subprocess.Popen, draw: random.Random, seconds: float) -> tuple[int, str]:
    """Send a signal at a random time, to the process or, as a terminal does, to its group; sometimes another one soon
    after. Returns the signal and what the process said."""
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


@pytest.mark.parametrize("case", range(CASES))
def test_case_65_interrupted_at_a_random_time(case, template, undisturbed, tmp_path):
    """INT, TERM or KILL at a random time: the end comes soon; a rerun gives the same bytes and leaves nothing over.

    A stop is one line and the signal's exit code, no process lives on, and what has a final name is whole.
    """
    draw = random.Random(f"interrupt {case}")
    kind = draw.choices(list(WEIGHTS), WEIGHTS.values())[0]
    if kind in ("bake ply", "export formats", "demo"):
        pytest.importorskip("bpy")
    expected, seconds = undisturbed(kind)
    work = Work(kind, template, tmp_path / "work")
    number, said = disturb(process := work.start(), draw, seconds)
    assert "Traceback" not in said, said
    if process.returncode not in (0, -number):
        assert process.returncode == 128 + number and number != signal.SIGKILL, (process.returncode, said)
        assert said.count("stopped") == 1 == len(said.splitlines()), said
    deadline = time.monotonic() + STOP_S
    while work.processes() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not work.processes()
    if number == signal.SIGKILL:  # a killed process cannot remove its folders of temporary files
        for left in work.folder.glob("tmp????????"):
            shutil.rmtree(left)
    stopped_cleanly = "terrain: stopped\n" in said
    for name, path in work.files().items():
        assert name in expected or (not stopped_cleanly and ("/.partial-" in f"/{name}" or "/lock" in name)), name
        if path.suffix in (".npz", ".ply", ".obj", ".csv") and name in expected:
            assert content(path) == expected[name], f"{name} is half-written"
    work.complete(*(["--resume"] if kind.startswith("export") and draw.random() < 0.5 else []))
    assert work.result() == expected
