# SPDX-License-Identifier: GPL-3.0-or-later
"""Relative paths of terrains stay right: those of stores and of height maps.

They start from the .blend file. They are rewritten where the file is saved to another folder, where Undo brings back
paths from before that, and where a terrain is appended, or linked and then made local.
"""

import os
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ..bridge.scene_paths import absolute_path
from ..bridge.writing import allow_writing
from ..session import session
from .store_location import RELATIVE, relative_to
from .store_paths import find_moved_stores

_before_save: dict[int, list[str]] = {}  # by session_uid: all paths before a save to another folder
# Absolute paths by session_uid and relative path, of folders where the open file was before: Undo knows no folder.
_earlier: dict[tuple[int, str], str] = {}
_linked: dict[str, str] = {}  # absolute paths by relative path, of linked terrains; "" if two libraries have the same


def _paths_of(obj) -> list[tuple]:
    """Return (property group, name of the property) of each path of a terrain that may be relative."""
    settings = obj.adaptive_terrain
    return [(settings, "store"), (settings, "source_path"), *((item, "path") for item in settings.more_sources)]


def _folder_of_file() -> str | None:
    """Return the folder of the open file, None before it is saved."""
    return str(Path(bpy.data.filepath).parent) if bpy.data.filepath else None


@persistent
def on_save_pre(path, _unused=None) -> None:
    """Change relative paths of terrains so that they hold from the folder that the file is being saved to.

    path: the file that is about to be written. `on_save_post` restores the paths if it is a copy.
    """
    before = bpy.data.filepath
    _before_save.clear()
    if not (before and path) or Path(before).parent == Path(path).parent:
        return
    for obj in session.all_terrains():
        _before_save[obj.session_uid] = [getattr(*place) for place in _paths_of(obj)]
        for owner, name in _paths_of(obj):
            text = getattr(owner, name)
            if text.startswith(RELATIVE):
                absolute = absolute_path(text)
                _earlier[obj.session_uid, text] = absolute
                setattr(owner, name, relative_to(absolute, str(Path(path).parent)))


@persistent
def on_save_post(path, _unused=None) -> None:
    """Restore the paths if only a copy of the open file was saved."""
    if not (bpy.data.filepath and path) or Path(bpy.data.filepath) != Path(path):
        _restore_paths()  # a copy was saved: the open file stays where it is
    _before_save.clear()


@persistent
def on_save_failed(_path, _unused=None) -> None:
    """Restore the paths after a save that failed."""
    _restore_paths()


def _restore_paths() -> None:
    """Give all terrains the paths that they had before the save."""
    for obj in session.all_terrains():
        for (owner, name), text in zip(_paths_of(obj), _before_save.get(obj.session_uid, ()), strict=False):
            if getattr(owner, name) != text:
                setattr(owner, name, text)
    _before_save.clear()


@persistent
def on_undo_pre(_scene, _unused=None) -> None:
    """Forget earlier paths that terrains have now: from the present folder they lead to something new."""
    if _earlier:
        for obj in session.all_terrains():
            for place in _paths_of(obj):
                _earlier.pop((obj.session_uid, getattr(*place)), None)


@persistent
def on_undo(_scene, _unused=None) -> None:
    """Rewrite paths that Undo or Redo brings back from before a save to another folder."""
    if _earlier:
        for obj in session.all_terrains():
            for owner, name in _paths_of(obj):
                if absolute := _earlier.get((obj.session_uid, getattr(owner, name))):
                    setattr(owner, name, relative_to(absolute, _folder_of_file()))


@persistent
def on_load_pre(_path, _unused=None) -> None:
    """Forget the folders of the file that is about to be closed."""
    _earlier.clear()
    _linked.clear()


@persistent
def on_append(imported, _unused=None) -> None:
    """Let an appended terrain find its store and its height maps: rewrite the relative paths from the other file.

    The new paths start from the open file. A path that leads nowhere stays, as in a paste (Ctrl V): Blender keeps the
    copied objects in a file in another folder, with the paths of the open file.
    """
    for item in imported.import_items:
        if (
            item.id_type != "OBJECT"
            or item.id is None
            or item.source_library is None
            or not session.is_terrain(item.id)
        ):
            continue
        for owner, name in _paths_of(item.id):
            text = getattr(owner, name)
            absolute = absolute_path(text, library=item.source_library)
            if text.startswith(RELATIVE) and os.path.exists(absolute):
                setattr(owner, name, relative_to(absolute, _folder_of_file()))
        find_moved_stores([item.id])


@persistent
@allow_writing
def on_update(_scene, depsgraph) -> None:
    """Let a linked terrain that is made local find its store and its height maps.

    Nothing tells that of Make Local, so the paths of linked terrains are noted before. A path that leads somewhere from
    the open file stays.
    """
    if not bpy.data.libraries or not depsgraph.id_type_updated("OBJECT"):
        return
    terrains = [obj for obj in bpy.data.objects if obj.type == "MESH" and obj.adaptive_terrain.enabled]
    for obj in terrains:
        for owner, name in _paths_of(obj) if obj.override_library is None else ():
            text = getattr(owner, name)
            if not text.startswith(RELATIVE):
                continue
            if obj.library is not None:
                absolute = absolute_path(text, library=obj.library)
                if _linked.setdefault(text, absolute) != absolute:
                    _linked[text] = ""
            elif _linked.get(text) and not os.path.exists(absolute_path(text)):
                setattr(owner, name, relative_to(_linked[text], _folder_of_file()))


HANDLERS = {
    "save_pre": on_save_pre,
    "save_post": on_save_post,
    "save_post_fail": on_save_failed,
    "undo_pre": on_undo_pre,
    "redo_pre": on_undo_pre,
    "undo_post": on_undo,
    "redo_post": on_undo,
    "load_pre": on_load_pre,
    "depsgraph_update_post": on_update,
}
if hasattr(bpy.app.handlers, "blend_import_post"):  # Blender 4.3
    HANDLERS["blend_import_post"] = on_append
