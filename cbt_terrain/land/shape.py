# SPDX-License-Identifier: GPL-3.0-or-later
"""A stack of effects applied to a raster: level by level, effect by effect within a level, tile by tile within a level.

An effect starts from its own change at the coarser level and finds the heights after the effects before it at this one.
Where a level was not asked for, the changes of the coarser one are taken between its samples. So every tile is a
function of the samples that it looks at, of parameters and of its place, and is kept by that content (tile_cache.py).
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ..field.heightfield import HeightField
from .level_plan import TILES, UPSAMPLED, WHOLE, LevelPlan
from .level_work import LevelGround, Work, apply_tile, apply_whole, is_let, parts, unpacked
from .levels import finer, finer_window, masked
from .mask import whole_mask
from .mask_reads import values_of
from .stack import Entry, Stack
from .stack_layers import joined
from .tile_cache import TileCache
from .tiles import BAND, Level, Wanted, Window, levels_of


class Finished(Exception):
    """Who waits is content with the levels that are done."""


@dataclass(frozen=True)
class Added:
    """What one effect has added at one level to what the coarser one said: metres, over the tiles that were made.
    `whole`: whether the level was worked on as one piece. `made`: its pieces, of which `computed` were not known
    before. `ms`: what that took."""

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


def _level(run: Shaping, level: Level, chosen: list[int], below: State | None) -> State:
    ground, tiles = LevelGround.of(run.heights, level), run.plan.made_with(level, chosen)
    total, layers, added = np.zeros(level.shape, np.float32), {}, []
    most, squares, unsure = (np.zeros(level.tile_count, kind) for kind in (float, float, bool))
    changes = []
    for number, entry in enumerate(run.entries):
        mask = _mask(run, entry, level, ground, total, layers)
        work = Work(run.cache, run.plan, level, ground, entry, total, layers, run.depths, mask, run.threads)
        coarse = None if below is None else below.changes[number]
        change, tile_most, tile_squares, figures = _entry(run, work, number, tiles, coarse)
        total += _put_on(entry, change, mask, ground, layers)
        most += tile_most
        squares += tile_squares
        if run.plan.how(entry, level) != UPSAMPLED:
            unsure |= (tile_most == 0.0) & _is_let(level, mask)
        added += [figures] if figures is not None else []
        # The finest level leaves nothing to a finer one.
        changes.append(change if level.number else None)
        if below is not None:
            below.changes[number] = None
        del change, coarse, mask, work  # memory: the next entry needs as much
    run.added += added
    run.tiles[level.number] = list(range(level.tile_count)) if level.is_whole else tiles
    if below is not None and not level.is_whole:
        # Nobody knows better than the coarser level; or who does was made for others only, and decides nothing here.
        for tile in set(range(level.tile_count)) - set(chosen):
            parent = level.parent(tile)
            most[tile], squares[tile], unsure[tile] = below.most[parent], below.squares[parent], below.unsure[parent]
    return State(level, changes, total, layers, most, squares, unsure)


def _mask(
    run: Shaping, entry: Entry, level: Level, ground: LevelGround, total: np.ndarray, layers: dict[str, np.ndarray]
) -> np.ndarray | None:
    """How much of an entry is wanted at a level, float32 [rows, columns], given what those before it have made."""
    if entry.mask is None:
        return None
    names = sorted({rule.of for rule in entry.mask.rules})
    pair = ({name: found[name] for name in names if name in found} for found in (ground.layers, layers))
    heights = partial(_heights, ground, total)
    read = values_of(names, level, heights, ground.missing, joined(*pair, run.depths), run.threads)
    return whole_mask(entry.mask, run.images.get(entry.mask.image), level, heights, read)


def _is_let(level: Level, mask: np.ndarray | None) -> np.ndarray:
    """bool [tiles]: whether a mask lets anything through."""
    let = np.ones(level.tile_count, bool)
    if mask is not None:
        let[:] = [mask[level.window(tile, BAND, BAND)].any() for tile in range(level.tile_count)]
    return let


def _heights(ground: LevelGround, total: np.ndarray, window: Window) -> np.ndarray:
    return ground.heights[window] + total[window]


def _entry(run: Shaping, work: Work, number: int, tiles: list[int], coarse: Sequence[np.ndarray] | None):
    """The change of an entry at a level, its parts, each [rows, columns]; what it has added in each tile: most and
    sum of squares by sample; and the figures."""
    level, entry = work.level, work.entry
    how = run.plan.how(entry, level)
    before, start = run.cache.made[entry.effect], time.perf_counter()
    most, squares = np.zeros(level.tile_count), np.zeros(level.tile_count)
    count = None if how == WHOLE else parts(entry.declaration, level)
    up = None if coarse is None else [finer(array, level.shape) for array in coarse[:count]]
    if how == UPSAMPLED:
        return up, most, squares, None
    if how == TILES:
        change, made = up, tiles
        _put_tiles(run, work, tiles, coarse, change, most, squares)
    else:
        cost = run.plan.cost(entry, level, None)
        told = run.progress(cost, level, entry)
        told(0.0)
        change, made = apply_whole(work, None if up is None else np.stack(up), told), range(level.tile_count)
        run.done += cost
        whole = slice(0, level.rows), slice(0, level.columns)
        delta = change[0] if up is None else change[0] - up[0]
        for tile in made:
            most[tile], squares[tile] = _sizes(delta, work.mask, whole, level.window(tile))
    rms = float(np.sqrt(squares[list(made)].mean())) if len(made) else 0.0
    computed = run.cache.made[entry.effect] - before
    spacing = max(level.step_x, level.step_y)
    count = len(made) if how == TILES else 1
    ms = (time.perf_counter() - start) * 1e3
    figures = Added(
        level.number, spacing, number, entry.effect, rms, float(most.max()), how == WHOLE, count, computed, ms
    )
    return change, most, squares, figures


def _put_tiles(
    run: Shaping,
    work: Work,
    tiles: list[int],
    coarse: Sequence[np.ndarray],
    change: list[np.ndarray],
    most: np.ndarray,
    squares: np.ndarray,
) -> None:
    """Make tiles, and put them into `change`, the coarser one's brought to this level; fills in their `most` and
    `squares`.

    By weights of what is there, not of what is added: a depth that is nowhere below 0 stays so, by the bit.
    """
    level, let = work.level, {tile for tile in tiles if is_let(work, tile)}
    rest = np.ones(level.shape, np.float32)
    for tile in let:
        rest[level.window(tile, BAND, BAND)] -= level.weights(tile)
    for part in change:
        part *= rest
    for tile in tiles:
        cost = run.plan.cost(work.entry, level, tile)
        told = run.progress(cost, level, work.entry)
        told(0.0)
        if tile in let:
            window, weights = level.window(tile, BAND, BAND), level.weights(tile)
            made = apply_tile(work, tile, coarse, told)
            for part, its in zip(change, made, strict=True):
                part[window] += its * weights
            added = made[0] - finer_window(coarse[0], *window)
            most[tile], squares[tile] = _sizes(added, work.mask, window, level.window(tile))
        run.done += cost


def _sizes(delta: np.ndarray, mask: np.ndarray | None, window, core) -> tuple[float, float]:
    """Most, and mean square, of a tile's own part of what was added in a window, as much of it as the mask lets."""
    own = tuple(slice(c.start - w.start, c.stop - w.start) for c, w in zip(core, window, strict=True))
    part = delta[own] if mask is None else delta[own] * mask[core]
    return float(np.abs(part).max()), float(np.square(part, dtype=np.float64).mean())


def _put_on(
    entry: Entry,
    change: Sequence[np.ndarray],
    mask: np.ndarray | None,
    ground: LevelGround,
    layers: dict[str, np.ndarray],
) -> np.ndarray:
    """The heights that an entry adds; its layers are put into `layers`. Nothing is copied that need not be: at a fine
    level an array takes hundreds of megabytes."""
    shown = masked(entry.declaration, unpacked(entry.declaration, change), mask)
    for layer in entry.declaration.layers:
        array = _without(ground.missing, shown.layers[layer.name])
        add = layer.per_metre and layer.name in layers
        layers[layer.name] = layers[layer.name] + array if add else array
        if add and not layer.signed:
            # Around a tile that was asked for alone an effect may take more of a depth than those before it have left
            # there: it saw the tile's own ground, and what is there is blended with coarser ground.
            np.maximum(layers[layer.name], np.float32(0.0), out=layers[layer.name])
    return _without(ground.missing, shown.heights)


def _without(missing: np.ndarray | None, samples: np.ndarray) -> np.ndarray:
    """0 in holes, into which a coarser level's samples are taken from beside them."""
    return samples if missing is None else np.where(missing, np.float32(0.0), samples)


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
        total, layers = _without(missing, total), {name: _without(missing, a) for name, a in layers.items()}
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
