# SPDX-License-Identifier: GPL-3.0-or-later
"""A small store and a flight over it, for tests of exports, and the files of an undisturbed export."""

import json
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.mesh.archive import read_npz
from adaptive_terrain.operators.cli import command_line

FRAMES = 8


def hills_flight(folder: Path) -> list[str]:
    """Build a store and a path in `folder`; return the arguments of an export of FRAMES frames, without --out."""
    y, x = np.mgrid[0:129, 0:129].astype(np.float32)
    np.save(folder / "hills.npy", 20 * np.sin(x / 5) * np.cos(y / 6))
    keys = [
        {"frame": 1, "eye": [0, -90, 60], "target": [0, 0, 0]},
        {"frame": FRAMES, "eye": [40, -20, 50], "target": [0, 20, 0]},
    ]
    (folder / "flight.json").write_text(json.dumps({"keyframes": keys}))
    store = str(folder / "hills.store")
    assert command_line.main(["import", str(folder / "hills.npy"), "--store", store]) == 0
    source = ["export", "--store", store, "--path", str(folder / "flight.json"), "--resolution", "640x360"]
    return [*source, "--frames", f"1-{FRAMES}", "--format", "npz"]


@pytest.fixture(scope="session")
def arguments(tmp_path_factory):
    """Return the arguments, without --out, of an export of a flight over a small store."""
    return hills_flight(tmp_path_factory.mktemp("flight"))


@pytest.fixture(scope="session")
def undisturbed(arguments, tmp_path_factory):
    """Return the bytes of every mesh of an undisturbed export, by name."""
    out = tmp_path_factory.mktemp("undisturbed")
    assert command_line.main([*arguments, "--out", str(out)]) == 0
    meshes = final_meshes(out)
    assert len(meshes) == FRAMES
    return meshes


def final_meshes(out: Path) -> dict[str, bytes]:
    """Return the bytes of every mesh with a final name, and assert that each can be read completely."""
    paths = [path for path in out.glob("*.npz") if not path.name.startswith(".")]
    for path in paths:
        assert read_npz(path)["info"]["frame"] == int(path.stem[-4:])
    return {path.name: path.read_bytes() for path in paths}


def assert_complete(out: Path, undisturbed: dict[str, bytes]) -> None:
    """Assert that a folder has the meshes of an undisturbed export, their summaries, and no other file."""
    assert final_meshes(out) == undisturbed
    summaries = sorted(out.glob("frame_*.json"))
    names = sorted(undisturbed)
    assert [json.loads(path.read_text())["files"] for path in summaries] == [{n: len(undisturbed[n])} for n in names]
    assert not list(out.glob(".partial-*"))
