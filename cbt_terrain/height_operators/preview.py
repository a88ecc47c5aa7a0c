# SPDX-License-Identifier: GPL-3.0-or-later
"""A fast preview of a stack: its coarsest level, added to heights that the viewport shows until shaping is done.

Shaping starts from the same level, so that rivers are where they will be.
"""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..field.heightfield import HeightField
from ..run.locks import cached
from .height_operator import OperatorGround
from .interpolation import add_change, interpolate, interpolate_columns
from .level_work import LevelGround, zero_holes
from .levels import apply_mask
from .mask import HeightMask, compute_mask
from .mask_reads import values_of
from .prepare import prepare
from .stack import Entry, Stack, check_by_products
from .stack_layers import merge_layers
from .tile_cache import compute_digest
from .tiles import Level, levels_of

# Samples along the longer side of the preview, whose errors are computed in a fraction of a second.
MAX_PREVIEW_SAMPLES = 1025
SECONDS = 10.0  # time limit; a preview leaves out the remaining operators
# Number of cached states of stacks' first entries, the most recently used ones. A state of 257 x 257 samples takes 1 MB
# (measured, alpine), one of 513 x 513 samples four times as much.
MAX_CACHED = 32
_CACHE_KEY = ("land preview",)  # key in FieldCache.results


class _TooSlow(Exception):
    """An operator exceeded the time limit of the preview."""


@dataclass
class _Applied:
    """The coarsest level after the first entries of a stack."""

    ground: OperatorGround
    change: np.ndarray  # sum of the entries' changes, float32 [rows, columns] m
    key: str = ""  # digest of these entries
    ms: float = 0.0  # of the last entry


@dataclass
class Preview:
    """Heights in memory and how they were computed."""

    field: HeightField
    ms: list[float]  # of each applied entry
    step_m: float = 0.0  # metres between samples of the level that they were applied to
    left_out_entry: str = ""  # label of the first entry that the time limit left out, "" if there is none
    build_ms: float = 0.0  # of measuring errors


@dataclass
class _Layers(Mapping[str, np.ndarray]):
    """Layers of the coarsest level, interpolated to the preview's samples on first use."""

    coarse: Mapping[str, np.ndarray]
    rows: np.ndarray  # of the preview's samples, float64, in samples of the coarsest level
    columns: np.ndarray
    results: dict[str, np.ndarray] = field(default_factory=dict)

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a layer at the preview's samples, float32 [rows, columns], interpolated when it is first read."""
        if name not in self.results:
            self.results[name] = interpolate(self.coarse[name], self.rows, self.columns)
        return self.results[name]

    def __iter__(self) -> Iterator[str]:
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
    """Return the whole terrain with the coarsest level of a stack, at most MAX_PREVIEW_SAMPLES along a side.

    Leading entries that equal those of a recent preview of the same source are not applied again. Bounds on a mesh of
    the preview are measured against these heights, which lack the source's finer tiles.

    images: mask images by file name, float32 [rows, columns], row 0 south. seconds: time limit of the operators. Raises
    TerrainError for a mask that reads a missing layer.
    """
    from ..field.build import from_array

    check_by_products(stack, source.layers)
    level = levels_of(source.lattice)[-1]
    states = _apply_entries(source, level, stack, images or {}, threads, seconds)
    lattice, positions = source.lattice, _positions(source)  # rows and columns in the source of the preview's samples
    rows, columns = (position / (1 << level.number) for position in positions)  # in samples of the coarsest level
    before, change = states[0].ground.heights, states[-1].change  # of the coarsest level
    heights = add_change(_source_heights(source), before, change, rows=rows, columns=columns)
    step_y = lattice.step_y * (lattice.height - 1) / (len(positions[0]) - 1)
    step_x = lattice.step_x * (lattice.width - 1) / (len(positions[1]) - 1)
    if source.valid is not None:
        nearest = [np.rint(position).astype(np.int64) for position in positions]
        heights[source.valid[np.ix_(*nearest)] == 0] = np.nan
    start = time.perf_counter()
    result = from_array(
        heights, step_x, step_y, source_max=source.source_max, holes=source.valid is not None, threads=threads,
        origin=source.origin, crs=source.crs, provenance=source.provenance,
    )  # fmt: skip
    build_ms = (time.perf_counter() - start) * 1e3
    digest = compute_digest(result.raster.digest, stack.key())  # the key of the stack covers the layers
    layers = _Layers(states[-1].ground.layers, rows, columns)
    result = result.with_raster(digest=digest, layers=layers, place=source.raster.place)
    left_out = stack.active[len(states) - 1 :]
    left_out_entry = (left_out[0].name or left_out[0].declaration.label) if left_out else ""
    ms = [state.ms for state in states[1:]]  # states[0] is the ground before the first entry
    step_m = max(level.step_x, level.step_y)
    return Preview(result, ms=ms, step_m=step_m, left_out_entry=left_out_entry, build_ms=build_ms)


def _apply_entries(
    source: HeightField, level: Level, stack: Stack, images: Mapping, threads: int, seconds: float
) -> list[_Applied]:
    """Return the states before the first entry and after each active one, as far as the time limit allows.

    States are cached by content, so that a changed entry starts from the one before it. images: values of mask
    images by file. seconds: the limit.
    """
    prepare(stack)  # loads or compiles the kernels, which the time limit does not include
    end = time.monotonic() + seconds

    def check_time(_fraction: float) -> None:
        """Raise _TooSlow after the time limit; operators call it as their progress."""
        if time.monotonic() > end:
            raise _TooSlow

    cached_states = source.cache.results.get(_CACHE_KEY, {})  # by their keys, the least recently used first
    # The state before the first entry has an empty key.
    start = cached_states.get("") or _Applied(_ground(source, level), np.zeros(level.shape, np.float32))
    states = [start]
    for entry in stack.active:
        key = compute_digest(states[-1].key, Stack((entry,)).key())
        if key in cached_states:
            states.append(cached_states[key])
            continue
        mask = None
        if entry.mask is not None:
            mask = _compute_weights(entry.mask, images, level, states[-1].ground, threads)
        ground = replace(states[-1].ground, seed=entry.seed, threads=threads, mask=mask, progress=check_time)
        try:
            check_time(0.0)
            states.append(_apply_entry(states[-1], ground, entry, key))
        except _TooSlow:
            break
    used = {state.key: state for state in states}
    others = [key for key in cached_states if key not in used]
    recent = others[max(len(others) + len(used) - MAX_CACHED, 0) :]
    source.cache.results[_CACHE_KEY] = {key: cached_states[key] for key in recent} | used
    return states


def _compute_weights(
    mask: HeightMask, images: Mapping, level: Level, ground: OperatorGround, threads: int
) -> np.ndarray:
    """Return an entry's mask at the preview's level, weights 0 to 1, float32 [rows, columns].

    images: values of mask images by file.
    """
    names = sorted({rule.of for rule in mask.rules})
    attributes = values_of(names, level, ground.heights.__getitem__, ground.missing, ground.layers, threads)
    return compute_mask(mask, images.get(mask.image), level, ground.heights.__getitem__, attributes)


def _ground(source: HeightField, level: Level) -> OperatorGround:
    """Return a level of the source as the ground that the first operator changes."""
    samples = LevelGround.of(source, level)
    heights = np.ascontiguousarray(samples.heights)
    return OperatorGround(
        heights,
        level.step_x,
        level.step_y,
        whole=level.shape,
        size=levels_of(source.lattice)[0].size,  # metres; `level` may extend beyond the raster
        level=level.number,
        missing=samples.missing,
        layers=samples.layers,
    )


def _apply_entry(before: _Applied, ground: OperatorGround, entry: Entry, key: str) -> _Applied:
    """Apply an entry and return the state after it.

    before: state that it starts from. ground: the same ground, with the entry's mask and seed. key: of the new state.
    Raises _TooSlow after the time limit.
    """
    start, effect = time.perf_counter(), entry.declaration
    change = apply_mask(effect, effect.apply(ground, entry.values, None), ground.mask)
    heights = zero_holes(ground.missing, change.heights)
    layers = merge_layers(ground.layers, change.layers, {layer.name for layer in effect.layers if layer.adds_up})
    after = replace(ground, heights=ground.heights + heights, mask=None, layers=layers)
    return _Applied(after, before.change + heights, key, (time.perf_counter() - start) * 1e3)


def _positions(source: HeightField) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows and columns of the source that the preview samples, float64, from border to border."""
    sides = source.lattice.height, source.lattice.width
    ratio = min(1.0, (MAX_PREVIEW_SAMPLES - 1) / (max(sides) - 1))
    rows, columns = (np.linspace(0.0, n - 1.0, max(2, round((n - 1) * ratio) + 1)) for n in sides)
    return rows, columns


def _source_heights(source: HeightField) -> np.ndarray:
    """Return the source's heights at the preview's samples, float32 [rows, columns], bilinear; cached with it."""
    key = (*_CACHE_KEY, "shown")

    def interpolate_rows() -> np.ndarray:
        """Interpolate the samples bilinearly, two rows of samples for each row of the preview."""
        rows, columns = _positions(source)
        low = np.minimum(rows.astype(np.int64), source.lattice.height - 2)
        south, north = (interpolate_columns(source.heights(low + more), columns) for more in (0, 1))
        fraction = (rows - low)[:, None].astype(np.float32)
        return south + fraction * (north - south)

    return cached(source.cache.results, key, interpolate_rows)
