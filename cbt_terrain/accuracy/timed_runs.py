# SPDX-License-Identifier: GPL-3.0-or-later
"""How long an update takes while a camera moves a little each frame: warm memory, and what the last frame leaves."""

import dataclasses
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..ask.criterion import Criterion
from ..ask.linear import length
from ..ask.view import View, listed_views
from ..mesh.attributes import Attribute
from ..mesh.surface import Surface
from ..plain_numbers import keep_plain_numbers
from ..terrain import Terrain

# A time is the median of this many runs, after one that finds cold memory; of more where a run is short.
RUNS, SHORT_RUNS, SHORT_MS = 5, 15, 5.0
# How far the camera moves between runs, and heights where that changes no leaf, as parts of the terrain's size.
MOVE, NUDGE = 1e-3, 1e-6


@dataclass(frozen=True, eq=False)
class Frame:
    """What one frame is refined for; arguments as of `Terrain.update`. `after`: the frame that follows it, to see what
    pops between the two."""

    views: Iterable[View] = ()
    placement: np.ndarray | None = None
    vertical_scale: float = 1.0
    vertical_offset: float = 0.0
    after: "Frame | None" = None

    def __post_init__(self):
        object.__setattr__(self, "views", listed_views(self.views))
        keep_plain_numbers(self, "The frame's")

    @property
    def heights(self) -> tuple:
        return self.placement, self.vertical_scale, self.vertical_offset


def timed_runs(
    terrain: Terrain,
    criterion: Criterion,
    frame: Frame,
    count: int = RUNS,
    write: Callable[[Surface], float] | None = None,
    effects: Callable[[Surface, Sequence[View]], dict[str, Attribute]] | None = None,
) -> list[dict[str, float]]:
    """Milliseconds by step of `count` updates, more where they are short; "ingest" are those that `write` says it took,
    "effects" those of making the attributes that it then writes too.

    The camera stands a little to the right of its place, then to the left, and so on; where that changes no leaf,
    heights move instead.
    """
    field, lattice, scale = terrain.field, terrain.field.lattice, frame.vertical_scale
    diagonal = length(((lattice.width - 1) * lattice.step_x, (lattice.height - 1) * lattice.step_y))
    step = MOVE * diagonal * _stretch(frame.placement)
    nudge = NUDGE * max((field.max_height - field.min_height) * abs(scale), abs(frame.vertical_offset), 1.0)
    runs, side = [], 1
    while len(runs) <= (count if not runs or runs[0]["total"] > SHORT_MS else SHORT_RUNS):
        side = -side
        views = [_moved(view, side * step) for view in frame.views]
        update = terrain.update(criterion, views, *frame.heights)
        if not update.changed:
            offset = frame.vertical_offset + side * nudge
            update = terrain.update(criterion, views, frame.placement, scale, offset)
        runs.append(dict(update.ms))
        surface = update.surface
        if effects is not None:
            start = time.perf_counter()
            surface = surface.with_attributes(effects(surface, views))
            runs[-1]["effects"] = (time.perf_counter() - start) * 1e3
        if write is not None:
            runs[-1]["ingest"] = write(surface)
    return runs[1:]  # the first found memory that was cold


def median_by_step(runs: list[dict[str, float]]) -> dict[str, float]:
    """A step that a run did not take took it no time."""
    steps = dict.fromkeys(step for run in runs for step in run)
    return {step: statistics.median(run.get(step, 0.0) for run in runs) for step in steps}


def to_finished_mesh(ms: dict[str, float]) -> float:
    """Milliseconds of all steps that come one after the other."""
    return ms["total"] + ms.get("effects", 0.0) + ms.get("ingest", 0.0)


def _moved(view: View, metres: float) -> View:
    """The view from further to its right."""
    matrix = view.world_to_camera.copy()
    matrix[0, 3] -= metres
    return dataclasses.replace(view, world_to_camera=matrix)


def _stretch(placement: np.ndarray | None) -> float:
    """World metres of a metre of the terrain's plane."""
    return 1.0 if placement is None else length(np.asarray(placement)[:3, 0])
