# SPDX-License-Identifier: GPL-3.0-or-later
"""What shapes the demo's island, and the water on it."""

import bpy
import numpy as np

from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.land.stack import Entry, Stack
from ...cbt_terrain.land.water_surface import water_surface
from ..mesh.writer import write_mesh

# Metres of water that are drawn, at least: less is a wet bed.
DRAWN_M = 0.25
STACK = Stack(
    (
        Entry(
            "rivers",
            {"years": 2.5e5, "erodibility": 4e-6, "hillslope": 1.5e4, "creep": 0.001, "steepest": 42.0},
            seed=1,
            name="Rivers",
        ),
        Entry("thermal", {"depth": 18.0, "bed": 45.0}, seed=2, name="Frost"),
        Entry("relief", {"wave": 60.0, "roughness": 0.3, "plains": 0.015}, seed=3, name="Rock"),
        Entry("snow", {"line": 720.0, "fall": 2.5}, seed=4, name="Snow"),
        Entry("water", {"rain": 1.5}, seed=5, name="Streams"),
    )
)


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
