# SPDX-License-Identifier: GPL-3.0-or-later
"""Press F12 over land that is not shaped, cancel by Esc in two ways, and write a report: FOLDER.

Run with a window and --enable-event-simulate. Blender's own Esc, which ends the render too, sees only real keys.
"""

import time

import bpy
from window_steps import module, run, take_steps, terrain, until

SIDE = 32_000.0  # metres: of the island itself
result = {"version": bpy.app.version_string, "ended": [], "said": []}


render_wait, resting_land, shaped_land = (
    module(f"operators.land.{name}") for name in ("render_wait", "resting_land", "shaped_land")
)
jobs, popup = module("operators.jobs"), module("operators.bridge.popup")
resting_land.REST_S = 1e9  # nothing else shapes land


def press(key: str):
    for window in bpy.context.window_manager.windows:
        for value in ("PRESS", "RELEASE"):
            window.event_simulate(type=key, value=value, x=300, y=300)
            yield 0.05


def is_rendering() -> bool:
    return bpy.app.is_job_running("RENDER")


def cancel(is_over):
    """Press Esc, and return the seconds until something is over."""
    start = time.monotonic()
    yield from press("ESC")
    yield from until(is_over, 0.02)
    return round(time.monotonic() - start, 2)


def steps():
    yield 2.0
    scene = bpy.context.scene
    for name in ("render_complete", "render_cancel"):
        getattr(bpy.app.handlers, name).append(lambda *_, name=name: result["ended"].append(name))
    show = popup._show
    popup._show = lambda: result["said"].append(list(popup._lines)) or show()
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    run(bpy.ops.mesh.adaptive_terrain_add, "INVOKE_DEFAULT", size=SIDE)
    yield from until(lambda: terrain() is not None and len(terrain().data.polygons) > 0)
    for effect in ("rivers", "droplets", "droplets"):  # rivers alone would be done before Esc
        run(bpy.ops.adaptive_terrain.land_add, effect=effect)
    yield from until(lambda: shaped_land.state_of(terrain()).shown == "Preview")
    scene.render.engine, scene.cycles.samples, scene.render.resolution_percentage = "CYCLES", 1, 10
    scene.cycles.use_denoising = False
    scene.render.use_lock_interface = True
    yield from a_key_shapes_before_the_render()
    yield from a_render_that_waits_is_cancelled(scene)
    yield from the_land_is_shaped_and_rendered()


def shaping():
    return jobs.find(jobs.SHAPE, terrain())


def a_key_shapes_before_the_render():
    yield from press("F12")
    yield from until(lambda: shaping() is not None and shaping().child is not None)
    result["rendering_while_shaping"] = is_rendering()
    yield 1.0
    result["job_ends_s"] = yield from cancel(lambda: shaping() is None)
    yield 1.0
    result["rendered_after_esc"] = is_rendering() or bool(result["ended"])


def a_render_that_waits_is_cancelled(scene):
    """Cancel a render from the menu, which waits in its thread. While the interface is locked no key reaches Python."""
    scene.render.use_lock_interface = False
    run(bpy.ops.render.render, "INVOKE_DEFAULT")
    yield from until(lambda: render_wait.waiting is not None and render_wait.waiting.is_watched)
    yield 1.0
    result["wait_ends_s"] = yield from cancel(lambda: render_wait.waiting is None)
    yield from until(lambda: not is_rendering() and result["said"])


def the_land_is_shaped_and_rendered():
    for entry in terrain().adaptive_terrain.land.entries[1:]:
        entry.on = False  # the other two were only there to outlast Esc
    run(bpy.ops.adaptive_terrain.shape_and_render, "INVOKE_DEFAULT")
    yield from until(lambda: len(result["ended"]) == 2)
    result["shaped"] = shaped_land.state_of(terrain()).shown


take_steps(steps(), result, first_interval=1.0)
