# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles that the frames of a shot see, for terrains whose store is incomplete: found, read ahead and loaded.

The first picture of a terrain is the store of its quick import, which has every n-th sample of a large source. Parts of
the raster, its tiles, can then be loaded in more detail; where a mosaic has finer files, these are loaded in parts
called squares. A SeenLand is the views of one frame with the error that they allow.

A farm's job finds tiles (`plan_tiles`), reads them into files on several computers (`read_tiles`), and loads these
(`load_tiles`) into a copy of the first picture in the job's folder, the job's store, so that neither the artist's work
nor another job changes it meanwhile.
"""

import json
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError, unwritable
from ...cbt_terrain.field.packing import copy_store
from ...cbt_terrain.field.store import open_store, read_json
from ...cbt_terrain.field.store_folder import AHEAD, JSON_NAME, remove_store
from ...cbt_terrain.importing.import_process import import_source
from ...cbt_terrain.importing.read_ahead import remove_ahead, share_of
from ...cbt_terrain.importing.refining import (
    are_all_samples,
    first_picture,
    is_large,
    loaded_tiles,
    picture_tiles,
    with_loaded,
)
from ...cbt_terrain.importing.thinning import loaded_m, loaded_text
from ...cbt_terrain.importing.tile_import import READ_TILES, ImportPart
from ...cbt_terrain.importing.view_needs import (
    SeenLand,
    are_loaded_enough,
    is_fine_enough,
    missing_squares,
    needed_tiles,
    neediest_tile,
)
from ...cbt_terrain.rasters.raster import ImportSettings
from ...cbt_terrain.run.named_file import read_regular
from ...cbt_terrain.run.owned_files import open_folder
from ...cbt_terrain.run.partial_files import written_beside
from ..bridge.scene_paths import absolute_path, store_path
from ..session.shot import visit_requests
from .import_terrain import settings_of
from .shot_import import forget_import, is_begun
from .view_tiles import seen_land

WANTED = "wanted.json"  # in the store's folder AHEAD: the tiles to load
MAX_WANTED = 1 << 20  # bytes
SUFFIX = ".store"
NEARLY_ALL = 0.9  # of the tiles of a store: a complete import then reads little more
ALL_SAMPLES = "the frames need all samples"


def can_load_tiles(store: Path) -> bool:
    """Return whether a store is incomplete, of a source so large that only the tiles in view are loaded."""
    with suppress(TerrainError):
        if os.path.exists(store / JSON_NAME) and loaded_m(read_json(store)["provenance"]) is not None:
            return is_large(open_store(first_picture(store)))
    return False


def num_tiles(store: Path) -> int:
    """Return the number of tiles of a store that may be in view; 0 for a store whose tiles cannot be loaded."""
    return picture_tiles(open_store(first_picture(store))) if can_load_tiles(store) else 0


def use_job_stores(objects: Sequence, stores: Path) -> None:
    """Give terrains their stores in the job's folder `stores`, until the file is opened again.

    A terrain without one there keeps its own. Raises TerrainError if that is incomplete.
    """
    for obj in objects:
        scene_store, of_job = Path(absolute_path(obj.adaptive_terrain.store)), job_store(obj, stores)
        if os.path.exists(of_job / JSON_NAME):
            obj.adaptive_terrain.store = str(of_job)
        elif obj.adaptive_terrain.store and can_load_tiles(scene_store):
            what = f"The tiles of {obj.name!r} that the frames see are not loaded in {stores}"
            raise TerrainError(what, fix="run `prepare` with the same --job-stores first")


def job_store(obj, stores: Path) -> Path:
    """Return the store of a terrain in the folder of a job's stores."""
    return stores.absolute() / f"{bpy.path.clean_name(obj.name)}{SUFFIX}"


def find_tiles(obj, frames: Sequence[int], stores: Path | None) -> tuple[Path, list[SeenLand], frozenset[int]]:
    """Return the store into which tiles are loaded, the SeenLand of each frame, and all tiles that they need.

    A terrain that renders do not show needs none. stores: the folder of the job's stores, in which that store is made;
    None for the terrain's own store. Raises TerrainError.
    """
    scene_store = Path(store_path(obj))
    store = scene_store if stores is None else _copied(first_picture(scene_store), job_store(obj, stores))
    # about_middle: the origin of the terrain's space is the raster's middle, as `seen_land` expects.
    requests = visit_requests(obj, bpy.context.scene, frames, about_middle=True)
    lands = [seen_land(request) for request in requests if not obj.hide_render]
    return store, lands, needed_tiles(store, lands)


def _lacking(store: Path, tiles: frozenset[int]) -> tuple[int, ...]:
    """Return those of some tiles that a store lacks, in ascending order. Raises TerrainError."""
    return tuple(sorted(tiles - loaded_tiles(read_json(store)["provenance"])))


def plan_tiles(obj, frames: Sequence[int], stores: Path | None) -> str:
    """Write the tiles that frames need and the store lacks, for `read_tiles`; return a text about them.

    Return "" if a job's frames need all samples: nearly all tiles, or more detail than tiles have. The tile that lacks
    most of the needed detail is loaded to find that out. stores: the folder of the job's stores, None for the terrain's
    own store. Raises TerrainError, also if the store is not of the terrain's sources and settings.
    """
    if is_begun(obj, stores, frames):  # an earlier run of the job found this out: it imports all samples
        return ALL_SAMPLES
    forget_import(obj, stores)  # a record for other frames or another first picture
    store, lands, needed = find_tiles(obj, frames, stores)
    tiles = _lacking(store, needed)
    if not tiles:
        remove_ahead(store)
        return "no further tiles are in view"
    if _needs_nearly_all(store, tiles, stores) or not (stores is None or _load_neediest(obj, store, lands, tiles)):
        discard_store(store)
        return ""
    # Without numbers of tiles this only checks the sources.
    import_source(_settings_with(obj, store, tiles), store, part=ImportPart(READ_TILES))
    _write_wanted(store, _lacking(store, needed))
    return f"{len(tiles):,} further tiles of {num_tiles(store):,} are in view"


def _needs_nearly_all(store: Path, tiles: Sequence[int], stores: Path | None) -> bool:
    """Return whether a job imports all samples instead of tiles, because these are nearly all samples of the source.

    Several computers then share all of that work, and not only the reading of tiles. The tiles of a very large source
    leave out samples; such tiles are loaded. stores: the folder of the job's stores; None outside a job: False.
    """
    picture = open_store(first_picture(store))
    return stores is not None and are_all_samples(picture) and len(tiles) >= NEARLY_ALL * picture_tiles(picture)


def _load_neediest(obj, store: Path, lands: Sequence[SeenLand], tiles: Sequence[int]) -> bool:
    """Load the tile that lacks most of the detail that views need; return whether it then has all of that.

    If it still lacks some, the other tiles would be loaded for nothing. If the store has loaded tiles already, no tile
    is loaded, and those are judged. lands: views of each frame. tiles: those that they need and the store lacks. Raises
    TerrainError.
    """
    if not loaded_tiles(read_json(store)["provenance"]):
        import_source(_settings_with(obj, store, (neediest_tile(store, lands, tiles),)), store)
    return are_loaded_enough(store, lands)


def _copied(picture: Path, store: Path) -> Path:
    """Return the job's store after making it from a first picture, unless it was made from the same before.

    picture: the store of a quick import, which has coarse heights only. Once tiles are loaded, `store` has a copy of
    the one that it was made from (`first_picture`).
    """
    if (store / JSON_NAME).exists() and read_json(first_picture(store))["digest"] != read_json(picture)["digest"]:
        discard_store(store)
    if not (store / JSON_NAME).exists():
        copy_store(picture, store)
    return store


def discard_store(store: Path) -> None:
    """Remove a job's store, with tiles that were read ahead. Raises TerrainError."""
    try:
        remove_ahead(store)
        remove_store(store)
    except OSError as reason:
        raise unwritable(f"The store {store}", reason) from reason


def _write_wanted(store: Path, tiles: Sequence[int]) -> None:
    """Write the numbers of tiles into a file of the store. Raises TerrainError."""
    file = store / AHEAD / WANTED
    try:
        with open_folder(file.parent, make=True):  # makes it
            pass
        with written_beside(file) as partial:
            partial.write_text(json.dumps(list(tiles)), encoding="utf-8")
    except OSError as reason:
        raise unwritable(f"The store {store}", reason) from reason


def read_tiles(obj, store: Path, part: tuple[int, int], on_progress: Callable[[float], None]) -> int:
    """Read a part of the tiles that `plan_tiles` has found, ahead of `load_tiles`; return their number.

    part: its number from 1, and the number of parts. Several computers may read different parts at the same time.
    Raises TerrainError.
    """
    try:
        found = json.loads(read_regular(store / AHEAD / WANTED, MAX_WANTED, links=False))
        wanted = {number for number in found if type(number) is int and number >= 0}
    except (OSError, ValueError, TypeError):
        return 0  # without the file no tile is left to read
    mine = share_of(wanted, *part)
    if mine:
        settings = _settings_with(obj, store, wanted)
        import_source(settings, store, lambda done, _text: on_progress(done), part=ImportPart(READ_TILES, mine))
    return len(mine)


def load_tiles(obj, frames: Sequence[int], stores: Path | None, on_progress: Callable[[float], None]) -> str:
    """Load the tiles that frames need; return a text about the store, or "" if the frames need all samples.

    Squares with finer files follow the tiles, since only loaded tiles show where they are needed. The text counts all
    tiles that the frames need, also those that `plan_tiles` or an earlier call has loaded. stores: the folder of the
    job's stores, None for the terrain's own store. A job's store is removed if the frames need all samples. Raises
    TerrainError.
    """
    store, lands, needed = find_tiles(obj, frames, stores)
    tiles = _lacking(store, needed)
    if _needs_nearly_all(store, tiles, stores):  # only in a job
        discard_store(store)
        return ""
    if tiles:
        import_source(_settings_with(obj, store, tiles), store, lambda done, _text: on_progress(done))
    remove_ahead(store)  # the files of `read_tiles`, which are no longer needed
    if squares := missing_squares(store, lands):
        import_source(_settings_with(obj, store, (), squares), store, lambda done, _text: on_progress(done))
    if is_fine_enough(store, lands):
        finest = f" and {len(squares):,} squares with finer files" if squares else ""
        text = loaded_text(read_json(store)["provenance"])
        return f"{len(needed):,} tiles in view{finest} are loaded, {text}"
    if stores is not None:
        discard_store(store)
    return ""


def _settings_with(obj, store: Path, tiles: Sequence[int] | set[int], squares: Sequence[int] = ()) -> ImportSettings:
    """Return the settings of a terrain's quick import with further loaded tiles and squares. Raises TerrainError."""
    quick = read_json(store)["provenance"]["settings"]["quick"]
    return with_loaded(replace(settings_of(obj), quick=quick), store, tiles, squares)
