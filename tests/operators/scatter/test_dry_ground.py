# SPDX-License-Identifier: GPL-3.0-or-later
"""New scatters: selected, and out of the water."""

from pathlib import Path

import bpy
import land_scenes
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.operators.land import shaped_land
from adaptive_terrain.operators.session import session
from blender_meshes import positions
from rasters import store_heights


def add_scatter(terrain):
    bpy.context.view_layer.objects.active = terrain
    assert bpy.ops.adaptive_terrain.scatter_add() == {"FINISHED"}
    return bpy.context.object


def put_heights(terrain, folder, heights):
    terrain.adaptive_terrain.store = str(store_heights(folder, heights, 10.0))


def test_a_new_scatter_alone_is_selected_and_active(terrain):
    terrain.select_set(True)
    scatter = add_scatter(terrain)
    assert bpy.context.object == scatter and bpy.context.selected_objects == [scatter]


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (2.0, -30.0), (0.01, 5.0)])
def test_a_scatter_ends_at_the_sea(terrain, scale, offset):
    """No point is below height 0 of the height map, and most of the land above has points."""
    settings = terrain.adaptive_terrain
    settings.vertical_scale, settings.vertical_offset = scale, offset
    bpy.context.view_layer.update()
    scatter = add_scatter(terrain)
    z = (positions(scatter)[:, 2] - offset) / scale
    dry = len(z)
    assert z.min() > -1e-3 and dry > 500
    scatter.adaptive_scatter.use_sea = False
    bpy.context.view_layer.update()
    session.update_object(terrain)
    z = (positions(scatter)[:, 2] - offset) / scale
    assert z.min() < -20.0 and dry == pytest.approx((z > 0.0).sum(), abs=2)


@pytest.mark.parametrize("lift", [100.0, -500.0], ids=["above the sea", "below it"])
def test_land_without_a_shore_is_not_limited(terrain, tmp_path, lift):
    y, x = np.mgrid[0:65, 0:65]
    put_heights(terrain, tmp_path / "land", 40 * np.sin(x / 9) * np.cos(y / 7) + lift)
    settings = add_scatter(terrain).adaptive_scatter
    assert not settings.use_sea and settings.where.water_depth.use


def test_a_sea_of_height_zero_has_no_points(terrain, tmp_path):
    """Many elevation models hold the sea as samples of 0."""
    y, x = np.mgrid[0:65, 0:65]
    put_heights(terrain, tmp_path / "land", np.maximum(2.0 * (x - 32), 0.0) + 0 * y)
    found = positions(add_scatter(terrain))
    assert found[:, 0].min() > -1.0 and len(found) > 500


def test_the_sea_has_the_level_of_the_stack(terrain):
    land_scenes.add("rivers", sea=10.0)
    settings = add_scatter(terrain).adaptive_scatter
    assert settings.use_sea and settings.sea_level == 10.0


def test_no_point_is_in_a_lake_of_the_stack(terrain, tmp_path):
    """A basin 100 m above the sea fills with water that is added after the scatter."""
    y, x = np.mgrid[0:129, 0:129]
    away = np.hypot(x - 64, y - 64) / 64
    put_heights(terrain, tmp_path / "basin", 140 - 60 * np.exp(-8 * away**2) - 30 * away)
    scatter = add_scatter(terrain)
    session.update_object(terrain)
    before = len(positions(scatter))
    bpy.context.view_layer.objects.active = terrain
    land_scenes.add("water")
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    session.update_object(terrain)
    depth = np.asarray(open_store(Path(shaped_land.store_of(terrain))).layers["water_depth"])
    column, row = (positions(scatter)[:, :2] / 10.0 + 64).T
    nearest = depth[np.rint(row).astype(int).clip(0, 128), np.rint(column).astype(int).clip(0, 128)]
    lake = (depth > 1.0).mean()
    assert 0.02 < lake < 0.5, "there is a lake"
    assert nearest.max() < 0.2 and len(nearest) < (1 - lake / 2) * before and len(nearest) > 500


def points_of(scatter):
    """Return the points of a scatter as a set of rows of their bytes."""
    return {row.tobytes() for row in positions(scatter)}


def add_water(terrain, **options):
    bpy.context.view_layer.objects.active = terrain
    assert bpy.ops.adaptive_terrain.water_surface(**options) == {"FINISHED"}
    session.update_object(terrain)
    [water] = [child for child in terrain.children if child.name.endswith("Water")]
    return water


def test_no_point_is_in_a_lake_of_add_water(terrain, tmp_path):
    """The lake may be made after the scatter or before; points elsewhere do not change."""
    y, x = np.mgrid[0:129, 0:129]
    away = np.hypot(x - 64, y - 64) / 64
    put_heights(terrain, tmp_path / "basin", 140 - 60 * np.exp(-8 * away**2) - 30 * away)
    first = add_scatter(terrain)
    before = points_of(first)
    water = add_water(terrain, level=-100.0)
    level = np.median(positions(water)[:, 2])
    radius = np.hypot(*positions(water)[:, :2].T).max()
    assert level > 100.0 and 150.0 < radius < 500.0
    dry = points_of(first)
    lost = np.array([np.frombuffer(row, np.float32) for row in before - dry])
    assert dry < before and len(lost) > 50 and np.hypot(*lost[:, :2].T).max() < radius
    assert np.hypot(*positions(first)[:, :2].T).min() > 0.9 * radius
    bpy.context.view_layer.objects.active = terrain
    second = add_scatter(terrain)
    assert np.hypot(*positions(second)[:, :2].T).min() > 0.9 * radius
    first.adaptive_scatter.where.water_depth.use = False
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert before <= points_of(first) and np.hypot(*positions(second)[:, :2].T).min() > 0.9 * radius
    bpy.data.objects.remove(water)
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert np.hypot(*positions(second)[:, :2].T).min() < 0.3 * radius, "without water they stand there again"


def test_points_follow_the_level_of_add_water(terrain, tmp_path, capfd):
    y, x = np.mgrid[0:65, 0:65]
    put_heights(terrain, tmp_path / "land", 10.0 + x + 0.0 * y)
    first = add_scatter(terrain)
    for level in (30.0, 25.0):
        add_water(terrain, level=level)
        assert level - 1e-3 < positions(first)[:, 2].min() < level + 2.0
    capfd.readouterr()
    second = add_scatter(terrain)
    assert "points; none in the water\n" in capfd.readouterr().out
    assert not second.adaptive_scatter.use_sea and positions(second)[:, 2].min() > 25.0 - 1e-3


def test_reeds_may_stand_in_shallow_water(terrain, tmp_path):
    """The rule Water Depth counts for the water of Add Water: up to its To, and not at all if it begins above 0."""
    y, x = np.mgrid[0:65, 0:65]
    put_heights(terrain, tmp_path / "land", 10.0 + x + 0.0 * y)
    scatter = add_scatter(terrain)
    add_water(terrain, level=40.0)
    scatter.adaptive_scatter.where.water_depth.high = 15.0
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert 24.0 < positions(scatter)[:, 2].min() < 26.0


def test_a_face_that_is_deleted_from_the_water_is_dry(terrain, tmp_path):
    y, x = np.mgrid[0:65, 0:65]
    put_heights(terrain, tmp_path / "land", 10.0 + x + 0.0 * y)
    scatter = add_scatter(terrain)
    water = add_water(terrain, level=40.0)
    water.hide_viewport = True
    water.data.clear_geometry()
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert positions(scatter)[:, 2].min() < 12.0
