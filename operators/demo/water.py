# SPDX-License-Identifier: GPL-3.0-or-later
"""The water on the demo's island."""

import bpy
import numpy as np

from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.land.water_surface import water_surface
from ..mesh.writer import write_mesh

# Metres of water that are drawn, at least: less is a wet bed.
DRAWN_M = 0.25


def add_water(scene, field: HeightField, material: bpy.types.Material):
    """Rivers and lakes as an object of their own; the sea has another. Returns it, or None where there is no water."""
    heights = field.heights(slice(None), slice(None))
    depth = np.where(heights > 0.0, field.layers["water_depth"], np.float32(0.0))
    surface = water_surface(field.lattice, heights, depth, field.layers["water_speed"], least=DRAWN_M)
    if not len(surface.positions):
        return None
    mesh = bpy.data.meshes.new("Water")
    write_mesh(mesh, surface)
    mesh.materials.append(material)
    water = bpy.data.objects.new("Water", mesh)
    scene.collection.objects.link(water)
    return water
