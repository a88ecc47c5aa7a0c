# SPDX-License-Identifier: GPL-3.0-or-later
"""Pick the ground with the mouse in a window, move the terrain under kept objects, and write a report: FOLDER.

Run with --enable-event-simulate. Every step is a turn of a timer, because Blender handles events and draws between
turns only.
"""

import importlib
import json
import sys
import time
import traceback
from pathlib import Path

import bpy
from bpy_extras import view3d_utils

[folder] = sys.argv[sys.argv.index("--") + 1 :]
folder = Path(folder)
WAIT_S = 900.0  # only so that a hang ends
PACKAGE = bpy.types.Object.adaptive_terrain.keywords["type"].__module__.partition(".operators")[0]
OPEN = {"ADAPTIVE_TERRAIN_PT_main", "ADAPTIVE_TERRAIN_PT_on_ground"}
result = {"version": bpy.app.version_string}
panels = importlib.import_module(f"{PACKAGE}.operators.ui.panels")
warmup = importlib.import_module(f"{PACKAGE}.cbt_terrain.run.warmup")


def parts(kind: str):
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    return window, area, next(region for region in area.regions if region.type == kind)


def until(condition):
    end = time.monotonic() + WAIT_S
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError("waited in vain")
        yield 0.05


def run(operator, *how, **asked):
    window, area, region = parts("WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region):
        return operator(*how, **asked)


def click(x: int, y: int):
    window = parts("WINDOW")[0]
    for kind, value in (("MOUSEMOVE", "NOTHING"), ("LEFTMOUSE", "PRESS"), ("LEFTMOUSE", "RELEASE")):
        window.event_simulate(type=kind, value=value, x=x, y=y)
        yield 0.1


def only_ground_is_open():
    panels.unregister()
    for cls in panels.CLASSES:
        if issubclass(cls, bpy.types.Panel) and not getattr(cls, "preset_subdir", ""):
            cls.bl_options = set() if cls.bl_idname in OPEN else {"DEFAULT_CLOSED"}
    panels.register()


def steps():
    _, area, region = parts("WINDOW")
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    only_ground_is_open()
    run(bpy.ops.mesh.adaptive_terrain_add, size=2000.0)
    terrain = bpy.context.object
    yield from until(lambda: len(terrain.data.polygons) > 0 and not warmup.preparing())
    area.spaces.active.show_region_ui = True
    yield 1.0
    parts("UI")[2].active_panel_category = "Terrain"
    yield 1.0
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
    (folder / "ground").touch()
    yield from until((folder / "ground_pictured").exists)


def turn():
    try:
        return next(_steps)
    except StopIteration:
        pass
    except Exception:
        result["error"] = traceback.format_exc()
    (folder / "done.json").write_text(json.dumps(result))
    (folder / "ground").touch()
    return None


_steps = steps()
bpy.app.timers.register(turn, first_interval=2.0)
