# SPDX-License-Identifier: GPL-3.0-or-later
"""A second raster of the same coordinate system is not silently put on the first."""

import bpy
from adaptive_terrain.operators.request.imported import neighbour_notes


def placed(name: str, crs: str, x: float, y: float):
    """Return an object that is tagged as an imported terrain."""
    obj = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    bpy.context.scene.collection.objects.link(obj)
    obj["SRID"], obj["crs x"], obj["crs y"] = crs, x, y
    return obj


def test_the_distance_to_the_first_raster_is_named(scene):
    west, east = placed("west", "EPSG:32632", 600640.0, 5199360.0), placed("east", "EPSG:32632", 601920.0, 5199350.5)
    [note] = neighbour_notes(east, [west, east])
    assert "1280 further east and -9.5 further north" in note and "west" in note
    east.location = (1280.0, -9.5, 0.0)
    bpy.context.view_layer.update()
    assert neighbour_notes(east, [west, east]) == []


def test_other_systems_and_the_same_raster_are_silent(scene):
    first = placed("first", "EPSG:32632", 600640.0, 5199360.0)
    assert neighbour_notes(first, [first]) == []
    assert neighbour_notes(placed("same", "EPSG:32632", 600640.0, 5199360.0), [first]) == []
    assert neighbour_notes(placed("other", "EPSG:2056", 2600640.0, 1199360.0), [first]) == []
    bare = bpy.data.objects.new("bare", bpy.data.meshes.new("bare"))
    assert neighbour_notes(bare, [first]) == []
