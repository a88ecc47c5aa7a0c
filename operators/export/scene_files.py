# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that the frames of a scene are made of.

A job brings them to a worker, and a change of one makes a finished frame stale. Only the .blend file decides their
order, so that two machines list them alike.
"""

import glob
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError, shown
from ..bridge.demand.trees import animated_paths
from ..bridge.scene_paths import absolute_path

TILE_MARKS = {"<UDIM>": "[0-9]" * 4, "<UVTILE>": "u[0-9]*_v[0-9]*"}
MAX_CACHE_FILES = 100_000
OWNERS = ("materials", "worlds", "lights", "linestyles", "textures", "scenes")  # of node trees, beside node groups
_NUMBER = re.compile(r"(?P<head>.*?)(?P<number>\d+)(?P<tail>\D*)", re.DOTALL)


def scene_files(frames: Sequence[int]) -> list[Path]:
    """List the external files that `frames` of the open file read, as absolute paths; missing files too.

    A sequence of images or volumes counts with the files of these frames. Folders of baked caches count with all their
    files. Packed files are part of the .blend file. Sounds and the files of Blender itself are left out. Raises
    TerrainError for a cache folder that holds more than caches do.
    """
    numbered = _numbered_files(frames)
    found = [file for path in _listed_paths() for file in numbered.get(path) or [path]]
    for folder in dict.fromkeys(map(os.path.normpath, filter(None, _cache_folders()))):
        found += _files_in(folder)
    return [Path(file) for file in dict.fromkeys(found)]


def color_config() -> list[Path]:
    """Return the OpenColorIO configuration that replaces Blender's own, where the environment names one."""
    return [Path(os.environ["OCIO"])] if os.environ.get("OCIO") else []


def _listed_paths() -> Iterator[str]:
    """Yield the paths that Blender lists, made absolute."""
    blender_folders = [os.path.normpath(bpy.utils.resource_path(kind)) + os.sep for kind in ("LOCAL", "SYSTEM")]
    for path in bpy.utils.blend_paths(absolute=True, packed=False, local=False):
        is_sound = os.path.splitext(path)[1].lower() in bpy.path.extensions_audio
        if path and not is_sound and not path.startswith(tuple(blender_folders)):
            yield os.path.normpath(path)


def _files_in(folder: str) -> list[str]:
    """Return all files in a cache folder. Raises TerrainError if there are more than caches have."""
    walked = (os.path.join(inner, name) for inner, _, names in os.walk(folder) for name in names)
    files = list(islice(walked, MAX_CACHE_FILES + 1))
    if len(files) > MAX_CACHE_FILES:
        raise TerrainError(
            f"The cache folder {shown(folder)} of this scene holds more than {MAX_CACHE_FILES:,} files",
            expected="files of one cache",
            fix="choose a folder for it alone, and bake it again",
        )
    return sorted(files)


def _numbered_files(frames: Sequence[int]) -> dict[str, list[str]]:
    """Map the path of each image, clip, volume and cache to the files that `frames` read in its place.

    The file of a sequence's path is its first one; a clip's files are numbered from it on. Data-blocks without a file
    are under "".
    """
    found: dict[str, list[str]] = {}
    for image in bpy.data.images:
        found.setdefault(_path_of(image), []).extend(_image_files(image, frames))
    for clip in bpy.data.movieclips:
        path = _path_of(clip)
        parts = _NUMBER.fullmatch(os.path.splitext(os.path.basename(path))[0])
        first = int(parts["number"]) if parts else 0
        numbers = {first + frame - clip.frame_start + clip.frame_offset for frame in frames}
        found.setdefault(path, []).extend(_sequence_files(path, numbers) if clip.source == "SEQUENCE" else [path])
    for volume in bpy.data.volumes:
        path = _path_of(volume)
        numbers = {number for frame in frames if (number := _volume_number(volume, frame)) is not None}
        found.setdefault(path, []).extend(_sequence_files(path, numbers) if volume.is_sequence else [path])
    for cache in bpy.data.cache_files:  # motion blur and overridden frames read neighbours: all files
        path = _path_of(cache)
        found.setdefault(path, []).extend(_sequence_files(path, None) if cache.is_sequence else [path])
    return found


def _path_of(block) -> str:
    """Return the absolute path of a data-block's file, "" without one."""
    return os.path.normpath(absolute_path(block.filepath, library=block.library)) if block.filepath else ""


def _image_files(image, frames: Sequence[int]) -> list[str]:
    """Return the files of an image that `frames` read: of its sequence, its tiles, or the one file, which may be ""."""
    path = _path_of(image)
    if image.source == "SEQUENCE":
        return _sequence_files(path, _image_numbers(image, frames))
    for mark, digits in TILE_MARKS.items() if image.source == "TILED" else ():
        if mark in path:
            return sorted(glob.glob(glob.escape(path).replace(mark, digits))) or [path]
    return [path]


def _image_numbers(image, frames: Sequence[int]) -> set[int] | None:
    """Return the file numbers of an image sequence that nodes show at `frames`; None if any file may be shown.

    Any may be if the settings are animated, or if something reads the image that `_image_users` does not find.
    """
    numbers, readers = set(), set()
    for block, user in _image_users(image):
        if animated_paths(user.id_data):
            return None
        readers.add(block)
        numbers |= {_image_number(user, frame) for frame in frames}
        if not getattr(user, "use_auto_refresh", True):  # then the file of another frame may stay
            numbers.add(user.frame_current)
    return numbers if bpy.data.user_map(subset={image})[image] <= readers else None


def _image_users(image) -> Iterator[tuple]:
    """Yield (data-block, settings of the sequence) of each node and texture that shows an image at the scene's frame.

    Nodes of geometry take the frame from a socket, which says nothing here: they are left out.
    """
    for texture in bpy.data.textures:
        if getattr(texture, "image", None) == image:
            yield texture, texture.image_user
    owned = ((block, getattr(block, "node_tree", None)) for name in OWNERS for block in getattr(bpy.data, name))
    for block, tree in (*owned, *((group, group) for group in bpy.data.node_groups)):
        for node in tree.nodes if tree else ():
            user = getattr(node, "image_user", node)
            if getattr(node, "image", None) == image and hasattr(user, "frame_duration"):
                yield block, user


def _image_number(user, frame: int) -> int:
    """Return the number of the file that Blender shows at a frame (BKE_image_user_frame_get).

    It is 0 for an empty sequence. user: the ImageUser with start, length and offset of the sequence.
    """
    length = user.frame_duration
    if not length:
        return 0
    position = frame - user.frame_start + 1  # in the sequence, from 1
    position = (position - 1) % length + 1 if user.use_cyclic else min(max(position, 0), length)
    return position + user.frame_offset


def _volume_number(volume, frame: int) -> int | None:
    """Return the number of the file that Blender shows at a frame; None if it shows none."""
    length, position = volume.frame_duration, frame - volume.frame_start + 1  # in the sequence, from 1
    if not length or (volume.sequence_mode == "CLIP" and not 1 <= position <= length):
        return None
    if volume.sequence_mode == "REPEAT":
        position = (position - 1) % length + 1
    elif volume.sequence_mode == "PING_PONG" and length > 1:  # both ends come once
        position = (position - 1) % (2 * length - 2) + 1
        position = 2 * length - position if position > length else position
    return min(max(position, 1), length) + volume.frame_offset


def _sequence_files(path: str, numbers: Iterable[int] | None) -> list[str]:
    """Return the files of the numbered sequence that `path` is in: those with `numbers`, or all that exist (None).

    Files with `numbers` may be missing. The result is [path] if its name has no number, or if none of all exists.
    """
    folder, name = os.path.split(path)
    stem, suffix = os.path.splitext(name)
    parts = _NUMBER.fullmatch(stem)
    if parts is None:
        return [path]
    if numbers is None:
        alike = re.compile(re.escape(parts["head"]) + r"\d+" + re.escape(parts["tail"] + suffix))
        names = os.listdir(folder) if os.path.isdir(folder) else []
        return sorted(os.path.join(folder, other) for other in names if alike.fullmatch(other)) or [path]
    width = len(parts["number"])
    return [os.path.join(folder, f"{parts['head']}{n:0{width}d}{parts['tail']}{suffix}") for n in sorted(numbers)]


def _cache_folders() -> Iterator[str]:
    """Yield the folders of baked caches: simulations, oceans, geometry nodes; "" for a cache without a folder.

    Unbaked caches are left out: a render may write them itself, and its frames would then seem stale. Folders of
    geometry nodes are always listed, since only baking writes them.
    """
    for obj in bpy.data.objects:
        points = [system.point_cache for system in obj.particle_systems]
        for modifier in obj.modifiers:
            if modifier.type == "NODES":
                yield _absolute_path(modifier.bake_directory, obj)
                yield from (_absolute_path(bake.directory, obj) for bake in modifier.bakes if bake.use_custom_path)
            elif modifier.type == "OCEAN" and modifier.is_cached:
                yield _absolute_path(modifier.filepath, obj)
            elif modifier.type == "FLUID" and modifier.fluid_type == "DOMAIN":
                if modifier.domain_settings.has_cache_baked_any:
                    yield _absolute_path(modifier.domain_settings.cache_directory, obj)
            elif modifier.type == "DYNAMIC_PAINT" and modifier.canvas_settings:
                points += [surface.point_cache for surface in modifier.canvas_settings.canvas_surfaces]
            elif hasattr(modifier, "point_cache"):
                points.append(modifier.point_cache)
        yield from (_point_cache_folder(cache, obj) for cache in points)
    for scene in bpy.data.scenes:
        if scene.rigidbody_world:
            yield _point_cache_folder(scene.rigidbody_world.point_cache, scene)


def _point_cache_folder(cache, block) -> str:
    """Return the folder of a point cache that is read from files; "" if it is in memory. block: its owner."""
    if cache.use_external:
        return _absolute_path(cache.filepath, block)
    if not (cache.use_disk_cache and cache.is_baked):
        return ""
    file = _absolute_path(block.library.filepath, None) if block.library else bpy.data.filepath
    folder, name = os.path.split(file)
    return os.path.join(folder, f"blendcache_{os.path.splitext(name)[0]}")


def _absolute_path(path: str, block) -> str:
    """Return a path of a data-block as an absolute one, "" for none."""
    return absolute_path(path, library=block.library if block else None) if path else ""
