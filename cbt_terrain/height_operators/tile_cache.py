# SPDX-License-Identifier: GPL-3.0-or-later
"""A cache of operators' results for tiles and levels, in files named for the hash of everything that determines them.

A file of another shape, or with a block that differs from its checksum, is computed again.
"""

import hashlib
import shutil
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike

from ..errors import TerrainError
from ..field.store_arrays import map_array as map_checked
from ..field.store_arrays import verify_array, write_array
from ..field.store_folder import is_tile_name
from ..run import owned_files, partial_files
from ..run.owned_files import NotOursError, open_folder

# Beyond this the least recently used files are removed, except those that the last run used.
MAX_BYTES = 4 << 30


class TileCache:
    """Cached arrays of a `folder`, None to cache nothing.

    `room`: bytes of disk that stay free. `made`, `kept`: by operator, the number of results that were computed, and of
    those that were found in the cache.
    """

    def __init__(self, folder: Path | None = None, room: int = 0) -> None:
        """Cache tiles in `folder`, which is made, or in no folder; room: bytes of the disk that must stay free.

        Raises OSError, and NotOursError for a link.
        """
        self.folder, self.room = folder, room
        self.made: Counter[str] = Counter()
        self.kept: Counter[str] = Counter()
        self._used: set[str] = set()
        if folder is not None:
            with open_folder(folder, make=True):
                pass
            partial_files.remove_abandoned(folder)

    def take(self, effect: str, key: str, shape: tuple[int, ...], compute: Callable[[], np.ndarray]) -> np.ndarray:
        """Return the float32 array of that shape under `key`, from its file or newly computed and cached.

        It is read only. effect: name of the operator, for the counts. compute: makes the array.
        """
        found = self.find(effect, key, shape)
        if found is not None:
            return found
        array = np.ascontiguousarray(compute(), np.float32)
        self.keep(effect, key, array)
        return array

    def find(self, effect: str, key: str, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> np.ndarray | None:
        """Return the array of that shape and type under `key`, read only; None if it is not cached.

        effect: name of the operator, for the count in `kept`.
        """
        self._used.add(f"{key}.npy")
        found = None if self.folder is None else read_cached(self.folder / f"{key}.npy", shape, dtype)
        if found is not None:
            self.kept[effect] += 1
        return found

    def keep(self, effect: str, key: str, array: np.ndarray) -> None:
        """Cache a contiguous array that was computed. effect: name of the operator, for the count in `made`."""
        self.made[effect] += 1
        if self.folder is not None:
            _write_cached(self.folder / f"{key}.npy", array, self.room)

    def trim(self, max_bytes: int = MAX_BYTES) -> None:
        """Remove least recently used tiles until the folder's files have at most `max_bytes`.

        Those that this cache has used stay. Errors are ignored, since the store is complete.
        """
        if self.folder is None:
            return
        files = []
        with suppress(OSError):
            for file in self.folder.iterdir():
                with suppress(OSError):
                    files.append((file.lstat().st_mtime, file.lstat().st_size, file))
        total = sum(int(size) for _, size, _ in files)
        for _, size, file in sorted(files):
            if total <= max_bytes:
                break
            if file.name not in self._used and is_tile_name(file.name):
                with suppress(OSError, NotOursError):
                    owned_files.remove_file(file)
                    total -= size


def compute_digest(*parts: object) -> str:
    """Return a hex digest of arrays, by shape, type and bytes, and of the `repr` of other values."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        if isinstance(part, np.ndarray):
            digest.update(repr((part.shape, part.dtype.str)).encode())
            digest.update(np.ascontiguousarray(part).data)
        else:
            digest.update(repr(part).encode())
    return digest.hexdigest()


def read_cached(file: Path, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> np.ndarray | None:
    """Return a cached array, mapped, or None if it is missing, damaged or not finite; it counts as used now."""
    try:
        verify_array(file, shape, dtype)
        found = map_checked(file, shape, dtype)
        owned_files.touch(file)
    except (OSError, TerrainError):
        return None
    return found if np.isfinite(found).all() else None


def _write_cached(file: Path, array: np.ndarray, room: int) -> None:
    """Write an array unless fewer than `room` bytes of the disk would stay free. Write errors are ignored."""
    with suppress(OSError):
        with open_folder(file.parent, make=True):  # another Blender may have removed it
            pass
        if shutil.disk_usage(file.parent).free < array.nbytes + room:
            return
    with suppress(OSError):
        write_array(file, array)
