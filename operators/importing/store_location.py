# SPDX-License-Identifier: GPL-3.0-or-later
"""Where stores are written: beside a saved .blend file, else in a data folder that survives an uninstall.

Blender deletes an extension's user folder with the extension. Up to version 0.2.0 stores of unsaved files were there;
they are moved out of it when Blender starts.
"""

import itertools
import os
import tempfile
from pathlib import Path

import bpy

from ...cbt_terrain.importing.earlier_import import source_digest
from ...cbt_terrain.rasters.raster import ImportSettings
from ...cbt_terrain.run.owned_files import check_folder, real_path
from ..bridge.scene_paths import absolute_path
from .imported import imported_of

RELATIVE = "//"
BAKED = "_baked"
STORES = os.path.join("adaptive_terrain", "stores")


def data_folder() -> Path:
    """Return the folder for stores of unsaved files, which need not exist."""
    return Path(bpy.utils.user_resource("DATAFILES", path=STORES))


def deleted_folder() -> Path | None:
    """Return the folder below which Blender deletes the user folders of extensions.

    None if this package is not installed as an extension.
    """
    package = __package__.rsplit(".", 2)[0]
    if not package.startswith("bl_ext."):
        return None
    return Path(bpy.utils.extension_path_user(package)).parent.parent


def old_folders() -> list[Path]:
    """Return the folders with stores of earlier versions, one a repository: Blender deletes them with the extension."""
    above = deleted_folder()
    return sorted(above.glob(f"*/{STORES}")) if above is not None else []


def is_shared(store: str) -> bool:
    """Return whether a store is in the data folder or in an earlier version's folder, where other files use it too."""
    folder = real_path(absolute_path(store))
    return any(folder.is_relative_to(real_path(other)) for other in [data_folder(), *old_folders()])


def lies_beside(settings) -> bool:
    """Return whether a terrain's store has a path relative to the .blend file and is moved with it."""
    if not bpy.data.filepath or not settings.store.startswith(RELATIVE):
        return False
    return is_beside(real_path(absolute_path(settings.store)))


def is_beside(folder: Path) -> bool:
    """Return whether a folder without links is below that of the saved .blend file and is moved with it.

    A file in the home folder has the data folder and perhaps the temporary folder below it. Those are not moved with
    the file, unless it is in them, too.
    """
    above = real_path(bpy.data.filepath).parent
    others = map(real_path, [data_folder(), *old_folders(), tempfile.gettempdir()])
    return folder.is_relative_to(above) and not any(
        folder.is_relative_to(other) and not above.is_relative_to(other) for other in others
    )


def can_write_beside() -> bool:
    """Return whether the file is saved, and the folder `terrain` next to it can be written or created."""
    if not bpy.data.filepath:
        return False
    folder = Path(bpy.data.filepath).parent
    beside = folder / "terrain"
    return os.access(beside if beside.exists() else folder, os.W_OK | os.X_OK)


def folder_beside(obj, source: str) -> str:
    """Return the path of a terrain's store of `source` beside the saved file, relative to it: `//terrain/...`.

    Raises NotOursError where the folder `terrain` is a link.
    """
    check_folder(Path(bpy.data.filepath).parent / "terrain")
    return f"{RELATIVE}terrain/" + bpy.path.clean_name(f"{Path(bpy.data.filepath).stem}_{obj.name}_{source}")


def store_folder(obj, settings: ImportSettings) -> str:
    """Return the path of the folder that an import writes: beside a saved file, relative to it, one folder a terrain.

    The name gets a number if the folder is the store of another terrain only: that one was renamed, or `clean_name`
    gives both the same name. For a file that is not saved, or whose folder cannot be written, it is in the data folder:
    one folder for each source and settings, because files share it. Raises TerrainError for a missing source.
    """
    source = Path(settings.source).stem
    if can_write_beside():
        beside = folder_beside(obj, source)
        names = itertools.chain([beside], (f"{beside}_{number}" for number in itertools.count(2)))
        return next(name for name in names if not _is_only_of_another(obj, name))
    return str(data_folder() / bpy.path.clean_name(f"{source}_{source_digest(settings)[:12]}"))


def _is_only_of_another(obj, folder: str) -> bool:
    """Return whether a folder is the store of another terrain in the file, but not that of `obj`."""
    terrains = [item for item in bpy.data.objects if item.type == "MESH" and item.adaptive_terrain.store]
    owners = [item for item in terrains if real_path(_absolute_store(item)) == real_path(absolute_path(folder))]
    return bool(owners) and obj not in owners


def _absolute_store(obj) -> str:
    """Return the absolute path of a terrain's store, also of a terrain that is linked from a library."""
    return absolute_path(obj.adaptive_terrain.store, library=obj.library)


def stored_path(folder: str) -> str:
    """Return the path of an import's store as a terrain keeps it: relative to the .blend file.

    folder: absolute. It stays so in the data folder, for a file that is not saved, and on another drive.
    """
    if not bpy.data.filepath or is_shared(folder):
        return folder
    return relative_to(folder, str(Path(bpy.data.filepath).parent))


def relative_to(path: str, folder: str | None) -> str:
    """Return an absolute path relative to a folder, `//...`; unchanged on another drive or without a folder."""
    try:
        return bpy.path.relpath(path, start=folder) if folder else path
    except ValueError:  # another drive
        return path


def after_save(path: str, file: str) -> str:
    """Return a path that is relative to the .blend file `file` as it holds from the open file.

    The user may have saved that file elsewhere since.
    """
    if bpy.data.filepath == file or not path.startswith(RELATIVE):
        return path
    absolute = bpy.path.abspath(path, start=str(Path(file).parent))
    return relative_to(absolute, str(Path(bpy.data.filepath).parent))


def baked_folder(obj) -> str:
    """Return the path for the baked land of a terrain: that of its store and "_baked". It may exist.

    Other files may use a store in a data folder: the path is then beside the .blend file (beginning with "//"), or in
    the data folder if nothing can be written there. Raises NotOursError if that file's folder of stores is a link.
    """
    store = obj.adaptive_terrain.store.rstrip("/\\")
    if is_shared(store):
        beside = can_write_beside()
        store = folder_beside(obj, source_name(obj)) if beside else str(data_folder() / Path(store).name)
    return store + BAKED


def source_name(obj) -> str:
    """Return the name of the source of a terrain's store, for the names of folders."""
    imported = imported_of(obj.adaptive_terrain)
    return Path(imported.settings.get("source", "") if imported else "").stem or "store"


def location_warnings(folder: str) -> list[str]:
    """Return a warning if a saved file's store could not be written beside the file; [] otherwise."""
    if not bpy.data.filepath or folder.startswith(RELATIVE):
        return []
    return [
        f"The folder {Path(bpy.data.filepath).parent} cannot be written, so the store is in {folder}; save the file in "
        "a folder that can be written and press Pack Store Beside File."
    ]
