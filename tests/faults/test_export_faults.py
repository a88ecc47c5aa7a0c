# SPDX-License-Identifier: GPL-3.0-or-later
"""Exports that are killed or run out of disk: whole files under final names, and a rerun completes."""

import os
import shutil
import signal
import subprocess

import pytest
from adaptive_terrain.operators.cli import command_line
from flights import assert_complete, final_meshes
from forked_programs import COMMAND_LINE, run_program, start_program

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


@pytest.mark.parametrize(
    ("when", "rename"),
    [
        ("after", 1),
        ("before", 16),
        *(
            pytest.param(*at, marks=pytest.mark.thorough)
            for at in (("before", 1), ("before", 2), ("after", 2), ("after", 16))
        ),
    ],
)
def test_killed_about_a_rename_then_resumed(arguments, undisturbed, tmp_path, capsys, when, rename):
    out = tmp_path / "out"
    assert run_program(SUICIDE, when, rename, *arguments, "--out", out).returncode == -signal.SIGKILL
    before = final_meshes(out)
    assert before == {name: undisturbed[name] for name in before}
    assert command_line.main([*arguments, "--out", str(out), "--resume"]) == 0
    whole_frames = (rename - (when == "before")) // 2
    assert capsys.readouterr().out.count("complete before") == whole_frames
    assert_complete(out, undisturbed)


def test_the_disk_is_full_then_resumed(arguments, undisturbed, small_disk, run_command):
    size = sum(map(len, undisturbed.values()))
    disk = small_disk(size // 2)
    out = disk / "out"
    done = run_command(*arguments, "--out", out)
    assert done.returncode == 1 and "No space left on device" in done.stderr and "Traceback" not in done.stderr
    before = final_meshes(out)
    assert 0 < len(before) < len(undisturbed) and before == {name: undisturbed[name] for name in before}
    assert not list(out.glob(".partial-*"))
    subprocess.run(["mount", "-o", f"remount,size={3 * size}", str(disk)], check=True)
    assert command_line.main([*arguments, "--out", str(out), "--resume"]) == 0
    assert_complete(out, undisturbed)


@pytest.mark.parametrize(
    "form", ["glb", "blend", *(pytest.param(name, marks=pytest.mark.thorough) for name in ("ply", "obj"))]
)
def test_blender_runs_out_of_disk(arguments, small_disk, capfd, tmp_path, form):
    """What Blender's own exporters cannot finish never stands under a final name."""
    pytest.importorskip("bpy")
    arguments = [*arguments[: arguments.index("--frames")], "--frames", "1-2", "--format", form]
    assert command_line.main([*arguments, "--out", str(tmp_path / "whole")]) == 0
    [first] = [path for path in (tmp_path / "whole").glob(f"*_0001.{form}")]
    out = small_disk(first.stat().st_size * 2 // 3) / "out"
    capfd.readouterr()
    assert command_line.main([*arguments, "--out", str(out)]) == 1
    assert not [path.name for path in out.glob(f"*.{form}")]
    assert not list(out.glob("frame_*.json"))
    said = capfd.readouterr().err.strip().splitlines()[-1]  # after a traceback that the glTF exporter prints
    assert f"_0001.{form} cannot be written (" in said and "Location" not in said
    assert form == "blend" or "No space left on device" in said


def test_the_store_is_deleted_while_it_is_exported(arguments, undisturbed, tmp_path):
    """An open store stays readable: the export ends well."""
    at = arguments.index("--store") + 1
    store, out = tmp_path / "own.store", tmp_path / "out"
    shutil.copytree(arguments[at], store)
    arguments = [*arguments[:at], str(store), *arguments[at + 1 :], "--out", str(out)]
    child = start_program(COMMAND_LINE, *arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    child.stdout.readline()  # the first frame stands
    shutil.rmtree(store)
    _, said = child.communicate()
    assert (said, child.returncode) == (b"", 0)
    assert_complete(out, undisturbed)
