# SPDX-License-Identifier: GPL-3.0-or-later
"""The job of a scene: everything that a worker needs in addition to the .blend file."""

import os
import tomllib
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.height_operators.land_folder import folder_beside
from ...cbt_terrain.importing.source_list import INDEX_SUFFIXES, files_of, names_several
from ...cbt_terrain.rasters.raster import ImportSettings
from ...cbt_terrain.rasters.sidecars import sidecars
from ...cbt_terrain.run.owned_files import check_folder, real_path
from ...cbt_terrain.run.partial_files import written_beside
from ..export.blend_files import check_distinct_names
from ..export.exporting import make_folder
from ..export.file_outputs import output_folders
from ..export.preparing import is_missing, store_folder_of
from ..export.scene_files import scene_files
from ..importing.import_terrain import settings_of
from ..importing.imported import loaded_text
from ..importing.shot_import import shared_tiles
from ..importing.shot_tiles import can_load_tiles, num_tiles
from ..maps.properties import map_folder
from ..maps.request import maps_shown_by_materials
from ..session.shot import frames_of
from ..terrain.properties import built_in_land
from .bundle import FarmJob, openjd_command, write_bundle
from .outside_files import check_outside, named_some

FRAMES, STORES, INSTALLED = "frames", "stores", "installed"
PACKAGE = Path(__file__).resolve().parents[2]
NEEDS_SHARED_DISK = "All workers need the store and its height maps under the same paths, on a shared disk"


def submit(
    scene,
    objects: Sequence,
    out: Path,
    *,
    frames: Sequence[int] | None,
    chunk: int,
    formats: Sequence[str],
    extension: str | None,
    min_memory_gib: float = 0.0,
    allow_outside: bool = False,
    shared_disk: bool = True,
    count_tiles: Callable[[bpy.types.Object], int] = shared_tiles,
) -> tuple[list[str], list[str]]:
    """Write the job of the open, saved file into the folder `out`.

    Return lines about it for the user, and notes about things left to do. Raises TerrainError if the scene lacks a
    file, or one may not be copied.

    Args:
        objects: the scene's terrains.
        frames: None for the scene's.
        chunk: frames of one task.
        formats: of meshes; empty for pictures.
        extension: a zip that workers install for this job, INSTALLED for the running one, None if they have it.
        min_memory_gib: required memory of a worker, 0 for any.
        allow_outside: allow any file from outside the scene's folder.
        shared_disk: let workers share the import of a large missing store; they need its files on one disk.
        count_tiles: returns the number of tiles of such an import, 0 if one worker does it.
    """
    from ... import __version__

    blend, out = real_path(bpy.data.filepath), real_path(out)
    frames = frames or frames_of(scene)
    files = list(dict.fromkeys(real_path(path) for path in scene_files(frames) if os.path.isfile(path)))
    height_maps, folders, outputs, notes = [], [], [], []
    tiles = []  # of each terrain: number of tiles whose import workers share, 0 if they share none
    for obj in objects:
        tiles.append(_add_terrain(obj, height_maps, folders, outputs, count_tiles if shared_disk else None))
        notes += [*_import_notes(obj, tiles[-1]), *_place_notes(obj, blend.parent)]
    if outside := check_outside(blend.parent, [*files, *height_maps], height_maps, folders, allow_outside):
        noun = "file or folder" if len(outside) == 1 else "files and folders"
        notes.append(f"the job brings {len(outside):,} {noun} from outside the scene's folder: {named_some(outside)}")
    for folder in [] if formats else output_folders(scene):
        if folder.is_relative_to(blend.parent) or folder.is_relative_to(out):
            outputs.append(folder)
        else:
            notes.append(
                f"a File Output node writes to {shown(folder)}, which farms do not bring back: choose a folder "
                "beside the file"
            )
    if formats or any(tiles):
        check_distinct_names(objects)  # of files and of the job's stores
    make_folder(out)
    zip_path = None if extension is None else _zip_path(extension, out)
    if zip_path is None:
        notes.append("no zip goes with the job: workers need the extension of this version")
    job = FarmJob(
        name=f"{blend.stem} {'meshes' if formats else 'pictures'}",
        blend=blend,
        frames=frames,
        chunk=chunk,
        formats=formats,
        out=out / FRAMES,
        version=__version__,
        zip_path=zip_path,
        files=[*files, *height_maps, *([] if zip_path is None else [zip_path])],
        folders=folders,
        output_folders=[*outputs, *([out / STORES] if any(tiles) else [])],
        platforms=() if zip_path is None else _platforms(zip_path),
        min_memory_gib=min_memory_gib,
        stores=out / STORES if any(tiles) else None,
        max_tiles=max(tiles, default=0),
        has_view=any(can_load_tiles(store_folder_of(obj)) for obj in objects),  # a task loads tiles in view first
    )
    write_bundle(job, out)
    lines = [f"{out} is a job of {len(set(job.frames)):,} frames, {job.chunk} a task"]
    lines.append(f"to run it on this machine: {openjd_command(out)}")
    return lines, notes


def _import_notes(obj, num_tiles: int) -> list[str]:
    """Return the notes about the import of a terrain before the frames.

    A complete store needs none, nor does a missing one that a single task imports. num_tiles: number of tiles whose
    import workers share, 0 if they share none.
    """
    store, loaded = store_folder_of(obj), loaded_text(obj.adaptive_terrain)  # "" unless the store is incomplete
    state = f"{obj.name}: {loaded or 'its store is missing'}; the job"
    if can_load_tiles(store):
        return [
            f"{state} first imports the tiles that its frames see, at most {num_tiles:,}, or all samples if the frames "
            f"need more detail. {NEEDS_SHARED_DISK}"
        ]
    if num_tiles:
        return [
            f"{state} first imports all of it, {num_tiles:,} tiles that workers share. {NEEDS_SHARED_DISK}; without "
            "one, switch off Shared Disk (--no-shared-disk)"
        ]
    return [f"{state} imports all of it first"] if loaded else []


def _place_notes(obj, home: Path) -> list[str]:
    """Return a note if the store of a terrain is not in the folder of the .blend file, `home`; else []."""
    store = store_folder_of(obj)
    if real_path(store).is_relative_to(home):
        return []
    return [
        f"the store of {obj.name} is not beside the file: workers that get no copy of it need it at {store}, or press "
        "Pack Store Beside File"
    ]


def missing_imports(objects: Sequence) -> dict[int, ImportSettings]:
    """Return the settings of the imports that a job of terrains has to make from the first sample, by session_uid.

    Raises TerrainError.
    """
    stores = {obj: store_folder_of(obj) for obj in objects}
    missing = [obj for obj, store in stores.items() if is_missing(store) and not can_load_tiles(store)]
    return {obj.session_uid: settings_of(obj) for obj in missing}


def _add_terrain(
    obj, height_maps: list[Path], folders: list[Path], outputs: list[Path], count_tiles: Callable | None
) -> int:
    """Add the files and folders of one terrain to the lists of a job; return the number of tiles that workers import.

    Workers divide the tiles of a large or incomplete store among them; 0 if one task imports the store, or none has to.

    height_maps: files to import. folders: existing stores, land and maps. outputs: folders that earlier steps of
    the job write. count_tiles: as in `submit`; None without a shared disk. The store and the height maps of a shared
    import are in no list. Raises TerrainError.
    """
    store, tiles = store_folder_of(obj), 0
    if can_load_tiles(store):  # workers share its disk
        if count_tiles is None:
            what = f"The store of {obj.name!r} is incomplete, and without a shared disk a farm cannot complete it"
            raise TerrainError(what, fix="import all of it before you submit")
        folders.append(store)
        tiles = num_tiles(store)
    elif is_missing(store):
        sources = _height_maps(obj, store) if built_in_land(obj.adaptive_terrain) is None else []
        tiles = 0 if count_tiles is None else count_tiles(obj)
        if not tiles:
            outputs.append(store)
            height_maps += sources
    else:
        folders.append(store)
    # Folders that the job makes from the store: land that height operators shape, and maps.
    derived = [folder_beside(str(store))] if any(entry.on for entry in obj.adaptive_terrain.land.entries) else []
    derived += [map_folder(obj)] if maps_shown_by_materials(obj) else []
    for folder in derived:
        check_folder(folder)
    outputs += derived
    folders += [folder for folder in derived if folder.is_dir()]
    return tiles


def _height_maps(obj, store: Path) -> list[Path]:
    """Return the files that the import of a terrain reads, with their sidecars.

    Raises TerrainError if a height map is missing or not known. store: the missing store, for the error.
    """
    settings = settings_of(obj)
    sources = files_of(settings) if names_several(settings) else [Path(settings.source)]
    missing = next((source for source in sources if not os.path.isfile(source)), None)
    if missing is not None:
        raise TerrainError(
            f"The terrain {obj.name!r} has neither its store {store} nor its height map {missing}",
            fix="import it again, or choose their paths",
        )
    if any(source.suffix.lower() in INDEX_SUFFIXES for source in sources):
        what = f"The terrain {obj.name!r} has no store {store}, and a tile index names its height maps"
        raise TerrainError(what, fix="import it before you submit")
    return [real_path(path) for source in sources for path in (source, *sidecars(source))]


def _platforms(zip_path: Path) -> list[str]:
    """Return the platforms in the manifest of the extension's zip, [] if it names none.

    Raises TerrainError for another file.
    """
    try:
        with zipfile.ZipFile(zip_path) as archive:
            found = tomllib.loads(archive.read("blender_manifest.toml").decode()).get("platforms", [])
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise TerrainError(
            f"{zip_path} is not the extension's zip ({error})", expected="one of `make extension`"
        ) from None
    return [name for name in found if isinstance(name, str)] if isinstance(found, list) else []


def _zip_path(extension: str, out: Path) -> Path:
    """Return the path of the zip for the job, after packing the running extension into the folder `out` for INSTALLED.

    Raises TerrainError for a file that is no zip, and for an extension that was not installed from one.
    """
    if extension != INSTALLED:
        if not (os.path.isfile(extension) and zipfile.is_zipfile(extension)):  # reading a pipe would wait
            raise TerrainError(f"{extension} is no zip", expected=f"the extension's, or {INSTALLED!r}")
        return real_path(extension)
    if not (PACKAGE / "wheels").is_dir():
        raise TerrainError(
            "This extension is not installed from a zip, so the job cannot include one",
            fix="name one (`make extension` builds it), or install the extension on the workers",
        )
    path = out / "adaptive_terrain.zip"
    with written_beside(path) as partial, zipfile.ZipFile(partial, "w") as archive:
        for file in sorted(PACKAGE.rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                archive.write(file, file.relative_to(PACKAGE))
    return path
