# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 49: kill -9 during an export; a rerun completes it, and no partial file has a final name."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.mesh.archive import read_npz
from adaptive_terrain.cbt_terrain.mesh.attributes import Attribute
from adaptive_terrain.cbt_terrain.mesh.surface import Surface
from adaptive_terrain.cbt_terrain.run.partial_files import new_token, written_beside
from adaptive_terrain.operators.cli import command_line
from flights import FRAMES, assert_complete, final_meshes
from forked_programs import run_program
from invariants import assert_invariants

# The child kills itself after it wrote the third entry of the third frame's archive.
SUICIDE = """
import os, signal, sys, zipfile
from adaptive_terrain.operators.cli.command_line import main
write, calls = zipfile.ZipFile.writestr, [0]
def counted(self, *arguments):
    write(self, *arguments)
    calls[0] += 1
    if calls[0] == 2 * 8 + 3:
        self.fp.flush()
        os.kill(os.getpid(), signal.SIGKILL)
zipfile.ZipFile.writestr = counted
sys.exit(main(sys.argv[1:]))
"""

pytestmark = pytest.mark.skipif(os.name != "posix", reason="SIGKILL")


def surface_of(path):
    """Read the surface in an exported file."""
    entries = read_npz(path)
    corners, count = entries["triangles"], len(entries["positions"])
    pairs = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1), axis=-1) @ [count, 1]
    keys = np.sort(entries["edges"], axis=1) @ [count, 1]
    order = np.argsort(keys)
    edge_of_corner = order[np.searchsorted(keys, pairs.ravel(), sorter=order)].astype(np.int32)
    about = entries["info"]["attributes"]
    attributes = {name: Attribute(entries[name], about[name]["domain"], about[name]["unit"]) for name in about}
    return Surface(entries["positions"], corners.ravel(), edge_of_corner, entries["edges"], attributes)


def test_case_49_an_undisturbed_export_is_whole(arguments, undisturbed, tmp_path):
    """The meshes of an undisturbed export keep the invariants."""
    lattice = open_store(arguments[arguments.index("--store") + 1]).lattice
    for name, content in undisturbed.items():
        (tmp_path / name).write_bytes(content)
        assert_invariants(surface_of(tmp_path / name), lattice)


def test_case_49_kill_while_a_file_is_written(arguments, undisturbed, tmp_path, capsys):
    """After a kill within the third frame's file two frames are whole, and a rerun gives the undisturbed bytes."""
    out = tmp_path / "out"
    assert run_program(SUICIDE, *arguments, "--out", out).returncode == -signal.SIGKILL
    assert len(list(out.glob(".partial-*"))) == 1, "the kill interrupted a write"
    assert final_meshes(out) == {name: undisturbed[name] for name in ("terrain_0001.npz", "terrain_0002.npz")}
    assert command_line.main([*arguments, "--out", str(out), "--resume"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.endswith("complete before") for line in lines] == [True] * 2 + [False] * (FRAMES - 2)
    assert_complete(out, undisturbed)


@pytest.mark.thorough
def test_case_49_kill_at_any_moment(arguments, undisturbed, tmp_path):
    """After three kills, each after one more frame, the existing files are whole and a rerun completes the rest."""
    out, command = tmp_path / "out", [sys.executable, "-m", "adaptive_terrain.operators.cli.command_line", *arguments]
    for round_ in range(3):
        child = subprocess.Popen(
            [*command, "--out", str(out), "--resume"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        deadline = time.monotonic() + 60
        while len(list(out.glob("frame_*.json"))) <= round_ and child.poll() is None and time.monotonic() < deadline:
            time.sleep(0.002)
        time.sleep(0.004 * round_)
        child.kill()
        child.wait()
        meshes = final_meshes(out)
        assert meshes == {name: undisturbed[name] for name in meshes}
    assert command_line.main([*arguments, "--out", str(out), "--resume"]) == 0
    assert_complete(out, undisturbed)


@pytest.mark.thorough
def test_case_49_exports_at_once_leave_each_other_alone(arguments, undisturbed, tmp_path):
    """Three simultaneous exports into one folder with the leftovers of a dead one give whole frames only."""
    out = tmp_path / "out"
    out.mkdir()
    dead = out / f".partial-{new_token()}"
    dead.mkdir()
    (dead / "terrain_0001.npz").write_bytes(b"half")
    with written_beside(out / "terrain_0001.npz") as alive:
        alive.write_bytes(b"of another export")
        assert command_line.main([*arguments, "--out", str(out)]) == 0
        assert alive.exists() and not dead.exists()
        assert command_line.main([*arguments, "--out", str(out), "--resume"]) == 0
        assert alive.exists()
    command = [sys.executable, "-m", "adaptive_terrain.operators.cli.command_line", *arguments, "--out", str(out)]
    options = [["--resume"], [], ["--resume"]]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    children = [subprocess.Popen([*command, *more], **pipes) for more in options]
    assert [(child.communicate()[1], child.returncode) for child in children] == [(b"", 0)] * 3
    assert_complete(out, undisturbed)
