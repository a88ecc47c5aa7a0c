# SPDX-License-Identifier: GPL-3.0-or-later
"""Click Add and Update in the panel as a user does, write a report, and stay open for the pictures: FOLDER.

Run with a window and --enable-event-simulate.
"""

import json
import math
import sys
import threading
import time

import bpy
from window_steps import click, folder, module, parts, picture, run, show_tab, take_steps, terrain, until

# Below the region's top, in pixels of a 1.0 interface: tabs' margin, the panel's header, half a button.
FIRST_BUTTON_BELOW_TOP = 40
SMALL = 257  # samples a side
warmup = module("cbt_terrain.run.warmup")
subjects = module("operators.accuracy.subject")
timed_runs = module("cbt_terrain.accuracy.timed_runs")
measuring = module("operators.accuracy.measure")
session = module("operators.session.session")
jobs = module("operators.jobs")
settings_for = subjects.settings_for
jobs.SHOWN_STEPS = 10  # the panel is drawn by software, and at each step of a progress bar
result = {"version": bpy.app.version_string, "background": bpy.app.background}
# Now, before the window is drawn for the first time: on a busy machine that takes longer than the kernels.
result["preparing_at_start"] = warmup.preparing()
result["warp_at_start"] = "warp" in sys.modules


def click_first_button():
    region = parts()[2]
    scale = bpy.context.preferences.system.ui_scale
    yield from click(region.x + region.width // 4, int(region.y + region.height - FIRST_BUTTON_BELOW_TOP * scale))


def turns_beside(operator, module, name: str, count: int):
    """Start an operator's job and return the number of turns that the window has until the job ends.

    The work waits on its thread for `count` turns. On the main thread it would wait in vain, without a turn.
    """
    gate, function, turns = threading.Event(), getattr(module, name), 0
    setattr(module, name, lambda *given, **named: (gate.wait(300.0), function(*given, **named))[1])
    run(operator, "INVOKE_DEFAULT")
    while not operator.poll():
        turns += 1
        if turns > count:
            gate.set()
        yield 0.02
    setattr(module, name, function)
    return turns


def steps():
    yield 2.0
    # The default cube stands where the terrain will be.
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    bpy.data.objects["Camera"].location.x += 0.01  # placed by a user: otherwise viewports would decide
    yield from show_tab()
    result["tab"] = parts()[2].active_panel_category
    started = time.monotonic()
    yield from click_first_button()
    yield from until(lambda: terrain() is not None)
    yield from until(lambda: warmup.preparing() or len(terrain().data.polygons) > 0)
    result["preparing_when_added"] = warmup.preparing()
    result["added_s"] = time.monotonic() - started
    yield from until(lambda: len(terrain().data.polygons) > 0)
    result["visible_s"] = time.monotonic() - started
    result["preparing_when_visible"] = warmup.preparing()
    result["triangles"] = len(terrain().data.polygons)
    yield from until(hud_shown)
    result["last_operation"] = bpy.context.window_manager.operators[-1].bl_idname, hud_shown()
    # The viewport's own mesh follows the settings, without a click.
    terrain().adaptive_terrain.viewport.error_px = 8.0
    yield from until(lambda: len(terrain().data.polygons) < result["triangles"])
    result["live_triangles"] = len(terrain().data.polygons)
    # With live update off nothing follows until Update is clicked.
    terrain().adaptive_terrain.live = False
    terrain().adaptive_terrain.viewport.error_px = 2.0
    yield 1.0
    result["not_live_triangles"] = len(terrain().data.polygons)
    yield from click_first_button()
    yield from until(lambda: len(terrain().data.polygons) != result["not_live_triangles"])
    result["updated_triangles"] = len(terrain().data.polygons)
    yield 1.0
    yield from picture("updated")
    yield from take_a_small_island()
    yield from measure_accuracy()
    yield from write_a_report()
    yield from keep_to_a_time()
    yield from smooth_between_samples()
    yield from bake_with_fit()
    yield from show_the_error()
    yield from follow_the_viewport()
    yield from cancel_an_import()
    yield from render_in_the_window()
    yield from render_the_viewport()


def hud_shown() -> bool:
    """Return whether the panel of the last operation is there; at 0 it is hidden."""
    return any(region.type == "HUD" and region.y > 0 for region in parts()[1].regions)


def take_a_small_island():
    """Replace the terrain by a small island and small pictures, which save most of the time of measurements."""
    bpy.context.scene.render.resolution_percentage = 40
    terrain().adaptive_terrain.island_size = SMALL
    bpy.ops.adaptive_terrain.import_source()
    yield from until(lambda: len(terrain().data.polygons) != result["updated_triangles"])
    result["small_triangles"] = len(terrain().data.polygons)


def measure_accuracy():
    """Measure in the background; a stopped measurement leaves nothing, and a finished one the curves."""
    settings = terrain().adaptive_terrain
    operators = bpy.ops.adaptive_terrain
    # Times that other programs disturb have a curve all the same.
    module("cbt_terrain.accuracy.rows").MAX_SPREAD = math.inf
    # too many errors to finish before the stop, even on a busy machine
    errors, measuring.PIXELS = measuring.PIXELS, tuple(16.0 * 0.999**i for i in range(4000))
    run(operators.measure_accuracy, "INVOKE_DEFAULT")
    yield 0.5
    with bpy.context.temp_override(window=parts()[0], area=parts()[1]):
        result["could_cancel_measuring"] = operators.cancel_job.poll()
        operators.cancel_job(kind="MEASURE")
    yield from until(operators.measure_accuracy.poll)
    result["curve_after_cancel"] = settings.viewport.curve
    measuring.PIXELS = errors
    result["turns_while_measuring"] = yield from turns_beside(
        operators.measure_accuracy, measuring, "measure_requests", 10
    )
    result["curves"] = [json.loads(detail.curve) for detail in (settings.viewport, settings.render)]


def coarse_settings(heights, frame, morph):
    """Return the cheap settings of a sweep: the first kind, which has pictures, and one of every other."""
    kinds = {}
    for s in settings_for(heights, frame, morph):
        kind = s.unit, s.interpolation, s.max_depth is None, s.meshlet == 0, s.fitted, s.morph
        kinds.setdefault(kind, []).append(s)
    first, *others = kinds.values()
    return [*first, *(kind[0] for kind in others)]


def write_a_report():
    """Run a sweep in the background while meshes are written; a stopped sweep leaves no report."""
    bpy.context.scene.render.resolution_percentage = 10  # rays through all pixels are most of its time
    timed_runs.SHORT_UPDATES = 1  # times are not looked at
    sweeping = module("cbt_terrain.accuracy.sweep")
    # too many settings to finish before the stop
    subjects.settings_for = lambda *arguments: coarse_settings(*arguments) * 100
    settings, operators = terrain().adaptive_terrain, bpy.ops.adaptive_terrain
    settings.reports = str(folder / "reports")
    scroll_panel(10_000)
    report = folder / "reports" / terrain().name / "index.html"
    meshes = len(bpy.data.meshes)
    run(operators.sweep_accuracy, "INVOKE_DEFAULT")
    yield 1.0
    yield from picture("sweeping")
    operators.cancel_job(kind="MEASURE")
    yield from until(operators.sweep_accuracy.poll)
    result["report_after_cancel"] = report.exists()
    subjects.settings_for = coarse_settings
    result["turns_while_sweeping"] = yield from turns_beside(operators.sweep_accuracy, sweeping, "sweep", 50)
    result["report"] = sorted(path.suffix for path in report.parent.iterdir())
    result["meshes_left_by_sweep"] = len(bpy.data.meshes) - meshes
    yield 1.0
    yield from picture("reported")
    bpy.context.scene.render.resolution_percentage = 40
    scroll_panel(-10_000)


def scroll_panel(pixels: int):
    window, area, region = parts()
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.view2d.scroll_down(deltay=pixels)


def keep_to_a_time():
    """Set a time budget: the measured curve gives the error, and the requested error does not count."""
    detail = terrain().adaptive_terrain.viewport
    terrain().adaptive_terrain.live = True
    curve = json.loads(detail.curve)
    # A measured point has a known mesh. Its time is replaced: times of so small a terrain are noise on a busy machine.
    point = len(curve["ms"]) // 2
    curve["ms"] = [2.0**i for i in range(len(curve["ms"]))]
    detail.curve, detail.max_ms = json.dumps(curve), curve["ms"][point] * 1.0001
    detail.error_px = 3.0  # different from all points, so that the budget changes the mesh
    yield from until(lambda: len(terrain().data.polygons) != result["small_triangles"])
    before = len(terrain().data.polygons)
    detail.limit_time = True
    yield from until(lambda: len(terrain().data.polygons) != before)
    yield 1.0
    result["budget"] = {"measured": curve["triangles"][point], "mesh": [len(terrain().data.polygons)]}
    yield from picture("budget")
    detail.error_px = 1.0
    yield 1.0
    result["budget"]["mesh"].append(len(terrain().data.polygons))
    detail.limit_time, detail.error_px = False, 2.0
    yield from until(lambda: len(terrain().data.polygons) == result["small_triangles"])


def smooth_between_samples():
    """Change the interpolation, which changes the mesh, and restore it."""
    settings = terrain().adaptive_terrain
    settings.viewport.error_px = 1.0
    yield from until(lambda: len(terrain().data.polygons) > result["small_triangles"])
    fine = len(terrain().data.polygons)
    settings.interpolation = "bicubic"
    yield from until(lambda: len(terrain().data.polygons) != fine)
    result["interpolations"] = {"bilinear": fine, "bicubic": len(terrain().data.polygons)}
    settings.interpolation = "bilinear"
    yield from until(lambda: len(terrain().data.polygons) == fine)
    settings.viewport.error_px = 2.0
    yield from until(lambda: len(terrain().data.polygons) == result["small_triangles"])


def bake_with_fit():
    """Bake a mesh as a separate object, with fewer triangles for the same error if fitted."""
    source, settings = terrain(), terrain().adaptive_terrain
    result["baked"] = {}
    settings.bake_error_m = 0.005
    for settings.bake_fit in (False, True):
        run(bpy.ops.adaptive_terrain.bake)
        assert source.hide_get() and source.hide_render, "the mesh is in its place"
        [baked] = [item for item in bpy.data.objects if "baked" in item.name]
        result["baked"][str(settings.bake_fit)] = len(baked.data.polygons)
        bpy.data.objects.remove(baked)
        source.hide_render = False
        source.hide_set(False)
        bpy.context.view_layer.objects.active = source
        yield 0.5


def show_the_error():
    """Show the overlay in the viewport's shading, and remove it."""
    settings = terrain().adaptive_terrain
    settings.live, settings.overlay = True, "ERROR"
    yield from until(lambda: "error_px" in terrain().data.attributes)
    run(bpy.ops.adaptive_terrain.show_overlay)
    yield 1.0
    result["error_px"] = max(item.value for item in terrain().data.attributes["error_px"].data)
    yield from picture("measured")
    settings.overlay = "NONE"
    yield from until(lambda: "error_px" not in terrain().data.attributes)


def follow_the_viewport():
    """Turn the view, which calls no handler, and wait until the terrain follows."""
    settings = terrain().adaptive_terrain
    settings.live, settings.camera_source = True, "VIEW"
    yield from until(lambda: len(terrain().data.polygons) != result["small_triangles"])
    yield 1.0
    result["viewport_triangles"] = len(terrain().data.polygons)
    parts()[1].spaces.active.region_3d.view_distance *= 4.0
    parts()[1].tag_redraw()
    yield from until(lambda: len(terrain().data.polygons) != result["viewport_triangles"])
    yield 1.0
    result["further_triangles"] = len(terrain().data.polygons)
    scene = parts()[0].scene
    settings.camera_source, camera, scene.camera = "SCENE", scene.camera, None
    parts()[1].spaces.active.region_3d.view_distance /= 4.0
    parts()[1].tag_redraw()
    yield from until(lambda: len(terrain().data.polygons) != result["further_triangles"])
    yield 1.0
    result["cameraless_triangles"] = len(terrain().data.polygons)
    scene.camera = camera
    yield 1.0


def cancel_an_import():
    """Stop a background import, after which the terrain has not changed."""
    settings = terrain().adaptive_terrain
    before, settings.island_size = settings.island_size, 4097
    result["store"] = settings.store
    run(bpy.ops.adaptive_terrain.import_source, "INVOKE_DEFAULT")
    result["import_runs_beside"] = jobs.find(jobs.IMPORT, terrain()) is not None
    # stop it far from its end, in one turn
    yield from until(lambda: not (job := jobs.find(jobs.IMPORT, terrain())) or job.fraction > 0.0)
    with bpy.context.temp_override(window=parts()[0], area=parts()[1]):
        result["could_cancel"] = bpy.ops.adaptive_terrain.cancel_job.poll()  # if not, it has failed: see its error
        result["import_error"] = session.record_of(terrain()).status.error
        if result["could_cancel"]:
            bpy.ops.adaptive_terrain.cancel_job(kind="IMPORT")
    yield 1.0
    with bpy.context.temp_override(window=parts()[0], area=parts()[1]):
        result["can_import_again"] = bpy.ops.adaptive_terrain.import_source.poll()
    result["store_after_cancel"] = settings.store
    settings.island_size = before


def render_in_the_window():
    """Render in the window with the render's detail, after which the viewport's detail returns."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.device, scene.cycles.use_denoising = 1, "CPU", False
    scene.render.resolution_percentage = 20
    scene.frame_start, scene.frame_end = 1, 2
    scene.render.filepath = str(folder / "window_")
    yield from until(lambda: len(terrain().data.polygons) == result["small_triangles"])
    terrain().adaptive_terrain.viewport.error_px = 4.0
    yield from until(lambda: len(terrain().data.polygons) != result["small_triangles"])
    result["before_render_triangles"] = len(terrain().data.polygons)
    rendered = result["rendered_triangles"] = []

    def look(_scene, _unused):
        rendered.append(len(terrain().data.polygons))

    bpy.app.handlers.render_post.append(look)
    scene.render.use_lock_interface = True
    with bpy.context.temp_override(window=parts()[0]):
        bpy.ops.render.render("INVOKE_DEFAULT", animation=True)
    yield 1.0
    yield from until(lambda: len(rendered) == 2 and not bpy.app.is_job_running("RENDER"))
    bpy.app.handlers.render_post.remove(look)
    yield from until(lambda: len(terrain().data.polygons) == result["before_render_triangles"])


def render_the_viewport():
    """Render an animation from the viewport, with the mesh of each frame."""
    scene = bpy.context.scene
    camera = scene.camera
    for frame, x in ((1, 7.0), (4, 30.0)):
        camera.location.x = x
        camera.keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end = 1, 4
    drawn = result["drawn_triangles"] = []

    def look(_scene, _unused):
        drawn.append(len(terrain().data.polygons))

    bpy.app.handlers.frame_change_post.append(look)
    area = parts()[1]
    region = next(region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=parts()[0], area=area, region=region):
        bpy.ops.render.opengl("INVOKE_DEFAULT", animation=True)
    yield from until(lambda: len(drawn) >= 5)  # four frames, and back to the first
    bpy.app.handlers.frame_change_post.remove(look)


take_steps(steps(), result)
