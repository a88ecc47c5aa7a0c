# SPDX-License-Identifier: GPL-3.0-or-later
"""Import a file in a factory scene with a window, as a new user does, and write a report: FOLDER FILE.

The report has the viewport's place and view after the import, and with the clip range and view of a factory scene.
"""

import sys

import bpy
from window_steps import folder, parts, take_steps, until, write_json

file = sys.argv[-1]


def steps():
    window, area, region = parts("WINDOW")
    space, view = area.spaces.active, area.spaces.active.region_3d
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    factory = space.clip_start, space.clip_end, view.view_distance, view.view_location.copy()
    camera = bpy.context.scene.camera
    place = [list(row) for row in camera.matrix_world]
    terrain = bpy.data.objects.new("Terrain", bpy.data.meshes.new("Terrain"))
    bpy.context.scene.collection.objects.link(terrain)
    bpy.context.view_layer.objects.active = terrain
    settings = terrain.adaptive_terrain
    settings.enabled, settings.source, settings.source_path = True, "FILE", file
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.adaptive_terrain.import_source("INVOKE_DEFAULT")
    yield from until(lambda: len(terrain.data.polygons) > 0)
    yield 2.0
    result = {
        "viewport": [region.x, region.y, region.width, region.height],
        "clip": [space.clip_start, space.clip_end],
        "camera_clip": [camera.data.clip_start, camera.data.clip_end],
        "camera_moved": place != [list(row) for row in camera.matrix_world],
        "width_m": terrain.dimensions.x,
    }
    write_json("imported.json", result)
    yield from until((folder / "imported_pictured").exists)
    space.clip_start, space.clip_end, view.view_distance, view.view_location = factory
    yield 1.0


take_steps(steps(), {}, first_interval=2.0)
