# SPDX-License-Identifier: GPL-3.0-or-later
"""Pick the ground with the mouse in a window, move the terrain under kept objects, and write a report: FOLDER.

Run with --enable-event-simulate.
"""

import bpy
from bpy_extras import view3d_utils
from window_steps import click, module, only_open, parts, picture, run, show_tab, take_steps, until

OPEN = {"ADAPTIVE_TERRAIN_PT_main", "ADAPTIVE_TERRAIN_PT_on_ground"}
result = {"version": bpy.app.version_string}
panels = module("operators.ui.panels")
warmup = module("cbt_terrain.run.warmup")


def steps():
    _, area, region = parts("WINDOW")
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    only_open(panels, OPEN)
    run(bpy.ops.mesh.adaptive_terrain_add, size=2000.0)
    terrain = bpy.context.object
    yield from until(lambda: len(terrain.data.polygons) > 0 and not warmup.preparing())
    yield from show_tab()
    x, y = region.x + region.width // 3, region.y + region.height // 2
    bpy.context.scene.cursor.location = (0.0, 0.0, 9000.0)
    run(bpy.ops.adaptive_terrain.pick_ground, "INVOKE_DEFAULT")
    yield 0.2
    yield from click(x, y)
    cursor = bpy.context.scene.cursor.location.copy()
    seen = view3d_utils.location_3d_to_region_2d(region, area.spaces.active.region_3d, cursor)
    result["picked"], result["clicked"] = [seen.x + region.x, seen.y + region.y], [x, y]

    run(bpy.ops.mesh.primitive_cube_add, size=60.0, location=(0.0, 0.0, 800.0))
    cube = bpy.context.object
    run(bpy.ops.adaptive_terrain.drop_to_ground, anchor="ORIGIN", keep=True)
    result["kept"] = []
    for place in ((300.0, 100.0), (-200.0, 250.0)):
        before = cube.matrix_world.translation.z
        cube.location.x, cube.location.y = place
        yield from until(lambda: abs(cube.matrix_world.translation.z - before) > 1e-3)  # noqa: B023
        yield 0.5
        at = cube.matrix_world.translation
        bpy.context.scene.cursor.location = (0.0, 0.0, 0.0)
        run(bpy.ops.adaptive_terrain.pick_ground, origin=(at.x, at.y, 9000.0), direction=(0.0, 0.0, -1.0))
        result["kept"].append([at.x, at.y, at.z, bpy.context.scene.cursor.location.z])
    yield 1.0
    yield from picture("ground")


take_steps(steps(), result, first_interval=2.0)
