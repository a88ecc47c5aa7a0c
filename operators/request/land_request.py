# SPDX-License-Identifier: GPL-3.0-or-later
"""The shaped land that a request is about: which store has it, and what stands in for it until it is there.

A stack is shaped into a folder beside its source's store, named for the source's content and the stack's key. So the
settings alone decide which land is shown: Undo brings back the one before at once, and terrains that ask for the same
share it. Nothing here touches Blender but `land_of`.
"""

import errno
import functools
import os
import re
import threading
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field import store as stores
from ...cbt_terrain.field import store_folder
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.land.preview import Preview, preview
from ...cbt_terrain.land.shape_process import shape_store
from ...cbt_terrain.land.stack import Stack, land_name
from ...cbt_terrain.run import launch, owned_files
from ...cbt_terrain.run.owned_files import NotOursError
from ..properties.land_properties import SEEN
from ..properties.scene_paths import absolute_path
from ..text.console import print_line
from . import land_masks, land_stack, land_tiles
from .land_folders import (
    MASKS,
    OF_VIEWS,
    folder_beside,
    is_land_name,
    is_of_views,
    records,
    shaped_stores,
)
from .land_folders import remove as remove_land

MOST_BYTES = 8 << 30  # of the shaped stores of a source, which spare steps of Undo their time
MOST_PREVIEWS = 4  # a preview holds about 12 MB
_SHORT_OF = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)  # what this process lacks, and no fault of a file
MOST_REPAIRS = 3  # of one land: a disk that damages all that is written would keep a viewport at it for ever
_repairs: Counter[str] = Counter()  # by folder, in this session
_previews: dict[str, Preview] = {}  # by `Land.folder`, the last one last
made = {"previews": 0, "stores": 0}  # how often land was made, for whoever wants to know what a scene costs
_shaping = threading.Lock()
_in_use: dict[int, str] = {}  # the land that each terrain of the open file has asked for last, by its session_uid


class DamagedLand(TerrainError):
    """A shaped store was damaged or removed, and is no store any more: who gathers the request again gets other
    land."""


@dataclass(frozen=True)
class Land:
    """A stack on a source. `source`: folder of its store. `folder`: of the shaped store, whether or not it is there;
    its name tells one stack from another. `waits`: a preview will not do. `seen`: who looks, where only what is seen is
    to be fine; None for everything."""

    source: str
    folder: str
    waits: bool
    stack: Stack = field(compare=False)
    seen: land_tiles.Seen | None = field(default=None, compare=False)

    @property
    def tiles(self) -> Path:
        """Where tiles are kept, of all stacks on this source."""
        return Path(self.folder).parent / store_folder.TILES

    @property
    def of_views_alone(self) -> "Land":
        """The same where only what some views see is fine, which has a store of its own."""
        return replace(self, folder=self.folder.removesuffix(OF_VIEWS) + OF_VIEWS)

    @property
    def of_views(self) -> bool:
        return is_of_views(self.folder)

    @property
    def shown(self) -> str:
        """Folder of the store that a viewport shows, "" where a preview has to do."""
        both = (self, self.of_views_alone)
        return next((land.folder for land in both if land.is_shaped), "")

    @property
    def is_shaped(self) -> bool:
        """Return whether the store is there, of this version, and records that it is this land."""
        changed = stores.changed_ns(self.folder)
        try:
            return bool(changed) and _is_recorded(self.folder, changed, _source_key(self.source))
        except TerrainError:
            return False


def land_of(obj, evaluated, depsgraph, waits: bool) -> Land | None:
    """What the stack of a terrain makes of its source; None without a stack. None, too, where a preview would do and
    the viewport does not show the terrain: for that one nothing is made. Raises TerrainError."""
    settings = evaluated.adaptive_terrain
    if not settings.store or not any(entry.on for entry in settings.land.entries):
        release(obj.session_uid)
        return None
    if not waits and not obj.visible_get(view_layer=depsgraph.view_layer):
        return None
    source = absolute_path(settings.store)
    folder = folder_beside(source)
    owned_files.check_folder(folder, MASKS, store_folder.TILES)
    stack = land_stack.stack_of(evaluated, depsgraph, folder / MASKS)
    if not stack.active:
        return None
    land = Land(source, str(folder / land_name(_source_key(source), stack)), waits, stack)
    owned_files.check_folder(folder, *(Path(some.folder).name for some in (land, land.of_views_alone)))
    _note_use(obj.session_uid, land)
    return land.of_views_alone if settings.land.where == SEEN else land


def _note_use(uid: int, land: Land) -> None:
    if _in_use.get(uid) != land.folder:
        _in_use[uid] = land.folder
        for folder in (land.folder, land.of_views_alone.folder):
            with suppress(OSError):
                owned_files.touch(folder)  # it was used just now: see `remove_old`


def release(uid: int) -> None:
    """The terrain `uid` has no stack any more."""
    _in_use.pop(uid, None)


def is_in_use(folder: Path) -> bool:
    """Whether a terrain of the open file shows the land in a folder, by whatever path, or is about to."""
    return os.path.realpath(folder).removesuffix(OF_VIEWS) in map(os.path.realpath, list(_in_use.values()))


def _source_key(store: str) -> str:
    changed = stores.changed_ns(store)
    if not changed:
        raise TerrainError(f"There is no terrain store at {store!r}: choose its folder under Store, or import again.")
    return _key_of(store, changed)


@functools.lru_cache(maxsize=64)
def _is_recorded(folder: str, _changed_ns: int, source_key: str) -> bool:
    return records(stores.read_json(Path(folder))["provenance"], folder, source_key)


@functools.lru_cache(maxsize=64)
def _key_of(store: str, _changed_ns: int) -> str:
    return stores.read_json(Path(store))["key"]


def raster_of(store: str, land: Land | None, open_field) -> HeightField:
    """The height field of a request's store, or of its land: that is shaped first if it has to be, else a preview does.
    For any thread. Raises TerrainError; DamagedLand where `store` was shaped."""
    if land is None:
        return _opened(store, open_field)
    if not land.waits and not land.is_shaped:
        return previewed(land, open_field).field
    if land.waits and (land.seen or not is_whole(land, open_field)):
        with _shaping:  # two renders of one land make it once
            wanted = wanted_tiles(land, open_field)
            if not is_whole(land, open_field) or not land_tiles.has(land.folder, wanted):
                wanted = land_tiles.with_known(land.folder, wanted)
                shape_store(land.source, land.stack, land.folder, wanted, tiles=land.tiles)
                land_tiles.note(land.folder, wanted)
                made["stores"] += 1
                remove_old(land)
    try:
        return open_field(land.folder)
    except TerrainError as error:
        if stores.changed_ns(land.folder):
            raise
        raise DamagedLand(
            f"The shaped land in {land.folder!r} is gone again, by a Clear Land Cache of another Blender perhaps: try "
            "once more."
        ) from error


def whole_raster_of(store: str, land: Land | None, open_field) -> HeightField:
    """As `raster_of`, for who reads all of it: shaped land is damaged nowhere, not in a layer either."""
    field = raster_of(store, land, open_field)
    if land is not None and land.is_shaped:
        changed = stores.changed_ns(land.folder)
        fault = _fault_in(land.folder)
        if fault is not None and _take_away(land.folder, changed, fault):
            return raster_of(store, land, open_field)
    return field


def _opened(store: str, open_field) -> HeightField:
    """A source's store, or a shaped one, which nobody imports."""
    changed = stores.changed_ns(store)
    try:
        return open_field(store)
    except TerrainError as error:
        if _take_away(store, changed, error):
            raise DamagedLand(_damage(store, error)) from error
        if _is_made_here(store) and not _is_short(error):
            raise TerrainError(
                f"{_fault(error)}. It is shaped land, which cannot be made again: look at its disk and its rights."
            ) from error
        raise


def is_whole(land: Land, open_field) -> bool:
    """Return whether the shaped store is there, can be opened and records that it is this land. One that cannot be
    opened is removed, so that it is made again; files of others in its folder stay. Raises TerrainError for a link, and
    for the store of another terrain."""
    changed = stores.changed_ns(land.folder)
    try:
        field = open_field(land.folder) if changed else None
    except TerrainError as error:
        _take_away(land.folder, changed, error)
        return False
    return field is not None and records(field.provenance, land.folder, _source_key(land.source))


def check_blocks(store: str, error: TerrainError) -> None:
    """Raise DamagedLand if it was the damage of a shaped store that an update ended with."""
    changed = stores.changed_ns(store)
    fault = _fault_behind(store, changed, str(error)) if _is_made_here(store) else None
    if fault is not None and _take_away(store, changed, fault):
        raise DamagedLand(_damage(store, fault)) from error


@functools.lru_cache(maxsize=8)
def _fault_behind(store: str, _changed_ns: int, _error: str) -> TerrainError | None:
    """Looked for once: an error of other causes may come again with every update."""
    return _fault_in(store)


def _fault_in(store: str) -> TerrainError | None:
    """The first in any block of a store."""
    try:
        stores.verify(store)
    except TerrainError as error:
        return error
    return None


def _take_away(store: str, changed_ns: int, why: TerrainError) -> bool:
    """Make what was shaped no store any more, unless it has changed since, and say so: nothing of it is anyone's own.
    What others have mapped of it stays theirs. Returns whether it is none now; any other store is left alone, and land
    that was made again often enough. Raises NotOursError where `why` is that a link stands there."""
    if isinstance(why, NotOursError):
        raise why
    if not _is_made_here(store) or _is_short(why):
        return False
    if changed_ns and stores.changed_ns(store) == changed_ns:
        if _repairs[store] >= MOST_REPAIRS:
            return False
        try:
            store_folder.take_away(Path(store))
        except OSError:
            return False
        _repairs[store] += 1
        print_line(f"Adaptive Terrain: {_damage(store, why)}")
    return True


def _is_short(why: TerrainError) -> bool:
    return getattr(why.__cause__, "errno", None) in _SHORT_OF


def _damage(store: str, why: TerrainError) -> str:
    return f"The shaped land in {store!r} is damaged, and is made again from its source: {_fault(why)}."


def _fault(why: TerrainError) -> str:
    return re.sub(r"[:;] import [^:;]*\.$", "", str(why))  # nobody has imported it


def _is_made_here(store: str) -> bool:
    """Whether a stack of the open file makes a store. One that a user has chosen as a source nobody makes again."""
    return is_in_use(Path(store)) and is_land_name(Path(store).name)


def wanted_tiles(land: Land, open_field) -> land_tiles.Tiles | None:
    """Those that the land's views need; None for all."""
    return None if land.seen is None else land.seen.tiles(open_field(land.source))


def previewed(land: Land, open_field) -> Preview:
    found = _previews.pop(land.folder, None)
    if found is None:
        made["previews"] += 1
        found = preview(open_field(land.source), land.stack, _images_of(land.stack), launch.default_threads())
    _previews[land.folder] = found
    while len(_previews) > MOST_PREVIEWS:
        del _previews[next(iter(_previews))]
    return found


def remove_old(land: Land) -> None:
    """Keep no more than MOST_BYTES of the shaped stores of a source: those that were used last. What is in use stays,
    and so does `land`; what is removed can be shaped again."""
    kept = shaped_stores(land.source)
    total = sum(size for _, size in kept)
    for folder, size in kept:
        if total > MOST_BYTES and not is_in_use(folder) and str(folder) != land.folder:
            remove_land(folder)
            total -= size


def _images_of(stack: Stack) -> dict[str, np.ndarray]:
    """The files that land_masks.py has written, row 0 south."""
    files = {entry.mask.image for entry in stack.active if entry.mask is not None and entry.mask.image}
    return {file: land_masks.read(file)[::-1] for file in files}


def preview_of(land: Land) -> Preview | None:
    """The preview that was made of a land, if it is still known."""
    return _previews.get(land.folder)


def forget() -> None:
    _previews.clear()
    _in_use.clear()
    _repairs.clear()
