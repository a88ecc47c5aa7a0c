# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder beside a source's store with all that stacks made of it: shaped stores, tiles and masks.

    STORE_land/NAME          a shaped store; NAME is the hash of the source and the stack, which the store records too
    STORE_land/NAME_views    the same, fine only where some views looked
    STORE_land/NAME.json     the tiles that a store was built for (requested_tiles.py)
    STORE_land/tiles, masks  results by tile, images of masks

It is a cache. But it may come with a stranger's project, and users may put files there: nothing in it is read, written
or removed through a link, and what this program did not make stays.
"""

import os
import re
from contextlib import suppress
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from ..field import store as stores
from ..field import store_folder
from ..run import owned_files
from ..run.named_file import open_regular
from . import requested_tiles

MASKS = "masks"
OF_VIEWS = "_views"  # ends the names of stores that are fine only where some views looked
_NAME = re.compile(f"[0-9a-f]{{16}}({OF_VIEWS})?")


def folder_beside(source: str) -> Path:
    """Return the folder beside a source's store in which all land that stacks made of it is."""
    return Path(source.rstrip("/\\") + owned_files.LAND)


def is_of_views(folder: str) -> bool:
    """Return whether the store in a folder is fine only where some views looked, by the folder's name."""
    return folder.endswith(OF_VIEWS)


def is_land_name(name: str) -> bool:
    """Return whether a folder of shaped land can have this name."""
    return _NAME.fullmatch(name) is not None


def records(provenance: dict, folder: str, source_key: str) -> bool:
    """Return whether a store records that it is the land its folder is named for.

    Return False for an older record, and for land that is not fine everywhere though its folder is not of views.
    provenance: the store's. folder: where it is. source_key: content key of the source's store. Raises TerrainError for
    the store of another terrain, which this program did not make for that folder.
    """
    shaped, name = provenance.get("shaped"), Path(folder).name
    if isinstance(shaped, dict):
        if shaped.get("land") == name.removesuffix(OF_VIEWS):
            return is_of_views(name) or shaped.get("everywhere") is True
        if "land" not in shaped and shaped.get("source_key") == source_key:
            return False  # a record without its land's name is of an older version
    raise TerrainError(
        f"The folder {folder!r} holds the store of another terrain",
        expected="land that was shaped from the store beside it",
        fix="move the folder elsewhere",
    )


def shaped_stores(source: str) -> list[tuple[Path, int]]:
    """List the shaped stores of a source with their bytes, the one that was not used for longest first.

    Stores that shaping did not make are left out. Raises TerrainError where that folder, or one in it, is a link.
    """
    beside = folder_beside(source)
    owned_files.check_folder(beside)
    by_use = []
    with suppress(OSError):
        for folder in beside.iterdir():
            if not is_land_name(folder.name):
                continue
            owned_files.check_folder(folder)
            if _is_removable(folder):
                by_use.append((folder.stat().st_mtime, folder, bytes_in(folder)))
    return [(folder, size) for _, folder, size in sorted(by_use)]


def _is_removable(folder: Path) -> bool:
    """Return whether a folder holds a shaped store, or one that cannot be read any more."""
    if not owned_files.is_real_file(folder / store_folder.JSON_NAME):
        return False
    try:
        return "shaped" in stores.read_json(folder)["provenance"]
    except TerrainError:
        return True


def read_mask(file: str) -> np.ndarray:
    """Read an image in the folder of masks, float32 [rows, columns], row 0 north. Raises TerrainError."""
    try:
        with open_regular(Path(file)) as handle:
            weights = np.lib.format.read_array(handle, allow_pickle=False)
        if weights.ndim != 2 or weights.dtype != np.float32 or not np.isfinite(weights).all():
            raise ValueError("expected finite float32 in rows and columns")
    except (OSError, ValueError, EOFError, SyntaxError, MemoryError) as reason:
        raise TerrainError(
            f"The mask {file} is damaged ({reason})", fix="delete the file, it is written again"
        ) from reason
    return weights


def bytes_in(folder: Path) -> int:
    """Add up the sizes of all files below a folder; another Blender may remove some meanwhile."""
    total = 0
    for inner, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                total += os.lstat(os.path.join(inner, name)).st_size
    return total


def remove(folder: Path) -> None:
    """Remove shaped land; what another Blender is writing there stays, and so does what this program did not make."""
    requested_tiles.remove_record(str(folder))
    with suppress(OSError):
        store_folder.remove_store(folder)
