# SPDX-License-Identifier: GPL-3.0-or-later
"""How results are shown: a line each, and JSON; performance_page.py makes the documents of them."""

import json
import os
import tempfile
from pathlib import Path

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run.owned_files import remove_file
from ...operators.text.numbers import number
from ..rig.measure import Row
from .goals import goal_of, missed_by

# What a reader of the page should know of each row.
MEANING = {
    "refine_1t": "The walk of the tree, tree marked; the camera moves by 0.1 % of the side a "
    "frame, all round over a flat 4097² field, edges of one length on screen, depth 27; one thread.",
    "refine_2t": "The same on two threads.",
    "refine_error": "Error on screen over a rough 4097² field, frustum and guard band on; one thread.",
    "still": "The same camera again: to know that nothing changed. No mesh is written.",
    "surface": "The whole update of the rough field: refine, weld, displace, normals, uv; all threads.",
    "meshlets": "As many triangles, 4⁴ for each leaf.",
    "ingest": "The arrays to an evaluated Blender mesh, with normals and two attributes.",
    "frame": "Camera moves to evaluated mesh, all that Blender does in between.",
    "frame_meshlets": "The same with 4⁴ triangles for each leaf.",
    "still_frame": "A frame change in Blender while the camera stands still; no mesh is written.",
    "demand": "Which attributes of the terrain's mesh the scene reads, found anew: the demo's sky and sea, a material "
    "of 20 nodes; beside the update of a flight.",
    "demand_large": "The same of a material of 200 nodes that reads 99 attributes.",
    "demand_kept": "The same while nothing has changed.",
    "effects_fused": "Height, slope, aspect, three curvatures and a normal of each vertex of the built-in island by "
    "one kernel, beside four; one thread.",
    "effects_cut": "These and twelve splat layers after the update to another view; all threads.",
    "effects_flight": "The same of a camera that moves on by 8 m; what stays is copied.",
    "effects_ingest": "One float of each vertex into Blender, beside the mesh.",
    "program_ingest": "ingest inside the Blender program that is named above, without a window. Before 4.5 Blender "
    "takes normals by corner only, and encodes them one by one: a million triangles took 608 ms in 4.3.2, 2.1 times "
    "the plain ingest, and a frame 638 ms.",
    "program_frame": "frame inside of it.",
    "program_frame_meshlets": "frame_meshlets inside of it.",
    "program_still_frame": "still_frame inside of it.",
    "depth": "refine_1t of the same leaves in trees of depth 20, 24, 28, 32: slowest beside fastest.",
    "depth_reached": "The same, each camera so low that its finest leaves reach that depth: other leaves, as many.",
    "budget_first": "An error 30 times too fine for a triangle limit: search and refinement of a first update, beside "
    "a refinement of the same leaves without a limit; rough 4097² field, one thread.",
    "budget_flight": "The same in a flight, beside one for the error that fits in its first frame; both take leaves "
    "from the last frame.",
    "budget_level": "As budget_first, of edges 30 times too short, all round over a flat 4097² field.",
    "splats": "Weights of twelve layers at the vertices of a million triangles, half of them with noise, beside the "
    "jets that their rules read; one thread.",
    "flow": "Catchment areas of 1025² samples, depressions cut through, several directions; beside the errors and "
    "ranges that an import makes of them; both by all threads.",
    "light_rays": "The sky from 300 vertices of the built-in island's mesh at 1 px, 16 azimuths each, by max mipmap, "
    "one thread: the same bits as with every crossing.",
    "light_preview": "The sky at all its vertices, first asked for: from coarse heights beside in full (four times "
    "a quarter of its azimuths), all threads.",
    "land_relief": "Fine relief of the built-in island, 1,025 x 1,025 samples, waves of 128 m and less led by slope "
    "and bend, beside numpy's plain octaves of the same noise; one thread.",
    "land_water": "Depth, speed and discharge of steady rain on the built-in island, 257 x 257 samples, beside an hour "
    "of rain marched as shallow water in our own vector rows; one thread.",
    "land_snow": "Snow of the built-in island, 257 x 257 samples: 14 horizons of each and 48 sweeps of slides, beside "
    "both by numpy's whole arrays; one thread.",
    "land_routing": "Receivers, depressions, order and areas of the same samples beside fastscapelib's; one thread.",
    "land_rivers": "A step of rivers of 20,000 years beside fastscapelib's, without creep and sediment; one thread.",
    "land_sediment": "The same step with sediment beside itself without.",
    "land_stack": "The demo's stack (uplift, rivers, frost, rock, water, snow) over the whole island: heights and "
    "layers, all threads; its steps are effects by level.",
    "land_demanded": "Relief on one tile of the island of 2,049 x 2,049 samples, with all that it starts from, beside "
    "relief on every tile. tiles, of: how many were made, of how many there are.",
    "land_scree": "A sweep of scree over the island, twice as steep, rock that breaks in beds and all, beside numpy's, "
    "to the same bytes; one thread.",
    "land_droplets": "500 droplets a square kilometre over the island; one thread. us_droplet: microseconds for each.",
    "scatter": "Points of a scatter on the rough field, one on 2.05 x 2.05 m up to 1,500 m from the camera, nothing "
    "known before, beside the same points by numpy's whole arrays. tested: candidates that were looked at.",
    "scatter_flight": "The same, of the next frame of the flight.",
    "hidden": "Triangles of the demo's flight at 1 px, 1920 x 1080, where hidden ground may be 8 times coarser, beside "
    "those of the same without; ms is an update's. map_ms: of it the map; low_ratio: 20 m above the ground.",
    "morph_flight": "An update whose points rise to their places (a morph of 1.5), beside one without for the same "
    "bound: in a flight over the rough 4097² field at a million triangles without; one thread.",
    "morph_cut": "The same after a cut to another view.",
    "maps_normal": "A map of the built-in island's normals, 2,048 texels a side, from heights to a complete PNG file, "
    "beside numpy's differences of the same raster, squeezed alike, on one thread.",
    "shading_error": "Lambert's shading of the built-in island at 1 px, 960 x 540, by its baked normal map: rms from "
    "the truth, beside that of normals at vertices; ms are the map's.",
    "shading_flicker": "How much more than the truth that picture changes from frame to frame.",
    "detail_from_air": "Triangles of the built-in island at 1 px with 5 cm of detail in waves of 4 m and less, beside "
    "those without, from over its rim; ms are of a first update.",
    "detail_from_ground": "The same from 2 m above the ground, where a pixel is some millimetres.",
    "detail_displace": "Displacement with nine octaves of detail beside without, all vertices anew, one thread.",
    "query_heights": "A million places of the built-in island in order: heights, normals, slopes; beside heights alone "
    "by numpy; one thread. ns_random: in random order.",
    "query_rays": "First hits of a camera's rays from 300 m over the island, 640 x 360; beside numpy's march by the "
    "side of a cell; one thread.",
    "query_sight": "Which samples within 500 m that eye sees, a line of sight each; one thread.",
    "fit_rough": "A static mesh for one vertical error (asked_m) whose vertices may leave the surface, `bake --fit`: "
    "513² samples of the rough field; beside greedy Delaunay insertion for the same error at the samples.",
    "fit_jacksboro": "The same of a real DEM, 321 x 385 samples 90 m apart.",
    "cold_start": "Python's start to the first mesh of a store, kernels compiled before.",
    "cold_start_no_cache": "The same with an empty kernel cache: everything is compiled.",
    "import": "A 4097² float32 GeoTIFF to a store with its error hierarchy, in the import's own process.",
    "import_reopen": "That store opened again; the goal is 50 ms.",
    "large_open": "A generated store of 16385² samples opened.",
    "large_frame": "Frames of it, beside the same number of triangles of 4097² samples; first: not in the file cache.",
    "large_memory": "Memory that stays resident after these frames, beside the same of 4097² samples.",
    "scale_refine": "Slope of time over triangles, logarithms of both; the time is of the largest size.",
    "scale_surface": "The same of surface.",
    "scale_ingest": "The same of ingest.",
    "scale_frame": "The same of frame.",
    "cycles_error": "A whole Cycles render, 960 x 540, 1 sample: our error at 1 px beside Cycles' dicing at 1 px. "
    "ssim: how like the picture is to that of the whole grid; cpu_s: processor seconds a frame.",
    "cycles_error_memory": "Peak memory of the two processes.",
    "same_picture": "The same of the built-in island, shaded by a baked map of its normals, at the coarsest error_px "
    "(in steps of a quarter octave) whose picture is as like that of the whole grid as dicing's, within an SSIM of "
    "0.002; ms are of processor time. Not in it: the map is baked once (bake_cpu_s), as the store is imported once.",
    "same_picture_memory": "Peak memory of the two processes above that of one that renders a flat plane. Ours has "
    "baked its map as well.",
    "same_picture_2px": "As same_picture, against dicing at 2 px.",
    "same_picture_2px_memory": "As same_picture_memory, against dicing at 2 px.",
    "same_picture_4px": "As same_picture, against dicing at 4 px.",
    "same_picture_4px_memory": "As same_picture_memory, against dicing at 4 px.",
}


def line(row: Row) -> str:
    """One row as the terminal shows it."""
    parts = [f"{row.name:20} {row.size:>11,}", f"{number(row.ms):>9} ms" if row.ms is not None else " " * 12]
    if row.ratio is not None:
        base = "" if row.baseline_ms is None else f"{number(row.baseline_ms)} ms"
        parts.append(f"{row.baseline:>14} {base:>11}  ratio {row.ratio:7.4f}")
    goal, missed = goal_of(row.name, row.size), missed_by(row)
    if goal is not None and row.ratio is not None:
        parts.append(f"goal {goal:g}: {'met' if missed is None else f'missed by {missed:.0%}'}")
    parts += [f"{name} {number(value)}" for name, value in row.figures.items()]
    if row.attempts > 1:
        parts.append(f"attempt {row.attempts}")
    return "  ".join(parts).rstrip()


def as_json(row: Row) -> dict:
    """The six keys of a result, its goal, and what else was measured."""
    content = {name: getattr(row, name) for name in ("name", "size", "ms", "baseline", "baseline_ms", "ratio")}
    content["goal"] = goal_of(row.name, row.size)
    extras = {"first_ms": row.first_ms, "steps": row.steps, "figures": row.figures}
    if row.attempts > 1:
        extras["attempts"] = row.attempts
    return content | {name: value for name, value in extras.items() if value}


def write_json(rows: list[Row], path: Path) -> None:
    text = json.dumps([as_json(row) for row in rows], indent=1, allow_nan=False)
    write_text(path, text + "\n")


def check_writable(path: Path) -> None:
    """Whether a file of that name can be written, folders above it included; raises TerrainError, leaves nothing."""
    existing = next(folder for folder in path.absolute().parents if folder.exists())
    try:
        if path.is_dir():
            raise IsADirectoryError(None, "it is a folder")
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as reason:
        raise _unwritable(path, reason) from reason


def write_text(path: Path, text: str) -> None:
    """All of the file or none of it; what is no plain file, like a pipe, is written into."""
    whole = path.is_file() or not path.exists()
    target = path.resolve() if whole else path
    part = target.with_name(f".{target.name}.{os.getpid()}") if whole else path
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.write_text(text, encoding="utf-8")
            if whole:
                part.replace(target)
        finally:
            if whole:
                remove_file(part, may_be_link=True)
    except OSError as reason:
        raise _unwritable(path, reason) from reason


def _unwritable(path: Path, reason: OSError) -> TerrainError:
    return TerrainError(f"{path} cannot be written ({reason.strerror}); choose another name.")
