# SPDX-License-Identifier: GPL-3.0-or-later
"""Undo and redo by keys during and after the import of a height map, and write a report: FOLDER.

Run with a window and --enable-event-simulate: Blender handles keys between the turns of a timer.
"""

from pathlib import Path
from types import SimpleNamespace

import bpy
from bl_ext.user_default.adaptive_terrain.operators import jobs
from bl_ext.user_default.adaptive_terrain.operators.importing import import_terrain
from window_steps import parts, run, take_steps, terrain, until

result = {}
# An import may end within one turn of the window. `held` delays its end, as kernels that are still being compiled do.
held = [True]
jobs.warmup = SimpleNamespace(preparing=lambda: held[0], wait=lambda: None)


def press_z(**keys):
    window, area, _ = parts()
    place = {"x": area.x + area.width // 3, "y": area.y + area.height // 2}
    window.event_simulate(type="MOUSEMOVE", value="NOTHING", **place)
    for value in ("PRESS", "RELEASE"):
        window.event_simulate(type="Z", value=value, ctrl=True, **place, **keys)


def gone_and_back(name: str, go, come_back):
    """Remove the terrain during its import, which ends the import, and bring it back."""
    yield from until(lambda: jobs.find(jobs.IMPORT, terrain()) is not None)
    go()
    yield from until(lambda: terrain() is None and not jobs.running)
    come_back()
    yield from until(lambda: terrain() is not None)
    yield from until(lambda: jobs.find(jobs.IMPORT, terrain()) is not None)
    result[name] = [terrain().adaptive_terrain.store, len(jobs.running)]


def one_step_with_its_import():
    """Undo and redo adding with its import as one step, with a later step and without."""
    store, end = terrain().adaptive_terrain.store, bpy.context.scene.camera.data.clip_end
    press_z()
    yield from until(lambda: terrain() is None)
    press_z(shift=True)
    yield from until(lambda: terrain() is not None and len(terrain().data.polygons) > 0)
    terrain().location.x = 1.0
    bpy.ops.ed.undo_push(message="Moved")
    press_z()
    yield from until(lambda: terrain().location.x == 0.0 and len(terrain().data.polygons) > 0)
    same = terrain().adaptive_terrain.store == store, bpy.context.scene.camera.data.clip_end == end
    result["one_step"] = [*same, len(jobs.running)]


def steps():
    yield 2.0
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    bpy.ops.ed.undo_push(message="Empty")
    run(bpy.ops.mesh.adaptive_terrain_add, "INVOKE_DEFAULT", True)
    yield from gone_and_back("undone", press_z, lambda: press_z(shift=True))
    yield from gone_and_back("deleted", lambda: run(bpy.ops.object.delete, "EXEC_DEFAULT", True), press_z)
    held[0] = False
    yield from until(lambda: len(terrain().data.polygons) > 0)
    result["imported"] = Path(bpy.path.abspath(terrain().adaptive_terrain.store)).is_dir()
    yield from one_step_with_its_import()
    result["left"] = [len(jobs.running), len(import_terrain._gone)]


take_steps(steps(), result)
