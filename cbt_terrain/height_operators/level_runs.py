# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs of entries at one level: one operator over the whole level, or several in each tile.

An *entry* is an operator of the stack with its parameters, numbered by its index. Its change is a list of arrays:
heights, layers and, except at level 0, state for the next finer level. `land` has the result of all entries so far: the
sum of their changes of heights (`total`) and their layers, in a window of the level. Tiles are blended into the
interpolated change of the coarser level, over BAND samples on both sides of their borders.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from .level_plan import TILES, UPSAMPLED, WHOLE
from .level_work import (
    Arrays,
    LandWindow,
    LevelWork,
    apply_tile,
    apply_whole,
    num_arrays,
    unpacked,
    within,
)
from .levels import finer, finer_window
from .shaping import Shaping
from .stack import Entry
from .tiles import BAND, Level, Window


@dataclass(eq=False)
class TileSums:
    """Statistics of the changes of an entry at a level, by tile."""

    max_change: np.ndarray  # float64 [tiles], largest change in metres
    mean_square: np.ndarray  # float64 [tiles], metres squared
    unmasked: np.ndarray  # bool [tiles], whether the mask is not 0 everywhere
    computed: int = 0  # pieces that were not cached
    ms: float = 0.0  # spent on these pieces, and planned for them
    planned_ms: float = 0.0

    @classmethod
    def zeros(cls, level: Level) -> "TileSums":
        """Return the sums of a level without changes."""
        count = level.tile_count
        return cls(np.zeros(count), np.zeros(count), np.zeros(count, bool))

    def add(self, level: Level, tile: int, delta: np.ndarray, mask: np.ndarray | None, window: Window) -> None:
        """Record the masked change of a tile. delta, mask: change in metres and weights in a window around it.

        The change is that of the entry beyond its interpolated coarser one. mask: None for weights of 1.
        """
        inner = within(level.window(tile), window)
        change = delta[inner] if mask is None else delta[inner] * mask[inner]
        self.max_change[tile] = np.abs(change).max()
        self.mean_square[tile] = np.square(change, dtype=np.float64).mean()
        # Wider than the tile, as its result is blended with those of its neighbours.
        self.unmasked[tile] = mask is None or mask[within(level.window(tile, BAND, BAND), window)].any()


@dataclass(frozen=True, eq=False)
class LevelRun:
    """A run of entries (LevelPlan.runs) at a level.

    `shaping`: the whole application. `work`: input that all entries share at the level. `numbers`: the entries, by
    index; a single one if it is applied to the whole level. `coarse`: each entry's change at the coarser level, None at
    the coarsest.
    """

    shaping: Shaping
    work: LevelWork
    numbers: list[int]
    coarse: Sequence[Arrays | None]

    def apply(self, tiles: list[int], land: LandWindow) -> tuple[Sequence[Arrays], list[TileSums]]:
        """Apply the run's entries to the level, add their changes to `land`, and return changes and statistics.

        Changes of level 0 are not returned for a run in tiles, since no finer level reads them. tiles: tiles to
        compute, unless the run is applied to the whole level. land: the land of the whole level. Raises Finished if the
        caller needs no finer levels.
        """
        entry = self.shaping.entries[self.numbers[0]]
        if self.shaping.plan.how(self.numbers[0], self.work.level) != WHOLE:
            return self._apply_to_tiles(tiles, land)
        sums, level, coarser = TileSums.zeros(self.work.level), self.work.level, self.coarse[0]
        mask, cost = self.work.mask(entry, land), self.shaping.plan.cost(entry, level.whole)
        report = self.shaping.progress(cost, level, entry)
        report(0.0)
        start = None if coarser is None else _upsample(coarser, level.shape)
        with _counted(self.shaping, entry, sums, cost):
            change = apply_whole(self.work, entry, land, mask, start, report)
        self.shaping.done += cost
        # If the change contradicts the interpolated coarser one, finer levels are computed in one piece.
        if start is not None and level.number and self.numbers[0] not in self.shaping.plan.doubted:
            before, after = (unpacked(entry.declaration, arrays) for arrays in (start, change))
            if entry.declaration.doubts(before, after, level.step_x * level.step_y):
                self.shaping.plan.doubt(self.numbers[0])
        delta = change[0] if start is None else change[0] - start[0]  # of heights, the first array
        for tile in range(level.tile_count):
            sums.add(level, tile, delta, mask, level.whole)
        land.total += self.work.accumulate(entry, change, mask, land)
        return [change], [sums]

    def _apply_to_tiles(self, tiles: list[int], land: LandWindow) -> tuple[Sequence[Arrays], list[TileSums]]:
        """Apply the entries to tiles, blend these into the interpolated coarser level, and update `land`.

        Return each entry's change, none at level 0, and its statistics by tile. tiles: those to compute. The land after
        all entries is blended, not each change, so that depths that are nowhere negative stay so.
        """
        level, first_mask, changes = self.work.level, None, []
        start = land.crop(level.whole)  # the land before the run, as `land` is updated below
        for number, arrays in zip(self.numbers, self.coarse, strict=True):
            entry = self.shaping.entries[number]
            assert arrays is not None  # the coarsest level is computed as a whole
            mask, count = self.work.mask(entry, land), num_arrays(entry.declaration, level)
            change = [finer(array, level.shape) for array in arrays[:count]]  # `count` omits the state at level 0
            # Only the first entry's mask may read the whole level, so it alone is reused for tiles (`_compute_tile`).
            first_mask = mask if number == self.numbers[0] else first_mask
            # Add the interpolated change to the land, as if no tile were computed: `accumulate` adds the layers and
            # returns the masked heights.
            land.total = land.total + self.work.accumulate(entry, change, mask, land)
            changes += [change] if level.number else []  # no finer level reads those of level 0
        sums = [TileSums.zeros(level) for _ in self.numbers]
        if all(self.shaping.plan.how(number, level) == UPSAMPLED for number in self.numbers):
            return changes, sums
        coarse_weight = np.ones(level.shape, np.float32)  # weight of the interpolated coarser level
        for tile in tiles:
            coarse_weight[level.window(tile, BAND, BAND)] -= level.weights(tile)
        names = {layer.name for number in self.numbers for layer in self.shaping.entries[number].declaration.layers}
        # Copies, since changes may share the arrays.
        land.layers |= {name: land.layers[name] * coarse_weight for name in names}
        for array in (land.total, *(array for change in changes for array in change)):
            array *= coarse_weight
        for tile in tiles:
            window, weights = level.window(tile, BAND, BAND), level.weights(tile)
            tile_changes, tile_land = self._compute_tile(tile, start, first_mask, sums)
            land.total[window] += tile_land.total * weights
            for name in names:
                land.layers[name][window] += tile_land.layers[name] * weights
            for change, tile_change in zip(changes, tile_changes if changes else (), strict=True):
                for array, tile_array in zip(change, tile_change, strict=True):
                    array[window] += tile_array * weights
        return changes, sums

    def _compute_tile(
        self, tile: int, land: LandWindow, mask: np.ndarray | None, sums: list[TileSums]
    ) -> tuple[list[np.ndarray], LandWindow]:
        """Apply the entries to one tile.

        Return their changes and the land over its window widened by BAND. land: the land of the whole level. mask:
        weights of the first entry's mask for the whole level, None without one. sums: statistics of each entry's
        changes, to which those of the tile are added.
        """
        level, changes = self.work.level, []
        # What each entry reads, narrower from entry to entry, and last the result.
        windows = [level.window(tile, *margin) for margin in self.shaping.plan.margins(level, self.numbers)]
        land, mask = land.crop(windows[0]), None if mask is None else mask[windows[0]]
        for number, arrays, entry_sums, target in zip(self.numbers, self.coarse, sums, windows[1:], strict=True):
            assert arrays is not None
            entry, window = self.shaping.entries[number], land.window
            mask = mask if number == self.numbers[0] else self.work.mask(entry, land)
            # The entry reads `window` and computes `target`, which the next one reads; `inner` is it within `window`.
            inner = within(target, window)
            coarser = np.stack([finer_window(array, *window) for array in arrays])
            change = coarser[(slice(num_arrays(entry.declaration, level)), *inner)]
            if self.shaping.plan.how(number, level) == TILES:
                cost = self.shaping.plan.cost(entry, window)
                report = self.shaping.progress(cost, level, entry)
                report(0.0)
                # A mask of 0 everywhere spares the work, unless the operator applies it itself (`masks`). `_counted`
                # adds the time of the block to the statistics.
                if mask is None or entry.declaration.masks or mask[inner].any():
                    with _counted(self.shaping, entry, entry_sums, cost):
                        change = apply_tile(self.work, entry, land, mask, coarser, target, report)
                self.shaping.done += cost
            land, mask = land.crop(target), None if mask is None else mask[inner]
            # Statistics are of what this level adds to the interpolated heights.
            entry_sums.add(level, tile, change[0] - coarser[0][inner], mask, target)
            land.total = land.total + self.work.accumulate(entry, change, mask, land)
            changes.append(change[(slice(None), *within(windows[-1], target))])
        return changes, land


def _upsample(arrays: Arrays, shape: tuple[int, int]) -> np.ndarray:
    """Interpolate a coarser change to float32 [arrays, *shape], one array at a time to save memory.

    shape: rows and columns of the finer level.
    """
    fine = np.empty((len(arrays), *shape), np.float32)
    for result, array in zip(fine, arrays, strict=True):
        result[...] = finer(array, shape)
    return fine


@contextmanager
def _counted(shaping: Shaping, entry: Entry, sums: TileSums, cost: float) -> Iterator[None]:
    """Add to `sums` the time of the `with` block and the number of results that it computed instead of reading them.

    cost: planned nanoseconds.
    """
    before, start = shaping.cache.made[entry.effect], time.perf_counter()
    yield
    sums.computed += shaping.cache.made[entry.effect] - before
    sums.ms += (time.perf_counter() - start) * 1e3
    sums.planned_ms += cost / 1e6
