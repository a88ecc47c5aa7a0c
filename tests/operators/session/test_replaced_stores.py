# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores that another program has replaced while a file is open."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators import jobs
from adaptive_terrain.operators.importing.imported import tag_object
from live_windows import show_window, turns
from placed_terrains import placed
from rasterio.transform import Affine
from rasters import hills, write_raster

CORNER = Affine(10, 0, 6e5, 0, -10, 5.2e6)  # east and south of it are 10 m a cell
HEIGHTS = hills(80, 30)


def largest_difference(terrain, scene, heights) -> float:
    """Return the largest difference in metres of a mesh from the heights of a file at the same coordinates.

    terrain: may be evaluated, as for a render.
    """
    places = [terrain.matrix_world @ vertex.co for vertex in terrain.original.data.vertices]
    points = np.array(places, np.float64)  # else float32 from Blender 5 on
    column = (points[:, 0] + scene["crs x"] - CORNER.c) / 10 - 0.5
    row = (CORNER.f - points[:, 1] - scene["crs y"]) / 10 - 0.5
    rows, columns = heights.shape
    west, north = np.clip(column.astype(int), 0, columns - 2), np.clip(row.astype(int), 0, rows - 2)
    x, y = column - west, row - north
    assert len(points) > 100 and min(column.min(), row.min()) > -0.01 and column.max() < columns and row.max() < rows
    upper, lower = ((1 - x) * heights[k, west] + x * heights[k, west + 1] for k in (north, north + 1))
    return np.abs((1 - y) * upper + y * lower - points[:, 2]).max()


def width_of(terrain) -> float:
    """Return the width of a mesh in metres."""
    return float(np.ptp([vertex.co.x for vertex in terrain.data.vertices]))


def import_again(path, heights, corner=CORNER) -> None:
    """Import other heights into the store `west`, as another program does."""
    file = write_raster(path / "again.tif", heights, crs="EPSG:32632", transform=corner)
    run_import(ImportSettings(str(file)), path / "west")


@pytest.fixture
def west(scene, tmp_path, monkeypatch):
    """Return a live terrain of the western half of the heights, and the folder of its store."""
    terrain = placed(tmp_path, "EPSG:32632", CORNER, "west", HEIGHTS[:, :40])
    tag_object(terrain)
    scene.camera.location, scene.camera.rotation_euler = (0.0, 0.0, 2000.0), (0.0, 0.0, 0.0)
    terrain.adaptive_terrain.viewport.error_px = 0.1
    bpy.context.view_layer.update()
    show_window(monkeypatch)
    turns()
    assert largest_difference(terrain, scene, HEIGHTS) < 0.1
    return terrain, tmp_path


def test_a_larger_raster_leaves_the_ground_in_its_place(scene, west):
    terrain, path = west
    import_again(path, HEIGHTS)
    turns()
    assert width_of(terrain) == 790.0 and largest_difference(terrain, scene, HEIGHTS) < 0.1


def test_heights_of_the_same_raster_are_shown(scene, west):
    terrain, path = west
    import_again(path, HEIGHTS[:, :40] + 25.0)
    turns()
    assert not any(terrain.location) and largest_difference(terrain, scene, HEIGHTS + 25.0) < 0.1


def test_a_render_moves_a_terrain_before_its_frame(scene, west):
    """Live Update is off: the viewport keeps mesh and place together."""
    terrain, path = west
    terrain.adaptive_terrain.live = False
    import_again(path, HEIGHTS)
    turns()
    assert width_of(terrain) == 390.0 and largest_difference(terrain, scene, HEIGHTS) < 0.1
    found = []

    def note(scene, depsgraph):
        if depsgraph.mode == "RENDER":
            evaluated = terrain.evaluated_get(depsgraph)
            found.append((width_of(terrain), largest_difference(evaluated, scene, HEIGHTS)))

    detail, scene.render.engine = terrain.adaptive_terrain.render, "BLENDER_WORKBENCH"
    detail.error_px, detail.smooth_transitions = 0.1, False
    bpy.app.handlers.frame_change_post.append(note)
    bpy.ops.render.render()
    bpy.app.handlers.frame_change_post.remove(note)
    [(width, difference)] = found
    assert width == 790.0 and difference < 0.1


def test_a_store_that_the_user_has_chosen_moves_nothing(scene, west):
    """Another file is in its place since then."""
    terrain, path = west
    placed(path, "EPSG:32632", Affine(10, 0, 6e5 + 100, 0, -10, 5.2e6), "other", HEIGHTS)
    terrain.adaptive_terrain.store = str(path / "other")
    turns()
    file = write_raster(path / "new.tif", HEIGHTS, crs="EPSG:32632", transform=CORNER)
    run_import(ImportSettings(str(file)), path / "other")
    turns()
    assert not any(terrain.location)


def test_an_import_of_this_program_places_its_terrain(scene, west):
    """Its end measures how far the raster has moved, so nothing else may move the terrain before."""
    terrain, path = west
    job = jobs.BackgroundJob(jobs.IMPORT, terrain.session_uid, lambda job: (None for _ in range(1)))
    import_again(path, HEIGHTS)
    turns()
    assert not any(terrain.location)
    job.close()
    turns()
    assert terrain.location.x == pytest.approx(200.0)


def test_update_follows_a_replaced_store_without_live(scene, west):
    """Also in a file that was opened before and not updated since."""
    terrain, path = west
    terrain.adaptive_terrain.live = False
    bpy.ops.wm.save_as_mainfile(filepath=str(path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(path / "scene.blend"))
    terrain = bpy.context.view_layer.objects.active = bpy.data.objects["west"]
    import_again(path, HEIGHTS)
    assert bpy.ops.adaptive_terrain.update() == {"FINISHED"}
    assert width_of(terrain) == 790.0 and largest_difference(terrain, bpy.context.scene, HEIGHTS) < 0.1
