# SPDX-License-Identifier: GPL-3.0-or-later
"""Repeat acts in the open file, and write samples of the process's memory and handles: FOLDER COUNTS.

COUNTS is JSON, {"fly": 1000, ...}: the number of times for each of `ACTS`, in this order. FOLDER gets a file of samples
for each act, then done.json. With a window every step is a turn of a timer, so that Blender draws and the terrain
follows; without one the steps follow each other.
"""

import functools
import json
import os
import sys
import time
import traceback
from pathlib import Path

import bpy
import window_steps
from bl_ext.user_default.adaptive_terrain.cbt_terrain.run import warmup
from bl_ext.user_default.adaptive_terrain.operators import jobs
from bl_ext.user_default.adaptive_terrain.operators.session import live, session
from bpy.app.handlers import persistent
from window_steps import WAIT_S, parts, terrain, write_json

counts = json.loads(sys.argv[-1])
until = functools.partial(window_steps.until, pause_s=0.005)
SAMPLES = 100  # maximum per act
RENDERED = 12  # every 12th frame of a flight in the window is rendered
SIDE = 100  # pixels from the window's lower left corner, where a key is pressed
_rendered: list[int] = []  # frames that a window has rendered
CYCLE = 48  # frames until the camera returns


def held() -> dict[str, int]:
    """Return memory in kilobytes, open files, threads, mapped arrays, data-blocks, records and triangles."""
    data = {
        kind.identifier: len(getattr(bpy.data, kind.identifier))
        for kind in bpy.types.BlendData.bl_rna.properties
        if kind.type == "COLLECTION"
    }
    return {
        "memory_kb": int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") // 1024,
        "files": len(os.listdir("/proc/self/fd")),
        "threads": len(os.listdir("/proc/self/task")),
        "mapped_arrays": Path("/proc/self/maps").read_text().count("/terrain/"),
        "datablocks": sum(data.values()),
        "records": len(session._records),
        "fields": len(session._fields),
        "triangles": len(terrain().data.polygons),
    }


def settled():
    """Wait until the terrain has followed a change, which happens at once without a window."""
    if not bpy.app.background:
        yield 0.0  # Blender evaluates and draws
        yield from until(lambda: live._job is None and not live._dirty and not warmup.preparing())


def viewport():
    window, area, region = parts("WINDOW")
    return bpy.context.temp_override(window=window, area=area, region=region, screen=window.screen)


def fly(step, count):
    """Show a frame with live update and motion blur, and render some frames in the window.

    The render starts by a key, after all other acts: Python that draws while Cycles starts or ends may leave Blender
    (4.3) in a state in which it permanently refuses operators and timers.
    """
    scene = bpy.context.scene
    scene.frame_set(1 + step % CYCLE)
    yield from settled()
    if step % RENDERED == 0:
        before = len(_rendered)
        for value in ("PRESS", "RELEASE"):
            bpy.context.window_manager.windows[0].event_simulate(type="F12", value=value, x=SIDE, y=SIDE)
            yield 0.05
        yield from until(lambda: len(_rendered) > before and not bpy.app.is_job_running("RENDER"))
        yield from settled()


def undo(step, count):
    """Change a setting, then Undo and Redo, also beyond the number of steps that Blender keeps."""
    detail = terrain().adaptive_terrain.viewport
    detail.error_px = 40.0 + step % 7
    yield from settled()
    with viewport():
        bpy.ops.ed.undo_push(message=f"step {step}")
    for again in (bpy.ops.ed.undo, bpy.ops.ed.redo, bpy.ops.ed.undo)[: 2 + (step % 3 == 0)]:
        with viewport():
            again()
        yield from settled()
    if len(terrain().data.polygons) == 0:
        raise AssertionError("Undo left no mesh")


def load(step, count):
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
    yield from settled()
    yield from until(lambda: session.record_of(terrain()).status.triangles > 0)


def arrange(step, count):
    """Add collections, a view layer, an instance and a driver, update, and remove them."""
    scene, obj = bpy.context.scene, terrain()
    collection = bpy.data.collections.new("Ground")
    scene.collection.children.link(collection)
    collection.objects.link(obj)
    [home] = [place for place in obj.users_collection if place != collection]
    home.objects.unlink(obj)
    layer = scene.view_layers.new("More")
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", collection
    scene.collection.objects.link(instance)
    driver = obj.driver_add("adaptive_terrain.viewport.error_px").driver
    driver.expression = "40 + frame % 9"
    scene.frame_set(1 + step % CYCLE)
    yield from settled()
    layer.layer_collection.children[collection.name].exclude = True
    scene.frame_set(2 + step % CYCLE)
    yield from settled()
    obj.driver_remove("adaptive_terrain.viewport.error_px")
    home.objects.link(obj)
    bpy.data.objects.remove(instance)
    bpy.data.collections.remove(collection)
    scene.view_layers.remove(layer)
    yield from settled()


def write(step, count):
    """Import another island into the store while another program reads it."""
    terrain().adaptive_terrain.seed = step
    bpy.context.view_layer.objects.active = terrain()
    assert bpy.ops.adaptive_terrain.import_source() == {"FINISHED"}
    yield 0.0


def render(step, count):
    """Render a frame with motion blur in the background."""
    bpy.context.scene.frame_set(1 + step % CYCLE)
    bpy.ops.render.render(write_still=True)
    yield 0.0


def quit_importing(step, count):
    """End Blender while a large import runs."""
    obj = terrain()
    bpy.context.view_layer.objects.active = obj
    obj.adaptive_terrain.island_size = 4097
    with viewport():
        bpy.ops.adaptive_terrain.import_source("INVOKE_DEFAULT")
    yield from until(lambda: jobs.find(jobs.IMPORT, terrain()).fraction > 0.02)
    bpy.ops.wm.quit_blender()
    yield WAIT_S  # that is done after this turn


@persistent
def note_render(scene, _unused) -> None:
    _rendered.append(scene.frame_current)


bpy.app.handlers.render_complete.append(note_render)
ACTS = {act.__name__: act for act in (undo, load, arrange, fly, write, render, quit_importing)}


def steps():
    yield 0.5
    yield from until(lambda: not warmup.preparing())
    for name, count in counts.items():
        started, cpu, samples = time.monotonic(), time.process_time(), []
        for step in range(count):
            yield from ACTS[name](step, count)
            if (step + 1) % max(1, count // SAMPLES) == 0:
                samples.append({"step": step + 1} | held())
        spent = {"wall_s": time.monotonic() - started, "cpu_s": time.process_time() - cpu}
        write_json(f"{name}.json", spent | {"samples": samples})
    write_json("done.json", {})


_steps = steps()


def turn():
    try:
        return next(_steps)
    except StopIteration:
        return None
    except Exception:
        write_json("done.json", {"error": traceback.format_exc()})
        return None


if bpy.app.background:
    while turn() is not None:
        pass
else:
    bpy.app.timers.register(turn, first_interval=0.5, persistent=True)
