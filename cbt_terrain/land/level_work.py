# SPDX-License-Identifier: GPL-3.0-or-later
"""One effect at one level: what it gets to see of a tile or of the whole, and what it makes of it, kept by content."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..field.heightfield import HeightField
from ..land_effects.land_effect import Change, Ground, LandEffect
from ..land_effects.levels import masked
from .level_plan import LevelPlan
from .mask import whole_mask
from .mask_reads import values_of
from .stack import Entry
from .tile_cache import TileCache, content_key
from .tiles import Level, Window

# Changed when the same content would give other numbers though no effect's version has changed.
METHOD = 6
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


@dataclass(eq=False)
class Land:
    """What effects have made of a window of a level so far. `total`: float32 [rows, columns] metres that they have
    added. `layers`: what they have left, likewise; arrays are replaced, not written."""

    window: Window
    total: np.ndarray
    layers: dict[str, np.ndarray]

    def part(self, window: Window) -> "Land":
        """A window of the level that lies in this one."""
        here = within(window, self.window)
        return Land(window, self.total[here], {name: layer[here] for name, layer in self.layers.items()})


@dataclass(frozen=True, eq=False)
class Work:
    """What all effects share at a level. `images`: of masks, by file name. `depths`: names of the layers that are."""

    cache: TileCache
    plan: LevelPlan
    level: Level
    source: LevelGround
    images: Mapping[str, np.ndarray]
    depths: set[str]
    threads: int

    def mask(self, entry: Entry, land: Land) -> np.ndarray | None:
        """How much of an entry is wanted, float32 [rows, columns] of the land, given what those before it have made."""
        if entry.mask is None:
            return None
        names = sorted({rule.of for rule in entry.mask.rules})
        layers = {name: self._layer(name, land) for name in names if name in {*land.layers, *self.source.layers}}
        heights, image = partial(self._heights, land), self.images.get(entry.mask.image)
        read = values_of(names, self.level, heights, self.source.missing, layers, self.threads)
        return whole_mask(entry.mask, image, self.level, heights, read, land.window)

    def _heights(self, land: Land, window: Window) -> np.ndarray:
        return self.source.heights[window] + land.total[within(window, land.window)]

    def ground(
        self, entry: Entry, land: Land, mask: np.ndarray | None, tell: Tell, asked: Window | None = None
    ) -> Ground:
        """What an effect sees of a land. asked: the part of it whose change is wanted, of the level."""
        level, source, window = self.level, self.source, land.window
        names = [name for name in entry.declaration.reads if name in land.layers or name in source.layers]
        return Ground(
            heights=self._heights(land, window),
            step_x=level.step_x,
            step_y=level.step_y,
            first=(window[0].start, window[1].start),
            whole=level.shape,
            size=self.plan.levels[0].size,
            level=level.number,
            asked=None if asked is None else within(asked, window),
            missing=None if source.missing is None else np.ascontiguousarray(source.missing[window]),
            mask=None if mask is None else np.ascontiguousarray(mask),
            layers={name: self._layer(name, land) for name in names},
            seed=entry.seed,
            threads=self.threads,
            progress=tell,
        )

    def _layer(self, name: str, land: Land) -> np.ndarray:
        """What is there before an effect: of the source, and of the effects before it, which add depths and replace
        states."""
        own, before = land.layers.get(name), self.source.layers.get(name)
        before = None if before is None else before[land.window]
        if own is not None and before is not None and name in self.depths:
            return own + before
        return np.ascontiguousarray(before if own is None else own)

    def put_on(self, entry: Entry, change: Sequence[np.ndarray], mask: np.ndarray | None, land: Land) -> np.ndarray:
        """The heights that an entry adds; its layers are put into those of the land. Nothing is copied that need not
        be: at a fine level an array takes hundreds of megabytes."""
        missing = None if self.source.missing is None else self.source.missing[land.window]
        shown = masked(entry.declaration, unpacked(entry.declaration, change), mask)
        for layer in entry.declaration.layers:
            array = without(missing, shown.layers[layer.name])
            if layer.per_metre and layer.name in land.layers:
                array = land.layers[layer.name] + array
                if not layer.signed:  # an effect may take all of a depth, but for rounding
                    array = np.maximum(array, np.float32(0.0), out=array)
            land.layers[layer.name] = array
        return without(missing, shown.heights)


def without(missing: np.ndarray | None, samples: np.ndarray) -> np.ndarray:
    """0 in holes, into which a coarser level's samples are taken from beside them."""
    return samples if missing is None else np.where(missing, np.float32(0.0), samples)


def _key(entry: Entry, ground: Ground, coarser: np.ndarray | None, kind: str) -> str:
    """Of all that a result is a function of."""
    effect = entry.declaration
    about = METHOD, kind, effect.name, effect.version, sorted(entry.values.items()), ground.seed
    place = ground.first, ground.whole, ground.level, ground.step_x, ground.step_y, ground.size, ground.asked
    mask = ground.mask if effect.masks else None
    arrays = [ground.heights, ground.missing, mask, coarser]
    layers = [part for name in sorted(ground.layers) for part in (name, ground.layers[name])]
    return content_key(about, place, *arrays, *layers)


def within(part: Window, window: Window) -> Window:
    """A window of the level, counted from the first sample of another that it lies in."""
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


def apply_whole(
    work: Work, entry: Entry, land: Land, mask: np.ndarray | None, coarser: np.ndarray | None, tell: Tell
) -> np.ndarray:
    """The change of a whole level, [parts, rows, columns]. coarser: the coarser level's, brought to this one."""
    effect, level = entry.declaration, work.level
    count = parts(effect, level)
    ground = work.ground(entry, land, mask, tell)

    def make() -> np.ndarray:
        below = None if coarser is None else unpacked(effect, coarser)
        return _packed(effect, effect.apply(ground, entry.values, below), count)

    return work.cache.take(effect.name, _key(entry, ground, coarser, "whole"), (count, *level.shape), make)


def apply_tile(
    work: Work, entry: Entry, land: Land, mask: np.ndarray | None, coarser: np.ndarray, asked: Window, tell: Tell
) -> np.ndarray:
    """The change of a part of a window of a level, [parts, rows, columns] of what is asked for.

    coarser: the change of the next coarser level brought to the window.
    """
    effect = entry.declaration
    count = parts(effect, work.level)
    ground = work.ground(entry, land, mask, tell, asked)

    def make() -> np.ndarray:
        made = _packed(effect, effect.apply(ground, entry.values, unpacked(effect, coarser)), count)
        return made[(slice(None), *ground.asked)]

    shape = count, *(part.stop - part.start for part in asked)
    return work.cache.take(effect.name, _key(entry, ground, coarser, "tile"), shape, make)
