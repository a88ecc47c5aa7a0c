# SPDX-License-Identifier: GPL-3.0-or-later
"""Move of the stores of one folder into another, with the folders beside them: shaped land and baked maps.

Shaped land is what height operators make of a store (STORE_land), baked maps are images of it.

On one file system an entry is renamed. Across file systems it is copied under a private name, compared byte by byte,
renamed, and the original removed. So an entry is complete in one of the two folders at any moment, and an interrupted
move continues when it is started again.
"""

import filecmp
import itertools
import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import TerrainError
from ..run import partial_files
from ..run.owned_files import (
    LAND,
    MAPS,
    check_folder,
    check_no_link,
    is_real_folder,
    open_folder,
    remove_empty,
    remove_file,
    remove_tree,
)
from . import store_folder

BESIDE = LAND, MAPS  # endings of the folders that belong to a store
MOVED = "_moved"  # suffix of a store whose name is taken in the new folder


@dataclass
class MovedStores:
    """Report of a move. `stores`: names in the new folder. `failures`: why entries stayed where they were."""

    stores: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)


def move_stores(old: Path, new: Path) -> MovedStores:
    """Move all entries of the folder `old` into the folder `new`, which is created if it is missing.

    An entry that cannot be moved stays, and the others are moved. `old` is removed if it is empty then. Raises OSError
    if `old` cannot be read.
    """
    moved = MovedStores()
    for folder in (old, new):
        partial_files.remove_abandoned(folder)  # leftovers of a killed move
    # Stores first, since each takes the folders beside it along, which are then not in `old` any more.
    for name in sorted(os.listdir(old), key=lambda name: (name.endswith(BESIDE), name)):
        if partial_files.is_partial_name(name) or not os.path.lexists(old / name):
            continue
        try:
            with open_folder(new, make=True, may_be_link=True):  # the user may have put it on another disk
                _move_with_folders(old / name, new, moved)
        except (OSError, TerrainError, RecursionError) as reason:
            moved.failures.append(f"{old / name}: {getattr(reason, 'strerror', None) or reason}")
    _remove_if_empty(old)
    return moved


def _move_with_folders(entry: Path, new: Path, moved: MovedStores) -> None:
    """Move a store or another entry, under its old name or the next free one, and the folders that belong to it.

    A folder of shaped land or maps (its name is that of its store and an ending of BESIDE) is moved only with its store
    or when that is gone. moved: gets the name of a store. new: the folder to move into.
    """
    ending = next((ending for ending in BESIDE if entry.name.endswith(ending)), "")
    if ending:
        if not os.path.lexists(entry.with_name(entry.name.removesuffix(ending))):  # its store was moved
            _merge(entry, new / entry.name)
        return
    is_store = (entry / store_folder.JSON_NAME).is_file()
    # The first name that is free: `_try_move` returns False for a name that is taken.
    target = next(path for path in map(new.joinpath, names_of(entry.name)) if _try_move(entry, path))
    moved.stores += [target.name] if is_store else []
    for ending in BESIDE:
        folder = entry.with_name(entry.name + ending)
        if os.path.lexists(folder):
            _merge(folder, target.with_name(target.name + ending))


def _try_move(source: Path, target: Path) -> bool:
    """Move an entry, and return True, if the target is free or holds a copy of it from an interrupted move.

    Return False, with both as they were, if the target holds something else.
    """
    if not os.path.lexists(target):
        move_entry(source, target)
        return True
    if not are_equal(source, target):
        return False
    _remove(source)
    return True


def _merge(source: Path, target: Path) -> None:
    """Move a folder of shaped land or maps into one that may exist.

    For a name in both folders the target's entry stays, because names stand for content there; the source's stays, too,
    if it differs. Raises NotOursError if either folder is a link.
    """
    for folder in (source, target):
        check_no_link(folder, "start Blender again")
    if not _try_move(source, target):
        check_folder(target)
        for name in sorted(os.listdir(source)):
            _try_move(source / name, target / name)
        _remove_if_empty(source)


def names_of(name: str) -> Iterator[str]:
    """Yield the possible names of a store in the new folder, in order of preference."""
    yield name
    yield name + MOVED
    yield from (f"{name}{MOVED}_{number}" for number in itertools.count(2))


def find_moved(path: str, new: Path) -> str:
    """Return the path in the folder `new` of an entry that `path` named in the old folder; "" if there is none.

    path: in any system's notation. Two folders in it that are named like `new` and its parent end the path of the old
    folder, so the next name is the entry's. If that was taken in `new`, the move gave the store the first free name
    (`names_of`), so the last one that exists is returned.
    """
    parts = path.replace("\\", "/").split("/")
    entry_indices = [index for index in range(2, len(parts)) if tuple(parts[index - 2 : index]) == new.parts[-2:]]
    if not entry_indices or {"", ".", ".."} & set(parts[entry_indices[-1] :]):
        return ""
    name, rest = parts[entry_indices[-1]], parts[entry_indices[-1] + 1 :]
    # A folder that belongs to a store has the store's new name and the ending.
    ending, moved = next((ending for ending in BESIDE if name.endswith(ending)), ""), ""
    for store in names_of(name.removesuffix(ending)):
        if not os.path.exists(new / store):
            break
        moved = str(new.joinpath(store + ending, *rest))
    return moved


def move_entry(source: Path, target: Path) -> None:
    """Move a file or a folder to a free path, also on another file system.

    Raises OSError, or TerrainError, also for a link; nothing is lost then. source: the file or folder. target: its
    new path.
    """
    check_no_link(source, "start Blender again")
    if os.lstat(source).st_dev == os.stat(target.parent).st_dev:
        os.rename(source, target)
        return
    copy_entry(source, target)
    _remove(source)


def copy_entry(source: Path, target: Path) -> None:
    """Copy a file or a folder to a free path, where it appears when it is complete. Raises OSError or TerrainError.

    source: the file or folder. target: path of the copy.
    """
    with partial_files.private_folder(target.parent) as private:
        copy = private / target.name
        if source.is_dir():
            shutil.copytree(source, copy, symlinks=True, copy_function=_copy_file)
        else:
            _copy_file(source, copy)
        if not are_equal(source, copy):
            raise OSError(f"its copy in {target.parent} differs")
        os.rename(copy, target)


def _copy_file(source: str | Path, target: str | Path) -> None:
    """Copy a file. Raises TerrainError, which stops `copytree` at once."""
    try:
        shutil.copy2(source, target)
    except OSError as reason:
        raise TerrainError(
            f"{Path(source).name} cannot be copied", str(reason.strerror or reason), fix="make room or allow access"
        ) from reason


def are_equal(first: Path, second: Path) -> bool:
    """Return whether two files, links or folders are equal with all their content."""
    if first.is_symlink() or second.is_symlink():
        return first.is_symlink() and second.is_symlink() and os.readlink(first) == os.readlink(second)
    if first.is_file() and second.is_file():
        return filecmp.cmp(first, second, shallow=False)
    if not (first.is_dir() and second.is_dir()) or sorted(os.listdir(first)) != sorted(os.listdir(second)):
        return False
    return all(are_equal(first / name, second / name) for name in os.listdir(first))


def _remove(entry: Path) -> None:
    """Rename an entry that was copied, so that no part of a store has its name, and remove it."""
    hidden = entry.with_name(f"{partial_files.PREFIX}{partial_files.new_token()}")
    os.rename(entry, hidden)
    with suppress(OSError, TerrainError):
        remove_tree(hidden) if is_real_folder(hidden) else remove_file(hidden)


def _remove_if_empty(folder: Path) -> None:
    """Remove a folder if it is empty; errors are ignored, because an empty folder does no harm."""
    with suppress(OSError, TerrainError):
        remove_empty(folder)
