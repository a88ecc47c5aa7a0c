# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the compositor's File Output nodes.

They are written into a private folder while a frame is rendered, and moved to their places when it is complete.
"""

import itertools
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.run.owned_files import real_path
from ...cbt_terrain.run.partial_files import written_beside
from ..bridge.scene_paths import absolute_path
from .exporting import check_target, make_folder, named_failures

FOLDER_PROPERTIES = ("directory", "base_path")  # of a File Output node: from Blender 5.0 on, and before
FRAME_NUMBER = "####"  # which Blender replaces


@contextmanager
def redirected_outputs(scene, folder: Path) -> Iterator[None]:
    """Let the File Output nodes of a scene write below `folder` in the `with` block.

    Each writes to its usual absolute path, moved below `folder`; `publish_outputs` moves the files to their places.
    Blender still fills in the names in braces of a node's path. From 5.0 on it leaves the frame's number out of the
    names while it renders one frame; here they get it, as in a render of all frames. Raises TerrainError for a name
    that leads out of its folder, and for a path that becomes too long.
    """
    nodes = output_nodes(scene)
    for node in nodes:
        _check_names_stay_below(node)
    before = [node_folder(node) for node in nodes]
    names = [(node, _node_names(node)) for node in nodes if hasattr(node, "file_name")]
    try:
        for node, path in zip(nodes, before, strict=True):
            drive, tail = os.path.splitdrive(_absolute_node_path(path))
            below = os.path.join(escape_braces(folder / _drive_name(drive)), tail.lstrip("/\\"))
            _set_node_folder(node, below)
            _check_not_cut(node, below, node_folder(node))
        for node, (name, items) in names:
            numbered = _numbered_names(node, name, items)
            _set_node_names(node, *numbered)
            _check_not_cut(node, numbered, _node_names(node))
        yield
    finally:
        for node, path in zip(nodes, before, strict=True):
            _set_node_folder(node, path)
        for node, (name, items) in names:
            _set_node_names(node, name, items)


def publish_outputs(scene, folder: Path) -> list[Path]:
    """Move the files that nodes wrote below `folder` to the nodes' own paths; return the final paths.

    Call it after the block of `redirected_outputs`. Files with these paths are replaced. Raises TerrainError; all paths
    are checked before the first file is moved.
    """
    moves = []
    for drive in sorted(
        {os.path.splitdrive(_absolute_node_path(node_folder(node)))[0] for node in output_nodes(scene)}
    ):
        below = folder / _drive_name(drive)
        files = sorted(Path(inner) / name for inner, _, names in os.walk(below) for name in names)
        moves += [(file, Path(drive + os.sep) / file.relative_to(below)) for file in files]
    for _, target in moves:
        make_folder(target.parent)
        check_target(target)
    for file, target in moves:
        with named_failures(target), written_beside(target) as partial:
            shutil.move(file, partial)  # a rename, or a copy to another disk
    return [target for _, target in moves]


def output_nodes(scene) -> list:
    """List the File Output nodes of a scene's compositor, also those in its groups."""
    if hasattr(scene, "compositing_node_group"):  # from Blender 5.0 on
        trees = [scene.compositing_node_group]
    else:
        trees = [scene.node_tree if scene.use_nodes else None]
    trees, nodes = [tree for tree in trees if tree], []
    for tree in trees:  # which grows by groups
        nodes += [node for node in tree.nodes if node.type == "OUTPUT_FILE"]
        inner = (getattr(node, "node_tree", None) for node in tree.nodes)
        trees += [tree for tree in inner if tree and tree not in trees]
    return nodes


def output_folders(scene) -> list[Path]:
    """List the folders that File Output nodes write to, each once and absolute, up to a placeholder in their path."""
    found = []
    for node in output_nodes(scene):
        path = os.path.abspath(absolute_path(node_folder(node)))
        # Before Blender 5.0 the path of a multilayer file has the file's name.
        is_file = hasattr(node, "base_path") and node.format.file_format == "OPEN_EXR_MULTILAYER"
        parts = Path(os.path.dirname(path) if is_file else path).parts
        found.append(Path(*itertools.takewhile(lambda part: not set("{#") & set(part), parts)))  # up to a placeholder
    return list(dict.fromkeys(found))


def folders_outside(scene, *homes: Path) -> list[Path]:
    """List the folders that File Output nodes write to and that are in none of `homes`, links resolved."""
    homes = [real_path(home) for home in homes]
    return [
        folder for folder in output_folders(scene) if not any(real_path(folder).is_relative_to(home) for home in homes)
    ]


def node_folder(node) -> str:
    """Return the path that a File Output node writes to, as the file has it."""
    return next(getattr(node, name) for name in FOLDER_PROPERTIES if hasattr(node, name))


def escape_braces(path: Path) -> str:
    """Return a path for Blender with doubled braces: from 4.5 on it replaces names in braces by values."""
    return str(path) if bpy.app.version < (4, 5, 0) else str(path).replace("{", "{{").replace("}", "}}")


def _set_node_folder(node, path: str) -> None:
    """Set the path that a File Output node writes to."""
    setattr(node, next(name for name in FOLDER_PROPERTIES if hasattr(node, name)), path)


def _check_not_cut(node, wanted, actual) -> None:
    """Raise TerrainError if Blender has cut a path or name short, as it does silently.

    wanted: the text that was set. actual: the node's present text.
    """
    if actual != wanted:
        raise TerrainError(
            f"The path or a name of the File Output node {shown(node.name)!r} is too long for Blender with the frame's "
            f"folder and number; it was cut to {shown(actual, 100)}",
            fix="shorten it, or choose another --out",
        )


def _check_names_stay_below(node) -> None:
    """Raise TerrainError for a file name that leads out of the node's folder: nothing would find that file."""
    if hasattr(node, "base_path"):  # before Blender 5.0
        names = [slot.path for slot in node.file_slots]
    else:
        name, items = _node_names(node)
        names = [name, *items]
    wrong = next((name for name in names if ".." in name.replace("\\", "/").split("/")), None)
    if wrong is not None:
        raise TerrainError(
            f"The File Output node {shown(node.name)!r} has the name {shown(wrong)!r}, which leads out of its folder",
            expected="a name below it",
            fix="put the folder into the node's path",
        )


def _node_names(node) -> tuple[str, list[str]]:
    """Return the file name of a node and the names of its items, from Blender 5.0 on."""
    return node.file_name, [item.name for item in node.file_output_items]


def _set_node_names(node, name: str, items: list[str]) -> None:
    """Set the file name of a node and the names of its items."""
    node.file_name = name
    for item, item_name in zip(node.file_output_items, items, strict=True):
        if item.name != item_name:  # setting it makes new sockets
            item.name = item_name


def _numbered_names(node, name: str, items: list[str]) -> tuple[str, list[str]]:
    """Return the names of a node's file and items with a placeholder for the frame's number, unless they have one.

    An item's file has the node's name and the item's.
    """
    if node.format.media_type == "MULTI_LAYER_IMAGE":  # items are layers of one file
        return _with_frame_number(name), items
    return name, [_with_frame_number(name + item)[len(name) :] for item in items]


def _with_frame_number(name: str) -> str:
    """Return a name with the frame's placeholder at its end, unless it has one."""
    return name if "#" in name.rsplit("/", 1)[-1] else name + FRAME_NUMBER


def _absolute_node_path(path: str) -> str:
    """Return a node's path as an absolute one.

    A separator at its end, after which Blender puts a file's name, stays.
    """
    if path.startswith("//"):
        path = os.path.join(escape_braces(Path(bpy.data.filepath).parent), path[2:])
    end = os.sep if path.endswith(("/", "\\")) else ""
    return os.path.abspath(path) + end


def _drive_name(drive: str) -> str:
    """Return the name of the folder for files of a drive (Windows), below the redirected folder."""
    return "files_" + "".join(c if c.isalnum() else "_" for c in drive)
