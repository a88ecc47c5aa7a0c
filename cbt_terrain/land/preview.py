# SPDX-License-Identifier: GPL-3.0-or-later
"""A stack at a glance: its coarsest level, for the whole, under heights that a viewport shows until the rest is there.

The level is the one that shaping the land begins with, so that rivers are where they are going to be.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..field.build import from_array
from ..field.heightfield import HeightField
from ..land_effects.land_effect import Change, Ground, LandEffect
from ..land_effects.levels import masked
from ..run.locks import cached
from .kernels_needed import prepare
from .level_work import LevelGround
from .mask import whole_mask
from .mask_reads import values_of
from .stack import Entry, Stack, check_by_products
from .stack_layers import joined
from .tile_cache import content_key
from .tiles import Level, levels_of

# Samples along the longer side of what is shown, at most: their errors are found in a fraction of a second.
MOST_SHOWN = 1025
SECONDS = 10.0  # after which a preview goes without the effects that are left
# What entries have made is kept for later stacks that begin alike: of so many, those used last. One holds 1 MB more of
# 257 x 257 samples (measured, alpine), four times as much of 513 x 513.
MOST_KEPT = 32
_FOUND = ("land preview",)  # in HeightField.found


class _TooSlow(Exception):
    """An effect takes longer than anyone would wait for a preview."""


@dataclass
class _Applied:
    """What some first entries of a stack have made of the coarsest level: the ground, what they have changed in all,
    what names these entries, and the milliseconds that the last one took."""

    ground: Ground
    change: np.ndarray
    key: str = ""
    ms: float = 0.0


@dataclass
class Preview:
    """`field`: heights in memory. `ms`: milliseconds of each active entry that is in it. `step_m`: metres between
    samples of the level that they were applied to. `without`: the entry before which it ends, as too slow, or "".
    """

    field: HeightField
    ms: list[float] = field(default_factory=list)
    step_m: float = 0.0
    without: str = ""


@dataclass
class _Layers(Mapping):
    """Layers of the coarsest level at the places that are shown, made when they are first asked for."""

    coarse: Mapping[str, np.ndarray]
    rows: np.ndarray
    columns: np.ndarray
    made: dict[str, np.ndarray] = field(default_factory=dict)

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.made:
            self.made[name] = _between(self.coarse[name], self.rows, self.columns)
        return self.made[name]

    def __iter__(self):
        return iter(self.coarse)

    def __len__(self) -> int:
        return len(self.coarse)


def preview(
    source: HeightField,
    stack: Stack,
    images: Mapping[str, np.ndarray] | None = None,
    threads: int = 1,
    seconds: float = SECONDS,
) -> Preview:
    """The whole terrain with the coarsest level of a stack, at MOST_SHOWN samples along the longer side at most.

    Entries that begin as those of one of the last previews of the same source are not applied again: a moved slider
    takes its own entry and those below it. The bound on its mesh is against these heights.

    images: of masks, by file name, float32 [rows, columns], row 0 south. seconds: that effects may take.
    """
    check_by_products(stack, source.layers)
    level = levels_of(source.lattice)[-1]
    states = _apply(source, level, stack, images or {}, threads, seconds)
    lattice, places = source.lattice, _places(source)
    coarse = [at / (1 << level.number) for at in places]
    heights = _shown(source) + _between(states[-1].change, *coarse)
    step_y = lattice.step_y * (lattice.height - 1) / (len(places[0]) - 1)
    step_x = lattice.step_x * (lattice.width - 1) / (len(places[1]) - 1)
    if source.valid is not None:
        near = [np.rint(at).astype(np.int64) for at in places]
        heights[source.valid[np.ix_(*near)] == 0] = np.nan
    made = from_array(
        heights, step_x, step_y, source_max=source.source_max, holes=source.valid is not None, threads=threads,
        origin=source.origin, crs=source.crs, provenance=source.provenance,
    )  # fmt: skip
    made.key = content_key(made.key, stack.key())  # its layers count, too
    made.layers = _Layers(states[-1].ground.layers, *coarse)
    left = stack.active[len(states) - 1 :]
    without = (left[0].name or left[0].declaration.label) if left else ""
    return Preview(made, [state.ms for state in states[1:]], max(level.step_x, level.step_y), without)


def _apply(
    source: HeightField, level: Level, stack: Stack, images: Mapping, threads: int, seconds: float
) -> list[_Applied]:
    """The ground without any entry, and after each of the active ones until time is over; kept for the next call."""
    prepare(stack)
    end = time.monotonic() + seconds

    def go_on(_part: float) -> None:
        if time.monotonic() > end:
            raise _TooSlow

    kept = source.found.get(_FOUND, {})
    states = [kept[""] if kept else _Applied(_ground(source, level), np.zeros(level.shape, np.float32))]
    for entry in stack.active:
        key = content_key(states[-1].key, Stack((entry,)).key())
        if key in kept:
            states.append(kept[key])
            continue
        mask = None
        if entry.mask is not None:
            mask = _mask(entry, images, level, states[-1].ground, threads)
        ground = replace(states[-1].ground, seed=entry.seed, threads=threads, mask=mask, progress=go_on)
        try:
            go_on(0.0)
            states.append(_after(states[-1], ground, entry, key))
        except _TooSlow:
            break
    used = {state.key: state for state in states}
    others = [key for key in kept if key not in used]
    source.found[_FOUND] = {key: kept[key] for key in others[max(len(others) + len(used) - MOST_KEPT, 0) :]} | used
    return states


def _mask(entry: Entry, images: Mapping, level: Level, ground: Ground, threads: int) -> np.ndarray:
    names = sorted({rule.of for rule in entry.mask.rules})
    read = values_of(names, level, ground.heights.__getitem__, ground.missing, ground.layers, threads)
    return whole_mask(entry.mask, images.get(entry.mask.image), level, ground.heights.__getitem__, read)


def _ground(source: HeightField, level: Level) -> Ground:
    found = LevelGround.of(source, level)
    heights = np.ascontiguousarray(found.heights)
    return Ground(
        heights,
        level.step_x,
        level.step_y,
        whole=level.shape,
        size=levels_of(source.lattice)[0].size,
        level=level.number,
        missing=found.missing,
        layers=found.layers,
    )


def _after(before: _Applied, ground: Ground, entry: Entry, key: str) -> _Applied:
    start, effect = time.perf_counter(), entry.declaration
    made = masked(effect, effect.apply(ground, entry.values, None), ground.mask)
    heights = made.heights
    if ground.missing is not None:
        heights = np.where(ground.missing, np.float32(0.0), heights)
    after = replace(ground, heights=ground.heights + heights, mask=None, layers=_with_layers(ground, effect, made))
    return _Applied(after, before.change + heights, key, (time.perf_counter() - start) * 1e3)


def _with_layers(ground: Ground, effect: LandEffect, made: Change) -> dict[str, np.ndarray]:
    """The layers of a stack after one more effect."""
    return joined(ground.layers, made.layers, {layer.name for layer in effect.layers if layer.per_metre})


def _places(source: HeightField) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the source at which heights are shown, float64: from rim to rim."""
    sides = source.lattice.height, source.lattice.width
    less = min(1.0, (MOST_SHOWN - 1) / (max(sides) - 1))
    return tuple(np.linspace(0.0, n - 1.0, max(2, round((n - 1) * less) + 1)) for n in sides)


def _shown(source: HeightField) -> np.ndarray:
    """float32, the source's heights at the places that are shown; kept for the next call."""
    key = (*_FOUND, "shown")

    def interpolate() -> np.ndarray:
        rows, columns = _places(source)
        low = np.minimum(rows.astype(np.int64), source.lattice.height - 2)
        pair = [_along(source.heights(low + more), columns) for more in (0, 1)]
        part = (rows - low)[:, None].astype(np.float32)
        return pair[0] + part * (pair[1] - pair[0])

    return cached(source.found, key, interpolate)


def _between(samples: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """float32 [rows, columns]: samples of a grid between which one goes straight."""
    low = np.minimum(rows.astype(np.int64), max(len(samples) - 2, 0))
    part = (rows - low)[:, None].astype(np.float32)
    across = _along(samples, columns)
    return across[low] + part * (across[np.minimum(low + 1, len(samples) - 1)] - across[low])


def _along(samples: np.ndarray, columns: np.ndarray) -> np.ndarray:
    last = samples.shape[1] - 1
    low = np.minimum(columns.astype(np.int64), max(last - 1, 0))
    part = (columns - low).astype(np.float32)
    left = samples[:, low]
    return left + part * (samples[:, np.minimum(low + 1, last)] - left)
