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
    return terrain.children[-1]


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


def test_trees_stand_above_the_sea_of_add_water(terrain, tmp_path):
    """The sea of land without a coast is that of its water, whichever of the two is added first."""
    y, x = np.mgrid[0:65, 0:65]
    put_heights(terrain, tmp_path / "land", 10.0 + x + 0.0 * y)
    first = add_scatter(terrain)
    assert not first.adaptive_scatter.use_sea
    bpy.context.view_layer.objects.active = terrain
    assert bpy.ops.adaptive_terrain.water_surface(level=30.0) == {"FINISHED"}
    assert bpy.ops.adaptive_terrain.scatter_add() == {"FINISHED"}
    second = bpy.context.object
    session.update_object(terrain)
    for scatter in (first, second):
        assert scatter.adaptive_scatter.use_sea and positions(scatter)[:, 2].min() > 30.0 - 1e-3
    second.adaptive_scatter.sea_level = 40.0
    bpy.context.view_layer.objects.active = terrain
    bpy.ops.adaptive_terrain.water_surface(level=25.0)
    assert [child.adaptive_scatter.sea_level for child in (first, second)] == pytest.approx([25.0, 40.0])
