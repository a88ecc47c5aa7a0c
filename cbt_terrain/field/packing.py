# SPDX-License-Identifier: GPL-3.0-or-later
"""Copy of a store to another folder, with at least one complete store at any time.

The arrays are copied into a folder with another name, compared byte by byte with their sources, and renamed at the end;
store.json, which makes the folder a store, comes last. On one file system arrays are linked instead of copied, because
the arrays of a published store never change.
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


def copy_store(
    source: str | os.PathLike, target: str | os.PathLike, on_progress: Callable[[float], None] = lambda _fraction: None
) -> None:
    """Make `target` a copy of the store at `source`, with its derived arrays, if it is not one already.

    on_progress(fraction) is called between chunks of some megabytes; an exception from it stops the copy. Raises
    TerrainError if no store may be written at `target`, if it holds another one, or if it cannot be written.
    """
    source, target = Path(source), Path(target)
    content = stores.read_json(source)
    name = content["data"]
    stores.open_store(source)  # raises unless the source is a complete store
    store_folder.check_target(target)
    if (target / store_folder.JSON_NAME).exists():
        target_content = stores.read_json(target)
        if (target_content["key"], target_content["data"]) == (content["key"], name):  # it is the copy already
            stores.open_store(target)
            return
        raise TerrainError(f"The folder {target} holds the store of another terrain", fix="choose another folder")
    new_folders = store_folder.missing_folders(target)  # removed again after a failure
    part = target / store_folder.new_data_name()  # the arrays' folder while they are copied
    lock = None  # descriptor that keeps other processes from removing `part` as abandoned
    try:
        lock = partial_files.make_folder(part, parents=True)
        store_folder.remove_abandoned(target)
        _copy_arrays(source / name, part, on_progress)
        store_folder.remove_arrays(target / name)  # left by a killed copy
        os.rename(part, target / name)
        # The arrays are complete; the JSON file, checked as a draft among them, makes the folder a store.
        text = read_regular(source / store_folder.JSON_NAME, store_folder.MAX_JSON_BYTES, links=False)
        draft = target / name / store_folder.JSON_NAME
        draft.write_bytes(text)
        stores.check_version(target, draft)
        os.replace(draft, target / store_folder.JSON_NAME)
        partial_files.end_work(target / name, lock)
        lock = None
    except OSError as reason:
        raise TerrainError(
            f"The store {source} cannot be copied to {target} ({reason.strerror or reason}), and is as it was",
            fix="make room or save the file elsewhere",
        ) from reason
    finally:
        if lock is not None:
            os.close(lock)
        if not (target / store_folder.JSON_NAME).exists():
            with suppress(OSError, NotOursError):
                store_folder.remove_arrays(target / name)
            store_folder.discard(target, part.name, new_folders)


def _copy_arrays(source: Path, target: Path, on_progress: Callable[[float], None]) -> None:
    """Link all arrays of a folder in another, or copy them. on_progress: gets the fraction of bytes that are there.

    Raises OSError, also for a copy that differs from its source.
    """
    files = [file for file in sorted(source.iterdir()) if file.suffix == ".npy"]
    for file in files:
        open_regular(file).close()  # raises for a link before anything is copied
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
    """Copy one file, and return the bytes copied so far: `done` plus its size.

    total: bytes of all files, for the fractions that `on_progress` gets.
    """
    with open_regular(source) as reader, target.open("xb") as writer:
        while chunk := reader.read(CHUNK_BYTES):
            writer.write(chunk)
            done += len(chunk)
            on_progress(done / total)
        writer.flush()
        os.fsync(writer.fileno())
    return done
