# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of the engine without Blender: refinement, the whole update, a camera at rest, a triangle limit, geomorphing."""

from dataclasses import replace
from functools import cache

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.terrain import Terrain
from ...cbt_terrain.view.criterion import Criterion
from ...cbt_terrain.view.morph import SMOOTH
from ..rig import scenes
from ..rig.baselines import ROAM, RoamRebuild
from ..rig.measure import BenchmarkRow, alternate, stopwatch
from ..rig.scenes import MILLION

# Row to threads and triangles.
REFINE_SIZES = {"refine_1t": (1, (50_000, 500_000, MILLION)), "refine_2t": (2, (500_000, MILLION))}
# The requested error is FINER times smaller than the error that fits into BUDGET_SIZE triangles.
BUDGET_SIZE, FINER = 300_000, 30
SURFACE_STEPS = ("weld", "displace")
MORPH_FRAMES = 0.25  # frames of the usual flight in one frame of `morph_flight`


def edge_flight(flat: HeightField, size: int, threads: int | None = None) -> scenes.TimedFlight:
    """Return a panoramic flight over flat ground for edges of one length on screen."""
    return scenes.TimedFlight(flat, scenes.around, scenes.edges(_edge_px(flat, size)), threads)


@cache
def _edge_px(flat: HeightField, size: int) -> float:
    return scenes.pixels_for(flat, scenes.around(0), scenes.edges, size)


def error_flight(rough: HeightField, size: int, threads: int | None = None) -> scenes.TimedFlight:
    """Return a flight over rough ground for one error on screen."""
    return scenes.TimedFlight(rough, scenes.over, scenes.errors(error_px(rough, size)), threads)


@cache
def error_px(rough: HeightField, size: int) -> float:
    """Return the error in pixels that gives about `size` triangles in the first frame of that flight."""
    return scenes.pixels_for(rough, scenes.over(0), scenes.errors, size)


def refine_ms(steps: dict[str, float]) -> float:
    """Return the time of the walk and of writing the tree."""
    return steps["refine"] + steps.get("tree", 0.0)


def refine_row(name: str, flat: HeightField, size: int, roam: RoamRebuild | None) -> BenchmarkRow:
    """Measure refinement for edge lengths on the threads that REFINE_SIZES gives for this row."""
    threads, _ = REFINE_SIZES[name]
    return _refinement_row(name, size, edge_flight(flat, size, threads), roam)


def refine_error_row(rough: HeightField, roam: RoamRebuild | None) -> BenchmarkRow:
    """Measure refinement for an error on screen, on one thread."""
    return _refinement_row("refine_error", MILLION, error_flight(rough, MILLION, 1), roam)


def _refinement_row(name: str, size: int, flight: scenes.TimedFlight, roam: RoamRebuild | None) -> BenchmarkRow:
    timed = alternate(flight, roam.timer(size) if roam else None)
    row = BenchmarkRow(name, size, refine_ms(timed.ms), ROAM, timed.baseline_ms, first_ms=refine_ms(timed.first_ms))
    row.steps = {step: ms for step, ms in timed.ms.items() if step not in (*SURFACE_STEPS, "total")}
    return row


def surface_row(rough: HeightField, roam: RoamRebuild | None) -> BenchmarkRow:
    """Measure the whole update, from the camera to positions, normals, texture coordinates and topology."""
    timed = alternate(error_flight(rough, MILLION), roam.timer(MILLION) if roam else None)
    first_ms = timed.first_ms["total"]
    return BenchmarkRow(
        "surface", MILLION, timed.ms["total"], ROAM, timed.baseline_ms, first_ms=first_ms, steps=timed.ms
    )


def still_row(rough: HeightField, roam: RoamRebuild | None) -> BenchmarkRow:
    """Measure an update with an unchanged camera, which finds that the mesh is up to date."""
    flight = error_flight(rough, MILLION)
    flight()

    def stay() -> dict[str, float]:
        views = [scenes.over(0)]  # equal to the last view, but another object
        with stopwatch() as elapsed:
            update = flight.terrain.update(flight.criterion, views)
        if update.changed:
            raise TerrainError("A camera that did not move gave another mesh")
        return {"total": elapsed[0]}

    timed = alternate(stay, roam.timer(MILLION) if roam else None)
    return BenchmarkRow("still", MILLION, timed.ms["total"], ROAM, timed.baseline_ms, first_ms=timed.first_ms["total"])


def budget_flight_row(rough: HeightField) -> BenchmarkRow:
    """Measure search and refinement under a triangle limit, against refinement for the error that just fits."""
    limited, fitting = budget_criteria(rough)
    flights = [scenes.TimedFlight(rough, scenes.over, criterion, 1) for criterion in (limited, fitting)]

    def search() -> dict[str, float]:
        ms = flights[0]()
        return {"budget": ms["budget"], "refine": refine_ms(ms)}

    timed = alternate(search, lambda: refine_ms(flights[1]()))
    ms = sum(timed.ms.values())
    return BenchmarkRow("budget_flight", BUDGET_SIZE, ms, "one refinement", timed.baseline_ms, steps=timed.ms)


def budget_criteria(rough: HeightField) -> tuple[Criterion, Criterion]:
    """Return a criterion held back by a triangle limit, and one of the error that the limit leads to."""
    px = scenes.pixels_for(rough, scenes.over(0), scenes.errors, BUDGET_SIZE) / FINER
    limited = replace(scenes.errors(px), max_triangles=BUDGET_SIZE)
    relaxed = Terrain(rough, 1).update(limited, [scenes.over(0)]).relaxed
    return limited, scenes.errors(px * relaxed)


def morph_flight_row(rough: HeightField) -> BenchmarkRow:
    """Measure whole updates with geomorphing against updates without it for the same bound."""
    plain = scenes.errors(error_px(rough, MILLION))
    criteria = (replace(plain, morph=SMOOTH), plain)
    morphing, sudden = (
        scenes.TimedFlight(rough, lambda frame: scenes.over(MORPH_FRAMES * frame), criterion, threads=1)
        for criterion in criteria
    )
    timed = alternate(morphing, lambda: sudden()["total"])
    return BenchmarkRow("morph_flight", MILLION, timed.ms["total"], "without", timed.baseline_ms, steps=timed.ms)
