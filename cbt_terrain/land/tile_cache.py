# SPDX-License-Identifier: GPL-3.0-or-later
"""What effects have made of tiles and levels, kept in files by content: asked twice, made once.

A file is named for the hash of all that its numbers are a function of. It is a guess until it is read: one of another
shape, or with a block that differs from its checksum, is made again.
"""

import hashlib
import shutil
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from ..field.store_arrays import map_array as map_checked
from ..field.store_arrays import verify_array, write_array
from ..field.store_folder import is_tile_name
from ..run import owned_files, partial_files
from ..run.owned_files import NotOursError, open_folder

# Beyond this, files that were not used longest are removed; what the last run has used always stays.
MOST_BYTES = 4 << 30


class TileCache:
    """`folder`: of the files, or None: nothing is kept. `room`: bytes of its disk that are left to others. `made`,
    `kept`: how many results of each effect were computed and how many were found."""

    def __init__(self, folder: Path | None = None, room: int = 0):
        self.folder, self.room = folder, room
        self.made, self.kept = Counter(), Counter()
        self._used: set[str] = set()
        if folder is not None:
            with open_folder(folder, make=True):
                pass
            partial_files.remove_abandoned(folder)

    def take(self, effect: str, key: str, shape: tuple[int, ...], make: Callable[[], np.ndarray]) -> np.ndarray:
        """float32 of that shape: what was kept under `key`, or what `make` makes, which is kept then. Read only."""
        file = None if self.folder is None else self.folder / f"{key}.npy"
        self._used.add(f"{key}.npy")
        found = _read(file, shape) if file is not None else None
        if found is not None:
            self.kept[effect] += 1
            return found
        made = np.ascontiguousarray(make(), np.float32)
        self.made[effect] += 1
        if file is not None:
            _write(file, made, self.room)
        return made

    def trim(self, most_bytes: int = MOST_BYTES) -> None:
        """Remove the files that were not used longest, until the rest takes no more; one that cannot be removed, or a
        folder that is gone by now, is left as it is: the store is there, and nothing may take it back."""
        if self.folder is None:
            return
        files = []
        with suppress(OSError):
            for file in self.folder.iterdir():
                with suppress(OSError):
                    files.append((file.lstat().st_mtime, file.lstat().st_size, file))
        total = sum(int(size) for _, size, _ in files)
        for _, size, file in sorted(files):
            if total <= most_bytes:
                break
            if file.name not in self._used and is_tile_name(file.name):
                with suppress(OSError, NotOursError):
                    owned_files.remove_file(file)
                    total -= size


def content_key(*parts) -> str:
    """Hex digest of arrays, and of the `repr` of all else."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        if isinstance(part, np.ndarray):
            digest.update(repr((part.shape, part.dtype.str)).encode())
            digest.update(np.ascontiguousarray(part))
        else:
            digest.update(repr(part).encode())
    return digest.hexdigest()


def _read(file: Path, shape: tuple[int, ...]) -> np.ndarray | None:
    try:
        verify_array(file, shape, np.float32)
        found = map_checked(file, shape, np.float32)
        owned_files.touch(file)
    except (OSError, TerrainError):
        return None
    return found if np.isfinite(found).all() else None


def _write(file: Path, array: np.ndarray, room: int) -> None:
    """Keep an array where that leaves so much room; a folder that cannot be written is left as it is."""
    with suppress(OSError):
        with open_folder(file.parent, make=True):  # another Blender may have cleared it meanwhile
            pass
        if shutil.disk_usage(file.parent).free < array.nbytes + room:
            return
    with suppress(OSError):
        write_array(file, array)
