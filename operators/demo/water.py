# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's sea, with its depth as an attribute, and the island's lakes and rivers."""

import bpy
import numpy as np

from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.lattice import Lattice, fit
from ...cbt_terrain.height_operators.water_surface import NAMES, sea_depth, water_surface
from ..bridge.writer import write_mesh

MIN_DEPTH_M = 0.25  # shallower rivers are not drawn
OPEN_SEA_M, OPEN_DEPTH_M = 200_000.0, 1000.0  # half the side of the open sea, and its depth
BEHIND_M = 4.0  # the sea continues below ground of this height, since a coarse mesh may dip below it
SEA_SAMPLES, RIVER_SAMPLES = 513, 2049  # maximum along a side


def add_sea(scene, field: HeightField, material: bpy.types.Material):
    """Add the sea at height 0: a grid with the attribute `water_depth`, without land, and four faces of open sea.

    Each of the four joins a side of the grid to a side of a much larger square. Return the object.
    """
    heights, _ = _thinned(field.heights(), field.lattice, SEA_SAMPLES)
    rows, columns = heights.shape
    west, south, east, north = field.lattice.rectangle()
    x, y = np.meshgrid(np.linspace(west, east, columns), np.linspace(south, north, rows))
    far = OPEN_SEA_M * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    points = np.concatenate([np.stack([x.ravel(), y.ravel()], -1), far])  # the far corners are the last four
    number = np.arange(rows * columns).reshape(rows, columns)
    cells = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], -1).reshape(-1, 4)
    # Cells below low land stay, too: a coarse mesh of it may dip below the sea.
    cells = cells[(heights.ravel()[cells] < BEHIND_M).any(axis=1)]
    near, first_far = number[[0, 0, -1, -1], [0, -1, -1, 0]], len(points) - 4  # corners of the grid, in the same order
    sides = [(near[k], first_far + k, first_far + (k + 1) % 4, near[(k + 1) % 4]) for k in range(4)]
    mesh = bpy.data.meshes.new("Sea")
    mesh.from_pydata(np.pad(points, ((0, 0), (0, 1))).tolist(), [], [*cells.tolist(), *sides])
    depth = np.append(sea_depth(heights, 0.0), np.full(4, OPEN_DEPTH_M)).astype(np.float32)
    mesh.attributes.new("water_depth", "FLOAT", "POINT").data.foreach_set("value", depth)
    return _add_object(scene, mesh, material)


def add_rivers(scene, field: HeightField, material: bpy.types.Material):
    """Add rivers and lakes above the sea as an object, and return it, or None without water.

    field: shaped land with the layers of the operator `water`.
    """
    heights, lattice = _thinned(field.heights(), field.lattice, RIVER_SAMPLES)
    depth, speed = (_thinned(field.layers[name], field.lattice, RIVER_SAMPLES)[0] for name in NAMES[:2])
    depth = np.where(heights > 0.0, depth, np.float32(0.0))
    surface = water_surface(lattice, heights, depth, speed, min_depth=MIN_DEPTH_M)
    if not len(surface.positions):
        return None
    mesh = bpy.data.meshes.new("Water")
    write_mesh(mesh, surface)
    return _add_object(scene, mesh, material)


def _thinned(samples: np.ndarray, lattice: Lattice, max_side: int) -> tuple[np.ndarray, Lattice]:
    """Return every n-th sample, at most `max_side` along a side, and the lattice of these samples.

    It covers the same ground if n divides the number of cells along each side, as on the island.
    """
    step = -(-(max(lattice.width, lattice.height) - 1) // (max_side - 1))  # rounded up
    found = np.ascontiguousarray(samples[::step, ::step])
    return found, fit(found.shape[1], found.shape[0], lattice.step_x * step, lattice.step_y * step)


def _add_object(scene, mesh: bpy.types.Mesh, material: bpy.types.Material):
    """Add an object with this mesh and material to the scene; return it."""
    mesh.materials.append(material)
    obj = bpy.data.objects.new(mesh.name, mesh)
    scene.collection.objects.link(obj)
    return obj
