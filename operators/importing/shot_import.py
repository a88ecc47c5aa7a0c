# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of all samples of a terrain by several computers, for a farm's job.

It is of a large raster whose store is missing, or whose tiles in view are not enough for the frames. A file beside the
job's stores records that it has begun. The steps of the import (`import --only`) then write into the terrain's own
store, and do nothing for a terrain without that record.
"""

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import bpy

from ...cbt_terrain.errors import unwritable
from ...cbt_terrain.field.lands import LANDS
from ...cbt_terrain.field.store import JSON_NAME, read_json
from ...cbt_terrain.importing.import_process import import_source
from ...cbt_terrain.importing.import_work import count_tiles
from ...cbt_terrain.importing.read_ahead import share_of
from ...cbt_terrain.importing.refining import first_picture
from ...cbt_terrain.importing.source_list import has_archives, names_several
from ...cbt_terrain.importing.tile_crew import may_be_large
from ...cbt_terrain.importing.tile_import import BEGIN, TILED_PARTS, ImportPart
from ...cbt_terrain.mosaic.mosaic_info import size_of_heights
from ...cbt_terrain.rasters.raster import ImportSettings
from ...cbt_terrain.rasters.source_formats import CELL, suffixes_with
from ...cbt_terrain.run.named_file import read_regular
from ...cbt_terrain.run.owned_files import open_folder, remove_file
from ...cbt_terrain.run.partial_files import written_beside
from ..bridge.scene_paths import store_path
from .import_terrain import settings_of

SUFFIX = ".all.json"  # of the record of a terrain that needs all samples
MAX_BYTES = 1 << 20
TILES = "tiles"
# Tiles of the smallest import that several computers share. Sharing adds four steps, one after the other, which start
# Blender for 5 s each. At 0.3 us of processor time a sample, 8 cores need 10 s for 64 tiles: an estimate.
MIN_TILES = 64


def shared_tiles(obj) -> int:
    """Return the number of tiles of the import of a terrain without a complete store, 0 if one computer does it.

    Several computers share it from MIN_TILES tiles on, if each can read a part of the source: an archive would be
    unpacked, and points gridded, by all of them. The headers of the files are read. Raises TerrainError.
    """
    return tiles_to_share(settings_of(obj))


def tiles_to_share(settings: ImportSettings) -> int:
    """Return the number of tiles of an import as `shared_tiles` does, on any thread."""
    if not may_be_large(settings) or _is_read_whole(settings):
        return 0
    count = count_tiles(size_of_heights(settings))
    return count if count >= MIN_TILES else 0


def _is_read_whole(settings: ImportSettings) -> bool:
    """Return whether any part of an import reads the whole source: an archive, or one file of points."""
    if settings.source in LANDS:
        return False
    is_points = not names_several(settings) and settings.source.lower().endswith(suffixes_with(CELL))
    return is_points or has_archives(settings)


def begin_import(obj, frames: Sequence[int], stores: Path) -> int:
    """Begin the import of all samples of a terrain, and record it; return the number of its tiles.

    What an earlier call has begun for the same sources and settings is continued. frames: those that need the samples.
    stores: the folder of the job's stores. Raises TerrainError.
    """
    report = import_source(settings_of(obj), store_path(obj), part=ImportPart(BEGIN))
    file = _record_of(obj, stores)
    try:
        with open_folder(file.parent, make=True):  # makes it
            pass
        with written_beside(file) as partial:
            partial.write_text(json.dumps(_state(obj, frames) | {TILES: report.get(TILES, 0)}), encoding="utf-8")
    except OSError as reason:
        raise unwritable(f"The folder {stores}", reason) from reason
    return report.get(TILES, 0)


def is_begun(obj, stores: Path | None, frames: Sequence[int] | None = None) -> bool:
    """Return whether a job has begun to import all samples of a terrain without a complete store.

    The record must be of the present quick import. frames: it must also be of these frames, and of the .blend file as
    it is now; None for any. stores: the folder of the job's stores, None outside a job: False.
    """
    found = {} if stores is None else _read_record(obj, stores)
    wanted = _state(obj, frames or ())
    names = wanted if frames is not None else ("picture",)  # values that must be equal; picture: of the quick import
    return bool(found) and all(found.get(name) == wanted[name] for name in names)


def import_part(obj, stores: Path, step: str, share: tuple[int, int], on_progress: Callable[[float], None]) -> str:
    """Do a step of an import that `begin_import` has begun, and return a text about it; "" for none.

    step: the part of the import to do, such as reading tiles. share: for a step by tiles (TILED_PARTS), the number of
    this share, from 1, and the number of shares; several computers may do different shares at the same time. Other
    steps are done whole. stores: folder of the job's stores. Raises TerrainError.
    """
    if not is_begun(obj, stores):
        return ""
    total = _read_record(obj, stores)[TILES]
    numbers = share_of(range(total), *share) if step in TILED_PARTS else ()
    if numbers or step not in TILED_PARTS:
        chosen = ImportPart(step, frozenset(numbers))
        import_source(settings_of(obj), store_path(obj), lambda done, _text: on_progress(done), part=chosen)
    return f"{step}, {len(numbers):,} of {total:,} tiles" if step in TILED_PARTS else step


def forget_import(obj, stores: Path | None) -> None:
    """Remove the record of an import, if there is one."""
    if stores is not None and os.path.lexists(_record_of(obj, stores)):
        remove_file(_record_of(obj, stores))


def _state(obj, frames: Sequence[int]) -> dict:
    """Return what an import is begun for, as JSON: the digest of the quick import ("" without one), the frames, and the
    time of the last change of the .blend file.
    """
    store = Path(store_path(obj))
    picture = read_json(first_picture(store))["digest"] if os.path.exists(store / JSON_NAME) else ""
    changed = os.stat(bpy.data.filepath).st_mtime_ns if bpy.data.filepath else 0
    return {"picture": picture, "frames": sorted(frames), "blend_ns": changed}


def _record_of(obj, stores: Path) -> Path:
    """Return the file of the record of a terrain."""
    return stores.absolute() / f"{bpy.path.clean_name(obj.name)}{SUFFIX}"


def _read_record(obj, stores: Path) -> dict:
    """Return the record of a terrain; {} for none, and for a damaged one. stores: folder of the job's stores."""
    try:
        found = json.loads(read_regular(_record_of(obj, stores), MAX_BYTES, links=False))
        return found if type(found[TILES]) is int and found[TILES] >= 0 else {}
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return {}
