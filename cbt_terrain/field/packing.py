# SPDX-License-Identifier: GPL-3.0-or-later
"""Copy a store to another folder, so that there is always a whole one.

The arrays go into a folder of another name, are compared byte by byte with those they were copied from, and get their
name at the end; store.json, which makes a store of them, comes last. On one file system arrays are linked, not copied:
nothing ever writes into an array of a published store.
"""

import filecmp
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from ..errors import TerrainError
from ..run import partial_files
from ..run.named_file import open_regular, read_regular
from ..run.owned_files import NotOursError
from . import store as stores
from . import store_folder

CHUNK_BYTES = 1 << 24


class PackingCancelled(TerrainError):
    """The user has stopped the copy; no store was changed."""


def copy_store(
    source: str | os.PathLike, target: str | os.PathLike, on_progress: Callable[[float], None] = lambda _fraction: None
) -> None:
    """Make `target` a copy of the store at `source`, which stays as it is. Does nothing if it is one already.

    on_progress(fraction) is called between chunks of some megabytes; what it raises ends the copy. Raises TerrainError
    if `target` is no place for a store, holds another one, or cannot be written.
    """
    source, target = Path(source), Path(target)
    content = stores.read_json(source)
    name = content["data"]
    stores.open_store(source)
    store_folder.check_target(target)
    if (target / stores.JSON_NAME).exists():
        there = stores.read_json(target)
        if (there["key"], there["data"]) == (content["key"], name):
            stores.open_store(target)
            return
        raise TerrainError(f"The folder {target} holds the store of another terrain: choose another folder.")
    made = store_folder.missing_folders(target)
    part = target / store_folder.new_data_name()
    lock = None
    try:
        lock = partial_files.make_folder(part, parents=True)
        store_folder.remove_abandoned(target)
        _copy_arrays(source / name, part, on_progress)
        store_folder.remove_arrays(target / name)  # what a copy that was killed has left
        os.rename(part, target / name)
        text = read_regular(source / stores.JSON_NAME, store_folder.MAX_JSON_BYTES, links=False)
        draft = target / name / stores.JSON_NAME
        draft.write_bytes(text)
        stores.check_version(target, draft)
        os.replace(draft, target / stores.JSON_NAME)
        partial_files.end_work(target / name, lock)
        lock = None
    except OSError as reason:
        raise TerrainError(
            f"The store {source} cannot be copied to {target} ({reason.strerror or reason}): make room or save the "
            "file elsewhere. The store itself is as it was."
        ) from reason
    finally:
        if lock is not None:
            os.close(lock)
        if not (target / stores.JSON_NAME).exists():
            with suppress(OSError, NotOursError):
                store_folder.remove_arrays(target / name)
            store_folder.discard(target, part.name, made)


def _copy_arrays(source: Path, target: Path, on_progress: Callable[[float], None]) -> None:
    """Every array of one folder into another; raises OSError also where a copy is not what it was copied from."""
    files = [file for file in sorted(source.iterdir()) if file.suffix == ".npy"]
    for file in files:
        open_regular(file).close()
    total = sum(int(file.stat().st_size) for file in files) or 1
    done = 0
    for file in files:
        copy = target / file.name
        try:
            os.link(file, copy)
            done += file.stat().st_size
        except OSError:  # another file system, or one without links
            done = _copy(file, copy, done, total, on_progress)
            if not filecmp.cmp(file, copy, shallow=False):
                raise OSError(f"{file.name} is another file after it was copied") from None
        on_progress(done / total)


def _copy(source: Path, target: Path, done: int, total: int, on_progress: Callable[[float], None]) -> int:
    """Copy one file; returns the bytes done in all."""
    with open_regular(source) as reader, target.open("xb") as writer:
        while chunk := reader.read(CHUNK_BYTES):
            writer.write(chunk)
            done += len(chunk)
            on_progress(done / total)
        writer.flush()
        os.fsync(writer.fileno())
    return done
