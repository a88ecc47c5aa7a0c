# SPDX-License-Identifier: GPL-3.0-or-later
"""Untrusted names in printed lines cannot control a terminal or a farm."""

import ast
import json
from pathlib import Path

import pytest
from adaptive_terrain.operators.text.console import OPENJD, Progress, one_line, print_line
from store_exports import run

ROOT = Path(__file__).resolve().parents[3]
NAMES = [
    "a\nopenjd_fail: b",
    "a\ropenjd_fail: b",
    "a\u2028openjd_fail: b",
    "a\x85b",
    "\x1b[2Jred",
    "a\x0cb\x0b",
    "\u202ertl",
]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("show", [OPENJD, False])
def test_a_name_makes_neither_lines_nor_commands(name, show, capsys):
    bar = Progress(1.0, name, show)
    bar.say(f"{name}: done")
    printed = [line for line in capsys.readouterr().out.split("\n") if not line.startswith("openjd_progress: ")]
    assert len(printed) == 2 and printed[1] == "" and printed[0].isprintable()
    assert printed[0].startswith("openjd_status: ") == (show == OPENJD)


def test_only_messages_look_like_messages(capsys):
    for text in ("openjd_fail: x", "openjd_env: A=1", "openjd_status: y"):
        print_line(text)
    print_line("openjd_fail: x", "openjd_status")
    print_line("  two   spaces\tstay")
    lines = capsys.readouterr().out.split("\n")
    assert [line.startswith("openjd_") for line in lines] == [False, False, False, True, False, False]
    assert lines[3:5] == ["openjd_status: openjd_fail: x", "  two   spaces stay"]
    assert one_line("a" * 20_000) == "a" * 10_000 + "..."


def test_an_object_with_lines_in_its_name_is_one_status(scene, add_terrain, tmp_path, capsys):
    import bpy

    obj = add_terrain()
    obj.name = "T\nopenjd_fail: gone\u2028\x1b[31m"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    capsys.readouterr()
    assert run("prepare", "--scene", tmp_path / "scene.blend", "--frames", "1", "--progress", "openjd") == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("openjd_status: T openjd_fail: gone") for line in lines)
    assert {line.split(":")[0] for line in lines} <= {"openjd_status", "openjd_progress"}


def test_a_failure_is_one_message(tmp_path, capsys):
    missing = tmp_path / "a\nopenjd_env: A=1\n.json"
    code = run("verify", missing, "--frames", "1", "--progress", "openjd")
    lines = capsys.readouterr().out.splitlines()
    assert code == 1 and [line for line in lines if line.startswith("openjd_env")] == []
    assert sum(line.startswith("openjd_fail: ") for line in lines) == 1


def test_files_of_a_job_hold_no_raw_control_characters(tmp_path):
    from adaptive_terrain.operators.farm.bundle import FarmJob, write_bundle

    blend = tmp_path / "a\nb\u2028\x1b[31m.blend"
    job = FarmJob("n\nm", blend, [1], 1, ["npz"], tmp_path / "out", "1", None, [blend], [tmp_path], [])
    write_bundle(job, tmp_path)
    texts = [
        (tmp_path / name).read_text(encoding="utf-8") for name in ("parameter_values.yaml", "asset_references.yaml")
    ]
    assert all(c.isprintable() or c == "\n" for text in texts for c in text)
    values = {entry["name"]: entry["value"] for entry in json.loads(texts[0])["parameterValues"]}
    assert values["BlenderFile"] == str(blend) and values["JobName"] == "n m"
    assert json.loads(texts[1])["assetReferences"]["inputs"]["filenames"] == [str(blend)]


def test_the_product_prints_by_one_function():
    """Only `print_line` calls `print` with a text, except the farm's guard, a standalone script."""
    found = set()
    for path in (ROOT / "operators").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "print" and node.args:
                found.add((path.relative_to(ROOT / "operators").as_posix(), ast.unparse(node)))
    allowed = {"text/console.py": 3, "farm/guard.py": 4, "cli/command_line.py": 1}
    counts = {}
    for file, _ in found:
        counts[file] = counts.get(file, 0) + 1
    assert counts == allowed | {file: n for file, n in counts.items() if file.startswith("demo/")}
