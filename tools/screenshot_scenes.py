# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene of take_screenshots.py, run in Blender with a window: NAME FOLDER FILE.

Touches FOLDER/PICTURE.ready when a picture can be taken, and goes on when the file is gone.
"""

import importlib
import sys
import time
from pathlib import Path

import bpy

NAME, *_PATHS = sys.argv[sys.argv.index("--") + 1 :]
FOLDER, FILE = map(Path, _PATHS)
WAIT_S = 1200.0  # only so that a hang ends
MOVES, QUIET_MS = 60, 60.0
# Buttons in pixels from the upper left of the evening's window, and the samples of its render.
BUTTONS_X, SET_UP_Y, WATER_Y, SCATTER_Y = 1041, 332, 377, 401
SAMPLES = 16
PACKAGE = bpy.types.Object.adaptive_terrain.keywords["type"].__module__.partition(".operators")[0]
PANEL = "ADAPTIVE_TERRAIN_PT_"
IMPORT_PANELS = {"main", "source", "imported", "surface"}
LAND_PANELS = {"main", "land", "land_output", "scatters", "on_ground", "output"}


def module(name: str):
    """Import a module of the installed extension."""
    return importlib.import_module(f"{PACKAGE}.{name}")


def until(condition):
    """Yield until a condition holds."""
    end = time.monotonic() + WAIT_S
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError("waited in vain")
        yield 0.2


def viewport():
    """Return the first window, its 3D viewport and that viewport's main region and sidebar."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    regions = {region.type: region for region in area.regions}
    return window, area, regions["WINDOW"], regions["UI"]


def run(operator, *arguments, **options):
    """Call an operator in the viewport."""
    window, area, region, _ = viewport()
    with bpy.context.temp_override(window=window, area=area, region=region):
        operator(*arguments, **options)


def open_panels(names: set[str]) -> None:
    """Register the panels anew, with these open and the others closed."""
    panels = module("operators.ui.panels")
    register, unregister = bpy.utils.register_classes_factory(panels.CLASSES)
    unregister()
    for cls in panels.CLASSES:
        cls.bl_options = set() if cls.bl_idname.removeprefix(PANEL) in names else {"DEFAULT_CLOSED"}
    register()


def settle(terrain):
    """Move the camera by half a metre until an update is not disturbed by other programs; then let the window draw."""
    record = module("operators.session.session").record_of(terrain)
    for _ in range(MOVES):
        bpy.context.scene.camera.location.x += 0.5
        yield 0.5
        if sum(record.status.ms.values()) < QUIET_MS:
            break
    viewport()[1].tag_redraw()
    yield 3.0
    yield from picture(NAME)


def picture(name: str):
    """Wait until a picture is taken."""
    ready = FOLDER / f"{name}.ready"
    ready.touch()
    yield from until(lambda: not ready.exists())


def show_tab():
    """Open the tab Terrain."""
    viewport()[1].spaces.active.show_region_ui = True
    yield 1.5
    viewport()[3].active_panel_category = "Terrain"
    yield 1.0


def look(view_3d, nearer: float) -> None:
    """Move the viewport nearer; leave the camera in place with a lens that sees all of it."""
    view_3d.view_distance *= nearer
    run(bpy.ops.view3d.camera_to_view)
    view_3d.view_perspective = "PERSP"
    bpy.context.scene.camera.data.lens *= 0.6


def import_scene():
    """Import a model in degrees, reprojected, into a file in its folder: paths are short, and nothing warns."""
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    bpy.ops.wm.save_as_mainfile(filepath=str(FILE.with_name("valley.blend")))
    open_panels(IMPORT_PANELS)
    yield from show_tab()
    terrain = bpy.data.objects.new("Terrain", bpy.data.meshes.new("Terrain"))
    bpy.context.scene.collection.objects.link(terrain)
    bpy.context.view_layer.objects.active = terrain
    terrain.select_set(True)
    settings = terrain.adaptive_terrain
    settings.enabled, settings.source, settings.source_path, settings.project = True, "FILE", f"//{FILE.name}", "utm"
    run(bpy.ops.adaptive_terrain.import_source, "INVOKE_DEFAULT")
    yield from until(lambda: len(terrain.data.polygons) > 0)
    yield 2.0
    view_3d = viewport()[1].spaces.active.region_3d
    look(view_3d, 0.75)
    yield from settle(terrain)


def land_scene():
    """Shape the built-in mountains, in one large viewport."""
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    bpy.ops.wm.save_as_mainfile(filepath=str(FILE.with_name("mountains.blend")))
    open_panels(LAND_PANELS)
    run(bpy.ops.mesh.adaptive_terrain_add, "INVOKE_DEFAULT", land="MOUNTAINS", shape=True)
    terrain = bpy.context.view_layer.objects.active
    yield from until(lambda: len(terrain.data.polygons) > 0)
    yield 3.0
    run(bpy.ops.adaptive_terrain.shape, "INVOKE_DEFAULT")
    jobs, shaped = module("operators.jobs"), module("operators.land.shaped_land")
    yield 2.0
    yield from until(lambda: not jobs.running and not shaped.state_of(terrain).wanted)
    run(bpy.ops.screen.screen_full_area)
    yield 2.0
    look(viewport()[1].spaces.active.region_3d, 0.6)
    yield 2.0
    yield from show_tab()
    yield from settle(terrain)


def click(x: int, y: int):
    """Move the mouse to pixels from the upper left, press and release the left button."""
    window = viewport()[0]
    for kind, value in (("MOUSEMOVE", "NOTHING"), ("LEFTMOUSE", "PRESS"), ("LEFTMOUSE", "RELEASE")):
        window.event_simulate(type=kind, value=value, x=x, y=window.height - y)
        yield 0.5


def is_shown():
    """Return whether the terrain's mesh is that of the present view, and no job runs."""
    live, jobs = module("operators.session.live"), module("operators.jobs")
    return not live.is_behind() and not jobs.running


def evening_scene():
    """Go from a dropped elevation model to a render with water and trees, by clicks on the panel."""
    scene = bpy.context.scene
    run(bpy.ops.mesh.adaptive_terrain_from_file, "INVOKE_DEFAULT", filepath=str(FILE))
    yield from until(lambda: any(len(obj.data.polygons) > 6 for obj in scene.objects if obj.type == "MESH"))
    yield from until(is_shown)
    yield 5.0
    yield from picture("evening_import")
    yield from click(BUTTONS_X, SET_UP_Y)
    yield from until(lambda: "Terrain Sun" in scene.objects)
    yield 2.0
    yield from until(is_shown)
    yield 3.0
    yield from picture("evening_scene")
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", SAMPLES, False
    yield from click(BUTTONS_X, WATER_Y)
    yield from until(lambda: any(obj.name.endswith(" Water") for obj in scene.objects))
    yield 3.0
    yield from picture("evening_water")
    yield from click(BUTTONS_X, SCATTER_Y)
    yield 2.0
    yield from picture("evening_scatter")
    yield from click(BUTTONS_X - 66, SCATTER_Y + 23)
    yield from until(lambda: any(obj.name.endswith(" Scatter") for obj in scene.objects))
    yield 2.0
    yield from until(is_shown)
    yield 3.0
    yield from picture("evening_trees")
    scene.render.filepath = str(FOLDER / "evening_picture.png")
    run(bpy.ops.render.render, write_still=True)
    yield from picture("evening_picture")


def steps():
    """Yield the seconds to wait before each next step."""
    yield 2.0
    yield from {"first_import": import_scene, "panel": land_scene, "evening": evening_scene}[NAME]()


_steps = steps()
bpy.app.timers.register(lambda: next(_steps, None), first_interval=2.0)
