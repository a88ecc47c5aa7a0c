# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs of entries at one level: one operator over the whole level, or several in each tile.

Tiles are blended into the interpolated change of the coarser level.
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
    """The changes of an entry in each tile of a level, metres and metres squared.

    Also whether its mask is not 0 everywhere there, the number of pieces that were not cached, and the milliseconds
    spent on and planned for them.
    """

    max_change: np.ndarray
    mean_square: np.ndarray
    unmasked: np.ndarray
    computed: int = 0
    ms: float = 0.0
    planned_ms: float = 0.0

    @classmethod
    def zeros(cls, level: Level) -> "TileSums":
        """Return the sums of a level without changes."""
        count = level.tile_count
        return cls(np.zeros(count), np.zeros(count), np.zeros(count, bool))

    def add(self, level: Level, tile: int, delta: np.ndarray, mask: np.ndarray | None, window: Window) -> None:
        """Record the masked change of a tile, which is a part of a window."""
        inner = within(level.window(tile), window)
        change = delta[inner] if mask is None else delta[inner] * mask[inner]
        self.max_change[tile] = np.abs(change).max()
        self.mean_square[tile] = np.square(change, dtype=np.float64).mean()
        self.unmasked[tile] = mask is None or mask[within(level.window(tile, BAND, BAND), window)].any()


def apply_run(
    run: Shaping,
    work: LevelWork,
    numbers: list[int],
    tiles: list[int],
    coarse: Sequence[Arrays | None],
    land: LandWindow,
) -> tuple[Sequence[Arrays], list[TileSums]]:
    """Apply a run of entries (LevelPlan.runs) to a level, and update `land`.

    Return the arrays and the sums of each. coarse: their changes at the coarser level, or None.
    """
    entry = run.entries[numbers[0]]
    if run.plan.how(numbers[0], work.level) != WHOLE:
        return _apply_tiles(run, work, numbers, tiles, coarse, land)
    sums, level, coarser = TileSums.zeros(work.level), work.level, coarse[0]
    mask, cost = work.mask(entry, land), run.plan.cost(entry, level.whole)
    report = run.progress(cost, level, entry)
    report(0.0)
    start = None if coarser is None else _upsample(coarser, level.shape)
    with _counted(run, entry, sums, cost):
        change = apply_whole(work, entry, land, mask, start, report)
    run.done += cost
    if start is not None and level.number and numbers[0] not in run.plan.doubted:
        before, after = (unpacked(entry.declaration, arrays) for arrays in (start, change))
        if entry.declaration.doubts(before, after, level.step_x * level.step_y):
            run.plan.doubt(numbers[0])
    delta = change[0] if start is None else change[0] - start[0]
    for tile in range(level.tile_count):
        sums.add(level, tile, delta, mask, level.whole)
    land.total += work.accumulate(entry, change, mask, land)
    return [change], [sums]


def _upsample(arrays: Arrays, shape: tuple[int, int]) -> np.ndarray:
    """Interpolate a coarser change to float32 [arrays, rows, columns], one array at a time to save memory."""
    fine = np.empty((len(arrays), *shape), np.float32)
    for result, array in zip(fine, arrays, strict=True):
        result[...] = finer(array, shape)
    return fine


@contextmanager
def _counted(run: Shaping, entry: Entry, sums: TileSums, cost: float) -> Iterator[None]:
    """Add the time and the computed pieces of the block to `sums`; cost: planned nanoseconds."""
    before, start = run.cache.made[entry.effect], time.perf_counter()
    yield
    sums.computed += run.cache.made[entry.effect] - before
    sums.ms += (time.perf_counter() - start) * 1e3
    sums.planned_ms += cost / 1e6


def _apply_tiles(
    run: Shaping,
    work: LevelWork,
    numbers: list[int],
    tiles: list[int],
    coarse: Sequence[Arrays | None],
    land: LandWindow,
) -> tuple[Sequence[Arrays], list[TileSums]]:
    """Apply a run of entries to tiles, and blend these into the interpolated coarser level; update `land`.

    It blends the land after all entries, not each change, so that depths that are nowhere negative stay so. coarse:
    changes of the entries at the coarser level. Return those at this level, and the sums of each entry.
    """
    level, first, changes = work.level, None, []
    start = land.crop(level.whole)
    for number, arrays in zip(numbers, coarse, strict=True):
        entry = run.entries[number]
        assert arrays is not None  # the coarsest level is computed as a whole
        mask, count = work.mask(entry, land), num_arrays(entry.declaration, level)
        change = [finer(array, level.shape) for array in arrays[:count]]
        first = mask if number == numbers[0] else first
        land.total = land.total + work.accumulate(entry, change, mask, land)
        changes += [change] if level.number else []
    sums = [TileSums.zeros(level) for _ in numbers]
    if all(run.plan.how(number, level) == UPSAMPLED for number in numbers):
        return changes, sums
    rest = np.ones(level.shape, np.float32)
    for tile in tiles:
        rest[level.window(tile, BAND, BAND)] -= level.weights(tile)
    names = {layer.name for number in numbers for layer in run.entries[number].declaration.layers}
    land.layers |= {name: land.layers[name] * rest for name in names}  # copies, since changes may share the arrays
    for total in (land.total, *(array for change in changes for array in change)):
        total *= rest
    for tile in tiles:
        window, weights = level.window(tile, BAND, BAND), level.weights(tile)
        tile_changes, tile_land = _compute_tile(run, work, numbers, tile, coarse, start, first, sums)
        land.total[window] += tile_land.total * weights
        for name in names:
            land.layers[name][window] += tile_land.layers[name] * weights
        for change, tile_change in zip(changes, tile_changes if changes else (), strict=True):
            for array, tile_array in zip(change, tile_change, strict=True):
                array[window] += tile_array * weights
    return changes, sums


def _compute_tile(
    run: Shaping,
    work: LevelWork,
    numbers: list[int],
    tile: int,
    coarse: Sequence[Arrays | None],
    land: LandWindow,
    mask: np.ndarray | None,
    sums: list[TileSums],
) -> tuple[list[np.ndarray], LandWindow]:
    """Apply a run of entries, given by their numbers, to one tile.

    Return their changes and the land over its window widened by BAND. coarse: each entry's change at the coarser level.
    land: the land of the whole level. mask: weights of the first entry's mask for the whole level, None without one.
    sums: statistics of each entry's changes, to which those of the tile are added.
    """
    level, changes = work.level, []
    windows = [level.window(tile, *margin) for margin in run.plan.margins(level, numbers)]
    land, mask = land.crop(windows[0]), None if mask is None else mask[windows[0]]
    for number, arrays, entry_sums, target in zip(numbers, coarse, sums, windows[1:], strict=True):
        assert arrays is not None
        entry, window = run.entries[number], land.window
        mask = mask if number == numbers[0] else work.mask(entry, land)
        here = within(target, window)
        coarser = np.stack([finer_window(array, *window) for array in arrays])
        change = coarser[(slice(num_arrays(entry.declaration, level)), *here)]
        if run.plan.how(number, level) == TILES:
            cost = run.plan.cost(entry, window)
            report = run.progress(cost, level, entry)
            report(0.0)
            # A mask of 0 everywhere spares the work.
            if mask is None or entry.declaration.masks or mask[here].any():
                with _counted(run, entry, entry_sums, cost):
                    change = apply_tile(work, entry, land, mask, coarser, target, report)
            run.done += cost
        land, mask = land.crop(target), None if mask is None else mask[here]
        entry_sums.add(level, tile, change[0] - coarser[0][here], mask, target)
        land.total = land.total + work.accumulate(entry, change, mask, land)
        changes.append(change[(slice(None), *within(windows[-1], target))])
    return changes, land
