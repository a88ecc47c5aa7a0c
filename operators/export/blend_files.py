# SPDX-License-Identifier: GPL-3.0-or-later
"""The Blender file that a program opens: a scene with terrains, or an empty one; and its objects' names as files."""

import os
from pathlib import Path

from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.run.named_file import blocks_reader
from ...cbt_terrain.run.owned_files import real_path
from ..text.console import quiet

MAX_NAME_BYTES = 180  # of 255 that file systems allow; frame, kind and suffix take the others


def open_scene(blend: Path, stores: Path | None = None) -> tuple:
    """Open a .blend file; returns its active scene and that scene's terrains, one at least. Raises TerrainError.

    stores: folder of the stores of a farm's job, which the terrains get; None for their own.
    """
    bpy = import_bpy("A .blend file")
    from ..session import session

    if not os.path.isfile(blend):
        raise TerrainError(f"There is no scene at {blend}", expected="a .blend file")
    try:
        with quiet():
            bpy.ops.wm.open_mainfile(filepath=str(real_path(blend)), load_ui=False)
    except RuntimeError as error:
        raise TerrainError(
            f"Blender cannot open {blend} ({str(error).strip()})",
            expected=f"a file that Blender {bpy.app.version_string} or an older version saved",
        ) from None
    check_named_files(blend)  # refuses pipes and devices, on which Blender would wait
    scene = bpy.context.scene
    objects = session.terrains_of(scene)
    if not objects:
        raise TerrainError(
            f"The scene {scene.name!r} in {blend} has no adaptive terrain", fix="add one and save the file"
        )
    if stores is not None:
        from ..importing.shot_tiles import use_job_stores

        use_job_stores(objects, stores)
    return scene, objects


def check_named_files(blend: Path) -> None:
    """Raise TerrainError if the open scene names a pipe, a socket or a device as a file: Blender would wait for it."""
    import bpy

    from ..layers.images import numbered_files

    paths = {Path(path) for path in bpy.utils.blend_paths(absolute=True, packed=False, local=False)}
    for path in sorted(paths):
        # A path may be the pattern of an image in tiles, of which Blender reads each.
        waiting = next(filter(blocks_reader, [path, *numbered_files(path, "TILED")]), None)
        if waiting is not None:
            raise TerrainError(
                f"The scene {shown(blend)} names {shown(waiting)}, a pipe, a socket or a device",
                expected="a file",
                fix="choose another in Blender",
            )


def import_bpy(what: str):
    """Return the bpy module. Raises TerrainError if it is missing. what: subject of the error's "... needs"."""
    try:
        with quiet():
            import bpy
    except ImportError:
        raise TerrainError(
            f"{what} needs Blender's Python module",
            fix="run `pip install bpy` (the version that is made for this Python), or `blender --command "
            "adaptive_terrain`",
        ) from None
    return bpy


def new_object(name: str):
    """Open an empty Blender file, add a mesh object to it and return that. Raises TerrainError without Blender."""
    bpy = import_bpy("This format")
    open_empty_file()
    obj = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    bpy.context.collection.objects.link(obj)
    return obj


def open_empty_file() -> None:
    """Open an empty file, and keep the preferences.

    Factory settings (`read_factory_settings`) would disable this extension, and Blender would delete its wheels.
    `read_homefile` replaces the start-up file only.
    """
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def file_name(obj) -> str:
    """Return an object's name as the start of a file name: shortened, without characters that files cannot have.

    Two objects may get the same (`check_distinct_names`).
    """
    import bpy

    return bpy.path.clean_name(obj.name).encode()[:MAX_NAME_BYTES].decode(errors="ignore")


def check_distinct_names(objects) -> None:
    """Raise TerrainError if two objects would get the same file name, upper and lower case being equal."""
    seen = {}
    for obj in objects:
        other = seen.setdefault(file_name(obj).casefold(), obj)
        if other != obj:
            raise TerrainError(
                f"The objects {other.name!r} and {obj.name!r} would both be written to {file_name(obj)!r} files",
                fix="rename one of them",
            )
