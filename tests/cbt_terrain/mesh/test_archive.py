# SPDX-License-Identifier: GPL-3.0-or-later
"""The .npz of a surface: the same bytes at any time, and never a half-written file."""

import os
import time
import zipfile

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.mesh.archive import read_npz, write_npz, written_beside
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion


@pytest.fixture(scope="module")
def surface():
    field = from_array(np.fromfunction(lambda y, x: np.sin(x / 3) * y, (33, 33), dtype=np.float32), 2.0)
    return Terrain(field).update(Criterion(error_px=0.0, error_m=0.1)).surface


def test_every_entry_comes_back(surface, tmp_path):
    origin = np.array([500_000.25, 6_400_000.5, 0.0])
    write_npz(tmp_path / "a.npz", surface, origin, {"bound_m": 0.1})
    back = read_npz(tmp_path / "a.npz")
    assert back.pop("info") == {
        "bound_m": 0.1,
        "attributes": {
            "normals": {"domain": "POINT", "unit": ""},
            "uv": {"domain": "POINT", "unit": ""},
            "terrain_level": {"domain": "FACE", "unit": ""},
        },
    }
    expected = {name: getattr(surface, name) for name in ("positions", "triangles", "edges", "normals", "uv")}
    expected["terrain_level"] = surface.level
    assert back.keys() == {"origin", *expected}
    assert np.array_equal(back["origin"], origin) and back["origin"].dtype == np.float64
    for name, array in expected.items():
        assert np.array_equal(back[name], array) and back[name].dtype == array.dtype, name


def test_the_same_surface_is_the_same_bytes_at_any_time(surface, tmp_path, monkeypatch):
    write_npz(tmp_path / "a.npz", surface, np.zeros(3), {"b": 1, "a": 2})
    later = time.time() + 86_400
    monkeypatch.setattr("time.time", lambda: later)
    monkeypatch.setattr("time.localtime", lambda *_: (2031, 5, 6, 7, 8, 9, 0, 1, 0))
    write_npz(tmp_path / "b.npz", surface, np.zeros(3), {"a": 2, "b": 1})
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_info_may_hold_numbers_of_numpy(surface, tmp_path):
    path = str(tmp_path / "a.npz")
    write_npz(path, surface, (1, 2, 3), {"bound_m": np.float32(0.5), "frame": np.int64(7), "eye": np.arange(3)})
    info = read_npz(path)["info"]
    assert (info["bound_m"], info["frame"], info["eye"]) == (0.5, 7, [0, 1, 2])
    write_npz(path, surface)
    assert read_npz(path)["origin"].tolist() == [0, 0, 0]
    with pytest.raises(TerrainError, match="The info of an .npz holds .*object"):
        write_npz(path, surface, info={"field": object()})


def test_a_failed_write_leaves_the_old_file_and_nothing_else(surface, tmp_path, monkeypatch):
    path = tmp_path / "a.npz"
    write_npz(path, surface, np.zeros(3), {})
    before = path.read_bytes()

    def full(self, *_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(zipfile.ZipFile, "writestr", full)
    with pytest.raises(OSError, match="No space left"):
        write_npz(path, surface, np.zeros(3), {"other": True})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_the_temporary_name_keeps_the_suffix(tmp_path):
    with written_beside(tmp_path / "mesh.ply") as partial:
        assert partial.name == "mesh.ply" and partial.parent.parent == tmp_path
        partial.write_text("x")
        assert not (tmp_path / "mesh.ply").exists()
    assert (tmp_path / "mesh.ply").read_text() == "x"


def npz_of(path, how, surface):
    if how == "truncated":
        write_npz(path, surface, np.zeros(3), {})
        os.truncate(path, path.stat().st_size // 2)
    elif how == "npy":
        with path.open("wb") as file:
            np.save(file, np.zeros(3))
    elif how == "pipe":
        os.mkfifo(path)
    elif how == "flipped":
        write_npz(path, surface, np.zeros(3), {})
        content = bytearray(path.read_bytes())
        content[300] ^= 255
        path.write_bytes(content)
    elif how in ("empty", "text"):
        path.write_text("" if how == "empty" else "hello")
    elif how != "missing":
        info = {"no info": None, "bad JSON": "{", "no object": "5", "objects": np.array([{}], object)}[how]
        np.savez(path, **({"positions": np.zeros(3)} if info is None else {"info": np.array(info)}))


HOWS = [
    "empty",
    "text",
    "truncated",
    "flipped",
    "npy",
    "pipe",
    "missing",
    "no info",
    "bad JSON",
    "no object",
    "objects",
]


@pytest.mark.parametrize("how", HOWS)
def test_a_file_that_is_no_export_gives_one_sentence(surface, tmp_path, how):
    path = tmp_path / "a.npz"
    npz_of(path, how, surface)
    with pytest.raises(TerrainError, match="(not an .npz that this add-on exported|cannot be read).*a.npz") as caught:
        read_npz(path)
    assert "\n" not in str(caught.value)


def test_a_number_that_json_lacks_is_refused(surface, tmp_path):
    write_npz(tmp_path / "a.npz", surface, info={"bound_m": 1.5})
    with np.load(tmp_path / "a.npz") as file:
        entries = dict(file)
    entries["info"] = np.array(str(entries["info"]).replace("1.5", "NaN"))
    np.savez(tmp_path / "b.npz", **entries)
    with pytest.raises(TerrainError, match="has the number NaN"):
        read_npz(tmp_path / "b.npz")
