# SPDX-License-Identifier: GPL-3.0-or-later
"""The water of the demo's island: its coast, lakes and rivers."""

import bpy
import numpy as np

from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.lattice import fit
from ...cbt_terrain.land.water_surface import water_surface
from ..mesh.writer import write_mesh

# Metres of water that are drawn, at least: of rivers, where less is a wet bed, and of the sea.
RIVER_M, SEA_M = 0.25, 0.02
# Metres down to which the sea is drawn by its depth: below, it is as dark as the open sea.
COAST_M = 25.0
# Samples along a side, at most.
MOST_SAMPLES = 2049


def add_water(scene, field: HeightField, material: bpy.types.Material):
    """The sea along the coast, rivers and lakes as an object; the open sea has another. Returns it, or None where there
    is no water."""
    every = -(-(max(field.lattice.width, field.lattice.height) - 1) // (MOST_SAMPLES - 1))
    heights = np.ascontiguousarray(field.heights()[::every, ::every])
    depth, speed = (field.layers[name][::every, ::every] for name in ("water_depth", "water_speed"))
    lattice = fit(heights.shape[1], heights.shape[0], field.lattice.step_x * every, field.lattice.step_y * every)
    drawn = np.where(heights > 0.0, depth >= RIVER_M, heights > -COAST_M)
    depth = np.where(drawn, depth, np.float32(0.0))
    surface = water_surface(lattice, heights, depth, np.ascontiguousarray(speed), least=SEA_M)
    if not len(surface.positions):
        return None
    mesh = bpy.data.meshes.new("Water")
    write_mesh(mesh, surface)
    mesh.materials.append(material)
    water = bpy.data.objects.new("Water", mesh)
    water.visible_shadow = False  # on the open sea, which is lower
    scene.collection.objects.link(water)
    return water
