# SPDX-License-Identifier: GPL-3.0-or-later
"""Small disks, and what a store or a folder of exports holds, byte by byte."""

import hashlib
import subprocess
import sys
from pathlib import Path

import pytest
from adaptive_terrain.operators.cli import command_line
from flights import hills_flight

# Only so that a hang ends.
GUARD_S = 300


@pytest.fixture
def small_disk(tmp_path):
    """Makes a file system of its own of so many bytes at tmp_path / "disk"."""
    mounted = []

    def mount(size: int) -> Path:
        folder = tmp_path / "disk"
        folder.mkdir()
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], capture_output=True, text=True
        )
        if done.returncode != 0:
            pytest.skip(f"a small tmpfs cannot be mounted here, which needs root ({done.stderr.strip()})")
        mounted.append(folder)
        return folder

    yield mount
    for folder in mounted:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.fixture
def run_command():
    """Runs a verb of the command line in a process of its own; returns what subprocess.run does."""

    def run(*arguments, **options):
        command = [sys.executable, "-m", "adaptive_terrain.operators.cli.command_line", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, timeout=GUARD_S, **options)

    return run


@pytest.fixture
def contents():
    """Digests of all files of a folder by name."""

    def read(folder: Path) -> dict[str, str]:
        files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        return {str(f.relative_to(folder)): hashlib.blake2b(f.read_bytes()).hexdigest() for f in files}

    return read


@pytest.fixture(scope="session")
def flight(tmp_path_factory):
    """A small store, a flight over it, and the arguments of its export but for --out."""
    return hills_flight(tmp_path_factory.mktemp("flight"))


@pytest.fixture(scope="session")
def undisturbed(flight, tmp_path_factory):
    """The bytes of every mesh of an export that nothing disturbs, by name."""
    out = tmp_path_factory.mktemp("undisturbed")
    assert command_line.main([*flight, "--out", str(out)]) == 0
    return {path.name: path.read_bytes() for path in out.glob("*.npz")}
