# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of the engine alone, without Blender: refinement, surface, meshlets, a still camera, depth."""

import statistics
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial

from ...cbt_terrain.ask.criterion import Criterion
from ...cbt_terrain.ask.view import View
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.terrain import Terrain
from ..rig import scenes
from ..rig.baselines import ROAM, RoamRebuild
from ..rig.measure import BLOCKS, RUNS, Row, alternate, stopwatch

REFINE_SIZES = {1: (5_500, 50_000, 500_000, 1_000_000), 2: (500_000, 1_000_000)}
MILLION = 1_000_000
MESHLET = 4
ONCE = "one refinement"
DEPTHS, DEPTH_SIZE = (20, 24, 28, 32), 500_000
# So many triangles where an error so many times smaller than what fits is asked for.
BUDGET_SIZE, FINER = 300_000, 30
Update = Callable[[], dict[str, float]]  # makes one and returns the milliseconds of its steps
SURFACE_STEPS = ("weld", "meshlets", "displace")


def edge_flight(flat: HeightField, size: int, threads: int | None = None) -> scenes.Flight:
    """All round over flat ground, edges of one length on screen, to depth 27."""
    return scenes.Flight(flat, scenes.around, scenes.edges(_edge_px(flat, size)), threads)


@cache
def _edge_px(flat: HeightField, size: int) -> float:
    return scenes.pixels_for(flat, lambda _px: scenes.around(0), scenes.edges, size)


def error_flight(rough: HeightField, size: int, threads: int | None = None, meshlet: int = 0) -> scenes.Flight:
    """Through a lens over rough ground, one error on screen, with frustum and guard band."""
    return scenes.Flight(rough, scenes.over, scenes.errors(error_px(rough, size, meshlet), meshlet), threads)


@cache
def error_px(rough: HeightField, size: int, meshlet: int) -> float:
    """Pixels of error that give so many triangles where that flight begins."""
    return scenes.pixels_for(rough, lambda _px: scenes.over(0), partial(scenes.errors, meshlet=meshlet), size)


def refine_ms(steps: dict[str, float]) -> float:
    """The walk, which marks the tree."""
    return steps["refine"]


def refine_row(flat: HeightField, size: int, threads: int, roam: RoamRebuild | None) -> Row:
    return _refined(f"refine_{threads}t", size, edge_flight(flat, size, threads), roam)


def refine_error_row(rough: HeightField, roam: RoamRebuild | None) -> Row:
    return _refined("refine_error", MILLION, error_flight(rough, MILLION, 1), roam)


def _refined(name: str, size: int, flight: scenes.Flight, roam: RoamRebuild | None) -> Row:
    """`whole_ms` is all of the update but the surface: the refinement with what Python does around it."""
    timed = alternate(flight, roam.timer(size) if roam else None)
    whole = timed.ms["total"] - sum(timed.ms.get(step, 0.0) for step in SURFACE_STEPS)
    row = Row(name, size, refine_ms(timed.ms), ROAM, timed.baseline_ms, first_ms=refine_ms(timed.first_ms))
    row.figures = {"whole_ms": whole}
    row.steps = {step: ms for step, ms in timed.ms.items() if step not in (*SURFACE_STEPS, "total")}
    return row


def surface_row(rough: HeightField, roam: RoamRebuild | None) -> Row:
    """The whole update of a rough terrain, to arrays of positions, normals, texture coordinates and topology."""
    return _surfaced("surface", error_flight(rough, MILLION), roam)


def meshlets_row(rough: HeightField, roam: RoamRebuild | None) -> Row:
    return _surfaced("meshlets", error_flight(rough, MILLION, meshlet=MESHLET), roam)


def _surfaced(name: str, flight: scenes.Flight, roam: RoamRebuild | None) -> Row:
    timed = alternate(flight, roam.timer(MILLION) if roam else None)
    first_ms = timed.first_ms["total"]
    return Row(name, MILLION, timed.ms["total"], ROAM, timed.baseline_ms, first_ms=first_ms, steps=timed.ms)


def still_row(rough: HeightField, roam: RoamRebuild | None) -> Row:
    """An update with the same camera: how long it takes to know that the mesh may stay."""
    flight = error_flight(rough, MILLION)
    flight()

    def stay() -> dict[str, float]:
        views = [scenes.over(0)]  # equal, not the same object
        with stopwatch() as elapsed:
            update = flight.terrain.update(flight.criterion, views)
        if update.changed:
            raise TerrainError("A camera that did not move gave another mesh.")
        return {"total": elapsed[0]}

    timed = alternate(stay, roam.timer(MILLION) if roam else None)
    return Row("still", MILLION, timed.ms["total"], ROAM, timed.baseline_ms, first_ms=timed.first_ms["total"])


def budget_criteria(field: HeightField, view: View, asked: scenes.Asked) -> tuple[Criterion, Criterion]:
    """What is too fine for a triangle limit, and what keeps to it."""
    px = scenes.pixels_for(field, lambda _px: view, asked, BUDGET_SIZE) / FINER
    limited = replace(asked(px), max_triangles=BUDGET_SIZE)
    return limited, asked(px * Terrain(field, 1).update(limited, [view]).relaxed)


def budget_rows(rough: HeightField) -> Iterator[Row]:
    """An error over rough ground: first updates, and a flight."""
    limited, plain = budget_criteria(rough, scenes.over(0), scenes.errors)
    yield _budget_row("budget_first", *(_firsts(rough, scenes.over(0), asked) for asked in (limited, plain)))
    yield _budget_row("budget_flight", *(scenes.Flight(rough, scenes.over, asked, 1) for asked in (limited, plain)))


def budget_level_row(flat: HeightField) -> Row:
    """Edges over flat ground: first updates."""
    criteria = budget_criteria(flat, scenes.around(0), scenes.edges)
    return _budget_row("budget_level", *(_firsts(flat, scenes.around(0), asked) for asked in criteria))


def _firsts(field: HeightField, view: View, asked: Criterion) -> Update:
    return lambda: Terrain(field, 1).update(asked, [view]).ms


def _budget_row(name: str, limited: Update, plain: Update) -> Row:
    """Search and refinement, beside a refinement of the same leaves without a limit."""

    def searched() -> dict[str, float]:
        ms = limited()
        return {"budget": ms["budget"], "refine": ms["refine"]}

    timed = alternate(searched, lambda: plain()["refine"])
    return Row(name, BUDGET_SIZE, sum(timed.ms.values()), ONCE, timed.baseline_ms, steps=timed.ms)


def depth_row(flat: HeightField) -> Row:
    """The same leaves in trees of four depths."""
    return _depths("depth", {depth: flight_at(flat, DEPTHS[0], depth) for depth in DEPTHS})


def depth_reached_row(flat: HeightField) -> Row:
    """As many leaves, the finest of each tree at its depth."""
    return _depths("depth_reached", {depth: flight_at(flat, depth, depth) for depth in DEPTHS})


def _depths(name: str, flights: dict[int, scenes.Flight]) -> Row:
    """The slowest beside the fastest; all take turns, on one thread."""
    times: dict[int, list[float]] = {depth: [] for depth in flights}
    for flight in flights.values():
        flight()
    for _ in range(BLOCKS * RUNS):
        for depth, flight in flights.items():
            times[depth].append(refine_ms(flight()))
    medians = {depth: statistics.median(runs) for depth, runs in times.items()}
    row = Row(name, DEPTH_SIZE, max(medians.values()), "fastest depth", min(medians.values()))
    row.figures = {f"depth_{depth}_ms": ms for depth, ms in medians.items()}
    return row


def flight_at(flat: HeightField, reached: int, depth: int) -> scenes.Flight:
    """So low over the ground that the finest leaves just have `reached` bisections, in a tree of `depth`."""

    def asked(px: float):
        return scenes.edges(px, depth)

    def first(px: float):
        return scenes.around(0, scenes.height_reaching(reached, px))

    px = scenes.pixels_for(flat, first, asked, DEPTH_SIZE)
    height = scenes.height_reaching(reached, px)
    return scenes.Flight(flat, lambda frame: scenes.around(frame, height), asked(px), threads=1)
