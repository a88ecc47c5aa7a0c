# SPDX-License-Identifier: GPL-3.0-or-later
"""Drivers whose variables read data of the mesh."""

import re

import bpy

from ....cbt_terrain.attributes.attribute import GEOMETRY
from .found import ALL, Demand

NAMED = re.compile(r'attributes\["((?:[^"\\]|\\.)*)"\]')


def read_drivers(found: Demand, obj, objects, scene) -> None:
    """Add the attributes of a terrain's mesh that drivers of objects, shaders and node groups read as variables.

    A path that names no attribute counts as all of them. obj: the terrain. objects: all objects of the scene.
    """
    targets = {obj, obj.data}
    for block in _data_with_drivers(objects, scene):
        for curve in block.animation_data.drivers:
            paths = [t.data_path for v in curve.driver.variables for t in v.targets if t.id in targets]
            for path in paths:
                if "attributes" in path:
                    name = NAMED.search(path)
                    label = f"driver of {block.name}, {curve.data_path}"
                    found.add(name[1] if name else ALL, label if name else f"{label} (it names none)", GEOMETRY)


def _data_with_drivers(objects, scene):
    """Return the data-blocks that have drivers: objects and their data, the scene, shaders and node groups."""
    shaders = [*bpy.data.materials, *bpy.data.worlds, *bpy.data.lights]
    trees = [block.node_tree for block in shaders if block.node_tree]
    blocks = [*objects, *{o.data for o in objects if o.data}, scene, *shaders, *trees, *bpy.data.node_groups]
    # Images, the data of some empties, are never animated.
    animated = ((block, getattr(block, "animation_data", None)) for block in blocks)
    return [block for block, data in animated if data and len(data.drivers)]
