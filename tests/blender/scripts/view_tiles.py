# SPDX-License-Identifier: GPL-3.0-or-later
"""Import a mosaic whose tiles in view follow the camera and renders, with a second import: FOLDER TILES OTHER."""

import sys
from pathlib import Path

import bpy

sys.path.append(str(Path(__file__).parent))  # Blender does not do so for scripts
from window_steps import folder, parts, picture, run, take_steps, until  # noqa: E402

tiles, other = sys.argv[-2:]
report: dict = {}


def add(name: str, source: str):
    """Add a terrain of a source, and import it beside the window."""
    obj = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    bpy.context.scene.collection.objects.link(obj)
    choose(obj)
    settings = obj.adaptive_terrain
    settings.enabled, settings.source, settings.source_path = True, "FILE", source
    run(bpy.ops.adaptive_terrain.import_source, "INVOKE_DEFAULT")
    return obj


def choose(obj) -> None:
    for item in bpy.context.selected_objects:
        item.select_set(False)
    bpy.context.view_layer.objects.active = obj
    obj.select_set(True)


def look_down(x: float, y: float, z: float) -> None:
    camera = bpy.context.scene.camera
    camera.location, camera.rotation_euler = (x, y, z), (0.0, 0.0, 0.0)


def steps():
    modules = {name.rpartition(".")[2]: module for name, module in sys.modules.items() if ".operators." in name}
    jobs, imported_of, tiles_of = modules["jobs"], modules["imported"].imported_of, modules["view_tiles"]
    tiles_of.REST_S = 0.5
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    scene, camera = bpy.context.scene, bpy.context.scene.camera
    camera.data.clip_end = 1e6
    scene.render.engine, scene.render.resolution_x, scene.render.resolution_y = "BLENDER_WORKBENCH", 320, 180
    scene.render.filepath = str(folder / "rendered.png")
    look_down(-80000.0, -80000.0, 9000.0)
    terrain = add("Terrain", tiles)

    def loaded():
        found = imported_of(terrain.adaptive_terrain)
        return set(found.settings["loaded_tiles"]) if found is not None and found.refined_m else set()

    space, region = parts()[1].spaces.active, parts()[1].spaces.active.region_3d
    space.show_region_ui = True
    yield from until(loaded)
    report["first"] = sorted(loaded())
    yield 1.0
    parts()[2].active_panel_category = "Terrain"
    region.view_perspective = "CAMERA"
    choose(terrain)
    yield 3.0
    yield from picture("fine")
    look_down(60000.0, 50000.0, 9000.0)
    yield 0.3
    report["texts"] = [tiles_of.loaded_here(bpy.context, terrain)]
    before = loaded()
    yield from until(lambda: loaded() > before)
    report["moved"] = sorted(loaded() - before)
    report["texts"].append(tiles_of.loaded_here(bpy.context, terrain))
    second = add("Second", other)
    yield from until(lambda: jobs.find(jobs.IMPORT, second) is None and second.adaptive_terrain.store)
    report["second"] = [imported_of(second.adaptive_terrain).raster, jobs.find(jobs.IMPORT, terrain) is not None]
    bpy.data.objects.remove(second)
    choose(terrain)
    look_down(-60000.0, 60000.0, 9000.0)
    terrain.adaptive_terrain.render.error_px = 1e4
    before = loaded()
    run(bpy.ops.render.render, "INVOKE_DEFAULT", write_still=True)
    yield from until((folder / "rendered.png").exists)
    yield from until(lambda: not bpy.app.is_job_running("RENDER"))
    report["rendered"] = [
        jobs.find(jobs.IMPORT, terrain) is not None,
        modules["imported"].loaded_text(terrain.adaptive_terrain),
    ]
    run(bpy.ops.adaptive_terrain.cancel_job, kind="IMPORT")
    yield from until(lambda: jobs.find(jobs.IMPORT, terrain) is None)
    report["cancelled"] = modules["imported"].loaded_text(terrain.adaptive_terrain)
    run(bpy.ops.adaptive_terrain.import_source, "INVOKE_DEFAULT")
    yield 2.0
    try:
        report["added"] = list(run(bpy.ops.adaptive_terrain.add_tiles, filepath=other))
    except RuntimeError as error:
        report["added"] = str(error)
    report["sources"] = [len(terrain.adaptive_terrain.more_sources), jobs.find(jobs.IMPORT, terrain) is not None]
    run(bpy.ops.adaptive_terrain.cancel_job, kind="IMPORT")
    yield from until(lambda: jobs.find(jobs.IMPORT, terrain) is None)
    yield 1.0


take_steps(steps(), report, 2.0)
