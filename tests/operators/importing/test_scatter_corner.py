# SPDX-License-Identifier: GPL-3.0-or-later
"""Trees stay on their ground where tiles are added in the west and the south, and where Undo takes them back."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.scatter.request import CORNER
from blender_meshes import positions
from placed_terrains import add
from rasterio.transform import Affine
from rasters import hills, write_raster

pytestmark = pytest.mark.usefixtures("imports_here")
HEIGHTS = hills(80, 60)
WEST, NORTH, STEP = 6e5, 5.2e6, 10.0


def tile(path, name, rows, columns):
    """Write a part of HEIGHTS, whose row 0 is in the north, as a file."""
    transform = Affine(STEP, 0, WEST + STEP * columns.start, 0, -STEP, NORTH - STEP * rows.start)
    return write_raster(path / name, HEIGHTS[rows, columns], crs="EPSG:32632", transform=transform)


def trees_in_the_world():
    """Return the sorted places of the trees over the first tile, without its outermost cells, whole decimetres."""
    scatter = bpy.data.objects["trees"]
    bpy.context.view_layer.update()
    at = np.column_stack([positions(scatter).astype(np.float64), np.ones(len(positions(scatter)))])
    world = (at @ np.array(scatter.matrix_world).T)[:, :2]
    world = world[(np.abs(world) < STEP * np.array([18.5, 13.5])).all(axis=1)]
    return np.unique(np.round(world, 1), axis=0)


@pytest.mark.parametrize("is_old", [False, True])
def test_trees_stay_where_tiles_are_added(saved, is_old):
    """In files of earlier versions too, whose terrains have no note of the corner."""
    scene, path = saved
    camera = scene.camera.data
    camera.type, camera.ortho_scale, camera.clip_end = "ORTHO", 3000.0, 9000.0
    scene.camera.location, scene.camera.rotation_euler = (0.0, 0.0, 3000.0), (0.0, 0.0, 0.0)
    first = (slice(0, 30), slice(40, 80))
    terrain = add(path, "EPSG:32632", Affine(STEP, 0, WEST + 400, 0, -STEP, NORTH), "first", HEIGHTS[first])
    bpy.context.view_layer.objects.active = terrain
    bpy.ops.adaptive_terrain.scatter_add()
    scatter = bpy.context.object if bpy.context.object != terrain else terrain.children[0]
    scatter.name = "trees"
    scatter.adaptive_scatter.spacing, scatter.adaptive_scatter.full_until = 6.0, 0.0
    bpy.context.view_layer.objects.active = terrain
    if is_old:
        terrain.pop(CORNER, None)
    bpy.ops.adaptive_terrain.update()
    before = trees_in_the_world()
    assert len(before) > 2000
    for name, rows, columns in (("w.tif", slice(0, 30), slice(0, 40)), ("s.tif", slice(30, 60), slice(0, 80))):
        assert bpy.ops.adaptive_terrain.add_tiles(filepath=str(tile(path, name, rows, columns))) == {"FINISHED"}
        bpy.ops.adaptive_terrain.update()
        after = trees_in_the_world()
        near = (after[:, None] == before[None]).all(axis=2).any(axis=0)
        assert near.mean() > 0.8  # others are rounded to the next decimetre
