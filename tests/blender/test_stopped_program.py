# SPDX-License-Identifier: GPL-3.0-or-later
"""Signals stop commands inside the real Blender program, which has other signal handlers, like those outside."""

import json
import os
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import pytest
from real_program import processes

FLIGHT = {
    "clip": [1, 50000],
    "keyframes": [
        {"frame": 1, "eye": [-4700, -3900, 1150], "target": [0, 100, 420]},
        {"frame": 900, "eye": [2500, -1900, 880], "target": [300, 400, 760]},
    ],
}


@pytest.fixture(scope="module")
def store(program, tmp_path_factory):
    folder = tmp_path_factory.mktemp("stopped")
    program.run("--command", "adaptive_terrain", "import", "island", "--size", "257", "--store", folder / "store")
    (folder / "flight.json").write_text(json.dumps(FLIGHT))
    return folder


@pytest.mark.parametrize(
    ("verb", "number"),
    [
        ("import", signal.SIGTERM),
        ("export", signal.SIGINT),
        pytest.param("import", signal.SIGINT, marks=pytest.mark.thorough),
        pytest.param("export", signal.SIGTERM, marks=pytest.mark.thorough),
    ],
)
def test_a_command_is_stopped(program, store, tmp_path, verb, number):
    out = tmp_path / "out"
    arguments = {
        "import": ["import", "island", "--size", "4097", "--store", out, "--progress"],
        "export": ["export", "--store", store / "store", "--path", store / "flight.json", "--frames", "1-900"],
    }[verb]
    if verb == "export":
        arguments += ["--format", "npz,ply", "--out", out]
    command = program.command("--command", "adaptive_terrain", *arguments)
    environment = program.environment() | {"ADAPTIVE_TERRAIN_TEST_TOKEN": str(tmp_path)}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + 300
        pattern = "data-*" if verb == "import" else "frame_0002.json"
        while not list(out.glob(pattern)):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        for pid in processes(str(tmp_path)):
            with suppress(FileNotFoundError):  # a child may end between the two looks
                if "blender" in Path(f"/proc/{pid}/comm").read_text():
                    os.kill(pid, number)
        report = process.communicate(timeout=300)[1]
    finally:
        process.kill()
    assert process.returncode == 128 + number, report
    assert "adaptive-terrain: stopped\n" in report and "Traceback" not in report
    assert not processes(str(tmp_path))
    if verb == "import":
        assert not out.exists()
    else:
        frames = {path.stem for path in out.glob("frame_*.json")}
        assert 2 <= len(frames) < 900 and not list(out.glob(".partial-*"))
        wheels = program.user.glob("extensions/.local/lib/*/site-packages/warp/native/builtin.h")
        assert list(wheels), "a new file leaves the user's extensions as they are"
