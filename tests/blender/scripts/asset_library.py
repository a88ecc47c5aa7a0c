# SPDX-License-Identifier: GPL-3.0-or-later
"""Wait for the asset library, show it in the Asset Browser and drag the material onto an object: FOLDER."""

import sys
from pathlib import Path

import bpy
from window_steps import parts, picture, take_steps, until

EXTENSION = "bl_ext.user_default.adaptive_terrain"
result = {}


def entries():
    return [(entry.name, entry.path) for entry in bpy.context.preferences.filepaths.asset_libraries]


def ours():
    return [path for _name, path in entries() if Path(path).parent.name == "adaptive_terrain"]


def steps():
    bpy.context.preferences.filepaths.asset_libraries.new(name="Mine", directory=str(Path(sys.argv[-1])))
    mine = entries()[-1]
    yield from until(ours)
    [folder] = ours()
    import warp

    result["wheels"] = Path(warp.__file__).is_file()
    result["files"] = sorted(file.name for file in Path(folder).iterdir())
    window, area, _ = parts()
    yield from browse(area)
    yield from picture("browser")
    area.ui_type = "VIEW_3D"
    browser = max((a for a in window.screen.areas if a != area), key=lambda a: a.width * a.height)
    yield from browse(browser, "Terrain Material")
    with bpy.data.libraries.load(str(Path(folder) / "adaptive_terrain.blend"), assets_only=True) as (there, wanted):
        result["assets"] = {kind: len(getattr(there, kind)) for kind in ("materials", "node_groups", "collections")}
    cube = bpy.data.objects["Cube"]
    result["dragged"] = yield from drag(window, browser, cube)
    bpy.ops.preferences.addon_disable(module=EXTENSION)
    result["after_disable"] = [entry for entry in entries() if entry == mine], ours()


def browse(area, text: str = ""):
    """Show the library in an area, or the asset of a name."""
    area.ui_type = "ASSETS"
    yield 1.0
    area.spaces.active.params.asset_library_reference = "Adaptive Terrain"
    area.spaces.active.params.filter_search = text
    yield 5.0


def drag(window, browser, cube):
    """Drag the first asset onto the cube in the middle of the viewport; return the cube's materials."""
    main = next(region for region in browser.regions if region.type == "WINDOW")
    start = main.x + 60, main.y + main.height - 60
    view = parts("WINDOW")[2]
    goal = view.x + view.width // 2, view.y + view.height // 2
    window.event_simulate(type="MOUSEMOVE", value="NOTHING", x=start[0], y=start[1])
    yield 0.5
    window.event_simulate(type="LEFTMOUSE", value="PRESS", x=start[0], y=start[1])
    yield 0.5
    for k in range(1, 11):
        x, y = (round(a + (b - a) * k / 10) for a, b in zip(start, goal, strict=True))
        window.event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=y)
        yield 0.3
    window.event_simulate(type="LEFTMOUSE", value="RELEASE", x=goal[0], y=goal[1])
    yield 2.0
    yield from picture("dropped")
    return [slot.material.name for slot in cube.material_slots]


take_steps(steps(), result)
