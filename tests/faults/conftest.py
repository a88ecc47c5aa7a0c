# SPDX-License-Identifier: GPL-3.0-or-later
"""Small disks, digests of stores and exports, and verbs in child processes."""

import hashlib
import subprocess
import sys
from pathlib import Path

import pytest
from flights import arguments, undisturbed  # noqa: F401
from forked_children import fork_children  # noqa: F401

# Only so that a hang ends.
GUARD_S = 300


@pytest.fixture
def small_disk(tmp_path):
    """Return a function that mounts a file system of a given size at tmp_path / "disk"."""
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
    """Return a function that runs a verb of the command line in a child process, as subprocess.run."""

    def run(*words, **options):
        command = [sys.executable, "-m", "adaptive_terrain.operators.cli.command_line", *map(str, words)]
        return subprocess.run(command, capture_output=True, text=True, timeout=GUARD_S, **options)

    return run


@pytest.fixture
def contents():
    """Return a function for the digests of all files of a folder by name."""

    def read(folder: Path) -> dict[str, str]:
        files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        return {str(f.relative_to(folder)): hashlib.blake2b(f.read_bytes()).hexdigest() for f in files}

    return read
