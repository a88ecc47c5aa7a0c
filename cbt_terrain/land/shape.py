# SPDX-License-Identifier: GPL-3.0-or-later
"""A stack of effects applied to a raster: level by level, effect by effect within a level, tile by tile within a level.

An effect starts from its own change at the coarser level and finds the heights after the effects before it at this one.
Where a level was not asked for, the changes of the coarser one are taken between its samples. So every tile is a
function of the samples that it looks at, of parameters and of its place, and is kept by that content (tile_cache.py).
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from ..field.heightfield import HeightField
from ..land_effects.levels import finer, finer_window
from .level_plan import TILES, UPSAMPLED, WHOLE, LevelPlan
from .level_work import Land, LevelGround, Work, apply_tile, apply_whole, parts, unpacked, within, without
from .stack import Entry, Stack
from .tile_cache import TileCache
from .tiles import BAND, Level, Wanted, Window, levels_of


class Finished(Exception):
    """Who waits is content with the levels that are done."""


@dataclass(frozen=True)
class Added:
    """What one effect has added at one level to what the coarser one said: metres, over the tiles that were made.
    `whole`: whether the level was worked on as one piece; `doubtful`: not, though tiles of it are not to be trusted.
    `made`: its pieces, of which `computed` were not known before. `ms`: what that took."""

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


@dataclass(eq=False)
class Shaped:
    """`change`: float32 [rows, columns] metres of the raster's samples. `layers`: of the stack, float32 likewise, what
    is added to those of the source (`depths`) or replaces them. `level`: the finest that was made anywhere. `tiles`:
    those that were made, by level, of those that there are (`tile_counts`). `added`: see Added. `left_out_m`: root mean
    square and most of what the last level that was made added, where a finer one was not made: what is missing there is
    of that size."""

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
class State:
    """What a level leaves to the next finer one. `changes`: of each entry, its parts, each [rows, columns],
    without its mask. `total`: metres. `most`, `squares`: what was added in each tile, metres and metres squared.
    `unsure`: where an effect has added nothing, though its mask let it: finer waves than this level knows may come, or
    only layers."""

    level: Level
    changes: list[Sequence[np.ndarray] | None]
    total: np.ndarray
    layers: dict[str, np.ndarray]
    most: np.ndarray
    squares: np.ndarray
    unsure: np.ndarray


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

    def __post_init__(self):
        self.plan = LevelPlan(levels_of(self.heights.lattice), self.entries, self.wanted)
        self.tiles: list[list[int]] = [[] for _ in self.plan.levels]

    @property
    def depths(self) -> set[str]:
        """Names of the layers that are depths."""
        return {layer.name for entry in self.entries for layer in entry.declaration.layers if layer.per_metre}

    def progress(self, cost: float, level: Level, entry: Entry) -> Callable[[float], None]:
        """What an effect tells how far it is, of work that costs so much."""

        def said(part: float) -> None:
            if level is not self.plan.levels[-1] and self.finish():  # the coarsest is there at least
                raise Finished
            total = max(self.plan.total, 1.0)
            text = f"{entry.declaration.label}, {level.columns} x {level.rows}"
            self.on_progress(min((self.done + min(max(part, 0.0), 1.0) * cost) / total, 1.0), text)

        return said


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
    """What a stack makes of a raster: the same for any threads, and whatever the order in which tiles were asked for.

    wanted: of each level the tiles, or None for the whole (tiles.py). images: of masks, by file name, float32 [rows,
    columns], row 0 south. on_progress may raise, which stops the work; `finish` is asked as often, and ends it with the
    levels that are complete.
    """
    run = Shaping(heights, stack.active, images or {}, wanted, cache or TileCache(), threads, on_progress, finish)
    state, early = run_levels(run)
    return _result(run, state, early)


def run_levels(run: Shaping) -> tuple[State | None, bool]:
    """The last level that was made, and whether that was not all."""
    state = None
    for level in reversed(run.plan.levels):
        chosen = run.plan.chosen_at(level, *((None, None) if state is None else (state.most, state.unsure)))
        if not run.entries or not (level.is_whole or chosen):
            break
        try:
            state = _level(run, level, chosen, state)
        except Finished:
            return state, True
    return state, False


@dataclass(eq=False)
class Sums:
    """What an entry has added in each tile of a level: most and mean square, metres and metres squared; where its mask
    let it. `computed`: how many of its pieces were not known before; `ms`: what they took."""

    most: np.ndarray
    squares: np.ndarray
    let: np.ndarray
    computed: int = 0
    ms: float = 0.0

    @classmethod
    def none(cls, level: Level) -> "Sums":
        return cls(*(np.zeros(level.tile_count, kind) for kind in (float, float, bool)))

    def add(self, level: Level, tile: int, delta: np.ndarray, mask: np.ndarray | None, window: Window) -> None:
        """A tile's own part of what was added in a window, as much of it as the mask lets."""
        own = within(level.window(tile), window)
        part = delta[own] if mask is None else delta[own] * mask[own]
        self.most[tile], self.squares[tile] = np.abs(part).max(), np.square(part, dtype=np.float64).mean()
        self.let[tile] = mask is None or mask[within(level.window(tile, BAND, BAND), window)].any()


def _level(run: Shaping, level: Level, chosen: list[int], below: State | None) -> State:
    ground, tiles = LevelGround.of(run.heights, level), run.plan.made_with(level, chosen)
    work = Work(run.cache, run.plan, level, ground, run.images, run.depths, run.threads)
    land = Land(level.whole, np.zeros(level.shape, np.float32), {})
    most, squares, unsure = (np.zeros(level.tile_count, kind) for kind in (float, float, bool))
    changes, added = [], []
    for numbers in run.plan.runs(level):
        coarse = [None if below is None else below.changes[number] for number in numbers]
        made, sums = _run_of(run, work, numbers, tiles, coarse, land)
        for number, entry_sums in zip(numbers, sums, strict=True):
            how = run.plan.how(number, level)
            most += entry_sums.most
            squares += entry_sums.squares
            if how != UPSAMPLED:
                unsure |= (entry_sums.most == 0.0) & entry_sums.let
                added.append(_added(run, level, number, how == WHOLE, tiles, entry_sums))
            if below is not None:
                below.changes[number] = None  # memory: the next entry needs as much
        # The finest level leaves nothing to a finer one.
        changes += made if level.number else [None] * len(numbers)
        del made, coarse
    run.added += added
    run.tiles[level.number] = list(range(level.tile_count)) if level.is_whole else tiles
    if below is not None and not level.is_whole:
        # Nobody knows better than the coarser level; or who does was made for others only, and decides nothing here.
        for tile in set(range(level.tile_count)) - set(chosen):
            parent = level.parent(tile)
            most[tile], squares[tile], unsure[tile] = below.most[parent], below.squares[parent], below.unsure[parent]
    return State(level, changes, land.total, land.layers, most, squares, unsure)


def _added(run: Shaping, level: Level, number: int, whole: bool, tiles: list[int], sums: Sums) -> Added:
    made = list(range(level.tile_count)) if whole else tiles
    rms = float(np.sqrt(sums.squares[made].mean())) if made else 0.0
    spacing, effect = max(level.step_x, level.step_y), run.entries[number].effect
    figures = rms, float(sums.most.max()), whole, 1 if whole else len(tiles), sums.computed, sums.ms
    doubtful = not whole and bool(tiles) and number in run.plan.doubted
    return Added(level.number, spacing, number, effect, *figures, doubtful)


def _run_of(
    run: Shaping,
    work: Work,
    numbers: list[int],
    tiles: list[int],
    coarse: list[Sequence[np.ndarray] | None],
    land: Land,
) -> tuple[list[Sequence[np.ndarray]], list[Sums]]:
    """Apply a run of entries (LevelPlan.runs) to a level: their changes, of which each is its parts, each [rows,
    columns]; and what they add. coarse: their changes at the coarser level, or None. The land becomes theirs."""
    entry = run.entries[numbers[0]]
    if run.plan.how(numbers[0], work.level) != WHOLE:
        return _put_tiles(run, work, numbers, tiles, coarse, land)
    sums, level, below = Sums.none(work.level), work.level, coarse[0]
    mask, cost = work.mask(entry, land), run.plan.cost(entry, level.whole)
    told = run.progress(cost, level, entry)
    told(0.0)
    up = None if below is None else _brought(below, level.shape)
    with _counted(run, entry, sums):
        change = apply_whole(work, entry, land, mask, up, told)
    run.done += cost
    if up is not None and level.number and numbers[0] not in run.plan.doubted:
        both = (unpacked(entry.declaration, of) for of in (up, change))
        if entry.declaration.doubts(*both, level.step_x * level.step_y):
            run.plan.doubt(numbers[0])
    delta = change[0] if up is None else change[0] - up[0]
    for tile in range(level.tile_count):
        sums.add(level, tile, delta, mask, level.whole)
    land.total += work.put_on(entry, change, mask, land)
    return [change], [sums]


def _brought(below: Sequence[np.ndarray], shape: tuple[int, int]) -> np.ndarray:
    """float32 [parts, rows, columns]: a coarser change brought to a level, one part at a time for memory's sake."""
    up = np.empty((len(below), *shape), np.float32)
    for part, array in zip(up, below, strict=True):
        part[...] = finer(array, shape)
    return up


@contextmanager
def _counted(run: Shaping, entry: Entry, sums: Sums) -> Iterator[None]:
    before, start = run.cache.made[entry.effect], time.perf_counter()
    yield
    sums.computed += run.cache.made[entry.effect] - before
    sums.ms += (time.perf_counter() - start) * 1e3


def _put_tiles(
    run: Shaping, work: Work, numbers: list[int], tiles: list[int], coarse: list[Sequence[np.ndarray]], land: Land
) -> tuple[list[Sequence[np.ndarray]], list[Sums]]:
    """As `_run_of`: tiles, put into what the coarser level says.

    By weights of what is there after all entries, not of what each has added: a depth that is nowhere below 0 stays so.
    """
    level, first, changes = work.level, None, []
    start = land.part(level.whole)
    for number, below in zip(numbers, coarse, strict=True):
        entry = run.entries[number]
        mask, count = work.mask(entry, land), parts(entry.declaration, level)
        change = [finer(array, level.shape) for array in below[:count]]
        first = mask if number == numbers[0] else first
        land.total = land.total + work.put_on(entry, change, mask, land)
        changes += [change] if level.number else []
    sums = [Sums.none(level) for _ in numbers]
    if all(run.plan.how(number, level) == UPSAMPLED for number in numbers):
        return changes, sums
    rest = np.ones(level.shape, np.float32)
    for tile in tiles:
        rest[level.window(tile, BAND, BAND)] -= level.weights(tile)
    names = {layer.name for number in numbers for layer in run.entries[number].declaration.layers}
    land.layers |= {name: land.layers[name] * rest for name in names}  # copied: changes may share them
    for array in (land.total, *(part for change in changes for part in change)):
        array *= rest
    for tile in tiles:
        window, weights = level.window(tile, BAND, BAND), level.weights(tile)
        made, its_land = _tile(run, work, numbers, tile, coarse, start, first, sums)
        land.total[window] += its_land.total * weights
        for name in names:
            land.layers[name][window] += its_land.layers[name] * weights
        for change, its in zip(changes, made if changes else (), strict=True):
            for part, its_part in zip(change, its, strict=True):
                part[window] += its_part * weights
    return changes, sums


def _tile(
    run: Shaping,
    work: Work,
    numbers: list[int],
    tile: int,
    coarse: list[Sequence[np.ndarray]],
    land: Land,
    mask: np.ndarray | None,
    sums: list[Sums],
) -> tuple[list[np.ndarray], Land]:
    """A run of entries applied to a tile alone, one after the other: their changes and the land over its window with a
    BAND all round. mask: of the first, of the whole level."""
    level, made = work.level, []
    windows = [level.window(tile, *margin) for margin in run.plan.margins(level, numbers)]
    land, mask = land.part(windows[0]), None if mask is None else mask[windows[0]]
    for number, below, its, asked in zip(numbers, coarse, sums, windows[1:], strict=True):
        entry, window = run.entries[number], land.window
        mask = mask if number == numbers[0] else work.mask(entry, land)
        here = within(asked, window)
        coarser = np.stack([finer_window(array, *window) for array in below])
        change = coarser[(slice(parts(entry.declaration, level)), *here)]
        if run.plan.how(number, level) == TILES:
            cost = run.plan.cost(entry, window)
            told = run.progress(cost, level, entry)
            told(0.0)
            # Not where its mask lets nothing through.
            if mask is None or entry.declaration.masks or mask[here].any():
                with _counted(run, entry, its):
                    change = apply_tile(work, entry, land, mask, coarser, asked, told)
            run.done += cost
        land, mask = land.part(asked), None if mask is None else mask[here]
        its.add(level, tile, change[0] - coarser[0][here], mask, asked)
        land.total = land.total + work.put_on(entry, change, mask, land)
        made.append(change[(slice(None), *within(windows[-1], asked))])
    return made, land


def _result(run: Shaping, state: State | None, early: bool) -> Shaped:
    """What the last level that was made says of the raster's own samples."""
    levels, shape_ = run.plan.levels, (run.heights.lattice.height, run.heights.lattice.width)
    depths, counts = run.depths, [level.tile_count for level in levels]
    if state is None:
        return Shaped(np.zeros(shape_, np.float32), {}, depths, 0, run.tiles, counts, run.added, (0.0, 0.0), early)
    left_most, left_squares = _left_out(run, state)
    total, layers = state.total, state.layers
    for level in reversed(levels[: state.level.number]):
        total = finer(total, level.shape)
        layers = {name: finer(layer, level.shape) for name, layer in layers.items()}
    if state.level.number and run.heights.valid is not None:
        missing = run.heights.valid == 0
        total, layers = without(missing, total), {name: without(missing, a) for name, a in layers.items()}
    left = float(np.sqrt(left_squares)), float(left_most)
    return Shaped(
        np.ascontiguousarray(total), layers, depths, state.level.number, run.tiles, counts, run.added, left, early
    )


def _left_out(run: Shaping, state: State) -> tuple[float, float]:
    """Most, and mean square, of what was added where a level is left to be made: over tiles of the finest that was."""
    if state.level.number:
        return state.most.max(), state.squares.mean()
    left = sorted(set(range(state.level.tile_count)) - set(run.tiles[0])) if not state.level.is_whole else []
    return (state.most[left].max(), state.squares[left].mean()) if left else (0.0, 0.0)
