# SPDX-License-Identifier: GPL-3.0-or-later
"""The small store, exported along a flight by the command line."""

import json

import pytest
from adaptive_terrain.operators.cli import command_line

FLIGHT = {
    "fov": 50,
    "clip": [1, 50000],
    "keyframes": [
        {"frame": 1, "eye": [0, -900, 300], "target": [0, 0, 0]},
        {"frame": 4, "eye": [300, -300, 120], "target": [0, 200, 0]},
    ],
}


def run(*arguments) -> int:
    """Run the command line; return its exit code."""
    return command_line.main([str(argument) for argument in arguments])


@pytest.fixture
def flight(tmp_path):
    path = tmp_path / "flight.json"
    path.write_text(json.dumps(FLIGHT))
    return path


@pytest.fixture
def export(store, flight, tmp_path, capsys):
    """Run `export` of the small store; returns the exit code, the output and the folder."""

    def exported(*arguments, out="out", path=flight):
        folder = tmp_path / out
        source = "--store", store, "--path", path, "--resolution", "640x360"
        return run("export", *source, "--out", folder, *arguments), capsys.readouterr(), folder

    return exported


def bytes_of(folder, pattern="*.npz"):
    return {path.name: path.read_bytes() for path in folder.glob(pattern)}
