# SPDX-License-Identifier: GPL-3.0-or-later
"""Small disks, digests of stores and exports, and verbs in child processes."""

import hashlib
import subprocess
from pathlib import Path

import pytest
from flights import arguments, undisturbed  # noqa: F401
from forked_children import fork_children  # noqa: F401
from forked_programs import COMMAND_LINE, run_program


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
    """Return a function that runs a verb of the command line in a forked process, as subprocess.run."""
    return lambda *words: run_program(COMMAND_LINE, *words)


@pytest.fixture
def contents():
    """Return a function for the digests of all files of a folder by name."""

    def read(folder: Path) -> dict[str, str]:
        files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        return {str(f.relative_to(folder)): hashlib.blake2b(f.read_bytes()).hexdigest() for f in files}

    return read
