# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder of a store (store.py): its possible contents, where one may be written, and which files may be removed."""

import functools
import json
import os
import re
import time
from contextlib import suppress
from pathlib import Path

from ..errors import TerrainError, check_path, shown
from ..run import owned_files, partial_files
from ..run.named_file import read_regular
from ..run.owned_files import NotOursError
from .shared_pages import NAMES, PARTS
from .store_entries import is_data_name

JSON_NAME = "store.json"
# More than any store needs: coordinate systems and warnings are texts of some thousand characters.
MAX_JSON_BYTES = 1 << 22
DATA_PREFIX = "data-"
WORK_NAME = "work.json"  # in a folder of arrays that is made by tile, and can be completed later (tiling/tile_work.py)
UNFINISHED_NAME = "missing.npy"  # in such a folder until its arrays are published
WORK_SECONDS = 7 * 86_400.0  # since anything was written in such a folder; then it is abandoned
TILES = "tiles"  # the folder of cached tiles, which lives as long as the store
AHEAD = "ahead"  # the folder of tiles that were read ahead of an import (importing/read_ahead.py)
FIRST = "first"  # in the folder of arrays of loaded tiles: the store of the first picture (importing/refining.py)
# All files of a folder of arrays; a folder with any other file belongs to the user and is left alone.
_ARRAY_FILE = re.compile(
    r"(samples|raster|errors?|ranges|valid|pyramid(_[a-z][a-z0-9_]{0,40})?|tops|bottoms|borders|missing|kinds)\.npy"
    r"|(error|ranges)_(pages|places)\.npy"
    r"|((error|ranges|numbers)_c|error(_c)?_m\d+)\.npy|catalogue\.json|work\.json|tiles(-[0-9a-f]{32})?\.jsonl"
    r"|(read|measured)-[0-9]{1,12}\.part"  # of tiling/part_files.py
    r"|(effect_[a-z_]+|masks|mask_maxima)_[0-9a-f]{16}\.npy"
    r"|layer_[a-z][a-z0-9_]{0,40}\.npy|finer_(numbers|heights|errors|ranges|limits|pyramid)\.npy"
    r"|finer_(heights|errors|bounds|ranges|limits|values)_c\.npy"
    r"|((error|ranges|numbers)_c|error(_c)?_m\d+)\.[0-9a-f]{32}\.part|store\.json"  # .part: of version 0.1.0
    rf"|{partial_files.LOCK}"
)
_TILE = re.compile(r"[0-9a-f]{32}\.npy")
_AHEAD = re.compile(r"[0-9]{1,9}\.tile|wanted\.json")


def check_target(path: str | os.PathLike) -> None:
    """Raise TerrainError unless a store may be written at `path`: a new folder, an empty one, or a store.

    Folders of arrays of this program do no harm, nor do any files in the folder of a store that height operators have
    made from another one (`is_land`).
    """
    check_path("The store", path)
    folder = Path(path)
    if not os.fspath(path) or not folder.parts:
        raise TerrainError(f"The store's path {os.fspath(path)!r} names no folder", expected="the name of a folder")
    try:
        if not owned_files.is_real_file(folder):
            # Neither the folder nor its description may be a link; both may be missing.
            with suppress(FileNotFoundError, NotADirectoryError), owned_files.open_folder(folder):
                owned_files.check_no_link(folder / JSON_NAME)
        if not os.path.lexists(folder) or (folder / JSON_NAME).exists():
            folder.exists()  # raises OSError for an impossible name
            return
        if not folder.is_dir():
            raise TerrainError(f"The store {folder} is a file, not a folder", fix="choose another name")
        others = [] if is_land(folder) else foreign(folder)  # files of the user that do not belong to a store
        if others and (folder / JSON_NAME).exists():
            return  # another process has written a store meanwhile
    except OSError as reason:
        what = f"The store {shown(path)} cannot be used ({reason.strerror or reason})"
        raise TerrainError(what, fix="choose another folder") from reason
    if others:
        held = str(others[0].relative_to(folder))
        raise TerrainError(
            f"The folder {folder} is no terrain store and holds {held!r}", fix="choose a new or an empty folder"
        )


def is_land(folder: Path) -> bool:
    """Return whether a folder has the name of shaped land, in a folder beside a store (`STORE_land/HASH`)."""
    return owned_files.derived_components(folder.absolute()) > 1 and not is_data_name(folder.name)


def foreign(folder: Path) -> list[Path]:
    """Return the sorted entries that this program did not write, of a folder and of the folders of arrays in it.

    folder: one that holds no store.json.
    """
    entries = []
    with suppress(FileNotFoundError):  # another import has just removed it
        for entry in folder.iterdir():
            if is_data_name(entry.name) and owned_files.is_real_folder(entry):
                with suppress(FileNotFoundError):
                    entries += [inner for inner in entry.iterdir() if not is_array_file(inner)]
            elif not is_array_folder(entry) and os.path.lexists(entry):  # else it was removed meanwhile
                entries.append(entry)
    return sorted(entries)


def is_array_folder(folder: Path) -> bool:
    """Return whether this program wrote a folder of arrays or of tiles, by its name and by every file in it."""
    if folder.name == TILES and owned_files.is_real_folder(folder):
        return all(is_tile_name(entry.name) or is_array_file(entry) for entry in folder.iterdir())
    if not is_data_name(folder.name) or not owned_files.is_real_folder(folder):
        return False
    try:
        return all(map(is_array_file, folder.iterdir()))
    except FileNotFoundError:
        return True  # another import has just removed it


def is_array_file(entry: Path) -> bool:
    """Return whether this program wrote an entry of a folder of arrays, by its name and type; links never count."""
    is_folder = owned_files.is_real_folder(entry)
    return is_array_name(entry.name, is_folder) and (is_folder or owned_files.is_real_file(entry))


def is_array_name(name: str, is_folder: bool) -> bool:
    """Return whether this program gives this name to files, or to folders, in a folder of arrays.

    is_folder: whether a folder has it.
    """
    if is_folder:
        return name == FIRST or partial_files.is_partial_name(name)
    return _ARRAY_FILE.fullmatch(name) is not None


def is_tile_name(name: str) -> bool:
    """Return whether a file in the folder of tiles has the name of one."""
    return _TILE.fullmatch(name) is not None


def is_ahead_name(name: str) -> bool:
    """Return whether a file in the folder AHEAD has the name of a tile, or of the list of wanted ones."""
    return _AHEAD.fullmatch(name) is not None


def remove_arrays(folder: Path) -> None:
    """Remove a folder of arrays, if it exists.

    Raises OSError, and NotOursError, before anything is removed, if the folder or an entry is a link or not of this
    program.
    """
    if not is_data_name(folder.name):
        raise NotOursError(
            f"{folder} is no folder of arrays", expected="a name of data- and 32 hex digits", fix="keep it"
        )
    owned_files.remove_tree(folder, is_array_name)


def missing_folders(path: Path) -> list[Path]:
    """Return the folder of a store and the folders above it that are missing, the innermost first."""
    path = path.absolute()
    return [folder for folder in (path, *path.parents) if not folder.exists()]


def discard(path: Path, folder: str, new_folders: list[Path], with_work: bool = True) -> None:
    """Remove the folder of arrays of an unfinished version, its temporary files, and the folders created for it.

    path: the store's folder. folder: name of the folder of arrays. new_folders: from `missing_folders`. A published
    version stays, even if a later step has failed. with_work: whether a version that can be completed later is removed,
    too.
    """
    if named_folder(path) == path / folder or not with_work and os.path.lexists(path / folder / WORK_NAME):
        return
    for name in (folder, scratch_name(folder)):
        with suppress(OSError, NotOursError):
            remove_arrays(path / name)
    with suppress(OSError, NotOursError):  # another import has written there
        for parent in new_folders:
            owned_files.remove_empty(parent)


def named_folder(path: Path) -> Path | None:
    """Return the folder of arrays that store.json names; None without one, or for a damaged store."""
    content = _content(path)
    return None if content is None else path / content["data"]


def _content(path: Path) -> dict | None:
    """Return the unchecked content of store.json; None without one, or if it names no folder of arrays."""
    try:
        content = json.loads(read_regular(path / JSON_NAME, MAX_JSON_BYTES).decode("utf-8"))
        return content if is_data_name(content["data"]) else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def check_is_no_store(folder: str | os.PathLike) -> None:
    """Raise TerrainError if a folder for other files, which may be missing, is a store or in a store's own folders.

    A file there could replace the description of the store, or make a folder of arrays one that is never removed.
    """
    folder = Path(os.path.realpath(folder))
    entry = ""  # of the store that contains `folder`; "" for the store itself
    for parent in (folder, *folder.parents):
        is_reserved = is_data_name(entry) or entry in ("", TILES, AHEAD)
        if is_reserved and named_folder(parent) is not None:
            raise TerrainError(f"{folder} belongs to a terrain store", fix="choose another folder")
        entry = parent.name


def _is_current(path: Path, folder: Path) -> bool:
    """Return whether a store's JSON file names a folder of arrays, which is then in use."""
    return named_folder(path) == folder


def new_data_name() -> str:
    """Return the name of a new folder of arrays."""
    return f"{DATA_PREFIX}{partial_files.new_token()}"


def scratch_name(folder: str) -> str:
    """Return the name of the folder for temporary files beside a folder of arrays.

    Both carry the machine's mark, the first eight digits; the others are in reverse order.
    """
    token = folder.removeprefix(DATA_PREFIX)
    return f"{DATA_PREFIX}{token[:8]}{token[:7:-1]}"


def remove_abandoned(path: Path, with_work: bool = False) -> None:
    """Remove the folders of arrays that neither a living process nor store.json uses.

    The folder that store.json names stays, but loses its `_finished_files`. with_work: also remove the folders that
    could be completed; otherwise they are kept for WORK_SECONDS.
    """
    if os.path.lexists(path / JSON_NAME) and named_folder(path) is None:
        return  # a damaged store does not name the folder that it needs
    for folder in path.glob(f"{DATA_PREFIX}*"):
        with suppress(OSError):
            if not is_array_folder(folder):
                continue
            for file in _finished_files(path, folder):
                owned_files.remove_file(file)
            if with_work or not _can_be_continued(folder):
                token = folder.name.removeprefix(DATA_PREFIX)  # begins with the mark of the machine that wrote it
                is_needed = functools.partial(_is_current, path, folder)
                partial_files.remove_if_abandoned(folder, token, is_needed, is_array_name)


def _finished_files(path: Path, folder: Path) -> list[Path]:
    """Return the files of a store's folder of arrays that are of no use once it is published; [] before that.

    These are UNFINISHED_NAME and the whole arrays of which the pages are in another file.
    """
    content = _content(path)
    if content is None or content["data"] != folder.name:
        return []
    shared = content.get("shared", [])
    names = [name for name in NAMES if isinstance(shared, list) and name in shared]
    whole = [name for name in names if all(os.path.lexists(folder / f"{name}_{part}.npy") for part in PARTS)]
    return [folder / f"{name}.npy" for name in whole] + [folder / UNFINISHED_NAME]


def _can_be_continued(folder: Path) -> bool:
    """Return whether a folder holds work that can be completed, written to within WORK_SECONDS. Raises OSError."""
    newest = max(entry.lstat().st_mtime for entry in (folder, *folder.iterdir()))
    is_unfinished = all(os.path.lexists(folder / name) for name in (WORK_NAME, UNFINISHED_NAME))
    return is_unfinished and time.time() - newest < WORK_SECONDS


def take_away(path: Path) -> None:
    """Remove a store's JSON file, so that it is no store any more, and its arrays.

    Work of other processes and files of the user stay. Raises OSError and NotOursError if the JSON file cannot be
    removed.
    """
    arrays = named_folder(path)
    owned_files.remove_file(path / JSON_NAME)
    with suppress(OSError, NotOursError):
        if arrays is not None:
            remove_arrays(arrays)
    with suppress(OSError):
        remove_abandoned(path, with_work=True)


def remove_tiles(folder: Path) -> None:
    """Remove the tiles in a folder, and the folder if it is empty then. Raises NotOursError for a link, and OSError."""
    owned_files.remove_entries(folder, is_tile_name)
    partial_files.remove_abandoned(folder)
    with suppress(OSError):
        owned_files.remove_empty(folder)


def remove_store(path: Path) -> None:
    """Remove a store with its tiles, and its folder if it is empty then. Raises OSError and NotOursError."""
    take_away(path)
    remove_tiles(path / TILES)
    with suppress(OSError):
        owned_files.remove_empty(path)
