# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake, pack and measure beside the window: cancelled, finished, and ended by a file and by disabling: FOLDER."""

import threading

import bpy
from bl_ext.user_default.adaptive_terrain.operators import jobs
from window_steps import folder, parts, take_steps, terrain, until

result = {}
operators = bpy.ops.adaptive_terrain


def run(operator, **given):
    window, area, region = parts("WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region, object=terrain()):
        return list(operator("INVOKE_DEFAULT", **given))


def threads():
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("adaptive_terrain_measure")]


def press(key: str):
    """Press and release a key where the mouse is."""
    for value in ("PRESS", "RELEASE"):
        parts()[0].event_simulate(type=key, value=value)
        yield 0.2


def steps():
    yield 1.0
    bpy.ops.mesh.adaptive_terrain_add("EXEC_DEFAULT")
    yield from until(lambda: not jobs.running and len(terrain().data.polygons) > 0)
    scene, maps = bpy.context.scene, terrain().adaptive_terrain.maps
    scene.frame_end, scene.frame_current = 100_000, 7
    maps.folder, maps.frames, maps.which, maps.chosen = str(folder / "maps"), "SHOT", "CHOSEN", {"slope"}
    result["baking"] = run(operators.bake_maps)
    yield from until(lambda: scene.frame_current > 10)
    result["cancel"] = run(operators.cancel_job, kind="BAKE")
    yield from until(lambda: not jobs.running)
    result["cancelled"] = [scene.frame_current, [path.name for path in folder.glob("maps/*/*.png")]]
    maps.frames = "WHOLE"
    run(operators.bake_maps)
    yield from until(lambda: not jobs.running)
    result["maps"] = len(list(folder.glob("maps/*/*.png")))
    terrain().adaptive_terrain.store = bpy.path.abspath(terrain().adaptive_terrain.store)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    run(operators.pack_store)
    yield from until(lambda: not jobs.running)
    result["store"] = terrain().adaptive_terrain.store
    bpy.ops.wm.save_mainfile()
    run(operators.export_tileset, error_m=20.0)
    yield from until(lambda: len(bpy.context.window_manager.windows) > 1)
    dialog = bpy.context.window_manager.windows[1]
    yield from until(lambda: dialog.screen.areas[0].spaces.active.params)
    yield 1.0
    with bpy.context.temp_override(window=dialog, area=dialog.screen.areas[0]):
        result["proposed"] = bpy.context.space_data.params.filename
        bpy.ops.file.execute("INVOKE_DEFAULT")
    yield from until((folder / "Terrain_tileset.json").exists)  # a job so short may never be seen running
    yield from until(lambda: not jobs.running)
    result["tileset"] = sorted(path.suffix for path in folder.glob("Terrain_tileset*"))
    bpy.ops.wm.save_mainfile()
    result["asking"] = run(operators.submit, bring=False)
    yield 1.0
    yield from press("RET")
    yield from until((folder / "farm" / "template.yaml").exists)
    yield from until(lambda: not jobs.running)
    run(operators.measure_accuracy)
    yield from until(threads)
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    yield from until(lambda: bpy.data.filepath and bpy.context.window_manager.windows)
    result["after_opening"] = [len(jobs.running), threads()]
    yield 1.0
    run(operators.measure_accuracy)
    yield from until(threads)
    bpy.ops.preferences.addon_disable(module="bl_ext.user_default.adaptive_terrain")
    result["after_disabling"] = [len(jobs.running), threads()]


take_steps(steps(), result, persistent=True)
