# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground stays in its place where Undo takes back an import, or a copy shares the store."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.ground import world_ground
from adaptive_terrain.operators.importing.imported import imported_of, tag_object
from placed_terrains import add, placed
from rasterio.transform import Affine
from rasters import hills, write_raster

pytestmark = pytest.mark.usefixtures("imports_here")


@pytest.mark.parametrize("is_moved", [False, True])
def test_undo_of_added_tiles_leaves_the_ground_in_its_place(saved, is_moved):
    """Undo, and a file that was not saved after the import: the store has both files, and the place is the first's."""
    scene, path = saved
    heights, corner = hills(80, 30), Affine(10, 0, 6e5, 0, -10, 5.2e6)
    east = write_raster(
        path / "east.tif", heights[:, 40:], crs="EPSG:32632", transform=Affine(10, 0, 6e5 + 400, 0, -10, 5.2e6)
    )
    terrain = add(path, "EPSG:32632", corner, "west", heights[:, :40])
    if is_moved:
        terrain.location, terrain.rotation_euler, terrain.scale = (900.0, 30.0, 7.0), (0.0, 0.0, 0.6), (2.0, 2.0, 1.5)
    bpy.context.view_layer.update()
    local = np.array([(x, y, 0.0, 1.0) for x in np.linspace(-180, 180, 9) for y in np.linspace(-130, 130, 7)])
    world = (local @ np.array(terrain.matrix_world).T)[:, :3]

    def ground():
        bpy.context.view_layer.update()
        found = world_ground.ground_of(bpy.data.objects["west"], bpy.context.evaluated_depsgraph_get())
        return world_ground.find_below([found], world).heights

    before = ground()
    bpy.ops.wm.save_mainfile()
    copy = terrain.copy()
    copy.adaptive_terrain.frozen = "0 of the first raster"
    scene.collection.objects.link(copy)
    bpy.ops.ed.undo_push(message="Placed")
    bpy.context.view_layer.objects.active = terrain
    assert bpy.ops.adaptive_terrain.add_tiles(filepath=str(east)) == {"FINISHED"}
    assert np.abs(np.subtract(copy.location, terrain.location)).max() < 1e-3, "a copy shares the store"
    assert not copy.adaptive_terrain.frozen
    bpy.ops.ed.undo_push(message="Added")
    for step in (bpy.ops.ed.undo, bpy.ops.ed.redo, bpy.ops.ed.undo):
        step()
        assert imported_of(bpy.data.objects["west"].adaptive_terrain).raster == (80, 30)
        assert np.abs(ground() - before).max() < 1e-2
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
    assert np.abs(ground() - before).max() < 1e-2 and not len(bpy.data.objects["west"].adaptive_terrain.more_sources)
    bpy.context.view_layer.objects.active = bpy.data.objects["west"]
    assert bpy.ops.adaptive_terrain.import_source() == {"FINISHED"}
    assert imported_of(bpy.data.objects["west"].adaptive_terrain).raster == (40, 30)
    assert np.abs(ground() - before).max() < 1e-2, "an import of the first file alone"


def test_undo_leaves_a_terrain_with_a_chosen_store_alone(saved):
    scene, path = saved
    terrain = placed(path, "EPSG:32632", Affine(10, 0, 6e5, 0, -10, 5.2e6), "a")
    tag_object(terrain)
    placed(path, "EPSG:32632", Affine(10, 0, 6e5 + 100, 0, -10, 5.2e6), "b")
    terrain.adaptive_terrain.store = str(path / "b")
    for height in (1.0, 2.0):
        terrain.location.z = height
        bpy.ops.ed.undo_push(message="Moved")
    bpy.ops.ed.undo()
    assert list(bpy.data.objects["a"].location) == [0.0, 0.0, 1.0]
