# SPDX-License-Identifier: GPL-3.0-or-later
"""A program that waits for kernels to be compiled prints one line on stderr; a child process lets its parent do so."""

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest
from adaptive_terrain.cbt_terrain.run import compile_note, kernel_cache
from adaptive_terrain.cbt_terrain.sandbox import store_job

# Imports a small land, whose child process compiles kernels, and loads a kernel of this process.
PROGRAM = """
import sys
from adaptive_terrain import ImportSettings, import_source
from adaptive_terrain.cbt_terrain.run import warmup
import_source(ImportSettings("island", size=9), sys.argv[1])
print("imported", file=sys.stderr, flush=True)
from adaptive_terrain.kernels.field import fill
warmup.load(fill)
"""


@pytest.fixture(autouse=True)
def nothing_noted(monkeypatch):
    monkeypatch.setattr(compile_note, "_is_noted", False)
    monkeypatch.setattr(compile_note, "_tell", None)


def test_the_line_is_printed_once(capsys):
    for _ in range(2):
        compile_note.note()
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("Compiling kernels for the first use: about 10 s")


def test_only_a_missing_object_is_noted(tmp_path, monkeypatch, capsys):
    """Warp's loader is replaced: it would compile."""
    monkeypatch.setattr(kernel_cache.wp, "load_module", lambda *_name, **_device: None)
    monkeypatch.setattr(kernel_cache.wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr(kernel_cache, "compiled_file", lambda name: tmp_path / name / f"{name}.o")
    for whole, lines in ((True, 0), (False, 1)):
        monkeypatch.setattr(kernel_cache, "_is_whole", lambda _file, whole=whole: whole)
        kernel_cache.load("m")
        assert len(capsys.readouterr().err.splitlines()) == lines


@pytest.mark.parametrize("compiles", [False, True])
def test_a_parent_prints_the_line_of_its_child(compiles, capsys):
    messages = [store_job._parse_line(line) for line in (b'{"compiling": true}', b'{"compiling": 1}', b'["compiling"]')]
    assert messages == [{"compiling": True}, {}, {}]
    states = iter([False, True])

    def poll():
        return store_job.JobProgress(done=next(states), report={"read": 1})

    report = store_job.wait_for(lambda: SimpleNamespace(poll=poll, cancel=lambda: None, is_compiling=compiles))
    assert report == {"read": 1} and len(capsys.readouterr().err.splitlines()) == compiles


@pytest.mark.thorough
def test_an_import_notes_that_its_child_compiles(tmp_path):
    environment = os.environ | {"WARP_CACHE_PATH": str(tmp_path / "kernels")}
    command = [sys.executable, "-c", PROGRAM, str(tmp_path / "store")]
    for lines in (2, 1):
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        printed = done.stderr.splitlines()
        assert len(printed) == lines and printed[-1] == "imported", "before the end of the import, and once"
