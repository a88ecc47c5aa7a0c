# SPDX-License-Identifier: GPL-3.0-or-later
"""A tilted terrain, and its ground for Blender's ray casting: a fine grid of quads."""

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix, Vector
from rasters import store_heights

COLUMNS, ROWS, STEP = 49, 31, 16.0  # which fits no m * 2^k + 1
FINE = 4  # quads along a cell: between the samples of these hills a quad is then off by 4 mm at most
ASKEW = Matrix.LocRotScale(Vector((120.0, -40.0, 30.0)), Euler((0.15, -0.1, 0.7)), Vector((1.5, 0.75, 1.25)))


def hills(columns: int = COLUMNS, rows: int = ROWS, fine: int = 1) -> np.ndarray:
    """float64 [rows, columns] metres; with `fine` also between samples, bilinear."""
    y, x = np.mgrid[0:rows, 0:columns]
    heights = 30 * np.sin(x / 12) * np.cos(y / 9)
    for axis in (0, 1):
        at = np.arange((heights.shape[axis] - 1) * fine + 1) / fine
        low = np.minimum(at.astype(int), heights.shape[axis] - 2)
        part = np.expand_dims(at - low, 1 - axis)
        heights = heights.take(low, axis) * (1 - part) + heights.take(low + 1, axis) * part
    return heights


@pytest.fixture(scope="session")
def hills_store(tmp_path_factory):
    return str(store_heights(tmp_path_factory.mktemp("stores") / "smooth", hills(), STEP))


@pytest.fixture
def askew(scene, add_terrain, hills_store):
    """Return a terrain that is moved, turned, tilted and scaled, 1.5 times as high and 10 m lifted."""
    return place(add_terrain("Askew"), hills_store, ASKEW)


def place(terrain, store: str, matrix: Matrix):
    terrain.adaptive_terrain.store, terrain.matrix_world = store, matrix
    terrain.adaptive_terrain.vertical_scale, terrain.adaptive_terrain.vertical_offset = 1.5, 10.0
    bpy.context.view_layer.update()
    return terrain


class Cast:
    """Ray casts straight down onto quads of all terrains' hills, in a separate scene."""

    def __init__(self, *terrains):
        self.scene = bpy.data.scenes.new("cast")
        for terrain in terrains:
            settings = terrain.adaptive_terrain
            z = hills(fine=FINE) * settings.vertical_scale + settings.vertical_offset
            y, x = np.mgrid[0 : z.shape[0], 0 : z.shape[1]] * (STEP / FINE)
            points = np.stack([x - x.max() / 2, y - y.max() / 2, z], -1).reshape(-1, 3)
            corner = (np.arange(z.shape[0] - 1)[:, None] * z.shape[1] + np.arange(z.shape[1] - 1)).ravel()
            quads = np.stack([corner, corner + 1, corner + z.shape[1] + 1, corner + z.shape[1]], 1)
            mesh = bpy.data.meshes.new("cast")
            mesh.from_pydata(points, [], quads.tolist())
            obj = bpy.data.objects.new("cast", mesh)
            obj.matrix_world = terrain.matrix_world
            self.scene.collection.objects.link(obj)
        self.depsgraph = self.scene.view_layers[0].depsgraph
        self.scene.view_layers[0].update()

    def ray(self, origin, direction):
        """Place and normal of the first hit, or None."""
        hit, point, normal, *_ = self.scene.ray_cast(self.scene.view_layers[0].depsgraph, origin, direction)
        return (point, normal) if hit else None

    def height(self, place) -> float:
        found = self.ray((place[0], place[1], 5000.0), (0.0, 0.0, -1.0))
        return found[0].z if found else float("nan")

    def normal(self, place, over: float = 4.0) -> Vector:
        """Return the normal of the heights around a place: that of `ray_cast` is wrong for unevenly scaled objects."""
        x, y = place[:2]
        east, north = (self.height((x + i, y + j)) - self.height((x - i, y - j)) for i, j in ((over, 0), (0, over)))
        return Vector((-east, -north, 2 * over)).normalized()


def cube(name: str, location, size: float = 2.0, **channels):
    """Add a selected box whose origin is 1 m below its middle to the open scene."""
    mesh = bpy.data.meshes.new(name)
    s = size / 2
    mesh.from_pydata([(x, y, z + 1.0) for x in (-s, s) for y in (-s, s) for z in (-s, s)], [], [(0, 1, 3, 2)])
    return added(bpy.data.objects.new(name, mesh), location, **channels)


def added(obj, location=(0.0, 0.0, 0.0), **channels):
    obj.location = location
    for name, value in channels.items():
        setattr(obj, name, value)
    bpy.context.scene.collection.objects.link(obj)
    obj.select_set(True)
    return obj


def only(*objects, active=None):
    """Select these, and make the first, or `active`, active."""
    for obj in bpy.context.scene.objects:
        obj.select_set(obj in objects)
    bpy.context.view_layer.objects.active = active or (objects[0] if objects else None)
    bpy.context.view_layer.update()
