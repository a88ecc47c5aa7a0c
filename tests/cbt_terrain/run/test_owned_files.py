# SPDX-License-Identifier: GPL-3.0-or-later
"""Deleting and writing below a project: a link is never followed, and a file of another name is never removed."""

import os
import stat
import types
from pathlib import Path

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.run import owned_files, partial_files
from adaptive_terrain.cbt_terrain.run.owned_files import NotOursError, open_folder

DATA = f"data-{'0123456789abcdef' * 2}"
LAND = "0123456789abcdef"
links = pytest.mark.skipif(os.name != "posix", reason="Windows lets only some users make symbolic links")


@pytest.fixture(params=["descriptors", "paths"], autouse=True)
def system(request, monkeypatch):
    """Run a test in the way of POSIX, and in that of Windows."""
    if request.param == "paths":
        monkeypatch.setattr(owned_files, "_BY_DESCRIPTOR", False)
    return request.param


@pytest.fixture
def precious(tmp_path):
    """Write a folder of the user with files that have the program's names."""
    folder = tmp_path / "precious"
    for name in ("mine.txt", "store.json", f"{DATA}/samples.npy", f"{LAND}/store.json", "tiles/a.npy"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("mine")
    return folder


def content(folder: Path) -> dict[str, str]:
    return {str(file.relative_to(folder)): file.read_text() for file in folder.rglob("*") if file.is_file()}


@pytest.mark.parametrize(
    "path, count",
    [
        ("/p/st", 0),
        (f"/p/st/{DATA}", 1),
        ("/p/st/tiles", 1),
        ("/p/st_land", 1),
        (f"/p/st_land/{LAND}", 2),
        (f"/p/st_land/{LAND}_views/{DATA}", 3),
        ("/p/st_land/masks", 2),
        (f"/p/st_land/tiles/.partial-{'0' * 32}", 3),
        ("/p/st_land/chosen", 0),
        ("/p/st_maps/Terrain_1", 2),
        (f"/{LAND}", 1),
    ],
)
def test_derived_components_are_counted(path, count):
    assert owned_files.derived_components(Path(path)) == count


@links
@pytest.mark.parametrize("at", ["st_land", f"st_land/{LAND}", f"st_land/{LAND}/{DATA}"])
def test_no_derived_component_may_be_a_link(tmp_path, precious, at):
    path, before = tmp_path / f"st_land/{LAND}/{DATA}", content(precious)
    link = tmp_path / at
    link.parent.mkdir(parents=True, exist_ok=True)
    link.symlink_to(precious, target_is_directory=True)
    for use in (
        owned_files.remove_tree,
        owned_files.check_folder,
        lambda p: owned_files.remove_entries(p, lambda _name: True),
        lambda p: owned_files.remove_file(p / "samples.npy"),
        lambda p: partial_files.make_folder(p / f".partial-{'0' * 32}", parents=True),
        lambda p: partial_files.written_beside(p / "mine.txt").__enter__(),
    ):
        with pytest.raises(NotOursError, match=rf"{at} is a link; expected a folder .*: move it away"):
            use(path)
    assert content(precious) == before and link.is_symlink()


@links
def test_the_users_own_links_are_followed(tmp_path):
    """A home or a project that is a link, and a folder to export into."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "home").symlink_to(tmp_path / "disk")
    with partial_files.written_beside(tmp_path / "home" / "a.txt") as partial:
        partial.write_text("x")
    with open_folder(tmp_path / "home/st_land/tiles", make=True):
        pass
    assert content(tmp_path / "disk") == {"a.txt": "x"} and (tmp_path / "disk/st_land/tiles").is_dir()
    owned_files.remove_file(tmp_path / "home" / "a.txt", may_be_link=True)
    owned_files.remove_tree(tmp_path / "home/st_land", may_be_link=True)
    assert list((tmp_path / "disk").iterdir()) == []


@links
def test_links_in_a_folder_keep_what_they_lead_to(tmp_path, precious):
    """A folder of arrays with a link is refused as a whole; in a private one the link alone goes."""
    before = content(precious)
    for name in (DATA, f".partial-{'1' * 32}"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.npy").write_text("ours")
        (tmp_path / name / "samples.npy").symlink_to(precious / "mine.txt")
        (tmp_path / name / "folder").symlink_to(precious)
    with pytest.raises(NotOursError, match="holds 'folder'"):
        owned_files.remove_tree(tmp_path / DATA, lambda _name, _is_folder: True)
    assert len(os.listdir(tmp_path / DATA)) == 3
    owned_files.remove_tree(tmp_path / f".partial-{'1' * 32}")
    assert not (tmp_path / f".partial-{'1' * 32}").exists() and content(precious) == before
    with pytest.raises(NotOursError, match=r"samples.npy is a link; expected a file"):
        owned_files.remove_file(tmp_path / DATA / "samples.npy")
    with (
        pytest.raises(NotOursError, match=r"samples.npy is a link"),
        partial_files.written_beside(tmp_path / DATA / "samples.npy") as partial,
    ):
        partial.write_text("x")
    assert content(precious) == before


def test_a_folder_with_a_users_file_is_not_removed(tmp_path):
    folder = tmp_path / DATA
    folder.mkdir()
    for name in ("samples.npy", "notes.txt"):
        (folder / name).write_text(name)
    with pytest.raises(NotOursError, match=r"holds 'notes.txt'; expected only files that Adaptive Terrain made"):
        owned_files.remove_tree(folder, lambda name, _is_folder: name.endswith(".npy"))
    assert len(content(folder)) == 2
    owned_files.remove_entries(folder, lambda name: name.endswith(".npy"))
    assert list(content(folder)) == ["notes.txt"]


def test_folders_and_files_that_are_missing_are_no_error(tmp_path):
    owned_files.remove_tree(tmp_path / "none" / DATA)
    owned_files.remove_file(tmp_path / "none" / "a.txt")
    owned_files.remove_entries(tmp_path / "none", lambda _name: True)
    owned_files.check_folder(tmp_path / "none")
    with pytest.raises(FileNotFoundError), open_folder(tmp_path / "none"):
        pass


def test_a_file_in_place_of_a_folder_is_named(tmp_path):
    (tmp_path / "st_land").write_text("mine")
    for use in (owned_files.check_folder, owned_files.remove_tree):
        with pytest.raises(NotOursError, match=r"st_land is a file; expected a folder"):
            use(tmp_path / "st_land" / LAND)
    with pytest.raises(NotOursError, match=r"tmp.* is a folder; expected a file"):
        owned_files.remove_file(tmp_path)
    with pytest.raises(TerrainError, match="expected a folder"):
        owned_files.check_folder(tmp_path / "st_land" / "tiles")


@links
def test_a_link_put_in_place_after_the_check_is_not_followed(tmp_path, precious, monkeypatch, system):
    """The folder becomes a link between the look at it and its opening."""
    if system == "paths":
        pytest.skip("without descriptors a race cannot be ruled out")
    folder, before, real = tmp_path / "st_land" / LAND, content(precious), owned_files.OpenFolder.find
    folder.mkdir(parents=True)

    def find(self, name):
        found = real(self, name)
        if name == LAND and stat.S_ISDIR(found.st_mode):
            folder.rename(tmp_path / "moved")
            folder.symlink_to(precious)
        return found

    monkeypatch.setattr(owned_files.OpenFolder, "find", find)
    with pytest.raises(NotOursError, match="is a link"):
        owned_files.remove_entries(folder, lambda _name: True)
    assert content(precious) == before


@links
def test_a_folder_that_was_opened_stays_that_folder(tmp_path, precious, system):
    """What is made and removed after a swap happens in the folder that was opened."""
    if system == "paths":
        pytest.skip("without descriptors a race cannot be ruled out")
    folder, before = tmp_path / "tiles", content(precious)
    folder.mkdir()
    (folder / "mine.txt").write_text("ours")
    with open_folder(folder) as opened:
        folder.rename(tmp_path / "moved")
        folder.symlink_to(precious)
        os.unlink(**opened.at("mine.txt"))
        assert opened.entries() == []
    assert content(precious) == before and content(tmp_path / "moved") == {}


def test_reparse_points_of_windows_are_links():
    """A junction is a folder by its mode."""
    plain = types.SimpleNamespace(st_mode=stat.S_IFDIR | 0o777, st_file_attributes=0x10)
    junction = types.SimpleNamespace(st_mode=stat.S_IFDIR | 0o777, st_file_attributes=0x410)
    assert owned_files.is_link(junction) and not owned_files.is_link(plain)


def test_a_junction_is_refused(tmp_path, monkeypatch):
    real = os.stat

    def lstat(path, *, dir_fd=None, follow_symlinks=True):
        found = real(path, dir_fd=dir_fd, follow_symlinks=follow_symlinks)
        if Path(path).name != "tiles":
            return found
        return types.SimpleNamespace(st_mode=found.st_mode, st_file_attributes=0x410)

    (tmp_path / "tiles").mkdir()
    (tmp_path / "tiles" / "a.npy").write_text("mine")
    monkeypatch.setattr(owned_files.os, "stat", lstat)
    with pytest.raises(NotOursError, match="tiles is a link"):
        owned_files.remove_entries(tmp_path / "tiles", lambda _name: True)
    with pytest.raises(NotOursError, match="tiles is a link"):
        owned_files.remove_tree(tmp_path / "tiles")
    monkeypatch.undo()
    assert content(tmp_path) == {"tiles/a.npy": "mine"}


def test_folders_that_are_too_deep_are_refused(tmp_path):
    (tmp_path / "top" / "/".join(["a"] * 200)).mkdir(parents=True)
    with pytest.raises(owned_files.NotOursError, match="more than 64 folders deep"):
        owned_files.remove_tree(tmp_path / "top")
    assert (tmp_path / "top").exists()


@pytest.mark.skipif(os.name != "posix", reason="Windows lets only some users make symbolic links")
def test_a_link_to_itself_has_a_real_path(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    assert owned_files.real_path(tmp_path / "loop").name == "loop"
