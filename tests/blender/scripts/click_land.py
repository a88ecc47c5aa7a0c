# SPDX-License-Identifier: GPL-3.0-or-later
"""Add rivers to the island by a click, preview, shape, undo and hide, and write a report: FOLDER.

Run with a window and --enable-event-simulate.
"""

import os
import signal
import time

import bpy
import mathutils
from window_steps import WAIT_S, module, only_open, parts, picture, show_tab, take_steps, terrain, until

SIDE = 32_000.0  # metres: of the island itself
SAMPLES = 601  # along each side: 3 x 3 tiles
result = {"version": bpy.app.version_string}


session, shaped_land, jobs = (module(f"operators.{name}") for name in ("session.session", "land.shaped_land", "jobs"))
derived_store, resting_land = (
    module("cbt_terrain.height_operators.derived_store"),
    module("operators.land.resting_land"),
)
resting_land.REST_S = 1e9  # until it is its turn
warmup, panels = module("cbt_terrain.run.warmup"), module("operators.ui.panels")
OPEN = {"ADAPTIVE_TERRAIN_PT_main", "ADAPTIVE_TERRAIN_PT_land", "ADAPTIVE_TERRAIN_PT_land_effect"}


def shown() -> str:
    return shaped_land.state_of(terrain()).shown


def mean_height() -> float:
    """Return the mean height of the mesh's field in metres, which rivers lower."""
    record = session.record_of(terrain())
    assert record.status.field_key == record.field.key
    return float(record.field.heights().mean())


def turns(condition):
    """Wait, and return the longest time between two turns in seconds."""
    longest, before, end = 0.0, time.monotonic(), time.monotonic() + WAIT_S
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError("waited in vain")
        yield 0.1
        longest, before = max(longest, time.monotonic() - before), time.monotonic()
    return longest


def run(operator, *how, **asked):
    window, area, region = parts()
    own = {"object": terrain()} if terrain() is not None else {}
    with bpy.context.temp_override(window=window, area=area, region=region, **own):
        return operator(*how, **asked)


def steps():
    yield 2.0
    only_open(panels, OPEN)
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    yield from show_tab()
    run(bpy.ops.mesh.adaptive_terrain_add, "INVOKE_DEFAULT", size=SIDE)
    yield from until(lambda: terrain() is not None and len(terrain().data.polygons) > 0 and not warmup.preparing())
    yield from take_a_smaller_island()
    look_closer()
    result["source"] = mean_height()
    yield from rivers_are_shown_at_once()
    yield from a_slider_never_blocks()
    yield from it_is_baked_by_a_button()
    yield from shaping_runs_beside_the_window()
    yield from it_is_baked_by_a_button()
    yield from undo_and_hide()
    yield from it_gets_finer_while_it_rests()


def take_a_smaller_island():
    """Replace the land by one of fewer samples, which saves most of the time of shaping."""
    terrain().adaptive_terrain.island_size = SAMPLES
    run(bpy.ops.adaptive_terrain.import_source)
    record = session.record_of(terrain())
    yield from until(lambda: record.field.lattice.width == SAMPLES and record.status.field_key == record.field.key)
    yield 1.0


def look_closer():
    space = parts()[1].spaces.active
    view = space.region_3d
    view.view_rotation = mathutils.Euler((1.12, 0.0, 0.7)).to_quaternion()
    view.view_distance, view.view_location = 0.75 * SIDE, (0.0, 0.0, 0.05 * SIDE)
    space.clip_end, space.shading.show_cavity = 10.0 * SIDE, True
    terrain().adaptive_terrain.camera_source = "VIEW"


def rivers_are_shown_at_once():
    run(bpy.ops.adaptive_terrain.land_add, effect="rivers")
    bpy.ops.ed.undo_push(message="Rivers")
    yield from until(lambda: shown() == "Preview")  # the first compiles kernels
    yield 1.0
    result["preview"], result["tiles"] = mean_height(), shaped_land.state_of(terrain()).tiles
    yield from picture("preview")


def a_slider_never_blocks():
    entry, seconds, longest = terrain().adaptive_terrain.land.entries[0], [], 0.0
    for years in (250e3, 200e3, 400e3):
        start, before = time.monotonic(), derived_store.counts["previews"]
        request = session.record_of(terrain()).status.request
        entry.rivers.years = years
        changed = lambda request=request: session.record_of(terrain()).status.request is not request  # noqa: E731
        longest = max(longest, (yield from turns(changed)))
        seconds.append(time.monotonic() - start)
        result["previews_a_step"] = derived_store.counts["previews"] - before
    result["slider_s"], result["longest_turn_s"] = seconds, longest
    bpy.ops.ed.undo_push(message="Years")


def shaping_runs_beside_the_window():
    for effect in ("scree", "snow"):
        run(bpy.ops.adaptive_terrain.land_add, effect=effect)
    bpy.ops.ed.undo_push(message="More")
    yield from until(lambda: len(session.record_of(terrain()).status.request.land.stack.entries) == 3)
    run(bpy.ops.adaptive_terrain.shape, "INVOKE_DEFAULT")
    result["progress"] = jobs.find(jobs.SHAPE, terrain()) is not None
    yield 0.3
    run(lambda: bpy.ops.adaptive_terrain.cancel_job(kind="SHAPE"))
    yield from until(lambda: jobs.find(jobs.SHAPE, terrain()) is None)
    result["after_cancel"] = shown()
    start = time.monotonic()
    run(bpy.ops.adaptive_terrain.shape, "INVOKE_DEFAULT")
    yield 1.5
    yield from picture("shaping")
    result["longest_turn_shaping_s"] = yield from turns(lambda: shown() == "Shaped")
    result["shaped_s"], result["shaped"] = time.monotonic() - start, mean_height()
    result["tiles_shaped"] = shaped_land.state_of(terrain()).tiles
    yield 1.0
    yield from picture("shaped")


def it_is_baked_by_a_button():
    """Bake the land into the terrain's store, which looks the same; Undo restores the stack."""
    settings, before = terrain().adaptive_terrain, mean_height()
    try:
        run(bpy.ops.adaptive_terrain.bake_land, "INVOKE_DEFAULT")
    except RuntimeError as error:
        result["not_baked"] = str(error)
        return
    yield from until(lambda: jobs.find(jobs.BAKE_LAND, terrain()) is None)
    yield 1.0  # for the undo step of the job's end
    result["baked"] = [settings.store.endswith("_baked"), len(settings.land.entries)]
    yield from until(lambda: session.record_of(terrain()).status.request.land is None)
    result["baked_differs_m"] = abs(mean_height() - before)
    yield from undo()


def undo():
    """Return to the shaped land with three entries."""
    window, area, region = parts()
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.ed.undo()
    yield from until(lambda: len(terrain().adaptive_terrain.land.entries) == 3 and shown() == "Shaped")


def undo_and_hide():
    run(bpy.ops.adaptive_terrain.land_add, effect="relief")
    bpy.ops.ed.undo_push(message="Relief")
    yield from until(lambda: shown() == "Preview")
    stores = derived_store.counts["stores"]
    yield from undo()
    result["stores_for_undo"] = derived_store.counts["stores"] - stores
    terrain().hide_set(True)
    terrain().hide_render = True
    yield 1.0
    before = dict(derived_store.counts)
    terrain().adaptive_terrain.land.entries[0].rivers.years = 123e3
    yield 3.0
    result["hidden_cost"] = [derived_store.counts[name] - before[name] for name in before]
    terrain().hide_set(False)
    yield from until(lambda: shown() == "Preview")
    result["shown_cost"] = [derived_store.counts[name] - before[name] for name in before]


def it_gets_finer_while_it_rests():
    """Wait for finer land in view while the window stays responsive; a slider stops it."""
    resting_land.REST_S = 2.0
    view = parts()[1].spaces.active.region_3d
    view.view_distance, view.view_location = 0.06 * SIDE, (0.1 * SIDE, 0.1 * SIDE, 0.02 * SIDE)
    run(bpy.ops.adaptive_terrain.land_add, effect="droplets")
    yield from until(lambda: any(job.child is not None for job in jobs.running))
    [child] = [job.child for job in jobs.running]
    os.kill(child._process.pid, signal.SIGSTOP)  # on a busy machine it might end before the slider moves
    terrain().adaptive_terrain.land.entries[-1].on = False
    terrain().adaptive_terrain.land.entries[0].rivers.years = 140e3
    yield from until(lambda: child.poll().done)
    result["slider_ends_it"] = child.cancelled
    start = time.monotonic()
    result["longest_turn_resting_s"] = yield from turns(lambda: shown() == "Shaped")
    result["finer_s"], result["tiles_of_views"] = time.monotonic() - start, shaped_land.state_of(terrain()).tiles
    yield 1.0
    yield from picture("finer")


take_steps(steps(), result, first_interval=1.0)
