# SPDX-License-Identifier: GPL-3.0-or-later
"""Application of a stack to a raster: level by level, within a level operator by operator, and tile by tile.

An operator starts from its own change at the coarser level and reads the heights that earlier operators left at this
level. Outside the requested tiles the changes of the coarser level are interpolated. Every tile is therefore a function
of the samples in its window, the parameters and its position, and is cached by these (tile_cache.py).

`shaping` holds the raster, the stack's active entries (operators with their parameters), the plan of levels and tiles,
and the statistics so far. An entry is applied to a level in one piece (WHOLE), in TILES, or not at all (UPSAMPLED).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..field.heightfield import HeightField
from .interpolation import finer_change
from .level_plan import UPSAMPLED, WHOLE
from .level_runs import LevelRun, TileSums
from .level_work import Arrays, LandWindow, LevelGround, LevelWork, zero_holes
from .levels import finer
from .shaping import Added, Finished, Shaping
from .stack import Stack
from .tile_cache import TileCache
from .tiles import Level, Wanted

ROWS = 256  # of the raster that are interpolated at a time


@dataclass(eq=False)
class Shaped:
    """The result of a stack: the change to add to the raster's samples, metres, and layers; float32 [rows, columns].

    Layers named in `depths` are added to those of the source, others replace them. `level`: finest level that was
    computed anywhere. `tiles`: computed tiles by level, of `tile_counts`. `added`: statistics of each operator at each
    level. `left_out_m`: root mean square and largest change of the last level where finer ones were left out; the
    missing detail is of that size. `finished_early`: whether the caller's `finish` ended the work.
    """

    change: np.ndarray
    layers: dict[str, np.ndarray]
    depths: set[str]
    level: int
    tiles: list[list[int]]
    tile_counts: list[int]
    added: list[Added]
    left_out_m: tuple[float, float]
    finished_early: bool = False


@dataclass(eq=False)
class LevelState:
    """The result of a level, which the next finer one starts from.

    A tile is `uncertain` if an operator changed no height though its mask is not 0: finer levels may have shorter
    waves, or it changes layers.
    """

    level: Level
    changes: list[Arrays | None]  # of each entry (`num_arrays`), without its mask; None at level 0
    total: np.ndarray  # sum of all changes with their masks, float32 [rows, columns] m
    layers: dict[str, np.ndarray]
    max_change: np.ndarray  # [tiles], sum over entries of the largest change, metres
    mean_square: np.ndarray  # [tiles], likewise, metres squared
    uncertain: np.ndarray  # bool [tiles]


def shape(
    heights: HeightField,
    stack: Stack,
    wanted: Wanted,
    *,
    images: Mapping[str, np.ndarray] | None = None,
    cache: TileCache | None = None,
    threads: int = 1,
    on_progress: Callable[[float, str], None] = lambda _fraction, _message: None,
    finish: Callable[[], bool] = lambda: False,
) -> Shaped:
    """Apply a stack to a raster. The result depends neither on the number of threads nor on the order of requests.

    wanted: tiles of each level, or None for the whole level (tiles.py). images: mask images by file name, float32
    [rows, columns], row 0 south. on_progress: may raise, which stops the work. finish: called as often; True ends the
    work with the complete levels.
    """
    shaping = Shaping(heights, stack.active, images or {}, wanted, cache or TileCache(), threads, on_progress, finish)
    state, early = run_levels(shaping)
    return _result(shaping, state, early)


def run_levels(shaping: Shaping) -> tuple[LevelState | None, bool]:
    """Return the state of the last computed level, None if none was, and whether the run finished early.

    Requested tiles are left out where the coarser level changed heights by no more than their allowed error, unless it
    is uncertain: an operator changed nothing there although its mask is not 0, so that finer levels may differ.
    """
    state: LevelState | None = None
    for level in reversed(shaping.plan.levels):
        max_change = None if state is None else state.max_change
        uncertain = None if state is None else state.uncertain
        chosen = shaping.plan.choose_tiles(level, max_change, uncertain)
        if not shaping.entries or not (level.is_whole or chosen):
            break
        try:
            state = _compute_level(shaping, level, chosen, state)
        except Finished:
            return state, True
    return state, False


def _compute_level(shaping: Shaping, level: Level, chosen: list[int], coarser: LevelState | None) -> LevelState:
    """Apply all entries to the chosen tiles of a level and return its state.

    `chosen`: indices of tiles; their neighbours within the operators' halos are computed too. `coarser`: state of the
    next coarser level, None at the coarsest. Its arrays are dropped as they are used, to save memory. Raises Finished.
    """
    ground, tiles = LevelGround.of(shaping.heights, level), shaping.plan.with_neighbours(level, chosen)
    # `depths`: names of layers that are depths in metres, to which operators add instead of replacing them.
    work = LevelWork(shaping.cache, shaping.plan, level, ground, shaping.images, shaping.depths, shaping.threads)
    land = LandWindow(level.whole, np.zeros(level.shape, np.float32), {})  # changes of heights and layers so far
    total = TileSums.zeros(level)
    uncertain = np.zeros(level.tile_count, bool)  # whether finer levels may change more than this one
    changes: list[Arrays | None] = []
    added = []  # statistics of each entry that is applied, for the report
    for numbers in shaping.plan.runs(level):  # of entries that are applied together
        coarse = [None if coarser is None else coarser.changes[number] for number in numbers]
        results, sums = LevelRun(shaping, work, numbers, coarse).apply(tiles, land)
        for number, entry_sums in zip(numbers, sums, strict=True):
            how = shaping.plan.how(number, level)
            total.max_change += entry_sums.max_change  # a bound on the change by all entries
            total.mean_square += entry_sums.mean_square
            if how != UPSAMPLED:
                # Finer levels may have changes where this one has none.
                uncertain |= (entry_sums.max_change == 0.0) & entry_sums.unmasked
                added.append(_summarize_entry(shaping, level, number, how == WHOLE, tiles, entry_sums))
            if coarser is not None:
                coarser.changes[number] = None  # frees memory that the next entry needs
        # No finer level reads the changes of the finest one.
        changes += results if level.number else [None] * len(numbers)
        del results, coarse
    shaping.added += added
    shaping.tiles[level.number] = list(range(level.tile_count)) if level.is_whole else tiles
    if coarser is not None and not level.is_whole:
        # Tiles that were not chosen keep the coarser figures, even those that were computed as neighbours of others.
        for tile in set(range(level.tile_count)) - set(chosen):
            parent = level.parent(tile)
            total.max_change[tile] = coarser.max_change[parent]
            total.mean_square[tile] = coarser.mean_square[parent]
            uncertain[tile] = coarser.uncertain[parent]
    return LevelState(
        level,
        changes=changes,
        total=land.total,
        layers=land.layers,
        max_change=total.max_change,
        mean_square=total.mean_square,
        uncertain=uncertain,
    )


def _summarize_entry(
    shaping: Shaping, level: Level, number: int, whole: bool, tiles: list[int], sums: TileSums
) -> Added:
    """Return the report's line for entry `number` at a level: its changes in metres, tiles and time.

    `whole`: the operator was applied to the whole level, not to each of `tiles`.
    """
    covered = list(range(level.tile_count)) if whole else tiles
    rms = float(np.sqrt(sums.mean_square[covered].mean())) if covered else 0.0
    return Added(
        level=level.number,
        spacing_m=max(level.step_x, level.step_y),
        entry=number,
        effect=shaping.entries[number].effect,
        rms_m=rms,
        max_m=float(sums.max_change.max()),
        whole=whole,
        pieces=1 if whole else len(tiles),
        computed=sums.computed,
        ms=sums.ms,
        # Computed in tiles although the entry has contradicted a coarser level (`LevelPlan.doubt`).
        doubtful=not whole and bool(tiles) and number in shaping.plan.doubted,
        planned_ms=sums.planned_ms,
    )


def _result(shaping: Shaping, state: LevelState | None, early: bool) -> Shaped:
    """Return the result at the raster's own samples, interpolated from the last computed level.

    state: of that level, None if no level was computed. early: whether shaping was finished before the finest level.
    """
    levels, lattice = shaping.plan.levels, shaping.heights.lattice
    total, layers = np.zeros((lattice.height, lattice.width), np.float32), {}
    finest, left_out = 0, (0.0, 0.0)
    if state is not None:
        finest, left_out = state.level.number, _left_out(shaping, state)
        # After an early finish the change is interpolated at once, without spikes at cliffs. If a coarse level was
        # requested as the finest, the change is interpolated level by level, as layers always are.
        total, layers = _change_of_raster(shaping, state) if early else state.total, state.layers
        for level in reversed(levels[:finest]):
            total = total if early else finer(total, level.shape)
            layers = {name: finer(layer, level.shape) for name, layer in layers.items()}
        if finest and shaping.heights.valid is not None:
            missing = shaping.heights.valid == 0
            total, layers = zero_holes(missing, total), {name: zero_holes(missing, a) for name, a in layers.items()}
    total, counts = np.ascontiguousarray(total), [level.tile_count for level in levels]
    return Shaped(
        change=total,
        layers=layers,
        depths=shaping.depths,
        level=finest,
        tiles=shaping.tiles,
        tile_counts=counts,
        added=shaping.added,
        left_out_m=left_out,
        finished_early=early,
    )


def _change_of_raster(shaping: Shaping, state: LevelState) -> np.ndarray:
    """Return the change of the last computed level at the raster's samples.

    `finer_change` interpolates it, and takes away the raster's own detail that it replaces, so cliffs get no spikes.
    """
    number, before = state.level.number, LevelGround.of(shaping.heights, state.level).heights
    result = np.empty((shaping.heights.lattice.height, shaping.heights.lattice.width), np.float32)
    columns = np.arange(result.shape[1]) / (1 << number)
    for row in range(0, len(result), ROWS):
        rows = slice(row, min(row + ROWS, len(result)))
        # The coarse rows around these, and one more on each side, because the extremes around a row count.
        coarse = slice(max((rows.start >> number) - 1, 0), (rows.stop - 1 >> number) + 3)
        positions = np.arange(rows.start, rows.stop) / (1 << number) - coarse.start
        ground = shaping.heights.heights(rows)
        result[rows] = finer_change(ground, before[coarse], state.total[coarse], positions, columns)
    return result


def _left_out(shaping: Shaping, state: LevelState) -> tuple[float, float]:
    """Return the root mean square and the largest change of tiles without finer levels, metres; (0, 0) for none.

    If the last computed level is coarser than the raster, these are all its tiles. Else they are the raster's tiles
    that were not computed, with the changes of the coarser level.
    """
    tiles = sorted(set(range(state.level.tile_count)) - set(() if state.level.number else shaping.tiles[0]))
    if not tiles:
        return 0.0, 0.0
    return float(np.sqrt(state.mean_square[tiles].mean())), float(state.max_change[tiles].max())
