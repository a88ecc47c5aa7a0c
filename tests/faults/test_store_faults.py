# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores that are damaged, deleted, or written by several processes at once."""

import json
import os
import subprocess
import sys
import time

import pytest
from adaptive_terrain.cbt_terrain import store as store_module
from adaptive_terrain.cbt_terrain.criterion import Criterion
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.importing import ImportSettings, run_import
from adaptive_terrain.cbt_terrain.store import open_store
from adaptive_terrain.cbt_terrain.terrain import Terrain
from invariants import arrays, assert_invariants

ASKED = Criterion(error_px=0, error_m=20.0, meshlet=1)


@pytest.fixture
def store(tmp_path):
    """A store of 129 x 129 samples that has its errors for meshlets, too."""
    run_import(ImportSettings(source="island", size=129), tmp_path / "store")
    Terrain(open_store(tmp_path / "store"), 1).update(ASKED)
    return tmp_path / "store"


def arrays_of(store):
    [folder] = store.glob("data-*")
    return sorted(folder.iterdir())


def mesh(field):
    update = Terrain(field, 1).update(ASKED)
    assert_invariants(update.surface, field.lattice, meshlet=1)
    return arrays(update.surface)


@pytest.mark.parametrize("left", [0, 1, 100, 4096, 0.5, -1])
@pytest.mark.parametrize("name", ["samples.npy", "error.npy", "ranges.npy", "error_m1.npy"])
def test_an_array_is_cut_short(store, name, left):
    before = mesh(open_store(store))
    [file] = [path for path in arrays_of(store) if path.name == name]
    size = file.stat().st_size
    os.truncate(file, int(size * left) if isinstance(left, float) else left if left >= 0 else size + left)
    if name == "error_m1.npy":  # it is made anew from the others
        assert mesh(open_store(store)) == before
        assert mesh(open_store(store)) == before
        return
    with pytest.raises(TerrainError, match=f"{name}.*import") as caught:
        open_store(store)
    assert "\n" not in str(caught.value)
    run_import(ImportSettings(source="island", size=129), store)  # mends it
    assert mesh(open_store(store)) == before


def test_a_cut_store_is_one_line_of_the_command_line(store, run_command):
    os.truncate(arrays_of(store)[0], 1000)
    done = run_command("info", store)
    assert done.returncode == 1 and len(done.stderr.strip().splitlines()) == 1 and "import" in done.stderr


@pytest.mark.parametrize("part", range(0, 100, 7))
def test_the_json_is_cut_short(store, part):
    content = (store / "store.json").read_bytes()
    (store / "store.json").write_bytes(content[: len(content) * part // 100])
    with pytest.raises(TerrainError, match="store.json cannot be read.*import it again"):
        open_store(store)


def test_arrays_are_deleted_while_they_are_open(store):
    field = open_store(store)
    before = mesh(field)
    for file in arrays_of(store):
        file.unlink()
    assert mesh(field) == before
    with pytest.raises(TerrainError, match="lacks .*: import it again"):
        open_store(store)


IMPORT = """
import sys
from adaptive_terrain.cbt_terrain.importing import ImportSettings, run_import
sys.stdin.read(1)  # all begin at once
run_import(ImportSettings(source="island", size=257, seed=int(sys.argv[2])), sys.argv[1])
"""


def begin_imports(store, seeds):
    started = [
        subprocess.Popen(
            [sys.executable, "-c", IMPORT, str(store), str(seed)], stdin=subprocess.PIPE, stderr=subprocess.PIPE
        )
        for seed in seeds
    ]
    for child in started:
        child.stdin.write(b"g")
        child.stdin.flush()
    return started


@pytest.mark.parametrize("published", [False, True])
def test_another_import_ends_while_a_folder_is_looked_at(tmp_path, monkeypatch, published):
    """It was given up, and its arrays are gone when they are looked at; or there is a store now."""
    (tmp_path / ("data-" + "0" * 32)).mkdir()

    def ended(entry):
        if published:
            (tmp_path / store_module.JSON_NAME).write_text("{}")
        else:
            entry.rmdir()
        return False

    monkeypatch.setattr(store_module, "_is_own", ended)
    store_module.check_target(tmp_path)


@pytest.mark.parametrize("there_before", [False, True])
def test_three_processes_import_into_one_store(tmp_path, there_before):
    store = tmp_path / "store"
    expected = {}
    for seed in (1, 2, 3):
        run_import(ImportSettings(source="island", size=257, seed=seed), tmp_path / f"alone{seed}")
        expected[seed] = mesh(open_store(tmp_path / f"alone{seed}"))
    if there_before:
        run_import(ImportSettings(source="island", size=65), store)
    children = begin_imports(store, (1, 2, 3))
    if there_before:  # whoever reads meanwhile finds a whole store
        while any(child.poll() is None for child in children):
            field = open_store(store)
            assert field.samples.shape in ((65, 65), (257, 257))
            assert float(field.samples.max()) == field.max_height
            time.sleep(0.002)
    assert [(child.communicate()[1], child.returncode) for child in children] == [(b"", 0)] * 3
    field = open_store(store)
    assert mesh(field) == expected[field.provenance["settings"]["seed"]]
    content = json.loads((store / "store.json").read_text())
    assert (store / content["data"]).is_dir()
    # what the losers of a race have left goes with a later import, when it is a day old
    for folder in store.glob("data-*"):
        if folder.name != content["data"]:
            os.utime(folder, (0, 0))
    run_import(ImportSettings(source="island", size=65), store)
    assert len(list(store.glob("data-*"))) == 1
