# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores of earlier versions are moved, and terrains whose stores were moved find them again."""

import os
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ...cbt_terrain.field.moving import MovedStores, find_moved, move_stores
from ..bridge.scene_paths import absolute_path
from ..session import session
from ..text.console import print_line
from .store_location import data_folder, deleted_folder, old_folders

FOUND = "found"  # a topic
DELETES = "which Blender deletes with the extension"
notices: dict[str, str] = {}  # by topic, about moved stores, for the panel


@persistent
def on_load_post(_path, _unused=None) -> None:
    """Find stores that were moved since the file was saved."""
    notices.pop(FOUND, None)
    find_moved_stores()


@persistent
def on_undo(_scene, _unused=None) -> None:
    """Find moved stores again: Undo restores old paths."""
    find_moved_stores()


def find_moved_stores(objects=None) -> None:
    """Set the new path of stores that were moved to the data folder, and of images of their maps.

    A path in a folder that Blender deletes, without a store, is changed to the data folder. objects: terrains to look
    at, None for all.
    """
    found = []  # texts about the new paths
    for obj in session.all_terrains() if objects is None else objects:
        settings = obj.adaptive_terrain
        before = absolute_path(settings.store)
        if settings.store and (folder := _new_folder(before)):
            settings.store = folder
            found.append(f"that of {obj.name} in {folder}")
        elif settings.store and _would_be_deleted(before):  # the next import then writes into the data folder
            settings.store = str(data_folder() / Path(before).name)
    if found:
        _find_moved_images()
        show_notice(
            FOUND, f"Stores were moved and are found again: {'; '.join(found)}. Save the file to keep these paths."
        )


def _find_moved_images() -> None:
    """Set the new path of images whose folder was moved to the data folder."""
    for image in bpy.data.images:
        path = Path(absolute_path(image.filepath))
        if image.library is None and image.filepath and (folder := _new_folder(str(path.parent))):
            image.filepath = str(Path(folder) / path.name)


def _new_folder(path: str) -> str:
    """Return where a folder was moved to; "" if it is in its place or was not moved."""
    found = "" if os.path.exists(path) else find_moved(path, data_folder())
    return found if found and os.path.isdir(found) else ""


def _would_be_deleted(path: str) -> bool:
    """Return whether no store is at a path, and one imported there would be deleted with the extension."""
    above = deleted_folder()
    return above is not None and Path(path).is_relative_to(above) and not os.path.exists(path)


def show_notice(topic: str, notice: str) -> None:
    """Print a notice, and show it on the panel until another one has the same topic."""
    print_line(f"Adaptive Terrain: {notice}")
    notices[topic] = notice


def move_old_stores() -> None:
    """Move the stores of earlier versions into the data folder, at each start of Blender.

    Stores that cannot be moved stay, and the next start tries again.
    """
    for old in old_folders():
        try:
            moved = move_stores(old, data_folder())
        except OSError as reason:
            moved = MovedStores(failures=[f"{old}: {reason.strerror or reason}"])
        _report_moves(moved, old)


def _report_moves(moved: MovedStores, old: Path) -> None:
    """Report the stores that were moved out of the folder `old`, and those that could not be."""
    new = data_folder()
    if moved.failures:
        show_notice(
            f"kept in {old}",
            f"Stores could not be moved to {new} ({'; '.join(moved.failures)}). They are in {old}, {DELETES}: make "
            "room, or change the rights, and start Blender again.",
        )
    if moved.stores:
        names = ", ".join(moved.stores)
        show_notice(f"moved from {old}", f"Stores were moved out of {old}, {DELETES}, into {new}: {names}.")


HANDLERS = {
    "load_post": on_load_post,
    "undo_post": on_undo,
    "redo_post": on_undo,
}


def start() -> None:
    """Let a timer search for moved stores once the open file can be read; not in background mode."""
    if not bpy.app.background:
        bpy.app.timers.register(find_moved_stores, first_interval=0.0)  # the open file, which is out of reach here


def stop() -> None:
    """Stop looking for stores that have moved, and forget the notices."""
    if bpy.app.timers.is_registered(find_moved_stores):
        bpy.app.timers.unregister(find_moved_stores)
    notices.clear()
