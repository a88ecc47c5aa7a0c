# SPDX-License-Identifier: GPL-3.0-or-later
"""Clear Land Cache: what shaped land takes on disk, and room for other things."""

from contextlib import suppress
from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field import store as stores
from ...cbt_terrain.field import store_folder
from ...cbt_terrain.height_operators.derived_store import is_in_use
from ...cbt_terrain.height_operators.land_folder import bytes_in, folder_beside, remove, shaped_stores
from ...cbt_terrain.run.owned_files import check_folder
from .. import jobs
from ..bridge.scene_paths import absolute_path
from ..session import session
from ..session.polls import NOT_ACTIVE, cancelled_by_errors
from ..text.numbers import plain
from ..text.translations import phrase


def stored_land(store: str) -> list[tuple[str, Path, int]]:
    """List the cached land on disk of a store and of the store that it was baked from.

    Returns (kind, folder, bytes) each; kind is "shown" (a terrain in this Blender uses it), "not shown now" or
    "tiles" (results of single tiles, which later shaping reuses). All of it can be made again. Raises TerrainError for
    a link.
    """
    session.all_terrains()  # forgets removed objects, whose land is then no longer in use
    found = []
    for source in _sources(store):
        found += [("shown" if is_in_use(f) else "not shown now", f, size) for f, size in shaped_stores(source)]
        tiles = folder_beside(source) / store_folder.TILES
        check_folder(tiles.parent, tiles.name)
        found += [("tiles", tiles, bytes_in(tiles))] if tiles.is_dir() else []
    return found


def _sources(store: str) -> list[str]:
    """Return the stores whose stacks may have left data: `store`, and the one that it was baked from.

    The second is found at its old path, or beside `store` if both were moved together; it has to have the same key as
    when it was baked.
    """
    with suppress(TerrainError, OSError, ValueError, KeyError, TypeError):  # a provenance may hold anything
        shaped = stores.read_json(Path(store))["provenance"]["shaped"]
        before = Path(str(shaped["source"]))
        for folder in (before, Path(store).with_name(before.name)):
            if stores.changed_ns(folder) and stores.read_json(folder)["key"] == shaped["source_key"]:
                return [store, str(folder)]
    return [store]


def describe_cache(store: str) -> list[str]:
    """Return the lines of the dialog: the folders, and the size of each kind of data.

    Raises TerrainError for a folder that is a link.
    """
    parts, messages = stored_land(store), [str(folder_beside(source)) for source in _sources(store)]
    for what, about in (
        ("shown", phrase("Land that is shown, and stays")),
        ("not shown now", phrase("Land of other settings")),
        ("tiles", phrase("Tiles, which spare time when settings change a little")),
    ):
        sizes = [size for kind, _, size in parts if kind == what]
        size = megabytes(sum(sizes))
        number = "" if what == "tiles" else phrase(", stores: {}", len(sizes))
        messages.append(f"{about}: {size}{number}")
    return messages


def megabytes(size: float) -> str:
    """Format bytes as megabytes."""
    return f"{plain(size / 1e6)} MB"


class ClearLandCache(bpy.types.Operator):
    """Delete shaped land that no open terrain shows, to free disk space. It is computed again when it is needed"""

    bl_idname = "adaptive_terrain.land_clear"
    bl_label = "Clear Land Cache"

    @classmethod
    def poll(cls, context):
        """Return whether the shown terrain has a store and no land is being shaped, which reads the tiles.

        Blender polls again when the dialog is confirmed, where the button's object is lost: the panel's terrain counts.
        """
        terrain = session.shown_terrain(context)
        if terrain is None or not terrain.adaptive_terrain.store:
            cls.poll_message_set(NOT_ACTIVE)
            return False
        if jobs.find(jobs.SHAPE):
            cls.poll_message_set("Land is being shaped, which reads its tiles")
            return False
        return True

    def invoke(self, context, _event):
        """Ask before anything is removed, in a dialog with the sizes."""
        try:
            self.messages = describe_cache(self._store(context))
        except TerrainError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return context.window_manager.invoke_props_dialog(self, width=460, confirm_text="Clear")

    def draw(self, _context):
        """Draw the folders and the sizes of the cached land as lines of the dialog."""
        for line in self.messages:
            self.layout.label(text=line)

    @cancelled_by_errors
    def execute(self, context):
        """Remove tiles and the land that no terrain shows, and report the freed megabytes."""
        freed = 0
        for what, folder, size in stored_land(self._store(context)):
            if what == "tiles":
                store_folder.remove_tiles(folder)
            elif what != "shown":
                remove(folder)
            freed += size - bytes_in(folder)
        self.report({"INFO"}, f"{megabytes(freed)} freed")
        return {"FINISHED"}

    def _store(self, context) -> str:
        """Return the absolute path of the store of the terrain that the panel shows."""
        return absolute_path(session.shown_terrain(context).adaptive_terrain.store)
