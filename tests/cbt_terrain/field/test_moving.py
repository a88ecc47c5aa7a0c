# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores that move to another folder are never lost, and a move that was interrupted goes on."""

import os
from contextlib import suppress
from pathlib import Path

import pytest
from adaptive_terrain.cbt_terrain.field import moving
from adaptive_terrain.cbt_terrain.field.moving import find_moved, move_stores
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.run import partial_files
from fields import contents, write_store


@pytest.fixture
def old(tmp_path):
    """Write two stores, one of them with land and maps, and a file of the user."""
    folder = tmp_path / "old" / "adaptive_terrain" / "stores"
    write_store(folder / "hills", 1)
    write_store(folder / "hills_land" / "0123456789abcdef", 2)
    (folder / "hills_land" / "0123456789abcdef.json").write_text("tiles")
    (folder / "hills_maps" / "mark").mkdir(parents=True)
    (folder / "hills_maps" / "mark" / "snow.png").write_bytes(b"png")
    write_store(folder / "sea", 3)
    (folder / "notes.txt").write_text("mine")
    return folder


@pytest.fixture
def new(tmp_path):
    return tmp_path / "new" / "adaptive_terrain" / "stores"


@pytest.fixture(params=["one file system", "two file systems"])
def systems(request, monkeypatch):
    """Run a test on one file system, and with `old` on what seems to be another device."""
    if request.param == "one file system":
        return
    real_lstat, real_rename = os.lstat, os.rename

    def lstat(path, **more):
        found = real_lstat(path, **more)
        return os.stat_result([*found[:2], found.st_dev + 1, *found[3:]]) if "old" in Path(path).parts else found

    def rename(first, second, **more):
        if ("old" in Path(first).parts) != ("old" in Path(second).parts):
            raise OSError(18, "Invalid cross-device link")
        real_rename(first, second, **more)

    monkeypatch.setattr(moving.os, "lstat", lstat)
    monkeypatch.setattr(moving.os, "rename", rename)


def test_everything_moves_and_can_be_opened(old, new, systems):
    before = contents(old)
    moved = move_stores(old, new)
    assert moved.stores == ["hills", "sea"] and not moved.failures
    assert contents(new) == before and not old.exists()
    assert open_store(new / "hills").samples.shape == (17, 17)


@pytest.mark.parametrize("count", range(1, 14, 2))
def test_an_interrupted_move_loses_nothing_and_goes_on(old, new, systems, monkeypatch, count):
    """The process ends at the `count`th change of the disk."""
    before, calls = contents(old), 0

    def stop_at(function):
        def stopped(*given, **more):
            nonlocal calls
            calls += 1
            if calls == count:
                raise KeyboardInterrupt
            return function(*given, **more)

        return stopped

    with monkeypatch.context() as patch, suppress(KeyboardInterrupt):
        for name in ("copytree", "copy2"):
            patch.setattr(moving.shutil, name, stop_at(getattr(moving.shutil, name)))
        for name in ("remove_tree", "remove_empty", "remove_file"):
            patch.setattr(moving, name, stop_at(getattr(moving, name)))
        patch.setattr(moving.os, "rename", stop_at(moving.os.rename))
        move_stores(old, new)
    assert calls >= count or moving.os.lstat(old.parent).st_dev == moving.os.stat(new.parent).st_dev
    both = set(contents(new).values()) | set(contents(old).values() if old.exists() else ())
    assert both >= set(before.values())
    move_stores(old, new) if old.exists() else None
    assert contents(new) == before
    assert not old.exists() or all(entry.name.startswith(".partial-") for entry in old.iterdir())


def test_a_killed_copy_is_no_hindrance_and_goes(old, new, systems):
    half = new / f".partial-{partial_files.new_token()}"
    half.parent.mkdir(parents=True)
    os.close(partial_files.make_folder(half))
    write_store(half / "hills", 1)
    before = contents(old)
    move_stores(old, new)
    assert contents(new) == before and not half.exists()


def test_a_store_of_the_same_name_stays_and_both_are_found(old, new):
    other = write_store(new / "hills", 7)
    (new / "hills_land").mkdir()
    before, there = contents(old), contents(other)
    assert move_stores(old, new).stores == ["hills_moved", "sea"]
    assert contents(other) == there
    assert contents(new / "hills_moved") == {k[6:]: v for k, v in before.items() if k.startswith("hills/")}
    assert (new / "hills_moved_land" / "0123456789abcdef" / "store.json").exists()
    assert find_moved(str(old / "hills"), new) == str(new / "hills_moved")
    assert find_moved(str(old / "hills_maps" / "mark"), new) == str(new / "hills_moved_maps" / "mark")


def test_a_store_that_cannot_be_moved_stays_and_is_named(old, new, monkeypatch):
    before, real = contents(old), os.rename

    def rename(first, second):
        if Path(first).name == "hills":
            raise PermissionError(13, "Permission denied")
        real(first, second)

    with monkeypatch.context() as patch:
        patch.setattr(moving.os, "rename", rename)
        moved = move_stores(old, new)
    assert moved.stores == ["sea"] and moved.failures == [f"{old / 'hills'}: Permission denied"]
    assert open_store(old / "hills").key
    assert move_stores(old, new).stores == ["hills"] and contents(new) == before


@pytest.mark.parametrize("systems", ["two file systems"], indirect=True)
def test_a_full_disk_is_named_and_costs_no_store(old, new, systems, monkeypatch):
    before, real = contents(old), moving.shutil.copy2

    def copy2(source, target):
        if Path(source).name == "samples.npy" and "hills" in Path(source).parts:
            raise OSError(28, "No space left on device")
        return real(source, target)

    monkeypatch.setattr(moving.shutil, "copy2", copy2)
    moved = move_stores(old, new)
    assert moved.stores == ["sea"]
    what = f"{old / 'hills'}: samples.npy cannot be copied"
    assert moved.failures[0] == f"{what} (No space left on device): make room or allow access."
    assert contents(old) | contents(new) == before and not list(new.glob(".partial-*"))
    assert (old / "hills_land").is_dir() and (old / "hills_maps").is_dir(), "they stay beside their store"


@pytest.mark.parametrize(
    "path",
    [
        "/home/a/.user/user_default/adaptive_terrain/stores/sea",
        r"C:\Users\a\extensions\.user\user_default\adaptive_terrain\stores\sea",
    ],
)
def test_a_path_of_any_old_folder_leads_to_the_new_one(new, path):
    assert find_moved(path, new) == ""
    write_store(new / "sea", 1)
    assert find_moved(path, new) == str(new / "sea")


@pytest.mark.parametrize(
    "path", ["", "/a/stores/sea", "/adaptive_terrain/stores/..", "/adaptive_terrain/stores/sea/../x"]
)
def test_other_paths_lead_nowhere(new, path):
    write_store(new / "sea", 1)
    assert find_moved(path, new) == ""


@pytest.mark.parametrize("linked", ["source", "target", "orphan", "store"])
def test_links_are_not_followed(old, new, tmp_path, linked):
    """They stay where they are, their targets keep all files, and other stores are moved."""
    precious = tmp_path / "precious"
    (precious / "thesis").mkdir(parents=True)
    (precious / "mine.txt").write_text("mine")
    if linked == "source":
        write_store(new / "hills_land" / "0123456789abcdef", 2)
        (old / "hills_land").rename(tmp_path / "away")
        (old / "hills_land").symlink_to(precious)
    elif linked == "target":
        new.mkdir(parents=True)
        (new / "hills_land").symlink_to(precious)
    else:
        (old / ("lost_land" if linked == "orphan" else "linked")).symlink_to(precious)
    moved = move_stores(old, new)
    assert sorted(os.listdir(precious)) == ["mine.txt", "thesis"] and (precious / "mine.txt").read_text() == "mine"
    assert any("is a link" in failure for failure in moved.failures) and "sea" in moved.stores
    assert open_store(new / "sea").key


def test_deep_folders_are_no_traceback(old, new):
    for top in (old / "hills_maps", new / "hills_maps"):
        deep = top / "/".join(["a"] * 900)
        deep.mkdir(parents=True)
    (new / "hills_maps" / "b").write_text("")
    assert "sea" in move_stores(old, new).stores
