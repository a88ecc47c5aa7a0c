# SPDX-License-Identifier: GPL-3.0-or-later
"""`adaptive-terrain demo`: the built-in island from import to pictures, and a page with the figures of this run."""

import json
import os
import platform
import time
from pathlib import Path

from ...cbt_terrain.accuracy.crops import crops
from ...cbt_terrain.accuracy.timed_runs import TimedFrame
from ...cbt_terrain.field.store import open_store
from ...cbt_terrain.height_operators.shape_process import shape_store
from ...cbt_terrain.height_operators.tiles import whole_land
from ...cbt_terrain.importing.import_process import import_source
from ...cbt_terrain.rasters.raster import ImportSettings
from ...cbt_terrain.run import warmup
from ...cbt_terrain.terrain import Terrain
from ...cbt_terrain.view.camera_path import read_camera_path
from ...cbt_terrain.view.criterion import Criterion
from ..blender import need_bpy
from ..export.exporting import export_frames, make_folder, write_text
from ..export.frame_sources import StoreFrames
from ..text.console import Progress
from .page import write_page
from .stack import ISLAND_SEED, STACK

SIZE = 4097
FRAMES = range(1, 25)
PICTURE_FRAMES = (1, 12, 24)
LEVELS_FRAME = 12
RESOLUTION = (1280, 720)
PLAN_RESOLUTION = (1000, 1000)
ERROR_PX = 1.0
LEVELS_ERROR_PX = 6.0  # makes single triangles visible
# Relative durations of the steps, for the estimate of the time left.
WEIGHT = {"import": 8.0, "land": 15.0, "meshes": 10.0, "crops": 5.0, "maps": 14.0, "picture": 16.0, "levels": 8.0}
CROPS_PX = (4.0, 2.0, 1.0, 0.5)  # shown side by side on the page
FLIGHT = {
    "fov": 45,
    "clip": [1, 100000],
    "keyframes": [
        {"frame": 1, "eye": [-3500, -4700, 520], "target": [50, 0, 370]},
        {"frame": 12, "eye": [-3100, -1480, 840], "target": [200, 0, 410]},
        {"frame": 24, "eye": [1750, -4800, 220], "target": [520, 0, 450]},
    ],
}


def run(out: Path, show_progress: bool | None = None) -> None:
    """Import and shape the island, export a flight of 24 frames, render pictures, and write `index.html` into `out`.

    All other files are in `out`, too. The scene takes the place of Blender's open file. show_progress: whether there is
    a progress bar, None for one in a terminal only. Raises TerrainError.
    """
    need_bpy("The demo")
    make_folder(out)
    steps: dict[str, float] = {}
    weights = sum(WEIGHT.values()) + WEIGHT["picture"] * (len(PICTURE_FRAMES) - 1)

    def end_step(step: str, line: str, weight: float) -> None:
        """Record the seconds of a step, print a line about it and advance the bar by its weight."""
        steps[step] = time.perf_counter() - started - sum(steps.values())
        bar.say(f"{line} ({steps[step]:.1f} s)")
        bar.to(bar.done + weight)

    started = time.perf_counter()
    warmup.start()  # compile before any frame is timed
    with Progress(weights, "demo", show_progress) as bar:
        store = out / "store"
        import_source(ImportSettings(source="island", size=SIZE, seed=ISLAND_SEED), out / "source")
        warmup.wait()
        end_step("Import", f"source: the island, {SIZE} x {SIZE} samples", WEIGHT["import"])
        # A pixel of the flight covers 3 m or more. The finest level, of 2 m, would change heights by 1 m and take most
        # of the time: only levels 1 and coarser are shaped.
        coarse = whole_land(open_store(out / "source").lattice, finest=1)
        report = shape_store(out / "source", STACK, store, coarse)
        tiles = f"{report['tiles_built']} of {report['tiles_there_are']} tiles"
        end_step("Land", f"store: {', '.join(entry.name.lower() for entry in STACK.entries)}, {tiles}", WEIGHT["land"])
        summaries, criterion = _export_flight(out, store)
        triangles = [summary["terrains"][0]["triangles"] for summary in summaries]
        line = f"meshes: {len(FRAMES)} frames, {min(triangles):,} to {max(triangles):,} triangles"
        end_step(f"{len(FRAMES)} meshes", line, WEIGHT["meshes"])
        flight = read_camera_path(out / "flight.json")
        error_crops = crops(Terrain(open_store(store)), TimedFrame([flight.view(LEVELS_FRAME, RESOLUTION)]), CROPS_PX)
        end_step("Pictures of four errors", f"crops: {', '.join(f'{px:g}' for px in CROPS_PX)} px", WEIGHT["crops"])
        from ..session import session
        from . import scene as demo_scene

        scene, obj = demo_scene.build(out, store, flight, FRAMES, RESOLUTION, criterion)
        end_step("Maps and material", f"maps: {', '.join(demo_scene.MAPS)}", WEIGHT["maps"])
        pictures = [(frame, f"frame_{frame:02d}.png") for frame in PICTURE_FRAMES]
        effects = {}
        for frame, name in pictures:
            scene.frame_set(frame)
            effects[frame] = session.record_of(obj).status.effects
            demo_scene.render(scene, out / name)
            end_step(f"Picture of frame {frame}", name, WEIGHT["picture"])
        num_triangles = demo_scene.draw_levels(out, scene, obj, LEVELS_FRAME, LEVELS_ERROR_PX, PLAN_RESOLUTION)
        end_step("Pictures of the levels", "levels.png, plan.png", WEIGHT["levels"])
    write_page(
        out / "index.html",
        machine=f"{os.cpu_count()} processor threads, {platform.system()} {platform.machine()}",
        size=SIZE,
        resolution=RESOLUTION,
        error_px=ERROR_PX,
        summaries=summaries,
        pictures=pictures,
        crops=error_crops,
        effects=effects,
        levels={"frame": LEVELS_FRAME, "error_px": LEVELS_ERROR_PX, "triangles": num_triangles},
        steps=steps,
    )
    print(f"{out / 'index.html'} shows it, made in {sum(steps.values()):.0f} s")


def _export_flight(out: Path, store: Path) -> tuple[list[dict], Criterion]:
    """Write `flight.json` and the flight's meshes as .npz into `out`; return the summaries and the criterion."""
    flight = out / "flight.json"
    write_text(flight, json.dumps(FLIGHT, indent=1) + "\n")
    criterion = Criterion(error_px=ERROR_PX)
    source = StoreFrames(store, flight, criterion, RESOLUTION, in_blender=False)
    summaries = []
    export_frames(
        source, FRAMES, ["npz"], out / "meshes", on_frame=lambda frame, summary, skipped: summaries.append(summary)
    )
    return summaries, criterion
