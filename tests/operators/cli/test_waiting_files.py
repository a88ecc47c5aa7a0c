# SPDX-License-Identifier: GPL-3.0-or-later
"""Pipes in the place of files that a user, a folder or a scene names: one error at once, no waiting."""

import json
import os

import pytest
import store_exports
from rasters import hills, imported, write_raster
from time_limit import time_limit


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run the command line in a folder with a store; returns the exit code and the message."""
    monkeypatch.chdir(tmp_path)
    imported(tmp_path, write_raster(tmp_path / "land.tif", hills(20, 20)), extent=(200.0, 200.0))

    def command(*argv):
        with time_limit(30):
            code = store_exports.run(*argv)
        return code, capsys.readouterr().err

    return command


STACK = {"version": 1, "entries": [{"effect": "snow", "mask": {"image": "pipe.png"}}]}
COMMANDS = {
    "pipe.csv": ["query", "--store", "store", "--points", "pipe.csv"],
    "pipe/maps.json": ["maps", "--store", "store", "--out", "pipe"],
    "pipe.json": ["maps", "--store", "store", "--out", "maps", "--path", "pipe.json"],
    "stack.json": ["shape", "--store", "store", "--stack", "stack.json", "--out", "land"],
    "pipe.png": ["shape", "--store", "store", "--stack", "masked.json", "--out", "land"],
    "store/store.json": ["query", "--store", "store", "--points", "points.csv"],
    "scene.blend": ["export", "--scene", "scene.blend", "--frames", "1", "--format", "npz", "--out", "out"],
    **{
        f"pipe{suffix}": ["import", f"pipe{suffix}", "--extent", "9x9", "--store", "new"]
        for suffix in (".tif", ".vrt", ".exr", ".npy", ".raw", ".asc", ".hgt")
    },
    **{
        f"land{suffix}": ["import", "land.tif", "--extent", "9x9", "--store", "new"]
        for suffix in (".tfw", ".tif.aux.xml", ".tif.msk", ".TIF.OVR", "_RPC.TXT")
    },
}


@pytest.mark.parametrize("pipe", COMMANDS)
def test_a_pipe_is_refused_at_once(pipe, run, tmp_path):
    (tmp_path / "points.csv").write_text("x,y\n0,0\n")
    (tmp_path / "masked.json").write_text(json.dumps(STACK))
    place = tmp_path / pipe
    place.parent.mkdir(exist_ok=True)
    place.unlink(missing_ok=True)
    os.mkfifo(place)
    code, message = run(*COMMANDS[pipe])
    assert code == 1 and message.startswith("adaptive-terrain: error: ") and message.count("\n") == 1
    assert place.name in message and any(way in message for way in ("expected", "again"))


def test_a_summary_that_is_a_pipe_is_damaged(run, tmp_path):
    (tmp_path / "out").mkdir()
    os.mkfifo(tmp_path / "out/frame_0001.json")
    code, message = run("verify", "out", "--frames", "1")
    assert code == 1 and "frame_0001.json is damaged" in message


def test_a_layer_that_is_a_pipe_is_not_copied(run, tmp_path):
    from adaptive_terrain.cbt_terrain.errors import TerrainError
    from adaptive_terrain.cbt_terrain.field.packing import copy_store

    data = json.loads((tmp_path / "store/store.json").read_text())["data"]
    os.mkfifo(tmp_path / "store" / data / "layer_scree.npy")
    with time_limit(30), pytest.raises(TerrainError, match="cannot be copied .*it is not a regular file"):
        copy_store(tmp_path / "store", tmp_path / "copy")
    assert not (tmp_path / "copy").exists()


def test_an_output_that_is_a_descriptor_is_refused(run, tmp_path):
    (tmp_path / "points.csv").write_text("x,y\n0,0\n")
    before = os.readlink("/dev/stdout") if os.path.islink("/dev/stdout") else None
    code, message = run("query", "--store", "store", "--points", "points.csv", "--out", "/dev/stdout")
    assert code == 1 and "/dev/stdout is a device or a pipe" in message
    assert before is None or os.readlink("/dev/stdout") == before


def test_npz_readers_refuse_a_pipe(tmp_path):
    from adaptive_terrain.cbt_terrain.errors import TerrainError
    from adaptive_terrain.cbt_terrain.mesh.archive import read_npz

    os.mkfifo(tmp_path / "a.npz")
    with time_limit(30), pytest.raises(TerrainError, match="it is not a regular file"):
        read_npz(tmp_path / "a.npz")
