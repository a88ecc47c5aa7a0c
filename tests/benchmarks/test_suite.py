# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that a run of the benchmark writes, and its failures."""

import importlib.util
import json
import os
import re
from dataclasses import asdict

import pytest
from adaptive_terrain.benchmarks import suite
from adaptive_terrain.benchmarks.pages import goals, report
from adaptive_terrain.benchmarks.rig.measure import BenchmarkRow
from adaptive_terrain.benchmarks.rows import in_program
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.cli import command_line


def a_program(tmp_path, script: str) -> list[str]:
    path = tmp_path / "blender"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return [str(path)]


def test_a_row_comes_from_inside_a_program(tmp_path):
    row = BenchmarkRow("program_frame", 1_000_000, 13.0, "plain_ingest", 240.0, steps={"mesh": 12.0})
    line = in_program.MARK + json.dumps(asdict(row))
    command = a_program(tmp_path, f"echo another line\necho '{line}'\necho Blender quit")
    assert in_program.program_frame_row(command, tmp_path) == row and row.name in goals.ROWS
    with pytest.raises(TerrainError, match=r"has measured nothing \(Blender quit\)"):
        in_program.program_frame_row(a_program(tmp_path, "echo Blender quit"), tmp_path)


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("echo Krita 5", "no Blender program"),
        ("echo no display >&2; exit 3", "ended with code 3 \\(no display\\)"),
        ("printf 'Krita \\351'", "no Blender program"),
    ],
)
def test_a_program_that_is_not_blender_is_refused_first(one_row, tmp_path, capsys, script, message):
    assert command_line.main(["bench", "--quick", "--blender", *a_program(tmp_path, script)]) == 1
    printed = capsys.readouterr()
    assert re.search(message, printed.err) and not printed.out
    assert command_line.main(["bench", "--quick", "--blender", str(tmp_path / "nothing")]) == 1
    assert "cannot be started" in capsys.readouterr().err


@pytest.fixture
def one_row(monkeypatch):
    """Replace the suite by one row that fails its goal."""
    monkeypatch.setattr(suite, "build_roam_rebuild", lambda *_: None)
    monkeypatch.setattr(
        suite, "list_measures", lambda *_: [lambda: BenchmarkRow("maps_normal", 1_000_000, 200.0, "numpy", 100.0)]
    )


def test_a_quick_run_that_is_too_slow_fails_once_written(one_row, tmp_path, capsys):
    target = tmp_path / "rows.json"
    assert command_line.main(["bench", "--quick", "--json", str(target)]) == 1
    captured = capsys.readouterr()
    assert captured.err == (
        "adaptive-terrain: error: Rows were slower than allowed in each of 3 attempts: "
        "maps_normal at 1,000,000 (ratio 2, at most 1.5).\n"
    )
    [row] = json.loads(target.read_text())
    assert row["attempts"] == 3 and captured.out.count("goal 1: missed") == 3
    assert command_line.main(["bench"]) == 0


def test_an_extension_without_benchmarks_has_no_such_verb(monkeypatch, capsys):
    assert command_line.main(["--help"]) == 0
    assert "bench " in capsys.readouterr().out
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, package: None)
    assert command_line.main(["--help"]) == 0
    assert "bench" not in capsys.readouterr().out
    assert command_line.main(["bench"]) == 2
    assert "invalid choice: 'bench'" in capsys.readouterr().err


def test_documents_are_written_only_where_asked(one_row, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command_line.main(["bench"]) == 0
    assert list(tmp_path.iterdir()) == []
    assert command_line.main(["bench", "--docs", "docs"]) == 0
    assert (tmp_path / "docs" / "performance.md").exists()
    assert command_line.main(["bench", "--quick", "--docs", "docs"]) == 2
    assert "--quick leaves rows out" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--json", "--docs"])
def test_unwritable_files_are_reported_before_measuring(option, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(suite, "list_measures", lambda *_: pytest.fail("it was measured"))
    (tmp_path / "file").write_text("in the way")
    assert command_line.main(["bench", option, str(tmp_path / "file" / "below")]) == 1
    captured = capsys.readouterr()
    assert "cannot be written (Not a directory): choose another name." in captured.err and captured.err.count("\n") == 1
    assert captured.out == "" and [path.name for path in tmp_path.iterdir()] == ["file"]


def test_an_interrupted_run_leaves_existing_files(one_row, tmp_path, monkeypatch, capsys):
    def stop():
        raise KeyboardInterrupt

    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(suite.tempfile, "tempdir", None)
    monkeypatch.setattr(suite, "list_measures", lambda *_: [stop])
    (tmp_path / "rows.json").write_text("[]")
    assert command_line.main(["bench", "--json", str(tmp_path / "rows.json")]) == 130
    assert capsys.readouterr().err == "adaptive-terrain: stopped\n"
    assert [path.name for path in tmp_path.iterdir()] == ["rows.json"]
    assert (tmp_path / "rows.json").read_text() == "[]"


def test_results_go_into_a_pipe_too(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    end = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    report.write_json([BenchmarkRow("frame", 1_000_000, 1.0)], tmp_path / "pipe")
    assert json.loads(os.read(end, 10_000))[0]["name"] == "frame"
    os.close(end)
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]
