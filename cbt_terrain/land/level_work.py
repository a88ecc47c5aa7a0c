# SPDX-License-Identifier: GPL-3.0-or-later
"""One effect at one level: what it gets to see of a tile or of the whole, and what it makes of it, kept by content."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..field.heightfield import HeightField
from .land_effect import Change, Ground, LandEffect
from .level_plan import LevelPlan
from .levels import finer_window
from .stack import Entry
from .tile_cache import TileCache, content_key
from .tiles import BAND, Level, Window

# Changed when the same content would give other numbers though no effect's version has changed.
METHOD = 4
Tell = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class LevelGround:
    """A raster's samples at a level. `heights`: float32 metres. `missing`: bool, or None. `layers`: of the source."""

    heights: np.ndarray
    missing: np.ndarray | None
    layers: Mapping[str, np.ndarray]

    @classmethod
    def of(cls, field: HeightField, level: Level) -> "LevelGround":
        missing = None if field.valid is None else _every(field.valid, level) == 0
        heights = _every(field.samples, level)
        heights = heights if field.steps is None else field.steps.heights(heights)
        return cls(heights, missing, {name: _every(field.layers[name], level) for name in field.layers})


def _every(samples: np.ndarray, level: Level) -> np.ndarray:
    """The samples of a level; one beyond the rim is the last."""
    if level.number == 0:
        return samples
    some = samples[:: 1 << level.number, :: 1 << level.number]
    short = [(0, n - found) for n, found in zip(level.shape, some.shape, strict=True)]
    padded = np.ascontiguousarray(np.pad(some, short))
    if short[0][1]:
        padded[-1, : some.shape[1]] = samples[-1, :: 1 << level.number]
    if short[1][1]:
        padded[: some.shape[0], -1] = samples[:: 1 << level.number, -1]
    if short[0][1] and short[1][1]:
        padded[-1, -1] = samples[-1, -1]
    return padded


@dataclass(frozen=True, eq=False)
class Work:
    """An effect at a level. `total`: metres that effects before it have added; `layers`: what they have left, of which
    `depths` are depths. `mask`: float32 of the whole level, or None."""

    cache: TileCache
    plan: LevelPlan
    level: Level
    source: LevelGround
    entry: Entry
    total: np.ndarray
    layers: Mapping[str, np.ndarray]
    depths: set[str]
    mask: np.ndarray | None
    threads: int

    def ground(self, window: Window, tell: Tell, asked: Window | None = None) -> Ground:
        """What the effect sees of a window. asked: the part of it whose change is wanted, of the level."""
        level, source, effect = self.level, self.source, self.entry.declaration
        names = [name for name in effect.reads if name in self.layers or name in source.layers]
        return Ground(
            heights=source.heights[window] + self.total[window],
            step_x=level.step_x,
            step_y=level.step_y,
            first=(window[0].start, window[1].start),
            whole=level.shape,
            level=level.number,
            asked=None if asked is None else _within(asked, window),
            missing=None if source.missing is None else np.ascontiguousarray(source.missing[window]),
            mask=None if self.mask is None else np.ascontiguousarray(self.mask[window]),
            layers={name: self._layer(name, window) for name in names},
            seed=self.entry.seed,
            threads=self.threads,
            progress=tell,
        )

    def _layer(self, name: str, window: Window) -> np.ndarray:
        """What is there before the effect: of the source, and of the effects before it, which add depths and replace
        states."""
        own, before = self.layers.get(name), self.source.layers.get(name)
        if own is not None and before is not None and name in self.depths:
            return own[window] + before[window]
        return np.ascontiguousarray((before if own is None else own)[window])

    def key(self, ground: Ground, coarser: np.ndarray | None, kind: str) -> str:
        """Of all that the result is a function of."""
        effect = self.entry.declaration
        about = METHOD, kind, effect.name, effect.version, sorted(self.entry.values.items()), ground.seed
        place = ground.first, ground.whole, ground.level, ground.step_x, ground.step_y
        mask = ground.mask if effect.masks else None
        arrays = [ground.heights, ground.missing, mask, coarser]
        layers = [part for name in sorted(ground.layers) for part in (name, ground.layers[name])]
        return content_key(about, place, *arrays, *layers)


def _within(part: Window, window: Window) -> Window:
    rows, columns = (slice(p.start - w.start, p.stop - w.start) for p, w in zip(part, window, strict=True))
    return rows, columns


def _names(effect: LandEffect) -> list[str]:
    return [layer.name for layer in effect.layers]


def parts(effect: LandEffect, level: Level) -> int:
    """Of how many arrays the change of a level is made up: heights, layers, and what a finer level has to know."""
    return 1 + len(effect.layers) + (len(effect.kept) if level.number else 0)


def unpacked(effect: LandEffect, change: Sequence[np.ndarray]) -> Change:
    """A change of its `parts`, each float32 [rows, columns]: its heights first, then its layers as declared."""
    end = 1 + len(effect.layers)
    kept = dict(zip(effect.kept, change[end:], strict=True)) if len(change) > end else {}
    return Change(change[0], dict(zip(_names(effect), change[1:end], strict=True)), kept)


def _packed(effect: LandEffect, change: Change, count: int) -> np.ndarray:
    none, found = np.zeros_like(change.heights), change.layers | change.kept
    names = [*_names(effect), *effect.kept][: count - 1]
    return np.stack([change.heights, *(found.get(name, none) for name in names)], dtype=np.float32)


def apply_whole(work: Work, coarser: np.ndarray | None, tell: Tell) -> np.ndarray:
    """The change of a whole level, [parts, rows, columns]. coarser: the coarser level's, brought to this one."""
    effect, level = work.entry.declaration, work.level
    count = parts(effect, level)
    ground = work.ground((slice(0, level.rows), slice(0, level.columns)), tell)

    def make() -> np.ndarray:
        below = None if coarser is None else unpacked(effect, coarser)
        return _packed(effect, effect.apply(ground, work.entry.values, below), count)

    shape = count, *level.shape
    return work.cache.take(effect.name, work.key(ground, coarser, "whole"), shape, make)


def is_let(work: Work, tile: int) -> bool:
    """Whether an effect has anything to do with a tile; not where its mask lets nothing through."""
    if work.mask is None or work.entry.declaration.masks:
        return True
    return bool(work.mask[work.level.window(tile, BAND, BAND)].any())


def apply_tile(work: Work, tile: int, coarse: Sequence[np.ndarray], tell: Tell) -> np.ndarray:
    """The change of a tile, over its window with a BAND all round, [parts, rows, columns].

    coarse: [rows, columns] of the parts of the next coarser level.
    """
    effect, level = work.entry.declaration, work.level
    count = parts(effect, level)
    band = level.window(tile, BAND, BAND)
    rows, columns = work.plan.halo(work.entry, level)
    window = level.window(tile, BAND + rows, BAND + columns)
    ground = work.ground(window, tell, asked=band)
    coarser = np.stack([finer_window(array, *window) for array in coarse])

    def make() -> np.ndarray:
        made = _packed(effect, effect.apply(ground, work.entry.values, unpacked(effect, coarser)), count)
        return made[(slice(None), *ground.asked)]

    shape = count, *(part.stop - part.start for part in band)
    return work.cache.take(effect.name, work.key(ground, coarser, "tile"), shape, make)
