# SPDX-License-Identifier: GPL-3.0-or-later
"""Render a map by script and from the file dialog, and write a report: FOLDER."""

import bpy
from window_steps import folder, module, run, take_steps, terrain, until

jobs = module("operators.jobs")
result = {"version": bpy.app.version_string, "texts": []}
operator = bpy.ops.adaptive_terrain.render_map


def steps():
    scene = bpy.context.scene
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    run(bpy.ops.mesh.adaptive_terrain_add, size=2000.0)
    yield from until(lambda: terrain() is not None and len(terrain().data.polygons) > 0 and not jobs.running)
    run(bpy.ops.adaptive_terrain.map_camera, use_metres=True, metres=10.0)
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 64, False
    run(operator, "EXEC_DEFAULT", filepath=str(folder / "script.png"), tiles=(2, 1), geotiff=False)
    yield 0.1
    run(operator, "INVOKE_DEFAULT", tiles=(2, 1))
    yield from until(lambda: len(bpy.context.window_manager.windows) > 1)
    yield 1.0
    dialog = bpy.context.window_manager.windows[1]
    with bpy.context.temp_override(window=dialog, area=dialog.screen.areas[0]):
        parameters = bpy.context.space_data.params
        parameters.directory, parameters.filename = str(folder).encode(), "window.png"
        bpy.ops.file.execute("INVOKE_DEFAULT")
    yield from until(lambda: jobs.running)
    yield from note_until_it_ends()
    result["windows"], result["border"] = len(bpy.context.window_manager.windows), scene.render.use_border


def note_until_it_ends():
    """Note the job's texts while Blender renders beside the window."""
    while jobs.running:
        if jobs.is_rendering() and jobs.running[0].text not in result["texts"]:
            result["texts"].append(jobs.running[0].text)
        yield 0.02


take_steps(steps(), result, first_interval=2.0)
