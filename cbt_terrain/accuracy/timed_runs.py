# SPDX-License-Identifier: GPL-3.0-or-later
"""Times of updates while a camera moves a little each frame: with warm memory, and with reuse of the last frame.

Runs are compared by the processor time of all threads of this process: other programs lengthen the elapsed time of a
run by any factor, its processor time by little. The fastest run is the one that was disturbed least.
"""

import dataclasses
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..mesh.attributes import Attribute
from ..mesh.surface import Surface
from ..plain_numbers import keep_plain_numbers
from ..view.criterion import Criterion
from ..view.linear import length
from ..view.view import View, listed_views

if TYPE_CHECKING:
    from ..terrain import Terrain

# A time is that of the fastest of this many runs, after one that finds cold memory; of several frames FRAME_RUNS each.
RUNS, FRAME_RUNS = 5, 3
# Where an update takes less than SHORT_MS, a run is the mean of this many.
SHORT_UPDATES, SHORT_MS = 3, 5.0
# How far the camera moves between runs, and heights where that changes no leaf, as parts of the terrain's size.
MOVE, NUDGE = 1e-3, 1e-6


@dataclass(frozen=True, eq=False)
class TimedFrame:
    """The arguments of `Terrain.update` for one frame.

    `views`: cameras. `placement`: float64 [4, 4], terrain to world, None for the identity. Heights become `height *
    vertical_scale + vertical_offset` metres. `after`: the frame that follows it, to measure popping between the two.
    """

    views: tuple[View, ...] = ()
    placement: np.ndarray | None = None
    vertical_scale: float = 1.0
    vertical_offset: float = 0.0
    after: "TimedFrame | None" = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "views", tuple(listed_views(self.views)))
        keep_plain_numbers(self, "The frame's")

    @property
    def placement_and_heights(self) -> tuple:
        """Return placement, vertical scale and vertical offset: the arguments of `Terrain.update` after the views."""
        return self.placement, self.vertical_scale, self.vertical_offset


def timed_runs(
    terrain: "Terrain",
    criterion: Criterion,
    frame: TimedFrame,
    count: int = RUNS,
    write: Callable[[Surface], float] | None = None,
    effects: Callable[[Surface, Sequence[View]], dict[str, Attribute]] | None = None,
) -> list[dict[str, float]]:
    """Return the milliseconds of each step, by name, for `count` runs. A run is one update, or the mean of short ones.

    terrain: updated by `criterion` for the views, placement and vertical scale of `frame`, again and again.

    Names are those of the update's steps and "total" of it; "effects", the time of making attributes; "ingest", the
    time that `write` returns; "cpu", the processor time of all threads to the finished mesh. effects(surface, views):
    returns the attributes of a surface, None for none. write(surface): copies a surface, with these attributes, to its
    user, None to leave that out.

    The camera is a little to the right of its position, then to the left, and so on; where that changes no leaf,
    heights move instead.
    """
    field, lattice, scale = terrain.field, terrain.field.lattice, frame.vertical_scale
    diagonal = length(((lattice.width - 1) * lattice.step_x, (lattice.height - 1) * lattice.step_y))
    # World metres of a metre along the terrain's x axis.
    world_scale = 1.0 if frame.placement is None else length(np.asarray(frame.placement)[:3, 0])
    step = MOVE * diagonal * world_scale  # of the camera, world metres
    # Of heights, metres; at least NUDGE of a metre, so that it is above 0 for a flat terrain at sea level.
    nudge = NUDGE * max((field.max_height - field.min_height) * abs(scale), abs(frame.vertical_offset), 1.0)
    updates: list[dict[str, float]] = []
    side, update, surface = 1, None, None
    while len(updates) <= count * _updates_a_run(updates):  # one more, since the first finds cold memory
        side = -side
        views = [_move_right(view, side * step) for view in frame.views]
        update = surface = None  # the memory of the last run is free for this one
        start_cpu = cpu_ms()
        update = terrain.update(criterion, views, *frame.placement_and_heights)
        if not update.changed:
            update, offset = None, frame.vertical_offset + side * nudge  # the old mesh's memory is free for the new one
            start_cpu = cpu_ms()
            update = terrain.update(criterion, views, frame.placement, scale, offset)
        updates.append(dict(update.ms))
        surface = update.surface
        if effects is not None:
            start = time.perf_counter()
            surface = surface.with_attributes(effects(surface, views))
            updates[-1]["effects"] = (time.perf_counter() - start) * 1e3
        if write is not None:
            updates[-1]["ingest"] = write(surface)
        updates[-1]["cpu"] = cpu_ms() - start_cpu
    per_run = _updates_a_run(updates)
    warm = updates[1:]
    return [_combine_steps(warm[first : first + per_run], statistics.fmean) for first in range(0, len(warm), per_run)]


def _updates_a_run(updates: list[dict[str, float]]) -> int:
    """Return how many updates make one timed run: several if one is too short for the clock. updates: step times."""
    return SHORT_UPDATES if updates and updates[0]["total"] < SHORT_MS else 1


def cpu_ms() -> float:
    """Return the processor time of this process so far; elapsed time where the system counts it too coarsely."""
    is_fine = time.get_clock_info("process_time").resolution < 1e-4
    return (time.process_time() if is_fine else time.perf_counter()) * 1e3


def fastest_run(runs: list[dict[str, float]]) -> dict[str, float]:
    """Return the step times of the run with the least processor time, "cpu"."""
    return min(runs, key=lambda run: run["cpu"])


def median_by_step(runs: list[dict[str, float]]) -> dict[str, float]:
    """Return the median of each step; a step that a run did not take took it no time."""
    return _combine_steps(runs, statistics.median)


def _combine_steps(runs: list[dict[str, float]], mean: Callable) -> dict[str, float]:
    """Return one time for each step, combined over all runs by `mean` (of a list of ms); a missing step counts as 0."""
    steps = dict.fromkeys(step for run in runs for step in run)
    return {step: mean([run.get(step, 0.0) for run in runs]) for step in steps}


def ms_to_finished_mesh(ms: dict[str, float]) -> float:
    """Return the milliseconds from the request to the finished mesh: update, effects and transfer into Blender."""
    return ms["total"] + ms.get("effects", 0.0) + ms.get("ingest", 0.0)


def _move_right(view: View, metres: float) -> View:
    """Return the view moved to its right by `metres` of the world, as a camera that flies."""
    matrix = view.world_to_camera.copy()
    matrix[0, 3] -= metres
    return dataclasses.replace(view, world_to_camera=matrix)
