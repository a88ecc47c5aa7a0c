# SPDX-License-Identifier: GPL-3.0-or-later
"""Clear Land Cache: what shaped land takes on disk, and room for other things."""

import shutil
from pathlib import Path

import bpy

from ...cbt_terrain.field import store as stores
from ..text.numbers import plain
from . import land_jobs
from .land_request import bytes_in, folder_beside, is_in_use, remove, shaped_stores
from .polls import on_terrain


def held(source: str) -> list[tuple[str, Path, int]]:
    """What stacks on a source's store keep and could make again: what it is, where, and its bytes."""
    found = [("shown", folder, size) for folder, size in shaped_stores(source) if is_in_use(folder)]
    found += [("not shown now", folder, size) for folder, size in shaped_stores(source) if not is_in_use(folder)]
    tiles = folder_beside(source) / stores.TILES
    return found + ([("tiles", tiles, bytes_in(tiles))] if tiles.is_dir() else [])


def lines(source: str) -> list[str]:
    """What the dialog says: where, and what takes how much."""
    parts, said = held(source), [str(folder_beside(source))]
    for what, about in (("shown", "Land that is shown, and stays"), ("not shown now", "Land of other settings"),
                        ("tiles", "Tiles, which spare time when settings change a little")):  # fmt: skip
        sizes = [size for kind, _, size in parts if kind == what]
        said.append(f"{about}: {megabytes(sum(sizes))}" + (f", stores: {len(sizes)}" if what != "tiles" else ""))
    return said


def megabytes(size: float) -> str:
    return f"{plain(size / 1e6)} MB"


class ClearLandCache(bpy.types.Operator):
    """Remove shaped land that no open terrain shows, and tiles; it can all be made again"""

    bl_idname = "adaptive_terrain.land_clear"
    bl_label = "Clear Land Cache"

    @classmethod
    def poll(cls, context):
        if not on_terrain(cls, context) or not context.object.adaptive_terrain.store:
            return False
        if land_jobs.running:
            cls.poll_message_set("Land is being shaped, which reads its tiles")
            return False
        return True

    def invoke(self, context, _event):
        self.said = lines(self._source(context))
        return context.window_manager.invoke_props_dialog(self, width=460, confirm_text="Clear")

    def draw(self, _context):
        for line in self.said:
            self.layout.label(text=line)

    def execute(self, context):
        freed = 0
        for what, folder, size in held(self._source(context)):
            if what == "tiles":
                shutil.rmtree(folder, ignore_errors=True)
            elif what != "shown":
                remove(folder)
            freed += 0 if folder.exists() else size
        self.report({"INFO"}, f"{megabytes(freed)} freed")
        return {"FINISHED"}

    def _source(self, context) -> str:
        return bpy.path.abspath(context.object.adaptive_terrain.store)


register, unregister = bpy.utils.register_classes_factory((ClearLandCache,))
