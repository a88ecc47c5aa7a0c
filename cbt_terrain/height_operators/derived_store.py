# SPDX-License-Identifier: GPL-3.0-or-later
"""Shaped land as a cache: the store that a stack derives from a source's store, or a preview until it is there.

A derived store is in the folder next to its source (land_folder.py) and is named for the content of the source and the
stack. So the settings alone decide which land is shown: Undo brings back the one before at once, and terrains with
equal settings share one. Everything in the folder can be rebuilt, so a store that fails a check is removed and built
again. A `Land` is a source's store with a stack; `open_field` opens the height field of a store in a folder.
"""

import errno
import functools
import os
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from ..field import store as stores
from ..field import store_folder
from ..field.heightfield import HeightField
from ..run import launch, owned_files
from ..run.owned_files import NotOursError
from . import land_folder, requested_tiles, shaping_cost
from .land_folder import OF_VIEWS, is_land_name, read_mask
from .preview import Preview, preview
from .requested_tiles import SeenTiles, Tiles
from .shape_process import ShapeJob, shape_store
from .stack import Stack, land_name

OpenField = Callable[[str], HeightField]  # opens the store in a folder

DAMAGED = "land.damaged"  # code of the error for a derived store that was removed: the caller asks again
MAX_BYTES = 8 << 30  # of the derived stores of one source
MAX_PREVIEWS = 4  # a preview holds about 12 MB
MAX_REBUILDS = 3  # of one store in a session: a failing disk would keep the program busy for ever
LIMITS_OF_PROCESS = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)  # what this process lacks is no damage

counts = {"previews": 0, "stores": 0}  # how often each was built, for tests of a scene's cost
notify: Callable[[str], None] = print  # shows a sentence to the user
_shaping = threading.Lock()
_in_use: dict[int, str] = {}  # folder of the land that each user wants
_previews: dict[str, Preview] = {}  # by `Land.folder`, the last one used last
_rebuilds: Counter[str] = Counter()  # by folder
_costs_less_whole: dict[str, bool] = {}  # by the folder of land
_verified: set[tuple[str, int]] = set()  # stores, with their time of change, whose files were all checked


def on_shaping(_land: "Land", _fraction: float, _message: str) -> None:
    """Report the progress of shaping that the caller waits for: the finished fraction, 1 at the end, and a text.

    Blender's part replaces this function, which does nothing. It may be called on any thread, and cancels the shaping
    by raising TerrainError before the fraction is 1.
    """


@dataclass(frozen=True)
class Land:
    """A stack on a source.

    Attributes:
        source: folder of the source's store.
        whole: folder of the derived store of all of it, whether or not it is there.
        waits: whether the user waits for the store, as a render does, since a preview is not enough.
        stack: the height operators to apply.
        of_views: whether only the parts in view are fine; such land has another store.
        seen: the views that need fine land, None for all of it.
    """

    source: str
    whole: str
    waits: bool
    stack: Stack = field(compare=False)
    of_views: bool = False
    seen: SeenTiles | None = field(default=None, compare=False)

    @classmethod
    def of(cls, source: str, stack: Stack, waits: bool) -> "Land":
        """Return the land that a stack makes of the store `source`; nothing is shaped or opened.

        waits: whether the user needs the shaped store (as a render does), so that a preview is not enough.
        Raises TerrainError if one of its folders is a link.
        """
        beside = land_folder.folder_beside(source)
        land = cls(source, str(beside / land_name(_source_key(source), stack)), waits, stack)
        owned_files.check_folder(beside, *(Path(some.folder).name for some in (land, land.of_views_alone)))
        return land

    @property
    def tiles(self) -> Path:
        """Return the folder of the tiles of all stacks on this source."""
        return Path(self.folder).parent / store_folder.TILES

    @property
    def folder(self) -> str:
        """Return the folder of the derived store."""
        return self.whole + OF_VIEWS if self.of_views else self.whole

    @property
    def of_views_alone(self) -> "Land":
        """Return the same land where only the parts in view are fine, which is quicker to shape."""
        return replace(self, of_views=True)

    @property
    def in_shots(self) -> "Land":
        """Return the land that shots (camera moves) need: fine only in their views, or whole if that costs less."""
        if self.folder not in _costs_less_whole:
            lattice = shaping_cost.lattice_of(self.source)
            _costs_less_whole[self.folder] = shaping_cost.costs_less_whole(lattice, self.stack)
        return self if _costs_less_whole[self.folder] else self.of_views_alone

    @property
    def shown(self) -> str:
        """Return the folder of the store that a viewport shows, "" if it shows a preview because none is there yet."""
        both = (self, self.of_views_alone)
        return next((land.folder for land in both if land.is_shaped), "")

    @property
    def is_shaped(self) -> bool:
        """Return whether the store is there, has this version and records this land."""
        changed = stores.changed_ns(self.folder)
        try:
            return bool(changed) and _is_recorded(self.folder, changed, _source_key(self.source))
        except TerrainError:
            return False


def use(user: int, land: Land) -> None:
    """Note that a user wants this land: it is not removed as old, and is rebuilt if it is damaged.

    It replaces the land that this user wanted before. user: any number that identifies it, as the session_uid of an
    object. land: not one of views; both of its folders then count as in use.
    """
    if _in_use.get(user) != land.folder:
        _in_use[user] = land.folder
        for folder in (land.folder, land.of_views_alone.folder):  # a viewport may show either
            with suppress(OSError):
                owned_files.touch(folder)  # the folders that were not used for longest are removed first


def release(user: int) -> None:
    """Note that a user, by number, no longer wants any land; the land may be removed then."""
    _in_use.pop(user, None)


def is_in_use(folder: str | os.PathLike) -> bool:
    """Return whether a user wants the land in a folder, whole or fine only in views, also through a link."""
    return os.path.realpath(folder).removesuffix(OF_VIEWS) in map(os.path.realpath, list(_in_use.values()))


def forget() -> None:
    """Forget all users, previews and checks, for another file or a test."""
    for known in (_previews, _in_use, _rebuilds, _verified):
        known.clear()


def field_of_land(land: Land, open_field: OpenField, verified: bool = False) -> HeightField:
    """Return the height field of land, which is shaped first if it is needed; as `raster_of`."""
    return raster_of("", land, open_field, verified)


def raster_of(store: str, land: Land | None, open_field: OpenField, verified: bool = False) -> HeightField:
    """Return the height field of a store or of land, which is shaped first if it is needed. For any thread.

    Args:
        store: folder of the store to open if `land` is None.
        land: land to open instead; its preview if it is not shaped and `land.waits` is False.
        open_field: opens the store in a folder.
        verified: check all files of land first, as for an export: meshes do not read all of them.

    Raises:
        TerrainError: with the code DAMAGED where `store` was a damaged derived store, which is removed, or where
            another program has removed the land: call again. Others if nothing can be shaped or opened.
    """
    if land is None:
        return _open(store, open_field)
    if not land.waits and not land.is_shaped:
        return build_preview(land, open_field).field
    # Land shaped only where views see it (`seen`) may lack tiles of this request although it is usable.
    if land.waits and (land.seen or not is_usable(land, open_field)):
        with _shaping:  # two renders of one land shape it once
            _shape(land, open_field)
    if verified and _remove_damaged(land.folder) is not None:
        return raster_of(store, land, open_field)
    try:
        return open_field(land.folder)
    except TerrainError as error:
        if stores.changed_ns(land.folder):
            raise
        raise TerrainError(
            "Shaped land was removed, perhaps by Clear Land Cache of another Blender",
            land.folder,
            fix="try once more",
            code=DAMAGED,
        ) from error


def _shape(land: Land, open_field: OpenField) -> None:
    """Shape the tiles of a land that its folder lacks, together with those requested earlier; wait for them.

    Raises TerrainError, also if `on_shaping` cancels.
    """
    wanted = wanted_tiles(land, open_field)
    if not has_tiles(land, wanted, open_field):
        wanted = requested_tiles.with_known(land.folder, wanted)
        tell = functools.partial(on_shaping, land)
        try:
            shape_store(land.source, land.stack, land.folder, wanted, tell, tiles=land.tiles)
        finally:
            tell(1.0, "")  # ends the display of progress, also after an error
        finish_shaping(land, wanted)
        counts["stores"] += 1


def begin_shaping(land: Land, wanted: Tiles | None, gentle: bool = False) -> tuple[ShapeJob, Tiles | None]:
    """Begin to shape land in a child process; return the job and the tiles that `finish_shaping` needs.

    wanted: the requested tiles, from `wanted_tiles`, to which those of earlier requests are added; None for all.
    gentle: run at low priority. Raises TerrainError.
    """
    wanted = requested_tiles.with_known(land.folder, wanted)
    return ShapeJob(land.source, land.stack, land.folder, wanted, tiles=land.tiles, gentle=gentle), wanted


def finish_shaping(land: Land, wanted: Tiles | None) -> None:
    """Record tiles that were just shaped, and remove land beyond MAX_BYTES. wanted: requested tiles, None for all."""
    requested_tiles.note(land.folder, wanted)
    remove_old(land)


def is_usable(land: Land, open_field: OpenField) -> bool:
    """Return whether the derived store is there, can be opened and records this land; remove one that is damaged.

    Raises:
        TerrainError: the folder is a link or holds the store of another terrain.
    """
    if not stores.changed_ns(land.folder):
        return False
    try:
        derived = open_field(land.folder)
    except TerrainError as error:
        _remove_damaged(land.folder, error)
        return False
    return land_folder.records(derived.provenance, land.folder, _source_key(land.source))


def has_tiles(land: Land, wanted: Tiles | None, open_field: OpenField) -> bool:
    """Return whether the derived store is there with these tiles, None for all; remove one that is damaged."""
    return is_usable(land, open_field) and requested_tiles.has(land.folder, wanted)


def wanted_tiles(land: Land, open_field: OpenField) -> Tiles | None:
    """Return the tiles that the land's views need, None if all land is to be fine.

    The result has for each level {tile: allowed error in metres}. open_field: opens a store's height field.
    """
    return None if land.seen is None else land.seen.tiles(open_field(land.source))


def build_preview(land: Land, open_field: OpenField) -> Preview:
    """Return the preview of a land, built on first use; the last MAX_PREVIEWS stay in memory.

    open_field: opens a store's height field. Raises TerrainError for a source or a mask that cannot be read.
    """
    built = _previews.pop(land.folder, None)
    if built is None:
        counts["previews"] += 1
        images: dict[str, np.ndarray] = {file: read_mask(file)[::-1] for file in land.stack.mask_images}  # row 0 south
        built = preview(open_field(land.source), land.stack, images, launch.default_threads())
    _previews[land.folder] = built
    while len(_previews) > MAX_PREVIEWS:
        del _previews[next(iter(_previews))]
    return built


def preview_of(land: Land) -> Preview | None:
    """Return the preview of land if it is in memory, None otherwise."""
    return _previews.get(land.folder)


def remove_old(land: Land) -> None:
    """Remove derived stores of the land's source beyond MAX_BYTES, oldest use first, except `land` and land in use."""
    stored = land_folder.shaped_stores(land.source)
    total = sum(int(size) for _, size in stored)
    for folder, size in stored:
        if total > MAX_BYTES and not is_in_use(folder) and str(folder) != land.folder:
            land_folder.remove(folder)
            total -= size


def raise_if_damaged(store: str, error: TerrainError) -> None:
    """Check a derived store after an error that its damage may have caused; other stores and whole ones stay.

    A store is checked once; its result counts until the store changes.

    Raises:
        TerrainError: with the code DAMAGED if it was damaged and is removed.
    """
    changed = stores.changed_ns(store)
    if (store, changed) not in _verified:
        fault = _remove_damaged(store)
        if fault is not None:
            raise _damaged_error(store, fault) from error
        _verified.add((store, changed))


def _open(store: str, open_field: OpenField) -> HeightField:
    """Open the height field of a store, with `open_field`.

    Shaped land that is damaged is removed, so that it is shaped again. Raises TerrainError, then with the code DAMAGED.
    An error from a limit of this process, such as open files, is raised as it is.
    """
    try:
        return open_field(store)
    except TerrainError as error:
        if _remove_damaged(store, error) is not None:
            raise _damaged_error(store, error) from error
        if _is_rebuilt_here(store) and not _is_limit(error):
            fix = "check its disk and your rights: it is shaped land that cannot be built again"
            raise TerrainError(error.what, error.where, error.expected, fix) from error
        raise


def _remove_damaged(store: str, fault: TerrainError | None = None) -> TerrainError | None:
    """Remove a damaged derived store, and notify the user; return its fault, None if the store is whole or stays.

    The fault is also returned if another process has replaced the store meanwhile. fault: the error of opening it; None
    to check all its files. These stay: a store that no stack in use makes, one that was removed MAX_REBUILDS times, one
    for which this process lacks memory or open files, and files of others in the folder.

    Raises:
        NotOursError: the store is a link.
    """
    from ..field.verification import verify

    if not _is_rebuilt_here(store):
        return None
    changed = stores.changed_ns(store)  # time of its last change, 0 if it is gone
    if fault is None:
        try:
            verify(store)
            return None
        except TerrainError as found:
            fault = found
    if isinstance(fault, NotOursError):
        raise fault
    if _is_limit(fault):
        return None
    if changed and stores.changed_ns(store) == changed:  # else another process has replaced it
        if _rebuilds[store] >= MAX_REBUILDS:
            return None
        try:
            store_folder.take_away(Path(store))
        except OSError:
            return None
        _rebuilds[store] += 1
        notify(str(_damaged_error(store, fault)))
    return fault


def _damaged_error(store: str, fault: TerrainError) -> TerrainError:
    """Return the error for shaped land that is damaged and will be built again. fault: how it is damaged."""
    what = f"The shaped land in {store!r} is damaged and is built again from its source ({fault.what})"
    return TerrainError(what, code=DAMAGED)


def _is_limit(error: TerrainError) -> bool:
    """Return whether an error comes from a limit of this process, such as open files, and not from damage."""
    return getattr(error.__cause__, "errno", None) in LIMITS_OF_PROCESS


def _is_rebuilt_here(store: str) -> bool:
    """Return whether a user's stack makes this store. Shaped land that was chosen as a source is not built again."""
    return is_land_name(Path(store).name) and is_in_use(store)


def _source_key(store: str) -> str:
    """Return the content key of a store, read again if the store has changed. Raises TerrainError."""
    return _key_of(store, stores.check_exists(store))


@functools.lru_cache(maxsize=64)
def _is_recorded(folder: str, _changed_ns: int, source_key: str) -> bool:
    """Return whether a folder's store.json says that it was shaped from a source with this key.

    _changed_ns: time of its last change, only for the cache.
    """
    return land_folder.records(stores.read_json(Path(folder))["provenance"], folder, source_key)


@functools.lru_cache(maxsize=64)
def _key_of(store: str, _changed_ns: int) -> str:
    """Return the content key in a store's JSON file. _changed_ns: time of its last change, only for the cache."""
    return stores.read_json(Path(store))["key"]
