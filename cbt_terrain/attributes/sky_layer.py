# SPDX-License-Identifier: GPL-3.0-or-later
"""The sky over a raster by sweeps.

It is computed at every sample or, for a large raster, at the finest level with at most MAX_SAMPLES; a preview uses a
coarse level.

It is cached with the field and, when complete, in its store, for the last MAX_SCALES vertical scales. An interrupted
computation continues from the last complete azimuth: its state is the number of `azimuths` that are complete, of
AZIMUTHS, and `sky`, the sum of their shares at each sample. Its arrays are those of one `process`.

Holes hide nothing. A missing sample has the sky of the nearest known one, for points between both.
"""

import os

import numpy as np
import warp as wp

from ...kernels.effects import sweep as kernels
from ..field.cleaning import fill_missing
from ..field.derived_arrays import samples_by_level, scratch_array
from ..field.heightfield import HeightField
from ..run import launch
from ..run.buffers import flat
from ..run.locks import caching
from .light import AZIMUTHS, azimuths
from .pyramid import level_of, level_with, missing_of_level
from .whole import read_stored, remove_old, result_file, write_result

# Bounds memory and the time of a step.
MAX_SAMPLES = 1 << 25
VERSION = 1  # raised whenever values change
HOLES_VERSION = 1  # raised whenever values of rasters with holes change; those without keep theirs
MAX_SCALES = 2
# A preview has samples at multiples of 2^3 or more, at most this many, and half of the azimuths.
PREVIEW_LEVEL, PREVIEW_SAMPLES, PREVIEW_AZIMUTHS = 3, 300_000, AZIMUTHS // 2

# Kinds of cache entries; LOOKED: scales whose layers were searched in the store.
LAYER, PREVIEW, LOOKED = "sky", "coarse horizons", "looked for skies"


def layer_level(field: HeightField) -> int:
    """Return the level of the height pyramid at which the sky is computed, which depends on the raster's size alone."""
    return level_with(field.lattice, MAX_SAMPLES)


def is_known(field: HeightField, scale: float) -> bool:
    """Return whether the sky at a vertical scale is complete, so that values from it take no time.

    The store is searched at the first call for a scale only.
    """
    with caching:
        looked = field.cache.results.setdefault((LOOKED,), set())
        if (LAYER, scale) not in field.cache.results and scale not in looked:
            looked.add(scale)
            _load_from_store(field, scale)
        return field.cache.results.get((LAYER, scale), {}).get("azimuths") == AZIMUTHS


def sky_layer(field: HeightField, scale: float, threads: int) -> kernels.SkyLayer:
    """Return the sky of every sample at a vertical scale; compute it if it is not cached."""
    state = _add_azimuth(field, scale, threads)
    while state["azimuths"] < AZIMUTHS:
        state = _add_azimuth(field, scale, threads)
    return _layer(field, state["sky"], layer_level(field))


def advance(field: HeightField, scale: float, threads: int) -> bool:
    """Add one azimuth to the sky over the raster if one is missing; return whether it is complete.

    scale: vertical scale.
    """
    return _add_azimuth(field, scale, threads)["azimuths"] == AZIMUTHS


def _add_azimuth(field: HeightField, scale: float, threads: int) -> dict:
    """Add one azimuth, if one is missing, to the sky over the raster and return the state.

    The state has `azimuths`, a number, and `sky`, float32 [rows, columns], 0 .. 1 when complete. Further calls complete
    it, so that a caller can show progress and stop between them. scale: vertical scale.
    """
    with caching:  # the lock of cached results
        state = _layer_state(field, scale)
        if state["azimuths"] < AZIMUTHS:
            level = layer_level(field)
            steps = field.lattice.step_x * 2**level, field.lattice.step_y * 2**level
            heights = np.ascontiguousarray(level_of(field.raster, level, threads))
            (rows, columns), missing = heights.shape, missing_of_level(field.raster, level)
            azimuth = azimuths()[state["azimuths"]]
            if "horizons" not in state:  # for all azimuths, because new files take a tenth of the time
                state["horizons"] = scratch_array(field.raster, heights.shape, np.float32)
            horizons = state["horizons"]
            sweep(heights, steps, azimuth, scale, threads, horizons, missing=missing)
            # Removed while the kernel adds: after an interruption no half-added sums remain, and it starts again.
            sums = state.pop("sky", None)
            if sums is None:
                sums = scratch_array(field.raster, heights.shape, np.float32)
                sums.fill(0.0)
            sky = kernels.Sky()
            sky.rows, sky.columns = rows, columns
            # Slopes are differences of heights times `per_cell`, which has the vertical scale in it.
            sky.per_cell, sky.azimuth = wp.vec2f(scale / steps[0], scale / steps[1]), wp.vec2f(*azimuth)
            sky.share = 1.0 / AZIMUTHS
            sky.heights, sky.horizons, sky.out = (flat(a, wp.float32) for a in (heights, horizons, sums))
            launch.spread(kernels.add_sky, rows, [sky], step="light", threads=threads, cost=columns)
            done = state["azimuths"] + 1
            if done == AZIMUTHS:
                _fill_holes(sums, missing, threads)
                file = _file_of(field, scale)
                sums = write_result(field, file, sums)  # mapped if it is in the store
                remove_old(field, f"effect_{LAYER}_*.npy", file, MAX_SCALES)
                del state["horizons"]
            state |= {"sky": sums, "azimuths": done}
        return state


def _layer_state(field: HeightField, scale: float) -> dict:
    """Return the state of the sky's computation from memory or from the store; a new one if it is in neither.

    It has the number of finished azimuths and the sum of the sky so far. scale: vertical scale.
    """
    if (LAYER, scale) not in field.cache.results:
        _load_from_store(field, scale)
    state = _cache_entry(field, LAYER, scale)
    if state.get("azimuths") != AZIMUTHS and state.get("process") != os.getpid():
        state.clear()  # a forked child begins again, because it shares these arrays with its parent
        state["process"] = os.getpid()
    if "sky" not in state:
        state["azimuths"] = 0
    return state


def _load_from_store(field: HeightField, scale: float) -> None:
    """Load the complete sky into the cache if the field's store has it. scale: vertical scale."""
    shape = samples_by_level(field.lattice)[layer_level(field)]
    sky = read_stored(field, _file_of(field, scale), shape)
    if sky is not None:
        _cache_entry(field, LAYER, scale).update(azimuths=AZIMUTHS, sky=sky)


def _file_of(field: HeightField, scale: float) -> str:
    """Return the name of the file in the store that has the sky at a vertical scale, without its suffix."""
    return result_file(LAYER, VERSION, (scale,) if field.valid is None else (scale, "holes", HOLES_VERSION))


def _fill_holes(values: np.ndarray, missing: np.ndarray | None, threads: int) -> None:
    """Give missing samples the value of the nearest known one, in place. missing: bool like values, None without any.

    Values stay as they are if all samples are missing, as can be on a coarse level.
    """
    if missing is not None and missing.any() and not missing.all():
        values[missing] = np.nan
        fill_missing(values, threads)


def preview_horizons(field: HeightField, scale: float, threads: int) -> kernels.SkyLayer:
    """Return the horizons of a coarser raster in the first PREVIEW_AZIMUTHS azimuths, for a fast preview.

    They are slopes, float32 [azimuths, rows, columns], packed for kernels and cached with the field. scale: vertical
    scale.
    """
    # The finest level from PREVIEW_LEVEL on with at most PREVIEW_SAMPLES samples.
    level = level_with(field.lattice, PREVIEW_SAMPLES, PREVIEW_LEVEL)
    with caching:
        state = _cache_entry(field, PREVIEW, scale)
        if "horizons" not in state:
            heights = np.ascontiguousarray(level_of(field.raster, level, threads))
            steps = field.lattice.step_x * 2**level, field.lattice.step_y * 2**level
            missing = missing_of_level(field.raster, level)
            horizons = np.empty((PREVIEW_AZIMUTHS, *heights.shape), np.float32)
            for azimuth, out in zip(azimuths(), horizons, strict=False):
                sweep(heights, steps, azimuth, scale, threads, out, missing=missing)
                _fill_holes(out, missing, threads)
            state["horizons"] = horizons
    return _layer(field, state["horizons"], level)


def sweep(
    heights: np.ndarray,
    steps: tuple[float, float],
    azimuth: np.ndarray,
    scale: float,
    threads: int,
    out: np.ndarray,
    first: tuple[int, int] = (0, 0),
    missing: np.ndarray | None = None,
) -> None:
    """Fill `out` (float32 [rows, columns]) with the slope of each sample's horizon, at least 0.

    Lines in the direction of the azimuth cross the raster. `major` is the axis (rows or columns) that is more nearly
    along them, `minor` the other one, along which lines are a sample apart.

    heights: float32 [rows, columns], at least 2 each, metres, multiplied by `scale` here. steps: metres of a cell.
    azimuth: float64 [2], unit vector to the east and north. first: row and column of sample [0, 0] in a larger raster,
    so that this part of it has the same lines. missing: bool like heights, samples in holes, which hide nothing and get
    values without a meaning; None without any.
    """
    rows, columns = heights.shape
    east, north = azimuth[0] / steps[0], azimuth[1] / steps[1]
    s, upright = kernels.Sweep(), abs(north) > abs(east)
    s.heights, s.scale = flat(heights, wp.float32), scale
    s.major, s.minor = (rows, columns) if upright else (columns, rows)
    s.major_stride, s.minor_stride = (columns, 1) if upright else (1, columns)
    along, across = (north, east) if upright else (east, north)
    if missing is not None:
        s.holed, s.missing = 1, flat(missing.view(np.uint8), wp.uint8)
    # From one sample along the major axis to the next, a line moves `slope` minor samples and is `metres` long.
    s.backwards, s.slope, s.metres = int(along < 0.0), across / along, 1.0 / abs(along)
    s.phase = s.slope * first[0 if upright else 1] % 1.0  # part of a sample by which the larger raster's lines shift
    reach = s.slope * (s.major - 1)  # samples that a line moves along the minor axis across the raster
    # A line's number is the minor sample, without the phase, where it is at major sample 0. The first one reaches minor
    # sample 0 at one of the two ends of the raster.
    s.first = int(np.floor(min(-reach, 0.0) - s.phase))
    # One line beyond the last sample, since a sample is on a line or between it and the next.
    s.lines = int(np.floor(s.minor - 1 + max(-reach, 0.0))) - s.first + 2
    items = -(-s.lines // kernels.LINES)  # of work: each sweeps LINES lines, one after another
    # Scratch of each item, for one line: the heights along it, and the convex hull of those already passed.
    points = items * s.major
    s.profiles, s.hulls = flat(np.empty(points), wp.float64), flat(np.empty(points, np.int32), wp.int32)
    slopes = np.empty(2 * points, np.float32)  # of a line and of the one before
    s.slopes, s.out = flat(slopes, wp.float32), flat(out, wp.float32)
    launch.spread(kernels.sweep, items, [s], step="light", threads=threads, cost=2.0 * kernels.LINES * s.major)


def _cache_entry(field: HeightField, kind: str, scale: float) -> dict:
    """Return the cache entry of a kind at a vertical scale; a new one replaces the oldest if there are MAX_SCALES."""
    if (kind, scale) not in field.cache.results:
        others = [key for key in field.cache.results if key[0] == kind]
        for key in others[: max(0, len(others) + 1 - MAX_SCALES)]:
            del field.cache.results[key]
        field.cache.results[kind, scale] = {}
    return field.cache.results[kind, scale]


def _layer(field: HeightField, values: np.ndarray, level: int) -> kernels.SkyLayer:
    """Return values (float32 [..., rows, columns]) at the samples of a level as a layer for kernels."""
    layer, lattice = kernels.SkyLayer(), field.lattice
    layer.values = flat(values, wp.float32)
    layer.rows, layer.columns = values.shape[-2:]
    layer.west, layer.south, _, _ = lattice.rectangle()
    layer.step_x, layer.step_y = lattice.step_x * 2**level, lattice.step_y * 2**level
    return layer
