# SPDX-License-Identifier: GPL-3.0-or-later
"""Render while a header is drawn, which leaves Blender's flag against writing set, and approach the land: FOLDER.

The engine's call begins while the header is drawn, and ends after that.
"""

import time

import bpy
from window_steps import module, parts, run, take_steps, terrain, until

result = {"version": bpy.app.version_string, "writes": [], "rendered": []}
state = {"drawing": False, "in_header": False, "rendering": False, "ended": False}


class SlowEngine(bpy.types.RenderEngine):
    bl_idname = "SLOW"
    bl_label = "Slow"

    def render(self, depsgraph):
        state["rendering"] = True
        result["rendered"].append(len(terrain().evaluated_get(depsgraph).data.polygons))
        time.sleep(2.0)


def draw_slowly(_header, _context) -> None:
    state["in_header"] = state["drawing"]
    end = time.monotonic() + 60.0
    while state["drawing"] and not state["rendering"] and time.monotonic() < end:
        time.sleep(0.05)  # lets the render's thread begin its call
    state["in_header"] = False


def wait_for_header(*_arguments) -> None:
    """Wait on the render's thread, before the engine is called, until the header is drawn."""
    end = time.monotonic() + 60.0
    while state["drawing"] and not state["in_header"] and time.monotonic() < end:
        time.sleep(0.05)


def try_to_write() -> None:
    """Note whether a timer of another extension may write."""
    scene = bpy.context.scene
    try:
        scene.frame_step = scene.frame_step
        result["writes"].append(True)
    except AttributeError:
        result["writes"].append(False)


def triangles() -> int:
    return len(terrain().data.polygons)


def steps():
    bpy.utils.register_class(SlowEngine)
    bpy.types.VIEW3D_HT_header.append(draw_slowly)
    scene = bpy.context.scene
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    run(bpy.ops.mesh.adaptive_terrain_add, "INVOKE_DEFAULT", size=8_000.0)
    yield from until(lambda: terrain() is not None and triangles() > 0)
    terrain().adaptive_terrain.camera_source = "VIEW"
    yield 3.0
    scene.render.engine, scene.render.use_lock_interface, scene.render.resolution_percentage = "SLOW", False, 5
    bpy.app.handlers.render_complete.append(lambda *_: state.update(ended=True))
    bpy.app.handlers.render_pre.append(wait_for_header)
    yield from notes_whether_timers_write(1)
    state["drawing"] = True
    run(bpy.ops.render.render, "INVOKE_DEFAULT")
    while not state["ended"]:
        for area in bpy.context.window_manager.windows[0].screen.areas:
            area.tag_redraw()
        yield 0.05
    state["drawing"] = False
    yield from until(lambda: not bpy.app.is_job_running("RENDER"))
    yield from notes_whether_timers_write(2)
    bpy.app.timers.register(module("operators.bridge.writing").allow_writing(try_to_write))
    yield from until(lambda: len(result["writes"]) == 3)
    result["before"] = triangles()
    parts()[1].spaces.active.region_3d.view_distance *= 0.25
    end = time.monotonic() + 60.0
    yield from until(lambda: triangles() != result["before"] or time.monotonic() > end)
    result["after"] = triangles()
    # A second render: its handler writes on the render's thread.
    state.update(ended=False)
    run(bpy.ops.render.render, "INVOKE_DEFAULT")
    yield from until(lambda: state["ended"] and not bpy.app.is_job_running("RENDER"))


def notes_whether_timers_write(count: int):
    bpy.app.timers.register(try_to_write)
    yield from until(lambda: len(result["writes"]) == count)


take_steps(steps(), result, first_interval=1.0)
