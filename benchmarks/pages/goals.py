# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows with their goals, and the rule by which a quick run fails.

A new row needs an entry in ROWS and a measurement in suite.py.
"""

from dataclasses import dataclass, field

from ..rig.measure import BenchmarkRow

ANY_SIZE = 0
SLACK = 1.5
# A quick run fails if each of this many measurements of a row is worse than allowed.
ATTEMPTS = 3


@dataclass(frozen=True)
class RowGoal:
    """Description of a row in one sentence, and its ratios by size; smaller is better.

    Attributes:
        ratios: the goals.
        known: measured ratios of rows that miss their goals by SLACK or more, which may not become worse than SLACK
            times that.
    """

    sentence: str
    ratios: dict[int, float]
    known: dict[int, float] = field(default_factory=dict)


ROWS = {
    "refine_1t": RowGoal(
        "Refinement of flat ground, seen all around by a moving camera, for edges of equal length on screen, on one "
        "thread, against a complete rebuild of as many triangles in serial C.",
        {50_000: 2.2, 500_000: 0.35, 1_000_000: 0.25},
        {500_000: 0.68, 1_000_000: 0.38},
    ),
    "refine_2t": RowGoal(
        "The refinement of `refine_1t` on two threads against the same serial rebuild.",
        {500_000: 0.23, 1_000_000: 0.17},
        {500_000: 0.36, 1_000_000: 0.27},
    ),
    "refine_error": RowGoal(
        "Refinement of rough ground in a flight for an error on screen, on one thread, against a complete rebuild of "
        "as many triangles in serial C.",
        {ANY_SIZE: 0.3},
    ),
    "still": RowGoal(
        "An update with an unchanged camera, which finds that the mesh is up to date, against a complete rebuild in "
        "serial C.",
        {ANY_SIZE: 0.002},
    ),
    "surface": RowGoal(
        "A whole update in a flight over rough ground, to positions, normals and texture coordinates, on all threads, "
        "against a rebuild of the triangles alone in serial C.",
        {ANY_SIZE: 0.38},
        {ANY_SIZE: 0.57},
    ),
    "split_merge": RowGoal(
        "A pass of the classic concurrent update, in which every leaf splits or merges by one level, in a flight over "
        "rough ground, on one thread, against the walk that finds the same leaves in one call.",
        {ANY_SIZE: 12.0},
    ),
    "budget_flight": RowGoal(
        "Refinement in a flight under a triangle limit that is far too small for the requested error, search included, "
        "on one thread, against refinement for an error that fits.",
        {ANY_SIZE: 3.0},
    ),
    "morph_flight": RowGoal(
        "A whole update in a flight with *Geomorph*, on one thread, against one without for the same bound.",
        {ANY_SIZE: 2.5},
        {ANY_SIZE: 5.3},
    ),
    "hidden": RowGoal(
        "Triangles of the demo's flight where ground behind ridges may be 8 times coarser, against triangles without "
        "that.",
        {ANY_SIZE: 0.65},
    ),
    "effects_flight": RowGoal(
        "Seven attributes and twelve splat layers at all vertices in a flight, on all threads, against the update of "
        "the same frames.",
        {ANY_SIZE: 0.15},
        {ANY_SIZE: 0.37},
    ),
    "light_preview": RowGoal(
        "A first preview of sky light at all vertices, on all threads, against sky light in full.",
        {ANY_SIZE: 0.02},
    ),
    "land_rivers": RowGoal(
        "20,000 years of river erosion on 1,025 x 1,025 samples, on one thread, against fastscapelib.",
        {ANY_SIZE: 0.4},
    ),
    "land_scree": RowGoal(
        "A sweep of scree over 1,025 x 1,025 samples, on one thread, against numpy with equal bytes.",
        {ANY_SIZE: 0.06},
    ),
    "land_water": RowGoal(
        "Depth, speed and discharge of steady rain on 257 x 257 samples, on one thread, against an hour of rain "
        "simulated as shallow water by our own kernels.",
        {ANY_SIZE: 0.01},
    ),
    "scatter_flight": RowGoal(
        "The points of a scatter in the next frame of a flight, against the same points computed in numpy.",
        {ANY_SIZE: 0.1},
    ),
    "maps_normal": RowGoal(
        "A baked normal map of 2,048 x 2,048 texels in a PNG file, against differences in numpy with equal compression "
        "on one thread.",
        {ANY_SIZE: 1.0},
    ),
    "query_heights": RowGoal(
        "Heights, normals and slopes at a million points, on one thread, against heights alone in numpy.",
        {ANY_SIZE: 0.5},
    ),
    "fit_jacksboro": RowGoal(
        "Triangles of `bake --fit` on a real elevation model for a vertical error (error_m) that holds over the whole "
        "surface, against greedy Delaunay insertion (pydelatin), whose error holds at the samples.",
        {ANY_SIZE: 1.3},
    ),
    "cold_start": RowGoal(
        "Time from the start of Python to the first mesh of an existing store, with compiled kernels in the cache, "
        "against a limit of 1 s.",
        {ANY_SIZE: 1.0},
    ),
    "import": RowGoal(
        "Import of a GeoTIFF of 4,097 x 4,097 samples, 67 MB, in a child process, against a limit of 5 s.",
        {ANY_SIZE: 1.0},
    ),
    "import_mosaic": RowGoal(
        "Processor time of an import of 64 GeoTIFFs, side by side, against that of one file with the same samples.",
        {ANY_SIZE: 1.4},
    ),
    "import_large": RowGoal(
        "Import of a GeoTIFF of 16,385 x 16,385 samples, 1.07 GB, against the import of 4,097 x 4,097 samples times "
        "the ratio of their numbers.",
        {ANY_SIZE: 1.2},
    ),
    "large_frame": RowGoal(
        "An update in a flight over 16,385 x 16,385 samples, on all threads, against one with as many triangles over "
        "4,097 x 4,097.",
        {ANY_SIZE: 1.5},
    ),
    "large_memory": RowGoal(
        "Resident memory after these updates of 16,385 x 16,385 samples, against that of 4,097 x 4,097.",
        {ANY_SIZE: 2.0},
    ),
    "demand": RowGoal(
        "The search for attributes that a scene reads (the demo's sky and sea, a material of 20 nodes), so that unused "
        "effects cost nothing, against the update of a flight.",
        {ANY_SIZE: 0.02},
    ),
    "frame": RowGoal(
        "A frame in Blender, from the camera's motion to the evaluated mesh, against a plain script that writes a mesh "
        "of the same size.",
        {50_000: 1.0, 250_000: 0.5, 1_000_000: 0.17},
        {1_000_000: 0.28},
    ),
    "program_frame": RowGoal(
        "The row `frame` inside the Blender program named above, without a window, against the same plain script.",
        {ANY_SIZE: 0.35},
    ),
    "same_picture": RowGoal(
        "Processor time of a Cycles render of our mesh with a baked normal map, at the coarsest error (error_px) whose "
        "picture resembles that of the whole grid as much, against Cycles' adaptive dicing at 1 px.",
        {ANY_SIZE: 0.35},
    ),
    "same_picture_memory": RowGoal(
        "Peak memory of the same two renders above that of a render of a flat plane, against Cycles' adaptive dicing "
        "at 1 px.",
        {ANY_SIZE: 0.1},
        {ANY_SIZE: 0.24},
    ),
}


def goal_of(name: str, size: int) -> float | None:
    """Return the goal of a row, None if it has none."""
    return _ratio(ROWS[name].ratios, size) if name in ROWS else None


def known_ratio(name: str, size: int) -> float | None:
    """Return the known ratio of a row that misses its goal, None for others."""
    return _ratio(ROWS[name].known, size) if name in ROWS else None


def max_ratio(name: str, size: int) -> float | None:
    """Return the ratio above which a quick run fails, None for rows without a goal."""
    goal, known = goal_of(name, size), known_ratio(name, size)
    return None if goal is None else SLACK * max(goal, known or 0.0)


def excess(row: BenchmarkRow) -> float | None:
    """Return by which fraction a row misses its goal (0.3: 30 %), None if it has none or meets it."""
    goal = goal_of(row.name, row.size)
    if goal is None or row.ratio is None or row.ratio <= goal:
        return None
    return row.ratio / goal - 1


def failures(rows: list[BenchmarkRow]) -> list[BenchmarkRow]:
    """Return the rows that are worse than allowed."""
    limits = [(row, max_ratio(row.name, row.size)) for row in rows]
    return [row for row, limit in limits if limit is not None and row.ratio is not None and row.ratio > limit]


def _ratio(ratios: dict[int, float], size: int) -> float | None:
    return ratios.get(size, ratios.get(ANY_SIZE))
