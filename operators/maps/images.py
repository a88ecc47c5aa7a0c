# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked maps as Blender's images, and how a material finds its place in them.

    node.image, node.extension = map_image(obj, "detail_normal"), "EXTEND"
    tree.links.new(map_vector(tree, obj), node.inputs["Vector"])

The values are 0 .. 1; the "coding" of `index_of` describes their meaning. A normal map goes through a Normal Map node
whose space is Object.
"""

import secrets
from pathlib import Path

import bpy

from ...cbt_terrain.attributes.folder import UDIM, read_index
from ...cbt_terrain.attributes.tiling import MARGIN
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run.named_file import blocks_reader
from ..bridge.nodes import Nodes
from ..bridge.scene_paths import absolute_path
from ..bridge.writer import UV_LAYER
from ..land.shaped_land import store_of
from ..session.session import all_terrains, open_field
from .properties import map_folder

GROUP = "Terrain Map UV"
OUTDATED = (
    "The material shows maps of earlier heights, which are stretched over the present ones: press Bake Maps, then "
    "Terrain Material."
)
_marks: dict[int, str] = {}  # names of terrains' own folders, as in `maps.mark`, by session_uid


def reserve_folder(obj) -> None:
    """Name a terrain's own folder of maps (`maps.mark`), unless it has a name that no other terrain uses.

    A name that an undo has removed is restored: the maps still exist. A terrain of the same name in another file gets
    another name, because a random number is part of it.
    """
    maps = obj.adaptive_terrain.maps
    maps.mark = maps.mark or _marks.get(obj.session_uid, "")
    others = {str(map_folder(other)).casefold() for other in all_terrains() if other != obj}
    while obj.library is None and (not maps.mark or str(map_folder(obj)).casefold() in others):
        maps.mark = f"{obj.name}_{secrets.token_hex(4)}"  # also after renaming: materials show images of the folder
    _marks[obj.session_uid] = maps.mark


def index_of(obj) -> dict | None:
    """Return the maps of a terrain as maps.json of its folder lists them; None if none show its present heights.

    Raises TerrainError for a store that cannot be read.
    """
    settings = obj.adaptive_terrain
    if not settings.store:
        return None
    index = read_index(map_folder(obj))
    if index is None or index["height_field"] != open_field(store_of(obj)).raster.digest:
        return None
    return index


def map_image(obj, name: str) -> bpy.types.Image | None:
    """Return Blender's image of a terrain's baked map `name`; None if it is not baked, or its files are gone.

    The image is tiled (source TILED) unless the terrain is one tile. It is loaded unless it is in the file, and gets
    its name, colour space and alpha anew. Raises TerrainError for a store that cannot be read.
    """
    index, folder = index_of(obj), map_folder(obj)
    entry = index and index["maps"].get(name)
    files = [folder / tile["file"] for tile in entry["tiles"]] if entry else []
    if not files or not files[0].is_file() or any(map(blocks_reader, files)):  # a pipe would block Blender
        return None
    image = _find_image(folder / entry["file"]) or bpy.data.images.load(str(files[0]))
    if UDIM in entry["file"] and image.source != "TILED":
        image.source = "TILED"
        image.filepath = str(folder / entry["file"])
        image.reload()
    if obj.adaptive_terrain.store.startswith("//") and not image.filepath.startswith("//"):
        image.filepath = bpy.path.relpath(image.filepath)
    image.name = f"{obj.name} {name}"
    image.colorspace_settings.name = "sRGB" if entry["coding"].get("srgb") else "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED" if entry["coding"]["channels"] == 4 else "NONE"
    return image


def reload(folder: Path, files: set[str]) -> None:
    """Have Blender read the images of a folder again whose files are among `files`, the new ones."""
    for image in bpy.data.images:
        path = Path(absolute_path(image.filepath)) if image.filepath else None
        if path is not None and path.parent == folder and path.name in files:
            image.reload()


def images_of_materials(obj) -> set[Path]:
    """Return the files of all image textures in a terrain's materials, also in node groups."""
    waiting = [slot.material.node_tree for slot in obj.material_slots if slot.material and slot.material.node_tree]
    seen, found = set(), set()
    while waiting:
        tree = waiting.pop()
        if tree in seen:
            continue
        seen.add(tree)
        for node in tree.nodes:
            inner, image = getattr(node, "node_tree", None), getattr(node, "image", None)
            waiting += [inner] if inner is not None else []
            found |= {Path(absolute_path(image.filepath))} if image is not None and image.filepath else set()
    return found


def outdated_note(obj) -> str:
    """Return a note if a terrain's materials show maps that were baked from other heights; "" otherwise.

    An import may have given the terrain another store, and with it another folder of the same name for new maps.
    maps.mark: that name, "" before the first baking.
    """
    name = map_folder(obj).name
    if not obj.adaptive_terrain.maps.mark or all(path.parent.name != name for path in images_of_materials(obj)):
        return ""
    try:
        is_current = index_of(obj) is not None
    except TerrainError:  # the update reports a damaged store
        return ""
    return "" if is_current else OUTDATED


def map_vector(tree, obj) -> bpy.types.NodeSocket:
    """Add a node to a shader's `tree` whose output is the position in the maps of `obj`, for image textures; return
    that socket.
    """
    index = index_of(obj) or {"columns": 1, "rows": 1, "margin": 0.0}
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = _lookup_group(index["columns"], index["rows"])
    return node.outputs["Vector"]


def tile_metres(obj) -> float:
    """Return the length in the world that one tile of a terrain's maps covers with its margins, metres; 0 without maps.

    It is that of the tile's shorter side, by the larger scale of the object. index["margin"]: of each side, as a
    fraction of a tile.
    """
    index = index_of(obj)
    if index is None:
        return 0.0
    place = index["place"]
    side = min((place["east"] - place["west"]) / index["columns"], (place["north"] - place["south"]) / index["rows"])
    return side / (1.0 - 2.0 * index["margin"]) * max(obj.matrix_world.to_scale()[:2], key=abs)


def _find_image(path: Path) -> bpy.types.Image | None:
    """Return the image of this Blender file that shows the file `path`, None without one."""
    return next((i for i in bpy.data.images if i.filepath and Path(absolute_path(i.filepath)) == path), None)


def _lookup_group(columns: int, rows: int) -> bpy.types.NodeTree:
    """Return a node group that turns the mesh's UV into a position in the maps, inside a tile's margin.

    columns, rows: tiles of a map. A position is the number of the tile plus a place in it, MARGIN .. 1 - MARGIN.
    """
    name = f"{GROUP} {columns} x {rows}"
    group = bpy.data.node_groups.get(name)
    if group is not None and group.nodes:
        return group
    group = bpy.data.node_groups.new(name, "ShaderNodeTree")
    group.interface.new_socket(name="Vector", in_out="OUTPUT", socket_type="NodeSocketVector")
    n = Nodes(group)
    vector = n.add("ShaderNodeUVMap", uv_map=UV_LAYER).outputs["UV"]
    if columns * rows > 1:
        # tile + MARGIN + (1 - 2 MARGIN) (scaled - tile); scaled: UV in tiles
        counts = (float(columns), float(rows), 1.0)
        scaled = n.vector("MULTIPLY", vector, counts)
        tile = n.vector("MINIMUM", n.vector("FLOOR", scaled), (columns - 1.0, rows - 1.0, 0.0))
        inside = n.vector("MULTIPLY_ADD", scaled, (1.0 - 2.0 * MARGIN,) * 3, (MARGIN,) * 3)
        vector = n.vector("MULTIPLY_ADD", tile, (2.0 * MARGIN,) * 3, inside)
    n.add("NodeGroupOutput", {"Vector": vector})
    return group
