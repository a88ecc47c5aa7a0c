# SPDX-License-Identifier: GPL-3.0-or-later
"""A copy of a store is whole or is not there, and the store that it was made from stays."""

import os

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import packing
from adaptive_terrain.cbt_terrain.field.packing import copy_store
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.field.store_folder import new_data_name
from adaptive_terrain.cbt_terrain.run import partial_files
from fields import contents, write_store


@pytest.fixture
def no_links(monkeypatch):
    def fail(*_arguments):
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr(os, "link", fail)


@pytest.mark.parametrize("linked", [True, False])
def test_a_copy_has_the_same_bytes_and_the_source_stays(tmp_path, linked, request):
    if not linked:
        request.getfixturevalue("no_links")
    source, told = write_store(tmp_path / "source", 1), []
    before = contents(source)
    copy_store(source, tmp_path / "new" / "copy", told.append)
    assert contents(tmp_path / "new" / "copy") == before == contents(source)
    assert told == sorted(told) and told[-1] == 1.0
    assert open_store(tmp_path / "new" / "copy").key == open_store(source).key
    copy_store(source, tmp_path / "new" / "copy")
    assert contents(tmp_path / "new" / "copy") == before, "once more changes nothing"


def test_a_copy_is_not_touched_by_another_import_into_its_source(tmp_path):
    source = write_store(tmp_path / "source", 1)
    copy_store(source, tmp_path / "copy")
    before = contents(tmp_path / "copy")
    write_store(source, 2)
    assert contents(tmp_path / "copy") == before and open_store(source).key != open_store(tmp_path / "copy").key


def test_another_terrains_store_is_never_overwritten(tmp_path):
    source, other = write_store(tmp_path / "source", 1), write_store(tmp_path / "other", 2)
    before = contents(other)
    with pytest.raises(TerrainError, match="holds the store of another terrain"):
        copy_store(source, other)
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("mine")
    with pytest.raises(TerrainError, match="is no terrain store"):
        copy_store(source, tmp_path / "notes")
    assert contents(other) == before and contents(tmp_path / "notes") == {"mine.txt": b"mine"}


def test_a_copy_that_ends_early_leaves_nothing(tmp_path, no_links, monkeypatch):
    source = write_store(tmp_path / "source", 1)
    before = contents(source)

    def stop(_fraction):
        raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        copy_store(source, tmp_path / "copy", stop)
    assert not (tmp_path / "copy").exists()
    copied = packing._copy

    def damage(source, target, *others):
        done = copied(source, target, *others)
        target.write_bytes(target.read_bytes()[:-1] + b"?")
        return done

    monkeypatch.setattr(packing, "_copy", damage)
    with pytest.raises(TerrainError, match="another file after it was copied"):
        copy_store(source, tmp_path / "copy")
    assert not (tmp_path / "copy").exists() and contents(source) == before


def test_a_copy_that_cannot_be_opened_is_no_store(tmp_path, no_links, monkeypatch):
    """The arrays change after the copy was compared, as on a failing disk."""
    source = write_store(tmp_path / "source", 1)
    compared = packing._copy_arrays

    def damage(source, target, on_progress):
        compared(source, target, on_progress)
        (target / "samples.npy").write_bytes(b"half")

    monkeypatch.setattr(packing, "_copy_arrays", damage)
    with pytest.raises(TerrainError, match="samples.npy is damaged"):
        copy_store(source, tmp_path / "copy")
    assert not (tmp_path / "copy").exists() and open_store(source)


def test_what_a_killed_copy_has_left_is_no_hindrance(tmp_path):
    source = write_store(tmp_path / "source", 1)
    [data] = [path.name for path in source.iterdir() if path.is_dir()]
    (tmp_path / "copy" / data).mkdir(parents=True)
    (tmp_path / "copy" / data / "samples.npy").write_bytes(b"half")
    earlier = tmp_path / "copy" / new_data_name()
    os.close(partial_files.make_folder(earlier))
    (earlier / "samples.npy").write_bytes(b"half")
    copy_store(source, tmp_path / "copy")
    assert contents(tmp_path / "copy") == contents(source)


def test_a_store_that_is_not_there_is_named(tmp_path):
    with pytest.raises(TerrainError, match="no terrain store at .*nowhere"):
        copy_store(tmp_path / "nowhere", tmp_path / "copy")
    assert not (tmp_path / "copy").exists()
