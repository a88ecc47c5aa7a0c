# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths that no system can have are usage errors of every verb, and a TerrainError of the library."""

import argparse
from contextlib import suppress

import pytest
from adaptive_terrain.cbt_terrain.errors import MAX_NAME_BYTES, MAX_PATH_BYTES, TerrainError, path_fault
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.operators.cli.argument_types import path, path_text
from adaptive_terrain.operators.cli.command_line import _with_negatives_joined, main
from adaptive_terrain.operators.cli.parser import build_parser

IMPOSSIBLE = {
    "NUL": "a\0b",
    "long name": "x" * (MAX_NAME_BYTES + 1),
    "long name of two bytes a letter": "é" * (MAX_NAME_BYTES // 2 + 1),
    "long path": "ab/" * (MAX_PATH_BYTES // 3),
    "no character": "a\ud800b",
}
PLACES = ("DIR", "FILE", "FILE.json", "FILE.csv", "X.blend", "ZIP")  # names of paths in the help
POSITIONAL = ("source", "path", "folder")


def path_arguments() -> list[tuple[str, argparse.Action]]:
    """Return the arguments of every verb that name a file or a folder."""
    [verbs] = [action for action in build_parser()._actions if isinstance(action, argparse._SubParsersAction)]
    return [
        (verb, action)
        for verb, parser in verbs.choices.items()
        for action in parser._actions
        if action.metavar in PLACES or action.dest in POSITIONAL and not action.option_strings
    ]


@pytest.mark.parametrize("number", ["-1e9", "-.5", "-3.4e+38", "-5--1", "-inf"])
def test_options_take_values_that_begin_with_a_minus(number, capsys):
    """argparse alone takes an exponent for an option: "expected one argument"."""
    [verbs] = [action for action in build_parser()._actions if isinstance(action, argparse._SubParsersAction)]
    tried = 0
    for parser in verbs.choices.values():
        for action in parser._actions:
            if action.option_strings and action.nargs is None and action.type is not None:
                with suppress(SystemExit):
                    parser.parse_args(_with_negatives_joined([action.option_strings[0], number]))
                tried += 1
    assert tried > 50 and "expected one argument" not in capsys.readouterr().err


def test_every_path_of_every_verb_is_checked():
    found = path_arguments()
    assert len(found) > 30
    assert [(verb, action.dest) for verb, action in found if action.type not in (path, path_text)] == []


@pytest.mark.parametrize("name", IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_impossible_paths_are_usage_errors(name, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for arguments in (
        ["import", name, "--store", "s"],
        ["import", "island", "--store", name],
        ["info", name],
        ["query", "--store", "s", "--points", name],
        ["verify", name, "--frames", "1"],
    ):
        assert main(arguments) == 2, arguments[0]
        last = capsys.readouterr().err.splitlines()[-1]
        assert ": error: argument " in last and last.isprintable() and last.endswith(".") and len(last) < 500
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_impossible_paths_are_terrain_errors(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for use in (open_store, lambda path: import_source("island", path)):
        with pytest.raises(TerrainError) as caught:
            use(name)
        assert str(caught.value).startswith("The store ") and str(caught.value).isprintable()
    assert list(tmp_path.iterdir()) == []


def test_the_longest_possible_paths_have_no_fault(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = "x" * MAX_NAME_BYTES
    assert path_fault("a", name) is None and path_fault("a", tmp_path / name) is None
    (tmp_path / name).write_text("a")  # the system agrees
    room = MAX_PATH_BYTES - 1 - len(str(tmp_path)) - 1
    longest = ("a/" * room)[: room - 1] + "a"
    assert path_fault("a", longest) is None and path_fault("a", longest + "b") is not None
