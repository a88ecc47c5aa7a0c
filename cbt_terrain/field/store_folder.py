# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder of a store (store.py): what may lie there, where one may be written, and what of it may be taken away."""

import json
import os
import re
import shutil
from contextlib import suppress
from pathlib import Path

from ..errors import TerrainError, shown
from ..run import partial_files
from .store_entries import is_data_name

JSON_NAME = "store.json"
DATA_PREFIX = "data-"
TILES = "tiles"  # the folder of kept tiles, which lives as long as the store
# All that a folder of arrays ever holds; one that holds anything else is the user's own and is left alone.
_OWN_FILE = re.compile(
    r"(samples|raster|errors?|ranges|valid|(error|ranges|numbers)_c|error(_c)?_m\d+)\.npy"
    r"|effect_[a-z_]+_[0-9a-f]{16}\.npy"
    r"|layer_[a-z][a-z0-9_]{0,40}\.npy"
    r"|((error|ranges|numbers)_c|error(_c)?_m\d+)\.[0-9a-f]{32}\.part|store\.json"  # .part: of version 0.1.0
    rf"|{partial_files.LOCK}"
)
_KEPT_TILE = re.compile(r"[0-9a-f]{32}\.npy")


def check_target(path: str | os.PathLike) -> None:
    """Raise TerrainError unless a store may be written at `path`: a new folder, an empty one, or a store."""
    folder = Path(path)
    if not os.fspath(path) or not folder.parts or "\0" in os.fspath(path):
        raise TerrainError(
            f"The store's path {os.fspath(path)!r} names no folder: expected the name of a folder of its own."
        )
    try:
        if not os.path.lexists(folder) or (folder / JSON_NAME).exists():
            folder.exists()  # says here what is wrong with the name
            return
        if not folder.is_dir():
            raise TerrainError(f"The store {folder} is a file, not a folder: choose another name.")
        found = foreign(folder)
        if found and (folder / JSON_NAME).exists():
            return  # another process has made a store of it meanwhile
    except OSError as reason:
        why = reason.strerror or reason
        raise TerrainError(f"The store {shown(path)} cannot be used ({why}): choose another folder.") from reason
    if found:
        held = str(found[0].relative_to(folder))
        raise TerrainError(
            f"The folder {folder} is no terrain store and holds {held!r}: choose a new or an empty folder."
        )


def foreign(folder: Path) -> list[Path]:
    """What lies in the folder of a store, or in one of arrays in it, and was not made by this program."""
    found = []
    with suppress(FileNotFoundError):  # another import has just removed it
        for entry in folder.iterdir():
            if is_data_name(entry.name) and entry.is_dir() and not entry.is_symlink():
                with suppress(FileNotFoundError):
                    found += [inner for inner in entry.iterdir() if not is_own_entry(inner)]
            elif not is_own(entry) and os.path.lexists(entry):
                found.append(entry)
    return sorted(found)


def is_own(folder: Path) -> bool:
    """Whether a folder is one of arrays that this program made: by its name and by every file in it."""
    if folder.name == TILES and not folder.is_symlink() and folder.is_dir():
        return all(_KEPT_TILE.fullmatch(entry.name) or is_own_entry(entry) for entry in folder.iterdir())
    if not is_data_name(folder.name) or folder.is_symlink() or not folder.is_dir():
        return False
    try:
        return all(map(is_own_entry, folder.iterdir()))
    except FileNotFoundError:
        return True  # another import has just removed it


def is_own_entry(entry: Path) -> bool:
    """Whether something in a folder of arrays is what this program writes there, by its name."""
    if entry.is_dir():
        return partial_files.is_partial_name(entry.name)
    return _OWN_FILE.fullmatch(entry.name) is not None


def missing_folders(path: Path) -> list[Path]:
    """The folder of a store and those above it that are still to be made, the innermost first."""
    path = path.absolute()
    return [folder for folder in (path, *path.parents) if not folder.exists()]


def discard(path: Path, folder: str, made: list[Path]) -> None:
    """Take away the folder of arrays of an unfinished version, and the folders that were made for it. One that has
    been published stays, whatever has failed since."""
    if named_folder(path) == path / folder:
        return
    shutil.rmtree(path / folder, ignore_errors=True)
    with suppress(OSError):  # another import has put something there
        for parent in made:
            parent.rmdir()


def named_folder(path: Path) -> Path | None:
    """The folder of arrays that store.json names; None without one, or of a damaged store."""
    file = path / JSON_NAME
    try:
        name = json.loads(file.read_text(encoding="utf-8"))["data"] if file.is_file() else ""
        return path / name if is_data_name(name) else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def new_data_name() -> str:
    """Name of a new folder of arrays."""
    return f"{DATA_PREFIX}{partial_files.new_token()}"


def remove_abandoned(path: Path) -> None:
    """Take away the folders of arrays that neither a living process nor store.json has use for."""
    if (path / JSON_NAME).exists() and named_folder(path) is None:
        return  # of a damaged store nobody knows what it needs
    for folder in path.glob(f"{DATA_PREFIX}*"):
        with suppress(OSError):
            if is_own(folder):
                token = folder.name.removeprefix(DATA_PREFIX)
                partial_files.remove_if_abandoned(folder, token, lambda folder=folder: named_folder(path) == folder)


def take_away(path: Path) -> None:
    """Make a store no store any more, and free its arrays. What another process writes there meanwhile stays, and so
    does what is not of this program. Raises OSError where what says that it is a store cannot be removed."""
    file, arrays = path / JSON_NAME, named_folder(path)
    shutil.rmtree(file) if file.is_dir() and not file.is_symlink() else file.unlink(missing_ok=True)
    with suppress(OSError):
        if arrays is not None and is_own(arrays):
            shutil.rmtree(arrays, ignore_errors=True)
        remove_abandoned(path)
