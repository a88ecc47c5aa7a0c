# SPDX-License-Identifier: GPL-3.0-or-later
"""Application of a stack to a raster: level by level, within a level operator by operator, and tile by tile.

An operator starts from its own change at the coarser level and reads the heights that earlier operators left at this
level. Outside the requested tiles the changes of the coarser level are interpolated. Every tile is therefore a function
of the samples in its window, the parameters and its position, and is cached by these (tile_cache.py).
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from ..field.heightfield import HeightField
from .level_plan import TILES, UPSAMPLED, WHOLE, LevelPlan
from .level_work import (
    Arrays,
    LandWindow,
    LevelGround,
    LevelWork,
    apply_tile,
    apply_whole,
    num_arrays,
    unpacked,
    within,
    zero_holes,
)
from .levels import finer, finer_window
from .stack import Entry, Stack
from .tile_cache import TileCache
from .tiles import BAND, Level, Wanted, Window, levels_of


class Finished(Exception):
    """The caller needs no further levels."""


@dataclass(frozen=True)
class Added:
    """The difference of one operator at one level to its interpolated coarser level, over the computed tiles.

    Its root mean square and largest absolute value are in metres. `made`: number of pieces, of which `computed` were
    not cached. `doubtful`: computed in tiles although these differ too much from the level in one piece (`whole`).
    `planned_ms`: milliseconds that the plan expected on one thread.
    """

    level: int
    spacing_m: float
    entry: int
    effect: str
    rms_m: float
    most_m: float
    whole: bool
    made: int
    computed: int
    ms: float
    doubtful: bool = False
    planned_ms: float = 0.0


@dataclass(eq=False)
class Shaped:
    """The result of a stack: float32 [rows, columns] metres to add to the raster's samples, and layers likewise.

    Layers named in `depths` are added to those of the source, others replace them. `level`: finest level that was
    computed anywhere. `tiles`: computed tiles by level, of `tile_counts`. `left_out_m`: root mean square and largest
    change of the last level where finer ones were left out; the missing detail is of that size.
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

    The arrays of each entry (`num_arrays`) without its mask, total and layers; and sums over entries for each tile,
    metres and metres squared. A tile is `uncertain` if an operator changed no height though its mask is not 0: finer
    levels may have shorter waves, or it changes layers.
    """

    level: Level
    changes: list[Arrays | None]
    total: np.ndarray
    layers: dict[str, np.ndarray]
    max_change: np.ndarray
    mean_square: np.ndarray
    uncertain: np.ndarray


@dataclass(eq=False)
class Shaping:
    """One run over all levels."""

    heights: HeightField
    entries: Sequence[Entry]
    images: Mapping[str, np.ndarray]
    wanted: Wanted
    cache: TileCache
    threads: int
    on_progress: Callable[[float, str], None] = lambda _fraction, _message: None
    finish: Callable[[], bool] = lambda: False
    added: list[Added] = field(default_factory=list)
    done: float = 0.0

    def __post_init__(self) -> None:
        self.plan = LevelPlan(levels_of(self.heights.lattice), self.entries, self.wanted)
        self.tiles: list[list[int]] = [[] for _ in self.plan.levels]

    @property
    def depths(self) -> set[str]:
        """Names of the layers that are depths in metres, whose values add up."""
        return {layer.name for entry in self.entries for layer in entry.declaration.layers if layer.per_metre}

    def progress(self, cost: float, level: Level, entry: Entry) -> Callable[[float], None]:
        """Return a function that an operator calls with its finished fraction; cost: nanoseconds of its work."""

        def report(fraction: float) -> None:
            """Add the fraction of this operator to the progress. Raises Finished if the user ends the work early."""
            if level is not self.plan.levels[-1] and self.finish():  # the coarsest level is always computed
                raise Finished
            total = max(self.plan.total, 1.0)
            text = f"{entry.declaration.label}, {level.columns} x {level.rows}"
            self.on_progress(min((self.done + min(max(fraction, 0.0), 1.0) * cost) / total, 1.0), text)

        return report


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
    run = Shaping(heights, stack.active, images or {}, wanted, cache or TileCache(), threads, on_progress, finish)
    state, early = run_levels(run)
    return _result(run, state, early)


def run_levels(run: Shaping) -> tuple[LevelState | None, bool]:
    """Return the state of the last computed level, and whether the run finished early."""
    state = None
    for level in reversed(run.plan.levels):
        known = (None, None) if state is None else (state.max_change, state.uncertain)
        chosen = run.plan.choose_tiles(level, *known)
        if not run.entries or not (level.is_whole or chosen):
            break
        try:
            state = _compute_level(run, level, chosen, state)
        except Finished:
            return state, True
    return state, False


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


def _compute_level(run: Shaping, level: Level, chosen: list[int], coarser: LevelState | None) -> LevelState:
    """Apply all entries to the chosen tiles of a level and return its state.

    `chosen`: indices of tiles; their neighbours within the operators' halos are computed too. `coarser`: state of the
    next coarser level, None at the coarsest. Its arrays are dropped as they are used, to save memory.
    """
    ground, tiles = LevelGround.of(run.heights, level), run.plan.with_neighbours(level, chosen)
    work = LevelWork(run.cache, run.plan, level, ground, run.images, run.depths, run.threads)
    land = LandWindow(level.whole, np.zeros(level.shape, np.float32), {})
    total = TileSums.zeros(level)
    uncertain = np.zeros(level.tile_count, bool)
    changes: list[Arrays | None] = []
    added = []
    for numbers in run.plan.runs(level):
        coarse = [None if coarser is None else coarser.changes[number] for number in numbers]
        results, sums = _apply_run(run, work, numbers, tiles, coarse, land)
        for number, entry_sums in zip(numbers, sums, strict=True):
            how = run.plan.how(number, level)
            total.max_change += entry_sums.max_change
            total.mean_square += entry_sums.mean_square
            if how != UPSAMPLED:
                uncertain |= (entry_sums.max_change == 0.0) & entry_sums.unmasked
                added.append(_added(run, level, number, how == WHOLE, tiles, entry_sums))
            if coarser is not None:
                coarser.changes[number] = None  # frees memory that the next entry needs
        # No finer level reads the changes of the finest one.
        changes += results if level.number else [None] * len(numbers)
        del results, coarse
    run.added += added
    run.tiles[level.number] = list(range(level.tile_count)) if level.is_whole else tiles
    if coarser is not None and not level.is_whole:
        # Tiles that were not chosen keep the coarser figures, even those that were computed as neighbours of others.
        for tile in set(range(level.tile_count)) - set(chosen):
            parent = level.parent(tile)
            total.max_change[tile] = coarser.max_change[parent]
            total.mean_square[tile] = coarser.mean_square[parent]
            uncertain[tile] = coarser.uncertain[parent]
    return LevelState(level, changes, land.total, land.layers, total.max_change, total.mean_square, uncertain)


def _added(run: Shaping, level: Level, number: int, whole: bool, tiles: list[int], sums: TileSums) -> Added:
    """Return the report's line for entry `number` at a level: its changes in metres, tiles and time.

    `whole`: the operator was applied to the whole level, not to each of `tiles`.
    """
    computed = list(range(level.tile_count)) if whole else tiles
    rms = float(np.sqrt(sums.mean_square[computed].mean())) if computed else 0.0
    spacing, effect = max(level.step_x, level.step_y), run.entries[number].effect
    figures = rms, float(sums.max_change.max()), whole, 1 if whole else len(tiles), sums.computed, sums.ms
    doubtful = not whole and bool(tiles) and number in run.plan.doubted
    return Added(level.number, spacing, number, effect, *figures, doubtful, sums.planned_ms)


def _apply_run(
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
    """Apply a run of entries to tiles and blend these into the interpolated coarser level; see `_apply_run`.

    It blends the land after all entries, not each change, so that depths that are nowhere negative stay so.
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
    """Apply a run of entries to one tile.

    Return their changes and the land over its window widened by BAND. mask: of the first entry, for the whole level.
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


def _result(run: Shaping, state: LevelState | None, early: bool) -> Shaped:
    """Return the result at the raster's own samples, interpolated from the last computed level."""
    levels, shape_ = run.plan.levels, (run.heights.lattice.height, run.heights.lattice.width)
    depths, counts = run.depths, [level.tile_count for level in levels]
    if state is None:
        return Shaped(np.zeros(shape_, np.float32), {}, depths, 0, run.tiles, counts, run.added, (0.0, 0.0), early)
    left_max, left_mean_square = _left_out(run, state)
    total, layers = state.total, state.layers
    for level in reversed(levels[: state.level.number]):
        total = finer(total, level.shape)
        layers = {name: finer(layer, level.shape) for name, layer in layers.items()}
    if state.level.number and run.heights.valid is not None:
        missing = run.heights.valid == 0
        total, layers = zero_holes(missing, total), {name: zero_holes(missing, a) for name, a in layers.items()}
    left = float(np.sqrt(left_mean_square)), float(left_max)
    return Shaped(
        np.ascontiguousarray(total), layers, depths, state.level.number, run.tiles, counts, run.added, left, early
    )


def _left_out(run: Shaping, state: LevelState) -> tuple[float, float]:
    """Return the largest and the mean square change over tiles whose finer levels were not computed."""
    if state.level.number:
        return state.max_change.max(), state.mean_square.mean()
    left = sorted(set(range(state.level.tile_count)) - set(run.tiles[0])) if not state.level.is_whole else []
    return (state.max_change[left].max(), state.mean_square[left].mean()) if left else (0.0, 0.0)
