# SPDX-License-Identifier: GPL-3.0-or-later
"""One height operator at one level: its input for a tile or the whole level, and its result, cached by content.

An *entry* is an operator of the stack with its parameters and mask. `land` has the changes and layers of those before.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..field.heightfield import HeightField
from .catalogue import key_name
from .height_operator import Change, HeightOperator, OperatorGround
from .level_plan import LevelPlan
from .levels import apply_mask
from .mask import compute_mask
from .mask_reads import values_of
from .stack import Entry
from .tile_cache import TileCache, compute_digest
from .tiles import Level, Window

# Raise it when results change although no operator's version does.
METHOD = 6
HOLES = 1  # likewise, for results on land with holes alone
Report = Callable[[float], None]
# The arrays of a change (`num_arrays`), each float32 [rows, columns].
Arrays = Sequence[np.ndarray] | np.ndarray


@dataclass(frozen=True, eq=False)
class LevelGround:
    """A raster's samples at a level: float32 heights in metres, bool missing or None, and the source's layers."""

    heights: np.ndarray
    missing: np.ndarray | None
    layers: Mapping[str, np.ndarray]

    @classmethod
    def of(cls, field: HeightField, level: Level) -> "LevelGround":
        """Return the samples of a height field that a level has, every 2^level-th along both axes, with layers.

        Holes are marked, their heights filled.
        """
        missing = None if field.valid is None else _samples_of(field.valid, level) == 0
        heights = _samples_of(field.samples, level)
        # With `steps`, samples are numbers that stand for heights.
        heights = heights if field.steps is None else field.steps.heights(heights)
        return cls(heights, missing, {name: _samples_of(field.layers[name], level) for name in field.layers})


def _samples_of(samples: np.ndarray, level: Level) -> np.ndarray:
    """Return the samples of a level; a position beyond the border has the last sample."""
    if level.number == 0:
        return samples
    rows, columns = (
        np.minimum(np.arange(n) << level.number, count - 1) for n, count in zip(level.shape, samples.shape, strict=True)
    )
    return samples[np.ix_(rows, columns)]


@dataclass(eq=False)
class LandWindow:
    """The sum of the changes and layers so far in a window of a level, float32 [rows, columns].

    Arrays of layers are replaced, never written into.
    """

    window: Window
    total: np.ndarray  # of the changes of heights, metres
    layers: dict[str, np.ndarray]

    def crop(self, window: Window) -> "LandWindow":
        """Return a smaller window of the level, as views. window: in samples of the level."""
        here = within(window, self.window)
        return LandWindow(window, self.total[here], {name: layer[here] for name, layer in self.layers.items()})


@dataclass(frozen=True, eq=False)
class LevelWork:
    """Input that all operators share at a level."""

    cache: TileCache
    plan: LevelPlan
    level: Level
    source: LevelGround
    images: Mapping[str, np.ndarray]  # of masks, by file name, float32 [rows, columns], row 0 south
    depths: set[str]  # names of the layers that are depths, which add up
    threads: int

    def mask(self, entry: Entry, land: LandWindow) -> np.ndarray | None:
        """Return an entry's mask over the land that the entries before it left, float32 [rows, columns]; None without.

        land: the window that it is computed for; the whole level if rules read forms of the ground such as curvature or
        flow (`LevelPlan.runs`).
        """
        if entry.mask is None:
            return None
        names = sorted({rule.of for rule in entry.mask.rules})
        layers = {name: self._layer(name, land) for name in names if name in {*land.layers, *self.source.layers}}
        heights, image = partial(self._heights, land), self.images.get(entry.mask.image)
        attributes = values_of(names, self.level, heights, self.source.missing, layers, self.threads)
        return compute_mask(entry.mask, image, self.level, heights, attributes, land.window)

    def _heights(self, land: LandWindow, window: Window) -> np.ndarray:
        """Return the ground in a window: the source's heights plus the change so far, float32 [rows, columns] m."""
        return self.source.heights[window] + land.total[within(window, land.window)]

    def ground(
        self, entry: Entry, land: LandWindow, mask: np.ndarray | None, report: Report, target: Window | None = None
    ) -> OperatorGround:
        """Return an operator's input in the window of `land`: the ground as earlier entries left it, holes and mask.

        Layers are those that the operator reads. target: window of the level whose change is needed (the rest is
        margin), None for all. report: gets progress, 0 to 1.
        """
        level, source, window = self.level, self.source, land.window
        names = [name for name in entry.declaration.reads if name in land.layers or name in source.layers]
        return OperatorGround(
            heights=self._heights(land, window),
            step_x=level.step_x,
            step_y=level.step_y,
            first=(window[0].start, window[1].start),
            whole=level.shape,
            size=self.plan.levels[0].size,  # of the raster, metres
            level=level.number,
            target=None if target is None else within(target, window),
            missing=None if source.missing is None else np.ascontiguousarray(source.missing[window]),
            mask=None if mask is None else np.ascontiguousarray(mask),
            layers={name: self._layer(name, land) for name in names},
            seed=entry.seed,
            threads=self.threads,
            progress=report,
        )

    def _layer(self, name: str, land: LandWindow) -> np.ndarray:
        """Return a layer as an operator finds it, float32 [rows, columns] in the layer's unit.

        The layer of earlier operators of the stack is added to the source's if it is a depth (`self.depths`), and
        replaces it if not.
        """
        current, source = land.layers.get(name), self.source.layers.get(name)
        source = None if source is None else source[land.window]
        if current is not None and source is not None and name in self.depths:
            return current + source
        return np.ascontiguousarray(source if current is None else current)

    def accumulate(self, entry: Entry, change: Arrays, mask: np.ndarray | None, land: LandWindow) -> np.ndarray:
        """Add an entry's layers to those of the land and return its masked change of heights, float32 metres.

        The caller adds that change to `land.total`. In holes it is 0, and so are the layers. change, mask: in the
        window of `land`. As little as possible is copied: an array of a fine level takes hundreds of megabytes.
        """
        missing = None if self.source.missing is None else self.source.missing[land.window]
        result = apply_mask(entry.declaration, unpacked(entry.declaration, change), mask)
        for layer in entry.declaration.layers:
            array = zero_holes(missing, result.layers[layer.name])
            if layer.adds_up and layer.name in land.layers:
                array = land.layers[layer.name] + array
                if not layer.signed:  # rounding, after an operator that removes all of a depth
                    array = np.maximum(array, np.float32(0.0), out=array)
            land.layers[layer.name] = array
        return zero_holes(missing, result.heights)


def zero_holes(missing: np.ndarray | None, samples: np.ndarray) -> np.ndarray:
    """Return samples with 0 in holes, where interpolation from a coarser level has values of their surroundings.

    missing: bool, holes; None for none.
    """
    return samples if missing is None else np.where(missing, np.float32(0.0), samples)


def _result_key(entry: Entry, ground: OperatorGround, coarser: np.ndarray | None, kind: str) -> str:
    """Return the digest of an operator's inputs, by which its result is cached.

    coarser: its interpolated coarser change, None at the coarsest level. kind: "whole" or "tile".
    """
    effect = entry.declaration
    method = METHOD, kind, key_name(effect.name), effect.version, sorted(entry.values.items()), ground.seed
    holes = () if ground.missing is None else (HOLES,)
    position = ground.first, ground.whole, ground.level, ground.step_x, ground.step_y, ground.size, ground.target
    mask = ground.mask if effect.masks else None  # the caller applies the mask of other operators to the result
    arrays = [ground.heights, ground.missing, mask, coarser]
    layers = [item for name in sorted(ground.layers) for item in (name, ground.layers[name])]
    return compute_digest((*method, *holes), position, *arrays, *layers)


def within(inner: Window, outer: Window) -> Window:
    """Return a window relative to the first sample of the window `outer`, which contains it. inner: that window."""
    rows, columns = (slice(i.start - o.start, i.stop - o.start) for i, o in zip(inner, outer, strict=True))
    return rows, columns


def _layer_names(effect: HeightOperator) -> list[str]:
    """Return the names of the layers that an operator writes."""
    return [layer.name for layer in effect.layers]


def num_arrays(effect: HeightOperator, level: Level) -> int:
    """Return the number of arrays of a change: heights, layers and, except at level 0, the operator's state."""
    return 1 + len(effect.layers) + (len(effect.state) if level.number else 0)


def unpacked(effect: HeightOperator, change: Arrays) -> Change:
    """Return the change that packed arrays, each float32 [rows, columns], stand for: heights, layers, then state."""
    end = 1 + len(effect.layers)
    state = dict(zip(effect.state, change[end:], strict=True)) if len(change) > end else {}
    return Change(change[0], dict(zip(_layer_names(effect), change[1:end], strict=True)), state)


def _pack_change(effect: HeightOperator, change: Change, count: int) -> np.ndarray:
    """Return a change as one array [count, rows, columns], for the cache: heights, layers, then state.

    Layers that the operator did not write are 0. count: `num_arrays`, which leaves out the state at level 0.
    """
    zeros, arrays = np.zeros_like(change.heights), change.layers | change.state
    names = [*_layer_names(effect), *effect.state][: count - 1]
    return np.stack([change.heights, *(arrays.get(name, zeros) for name in names)], dtype=np.float32)


def apply_whole(
    work: LevelWork,
    entry: Entry,
    land: LandWindow,
    mask: np.ndarray | None,
    coarser: np.ndarray | None,
    report: Report,
) -> np.ndarray:
    """Apply an operator to a whole level, or take its change from the cache.

    Returns the change as float32 [arrays, rows, columns]: heights, layers, then state for the next finer level.
    coarser: the change at the next coarser level, interpolated to this one; None at the coarsest. mask: weights 0 to 1,
    None for 1. report: gets the finished fraction.
    """
    effect, level = entry.declaration, work.level
    count = num_arrays(effect, level)
    ground = work.ground(entry, land, mask, report)

    def compute() -> np.ndarray:
        """Compute the change, where the cache has none."""
        start = None if coarser is None else unpacked(effect, coarser)
        return _pack_change(effect, effect.apply(ground, entry.values, start), count)

    return work.cache.take(effect.name, _result_key(entry, ground, coarser, "whole"), (count, *level.shape), compute)


def apply_tile(
    work: LevelWork,
    entry: Entry,
    land: LandWindow,
    mask: np.ndarray | None,
    coarser: np.ndarray,
    target: Window,
    report: Report,
) -> np.ndarray:
    """Apply an operator to a tile, or take its change from the cache.

    Returns the change as float32 [arrays, rows, columns] of `target`: heights, layers, then state for the next finer
    level. target: window of the level whose change is needed, inside that of `land`. mask, coarser: weights, and the
    change of the next coarser level, interpolated; both in the window of `land`. report: gets the finished fraction.
    """
    effect = entry.declaration
    count = num_arrays(effect, work.level)
    ground = work.ground(entry, land, mask, report, target)

    def compute() -> np.ndarray:
        """Compute the change of the window, where the cache has none."""
        change = _pack_change(effect, effect.apply(ground, entry.values, unpacked(effect, coarser)), count)
        rows, columns = within(target, land.window)
        return change[:, rows, columns]

    shape = count, *(axis.stop - axis.start for axis in target)
    return work.cache.take(effect.name, _result_key(entry, ground, coarser, "tile"), shape, compute)
