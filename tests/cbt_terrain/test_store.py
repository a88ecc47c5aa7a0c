# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores: written atomically, opened by mapping, damaged ones refused."""

import json
import os
import time

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain import store
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.importing import ImportSettings, describe, run_import


@pytest.fixture
def island(tmp_path):
    path = tmp_path / "store"
    run_import(ImportSettings(source="island", size=129), path)
    return path


def folders(path):
    return sorted(p.name for p in path.iterdir() if p.is_dir())


def test_a_store_opens_fast_and_read_only_on_disk(island):
    before = {p: p.stat().st_mtime_ns for p in island.rglob("*")}
    start = time.perf_counter()
    field = store.open_store(island)
    assert time.perf_counter() - start < 0.05
    assert field.samples.shape == (129, 129) and field.path == island
    assert field.lattice.step_x == 64.0
    field.samples[:] = 0.0  # the mapping is private
    assert store.open_store(island).max_height == store.open_store(island).samples.max() > 1000.0
    assert {p: p.stat().st_mtime_ns for p in island.rglob("*")} == before


def test_meshlet_errors_are_kept_in_the_store(island):
    errors = store.open_store(island).error_for(1)
    assert len(list(island.glob("data-*/error_m1.npy"))) == 1
    kept = store.open_store(island).error_for(1)
    assert np.array_equal(kept, errors) and not list(island.glob("data-*/*.part"))


def test_a_store_that_cannot_be_written_still_gives_meshlet_errors(island, monkeypatch):
    def full(*_args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store.np, "save", full)
    assert store.open_store(island).error_for(1).shape == store.open_store(island).error.shape
    assert not list(island.glob("data-*/error_m1*"))


def test_a_new_version_replaces_the_old_one_while_it_is_in_use(island):
    old = store.open_store(island)
    peak, names = float(old.samples.max()), folders(island)
    run_import(ImportSettings(source="island", size=129, seed=8), island)
    assert len(folders(island)) == 1 and folders(island) != names
    assert float(old.samples.max()) == peak  # still mapped
    assert old.error_for(1).shape == old.error.shape  # kept in memory, not in the other terrain's folder
    assert not list(island.glob("data-*/error_m1*"))
    assert store.open_store(island).key != old.key


def test_leftovers_of_dead_imports_go_after_a_day(island):
    fresh, stale = island / "data-fresh", island / "data-stale"
    for folder in (fresh, stale):
        folder.mkdir()
    os.utime(stale, (time.time() - 2 * store.STALE_SECONDS,) * 2)
    run_import(ImportSettings(source="island", size=65), island)
    assert fresh.exists() and not stale.exists()


def test_a_store_replaced_while_it_is_opened_is_opened_again(island, monkeypatch):
    real, calls = store.read_json, []

    def outdated_once(path):
        content = real(path)
        calls.append(1)
        return content | {"data": "data-gone"} if len(calls) == 1 else content

    monkeypatch.setattr(store, "read_json", outdated_once)
    assert store.open_store(island).samples.shape == (129, 129)


def damage(path, how):
    content = json.loads((path / "store.json").read_text())
    data = path / content["data"]
    if how == "no json":
        (path / "store.json").unlink()
    elif how == "half a json":
        (path / "store.json").write_text('{"version": 1, "da')
    elif how == "other version":
        (path / "store.json").write_text(json.dumps(content | {"version": 99}))
    elif how == "no lattice":
        del content["lattice"]
        (path / "store.json").write_text(json.dumps(content))
    elif how == "array missing":
        (data / "error.npy").unlink()
    elif how == "array truncated":
        os.truncate(data / "error.npy", 1000)
    elif how == "array of another shape":
        np.save(data / "samples.npy", np.zeros((5, 5), np.float32))


DAMAGES = {
    "no json": "no terrain store",
    "half a json": "cannot be read",
    "other version": "version 99, expected 1",
    "no lattice": "damaged",
    "array missing": "lacks error.npy",
    "array truncated": "error.npy is damaged",
    "array of another shape": r"\(5, 5\), expected float32 \(129, 129\)",
}


@pytest.mark.parametrize("how", DAMAGES)
def test_a_damaged_store_is_a_clear_error(island, how):
    damage(island, how)
    with pytest.raises(TerrainError, match=DAMAGES[how]):
        store.open_store(island)
    run_import(ImportSettings(source="island", size=129), island)  # and importing again mends it
    assert store.open_store(island).samples.shape == (129, 129)


def test_describe_names_units_and_is_plain_data(island):
    about = describe(island)
    assert about["samples"] == [129, 129] and about["extent_m"] == [8192.0, 8192.0]
    assert about["highest_m"] > 1000.0 and about["largest_error_m"] > 0.0
    json.dumps(about)
    with pytest.raises(TerrainError, match="no terrain store"):
        describe(island / "nowhere")
