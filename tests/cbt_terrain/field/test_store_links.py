# SPDX-License-Identifier: GPL-3.0-or-later
"""A store in a stranger's folder: links and names in it never reach the user's other files."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import store as stores
from adaptive_terrain.cbt_terrain.field import store_folder
from adaptive_terrain.cbt_terrain.field.build import build
from adaptive_terrain.cbt_terrain.field.derived_arrays import derive_cached
from adaptive_terrain.cbt_terrain.field.store import Draft, open_store
from adaptive_terrain.cbt_terrain.height_operators.tile_cache import TileCache
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.run.owned_files import NotOursError

pytestmark = pytest.mark.skipif(os.name != "posix", reason="Windows lets only some users make symbolic links")
OTHER = f"data-{'0' * 32}"


def write(path: Path, height: float = 1.0) -> Path:
    """Write a store of 5 x 5 samples; returns its folder of arrays."""
    draft = Draft(path)
    try:
        samples = draft.allocate("samples", (5, 5), np.float32)
        samples[:] = height
        field = build(samples, 8.0, 8.0, missing=0, allocate=draft.allocate)
        draft.remove("errors")
        draft.publish(field, str(height), {})
    finally:
        draft.discard_unless_published()
    return draft.folder


def content(folder: Path) -> dict:
    return {str(file): (file.read_bytes(), file.stat().st_mtime_ns) for file in folder.rglob("*") if file.is_file()}


@pytest.fixture
def precious(tmp_path):
    """Write a store of the user with a note in it."""
    write(tmp_path / "precious")
    (tmp_path / "precious" / "notes.txt").write_text("mine")
    return tmp_path / "precious"


def test_a_store_that_is_a_link_is_read_and_never_replaced(tmp_path, precious):
    link, before = tmp_path / "st", content(precious)
    link.symlink_to(precious)
    assert open_store(link).samples.shape == (5, 5)
    for replace in (
        lambda: write(link, 2.0),
        lambda: run_import(ImportSettings("island", size=65), link),
        lambda: store_folder.check_target(link),
        lambda: store_folder.remove_store(link),
    ):
        with pytest.raises(TerrainError, match=r"st is a link; expected a folder .*: move it away"):
            replace()
    assert content(precious) == before and link.is_symlink()


def test_the_folders_above_a_store_may_be_links(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "home").symlink_to(tmp_path / "disk")
    write(tmp_path / "home" / "st")
    write(tmp_path / "home" / "st", 2.0)
    assert len(list((tmp_path / "disk" / "st").glob("data-*"))) == 1
    store_folder.remove_store(tmp_path / "home" / "st")
    assert list((tmp_path / "disk").iterdir()) == []


def test_an_old_version_that_is_a_link_is_left(tmp_path, precious):
    """store.json names a folder of arrays that leads to those of another store."""
    store, [arrays] = tmp_path / "st", precious.glob("data-*")
    data, before = write(store), content(precious)
    data.rename(tmp_path / "moved")
    data.symlink_to(arrays)
    with pytest.raises(NotOursError, match=f"{data.name} is a link"):
        open_store(store)
    write(store, 2.0)
    assert open_store(store).samples.max() == 2.0 and content(precious) == before and data.is_symlink()
    store_folder.remove_store(store)
    assert content(precious) == before and not (store / "store.json").exists() and data.is_symlink()


@pytest.mark.parametrize("name", ["../precious", "../precious/data-0", "/", ".", "..", OTHER + "/../../precious"])
def test_names_that_leave_the_store_are_not_followed(tmp_path, precious, name):
    store, before = tmp_path / "st", content(precious)
    write(store)
    file = store / "store.json"
    damaged = json.loads(file.read_text()) | {"data": name}
    file.write_text(json.dumps(damaged | {"sum": stores._sum_of(damaged)}))
    with pytest.raises(TerrainError, match="its 'data' is"):
        open_store(store)
    write(store, 2.0)
    store_folder.remove_store(store)
    assert content(precious) == before


def test_a_users_file_in_a_folder_of_arrays_keeps_it(tmp_path):
    """The folder of the version before is not removed."""
    data = write(tmp_path / "st")
    (data / "notes.txt").write_text("mine")
    write(tmp_path / "st", 2.0)
    assert (data / "notes.txt").read_text() == "mine" and open_store(tmp_path / "st").samples.max() == 2.0
    store_folder.remove_store(tmp_path / "st")
    assert list(content(tmp_path)) == [str(data / name) for name in os.listdir(data)] and len(os.listdir(data)) == 4


def test_hard_links_lose_a_name_and_keep_their_bytes(tmp_path, precious):
    data, before = write(tmp_path / "st"), content(precious)
    for name in ("samples.npy", "error.npy"):
        (data / name).unlink()
        os.link(next(precious.glob(f"data-*/{name}")), data / name)
    (tmp_path / "st" / "store.json").unlink()
    os.link(precious / "store.json", tmp_path / "st" / "store.json")
    write(tmp_path / "st", 2.0)
    store_folder.remove_store(tmp_path / "st")
    assert content(precious) == before


def test_a_store_json_that_is_a_link_is_refused(tmp_path, precious):
    (tmp_path / "st").mkdir()
    link, before = tmp_path / "st" / "store.json", content(precious)
    link.symlink_to(precious / "store.json")
    for use in (open_store, store_folder.check_target, store_folder.remove_store):
        with pytest.raises(NotOursError, match="store.json is a link; expected a file"):
            use(tmp_path / "st")
    link.unlink()
    link.symlink_to(tmp_path / "nothing")
    with pytest.raises(NotOursError, match="store.json is a link"):
        store_folder.check_target(tmp_path / "st")
    assert content(precious) == before


def test_a_kept_array_is_not_written_through_a_link(tmp_path, precious):
    data, before = write(tmp_path / "st"), content(precious)
    (data / "error_m1.npy").symlink_to(precious / "notes.txt")
    with pytest.raises(NotOursError, match="error_m1.npy is a link"):
        derive_cached(open_store(tmp_path / "st").raster, {"error_m1": ((3,), np.uint8)}, lambda _arrays: None)
    assert content(precious) == before


def test_tiles_behind_links_are_neither_read_nor_written(tmp_path, precious):
    before, key = content(precious), "0" * 32
    (tmp_path / "tiles").symlink_to(precious)
    with pytest.raises(NotOursError, match="tiles is a link; expected a folder"):
        TileCache(tmp_path / "tiles")
    (tmp_path / "tiles").unlink()
    cache = TileCache(tmp_path / "tiles")
    cache.take("relief", "1" * 32, (2, 3), lambda: np.ones((2, 3), np.float32))
    (tmp_path / "tiles" / f"{key}.npy").symlink_to(tmp_path / "tiles" / f"{'1' * 32}.npy")
    with pytest.raises(NotOursError, match=f"{key}.npy is a link; expected a file"):
        cache.take("relief", key, (2, 3), lambda: np.zeros((2, 3), np.float32))
    (tmp_path / "tiles" / f"{'2' * 32}.npy").symlink_to(precious / "notes.txt")
    cache._used.clear()
    cache.trim(0)
    left = sorted(os.listdir(tmp_path / "tiles"))
    assert left == [f"{key}.npy", f"{'2' * 32}.npy"] and content(precious) == before
    with pytest.raises(NotOursError, match="st/tiles is a link"):
        write(tmp_path / "st")
        (tmp_path / "st" / "tiles").symlink_to(precious)
        store_folder.remove_store(tmp_path / "st")
    assert content(precious) == before


def test_a_store_swapped_for_a_link_keeps_its_target(tmp_path, precious):
    """Between the making of a draft and its publication."""
    store, before = tmp_path / "st", content(precious)
    draft = Draft(store)
    samples = draft.allocate("samples", (5, 5), np.float32)
    field = build(samples, 8.0, 8.0, missing=0, allocate=draft.allocate)
    store.rename(tmp_path / "moved")
    store.symlink_to(precious)
    with pytest.raises((OSError, NotOursError)):
        draft.publish(field, "", {})
    draft.discard_unless_published()
    assert content(precious) == before
