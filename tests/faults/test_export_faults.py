# SPDX-License-Identifier: GPL-3.0-or-later
"""Exports that are killed, run out of disk or meet each other: whole files under final names, and a rerun completes."""

import json
import os
import shutil
import signal
import subprocess
import sys

import pytest
from adaptive_terrain.cbt_terrain.mesh.archive import read_npz
from adaptive_terrain.operators.cli import command_line

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals, mounts and limits are those of POSIX")
# Kills itself before or after the k-th rename: between two files, or between a file and the summary of its frame.
SUICIDE = """
import os, signal, sys
from adaptive_terrain.operators.cli.command_line import main
replace, calls, (when, at) = os.replace, [0], sys.argv[1:3]
def counted(*arguments, **folders):
    calls[0] += 1
    if when == "before" and calls[0] == int(at):
        os.kill(os.getpid(), signal.SIGKILL)
    replace(*arguments, **folders)
    if when == "after" and calls[0] == int(at):
        os.kill(os.getpid(), signal.SIGKILL)
os.replace = counted
sys.exit(main(sys.argv[3:]))
"""


def standing(out):
    """Return every mesh that has its final name, read to its end."""
    paths = [path for path in out.glob("*.npz") if not path.name.startswith(".")]
    for path in paths:
        assert read_npz(path)["info"]["frame"] == int(path.stem[-4:])
    return {path.name: path.read_bytes() for path in paths}


def assert_complete(out, undisturbed):
    assert standing(out) == undisturbed
    assert len(list(out.glob("frame_*.json"))) == len(undisturbed) and not list(out.glob(".partial-*"))


@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.parametrize("rename", [1, 2, 16])
def test_killed_about_a_rename_then_resumed(flight, undisturbed, tmp_path, run_command, when, rename):
    out = tmp_path / "out"
    command = [sys.executable, "-c", SUICIDE, when, str(rename), *flight, "--out", str(out)]
    assert subprocess.run(command, capture_output=True).returncode == -signal.SIGKILL
    before = standing(out)
    assert before == {name: undisturbed[name] for name in before}
    done = run_command(*flight, "--out", out, "--resume")
    assert done.returncode == 0, done.stderr
    whole_frames = (rename - (when == "before")) // 2
    assert done.stdout.count("complete before") == whole_frames
    assert_complete(out, undisturbed)


def test_the_disk_is_full_then_resumed(flight, undisturbed, small_disk, run_command):
    size = sum(map(len, undisturbed.values()))
    disk = small_disk(size // 2)
    out = disk / "out"
    done = run_command(*flight, "--out", out)
    assert done.returncode == 1 and "No space left on device" in done.stderr and "Traceback" not in done.stderr
    before = standing(out)
    assert 0 < len(before) < len(undisturbed) and before == {name: undisturbed[name] for name in before}
    assert not list(out.glob(".partial-*"))
    subprocess.run(["mount", "-o", f"remount,size={3 * size}", str(disk)], check=True)
    done = run_command(*flight, "--out", out, "--resume")
    assert done.returncode == 0, done.stderr
    assert_complete(out, undisturbed)


@pytest.mark.parametrize("form", ["ply", "obj", "glb", "blend"])
def test_blender_runs_out_of_disk(flight, small_disk, run_command, tmp_path, form):
    """What Blender's own exporters cannot finish never stands under a final name."""
    pytest.importorskip("bpy")
    arguments = [*flight[: flight.index("--frames")], "--frames", "1-2", "--format", form]
    assert command_line.main([*arguments, "--out", str(tmp_path / "whole")]) == 0
    [first] = [path for path in (tmp_path / "whole").glob(f"*_0001.{form}")]
    out = small_disk(first.stat().st_size * 2 // 3) / "out"
    done = run_command(*arguments, "--out", out)
    assert not [path.name for path in out.glob(f"*.{form}")], done.stderr
    assert not list(out.glob("frame_*.json"))
    said = done.stderr.strip().splitlines()[-1]  # after a traceback that the glTF exporter prints
    assert done.returncode == 1 and f"_0001.{form} cannot be written (" in said and "Location" not in said
    assert form == "blend" or "No space left on device" in said


def test_three_exports_into_one_folder(flight, undisturbed, tmp_path):
    out = tmp_path / "out"
    command = [sys.executable, "-m", "adaptive_terrain.operators.cli.command_line", *flight, "--out", str(out)]
    options = [["--resume"], [], ["--resume"]]
    children = [
        subprocess.Popen([*command, *more], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) for more in options
    ]
    assert [(child.communicate()[1], child.returncode) for child in children] == [(b"", 0)] * 3
    assert_complete(out, undisturbed)
    for path in out.glob("frame_*.json"):
        assert json.loads(path.read_text())["files"] == {
            name: len(undisturbed[name]) for name in undisturbed if name.endswith(f"{path.stem[-4:]}.npz")
        }


def test_the_store_is_deleted_while_it_is_exported(flight, undisturbed, tmp_path):
    """An open store stays readable: the export ends well."""
    at = flight.index("--store") + 1
    store, out = tmp_path / "own.store", tmp_path / "out"
    shutil.copytree(flight[at], store)
    arguments = [*flight[:at], str(store), *flight[at + 1 :], "--out", str(out)]
    command = [sys.executable, "-m", "adaptive_terrain.operators.cli.command_line", *arguments]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    child.stdout.readline()  # the first frame stands
    shutil.rmtree(store)
    _, said = child.communicate()
    assert (said, child.returncode) == (b"", 0)
    assert_complete(out, undisturbed)
