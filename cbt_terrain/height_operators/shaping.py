# SPDX-License-Identifier: GPL-3.0-or-later
"""One application of a stack over all levels: its plan, its progress, and what each operator added."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..field.heightfield import HeightField
from .level_plan import LevelPlan
from .stack import Entry
from .tile_cache import TileCache
from .tiles import Level, Wanted, levels_of


class Finished(Exception):
    """The caller needs no further levels."""


@dataclass(frozen=True)
class Added:
    """The difference of one operator at one level to its interpolated coarser level, over the computed tiles.

    Its root mean square and largest absolute value are `rms_m` and `max_m`.
    """

    level: int
    spacing_m: float
    entry: int  # index among the active entries
    effect: str  # name of the operator
    rms_m: float
    max_m: float
    whole: bool  # computed in one piece, not in tiles
    pieces: int  # that the operator worked on, of which `computed` were not cached
    computed: int
    ms: float  # of work on this operator
    doubtful: bool = False  # computed in tiles although these differ too much from the level in one piece
    planned_ms: float = 0.0  # that the plan expected on one thread


@dataclass(eq=False)
class Shaping:
    """One application of a stack to a raster: its input, its plan, and the statistics and progress so far."""

    heights: HeightField
    entries: Sequence[Entry]  # the active ones
    images: Mapping[str, np.ndarray]  # of masks, by file name
    wanted: Wanted  # requested tiles of each level
    cache: TileCache
    threads: int
    on_progress: Callable[[float, str], None] = lambda _fraction, _message: None
    finish: Callable[[], bool] = lambda: False  # returns True if the caller needs no finer level
    added: list[Added] = field(default_factory=list)
    done: float = 0.0  # planned nanoseconds of the finished work

    def __post_init__(self) -> None:
        self.plan = LevelPlan(levels_of(self.heights.lattice), self.entries, self.wanted)
        self.tiles: list[list[int]] = [[] for _ in self.plan.levels]  # computed ones, by level

    @property
    def depths(self) -> set[str]:
        """Return the names of the layers that are depths in metres, whose values add up."""
        return {layer.name for entry in self.entries for layer in entry.declaration.layers if layer.adds_up}

    def progress(self, cost: float, level: Level, entry: Entry) -> Callable[[float], None]:
        """Return a function that an operator calls with its finished fraction.

        cost: nanoseconds of its work. level, entry: what is computed, for the message.
        """

        def report(fraction: float) -> None:
            """Add the fraction of this operator to the progress. Raises Finished if the user ends the work early."""
            if level is not self.plan.levels[-1] and self.finish():  # the coarsest level is always computed
                raise Finished
            total = max(self.plan.total, 1.0)
            text = f"{entry.declaration.label}, {level.columns} x {level.rows}"
            self.on_progress(min((self.done + min(max(fraction, 0.0), 1.0) * cost) / total, 1.0), text)

        return report
