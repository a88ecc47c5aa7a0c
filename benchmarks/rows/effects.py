# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of effects at the vertices of a million triangles of the built-in island."""

import statistics
from collections.abc import Callable, Iterator
from functools import cache

import numpy as np

from ...cbt_terrain.ask.view import View
from ...cbt_terrain.effects.effect import Asked, Places
from ...cbt_terrain.effects.jet import make
from ...cbt_terrain.effects.pyramid import ground
from ...cbt_terrain.effects.splat import SPLATS
from ...cbt_terrain.evaluate.evaluate import Evaluator
from ...cbt_terrain.evaluate.plan import plan
from ...cbt_terrain.evaluate.scale import footprint_levels
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.terrain import Terrain
from ..rig import scenes
from ..rig.measure import BLOCKS, Row, alternate, runs_of, stopwatch
from .in_blender import flight_scene, new_object

MILLION = 1_000_000
APART = (
    ("detail_normal",),
    ("slope", "aspect"),
    ("mean_curvature", "profile_curvature", "plan_curvature"),
    ("height",),
)
TOGETHER = tuple(name for names in APART for name in names)
UPDATE = "the engine's update of the same frames"
EYES = (np.array([1500.0, -2300.0, 420.0]), np.array([-2600.0, 900.0, 700.0]))
FLIGHT_M = 8.0  # a frame


def ground_of_island() -> HeightField:
    field = scenes.built_in_island()
    ground(field, 1.0, 0.0, 1)  # made once for a store
    return field


def seen(eye: np.ndarray) -> View:
    return View.look(eye, (0, 0, 100.0))


def asked_px() -> float:
    return _px_for(ground_of_island(), MILLION)


@cache
def _px_for(field: HeightField, triangles: int) -> float:
    return scenes.pixels_for(field, lambda _px: seen(EYES[0]), scenes.errors, triangles)


def fused_row() -> Row:
    """Everything that a jet gives by one kernel, beside four; one thread."""
    field, view = ground_of_island(), seen(EYES[0])
    positions = Terrain(field).update(scenes.errors(asked_px()), [view]).surface.positions
    places = Places(field, positions, footprint_levels(field, positions, [view]))

    def ms(groups) -> float:
        with stopwatch() as elapsed:
            for names in groups:
                make(places, dict.fromkeys(names, {}), {})
        return elapsed[0]

    timed = alternate(lambda: {"total": ms([TOGETHER])}, lambda: ms(APART))
    return Row("effects_fused", MILLION, timed.ms["total"], "four kernels", timed.baseline_ms)


def frames_rows() -> Iterator[Row]:
    """Everything that a jet gives and twelve splat layers, beside the update that it follows: at cuts, in a flight."""
    px, ahead = asked_px(), (EYES[1] - EYES[0]) / np.sqrt(((EYES[1] - EYES[0]) ** 2).sum())
    yield _frames_row("effects_cut", px, lambda frame: EYES[frame % 2])
    yield _frames_row("effects_flight", px, lambda frame: EYES[0] + ahead * FLIGHT_M * frame)


def _frames_row(name: str, px: float, eye: Callable[[int], np.ndarray]) -> Row:
    field = ground_of_island()
    terrain = Terrain(field)
    evaluator = Evaluator(terrain.threads)
    wanted = plan([Asked(effect, ("benchmark",)) for effect in (*TOGETHER, *(splat.name for splat in SPLATS))])
    updates, effects, computed = [], [], []

    def next_frame() -> None:
        views = [seen(eye(len(effects)))]
        with stopwatch() as updated:
            surface = terrain.update(scenes.errors(px), views).surface
        with stopwatch() as evaluated:
            evaluator.attributes(wanted, field, surface, views)
        updates.append(updated[0])
        effects.append(evaluated[0])
        computed.append(evaluator.ran["slope"].computed / len(surface.positions))

    next_frame()
    next_frame()
    for _ in range(BLOCKS * runs_of(max(updates[1], effects[1]))):
        next_frame()
    ms, baseline = (statistics.median(times[2:]) for times in (effects, updates))
    row = Row(name, MILLION, ms, UPDATE, baseline, first_ms=effects[0])
    row.figures = {"computed_part": statistics.median(computed[2:])}
    return row


def ingest_row() -> Row:
    """One FLOAT attribute of the vertices, beside the whole mesh."""
    from ...operators.mesh.writer import write_mesh

    flight_scene()
    obj = new_object("Terrain")
    field, view = ground_of_island(), seen(EYES[0])
    surface = Terrain(field).update(scenes.errors(asked_px()), [view]).surface
    values = np.ascontiguousarray(surface.positions[:, 2])

    def written() -> dict[str, float]:
        with stopwatch() as elapsed:
            obj.data.attributes["height"].data.foreach_set("value", values)
        return {"total": elapsed[0]}

    def whole() -> float:
        with stopwatch() as elapsed:
            write_mesh(obj.data, surface)
        obj.data.attributes.new("height", "FLOAT", "POINT")
        return elapsed[0]

    whole()
    timed = alternate(written, whole)
    return Row("effects_ingest", MILLION, timed.ms["total"], "the mesh of the same", timed.baseline_ms)
