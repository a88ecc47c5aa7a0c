# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes the asset library: a .blend file and its catalogs, made in a separate Blender without the user's settings."""

import os
import tempfile
from pathlib import Path

import bpy

from ...cbt_terrain.attributes.color import DEFAULT_COLORS
from ...cbt_terrain.attributes.splat_rules import DEFAULT
from ...cbt_terrain.run import child
from ..land.water_surface import new_water_material
from ..layers.material import LayerSources, give_terrain_material, new_plain_material
from ..scatter import starter
from ..scatter.instancing import new_scatter_group
from ..scene.haze import haze_group
from .thumbnails import Studio

BLEND, CATALOGS, STAMP = "adaptive_terrain.blend", "blender_assets.cats.txt", "version.txt"
AUTHOR = "Adaptive Terrain"
MATERIALS, GROUPS, PLANTS, ROCKS = "Materials", "Node Groups", "Plants", "Rocks"
# Blender identifies a catalog by this number, never by its name.
ROOT_UUID = "5f0e1c52-8f0a-4c0e-9a57-2b9d6c1a7e00"
UUIDS = {
    MATERIALS: "5f0e1c52-8f0a-4c0e-9a57-2b9d6c1a7e01",
    GROUPS: "5f0e1c52-8f0a-4c0e-9a57-2b9d6c1a7e02",
    PLANTS: "5f0e1c52-8f0a-4c0e-9a57-2b9d6c1a7e03",
    ROCKS: "5f0e1c52-8f0a-4c0e-9a57-2b9d6c1a7e04",
}
VARIATION_M = 80.0  # size of the materials' variation: that of a terrain of 8 km


def child_main(folder: str, stamp: str) -> None:
    """Write the library in the child process of `library.start_writing`. stamp: version of the library."""
    child.end_with_parent()
    write_library(Path(folder), stamp)


def write_library(folder: Path, stamp: str) -> None:
    """Write the library to a folder, in an empty file that takes the place of the open one.

    stamp: version of the library. Its file is replaced last, so that it marks the others as complete. Partial files are
    beside the folder: the Asset Browser reads all that is in it.
    """
    # Factory settings would disable all extensions of this process, and Blender would then remove the wheels of the
    # user's extensions.
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    with tempfile.TemporaryDirectory(prefix="partial-", dir=folder.parent) as name:
        partial = Path(name)
        studio = Studio(bpy.context.scene, partial)
        _add_materials(studio)
        _add_starter(studio)
        _add_groups()
        # Before Blender 4.5 a file of chosen data-blocks loses the previews of collections.
        bpy.ops.wm.save_as_mainfile(filepath=str(partial / BLEND), copy=True, compress=True)
        lines = [f"{ROOT_UUID}:{AUTHOR}:{AUTHOR}"]
        lines += [f"{uuid}:{AUTHOR}/{label}:{AUTHOR}-{label}" for label, uuid in UUIDS.items()]
        (partial / CATALOGS).write_text("\n".join(["VERSION 1", "", *lines, ""]), encoding="utf-8")
        (partial / STAMP).write_text(stamp, encoding="utf-8")
        for file in (CATALOGS, BLEND, STAMP):
            os.replace(partial / file, folder / file)


def _mark(item, catalog: str, about: str) -> None:
    """Mark a data-block as an asset of a catalog. about: its description in the Asset Browser."""
    item.asset_mark()
    data = item.asset_data
    data.catalog_id, data.author, data.description = UUIDS[catalog], AUTHOR, about
    data.tags.new("terrain")


def _add_materials(studio: Studio) -> None:
    """Add the terrain's material, its node group, and materials of each default layer and of water, with previews."""
    layers = [(layer.name, color) for layer, color in zip(DEFAULT, DEFAULT_COLORS, strict=True)]
    ground = studio.new_ground(len(layers))
    terrain = give_terrain_material(ground, LayerSources(layers))
    terrain.name = "Terrain Material"
    node = next(node for node in terrain.node_tree.nodes if node.type == "GROUP")
    node.inputs["Variation Size"].default_value = VARIATION_M
    _mark(terrain, MATERIALS, "The default layers of a terrain by their weights: grass, scree, rock and snow")
    _mark(node.node_tree, GROUPS, "Colors of a terrain's layers by the attribute splat_1, with variation")
    plain = [new_plain_material(f"Terrain {name}", color, VARIATION_M) for name, color in layers]
    for item in plain:
        _mark(item, MATERIALS, "A ground with variation, for any object")
    water = new_water_material()
    _mark(water, MATERIALS, "Clear at the shore, dark where the attribute water_depth is large")
    for material in (terrain, *plain, water):
        ground.data.materials[0] = material
        studio.take(material, [ground])  # renders the preview
    bpy.data.objects.remove(ground)


def _add_starter(studio: Studio) -> None:
    """Add the collections and the objects of the starter collection, with previews."""
    for kind, collection in starter.add_starter(bpy.context).items():
        catalog = ROCKS if kind == "ROCKS" else PLANTS
        _mark(collection, catalog, "Choose it as the collection of a scatter")
        studio.take(collection, collection.objects)
        for obj in collection.objects:
            _mark(obj, catalog, f"One of the {collection.name.lower()}, in metres")
            studio.take(obj, [obj])


def _add_groups() -> None:
    """Add the node groups that no asset uses."""
    _mark(new_scatter_group(), GROUPS, "Puts a collection's objects on points, in metres of the world")
    _mark(haze_group(), GROUPS, "Haze of the air before the output of a material, by height and distance")
