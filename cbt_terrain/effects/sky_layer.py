# SPDX-License-Identifier: GPL-3.0-or-later
"""The sky over a raster by sweeps: of every sample or, of a large raster, of the finest level of its pyramid that has
MOST_SAMPLES at most; of a coarse one, as a preview.

Kept with the field, and when it is complete in its store, under the last MOST_SCALES vertical scales. Who is stopped in
between goes on from the last whole azimuth.
"""

from contextlib import suppress

import numpy as np
import warp as wp

from ...kernels.effects import sweep as kernels
from ..field import store
from ..field.heightfield import HeightField
from ..run import launch, owned_files
from ..run.buffers import flat
from ..run.locks import caching
from ..run.owned_files import NotOursError
from .light import AZIMUTHS, azimuths
from .pyramid import level_of, level_with, shapes
from .whole import file_of, read_kept

# So that memory and the time of a step stay bounded.
MOST_SAMPLES = 1 << 25
VERSION = 1  # raised whenever values change
MOST_SCALES = 2
# A preview: from samples at multiples of 2^3 or more, this many at most, and half of the azimuths.
PREVIEW_LEVEL, PREVIEW_SAMPLES, PREVIEW_AZIMUTHS = 3, 300_000, AZIMUTHS // 2

# Kinds of what is kept; LOOKED: the scales whose layers were looked for in the store.
LAYER, PREVIEW, LOOKED = "sky", "coarse horizons", "looked for skies"


def layer_level(field: HeightField) -> int:
    """The level of the pyramid that the layer is of: the raster's size alone decides."""
    return level_with(field.lattice, MOST_SAMPLES)


def is_known(field: HeightField, scale: float) -> bool:
    """Whether the layer is complete, so that values from it take no time."""
    with caching:
        looked = field.found.setdefault((LOOKED,), set())
        if (LAYER, scale) not in field.found and scale not in looked:
            looked.add(scale)
            _recall(field, scale)
        return field.found.get((LAYER, scale), {}).get("azimuths") == AZIMUTHS


def sky_layer(field: HeightField, scale: float, threads: int) -> kernels.SkyLayer:
    """The sky over every sample under a vertical scale; made first, if it is not known."""
    state = _advanced(field, scale, threads)
    while state["azimuths"] < AZIMUTHS:
        state = _advanced(field, scale, threads)
    return _layer(field, state["sky"], layer_level(field))


def advance(field: HeightField, scale: float, threads: int) -> bool:
    """One azimuth more of the layer, if one is missing; returns whether it is complete."""
    return _advanced(field, scale, threads)["azimuths"] == AZIMUTHS


def _advanced(field: HeightField, scale: float, threads: int) -> dict:
    """What there is of the layer then: `sky`, float32 [rows, columns], of so many `azimuths`."""
    with caching:
        state = _begun(field, scale)
        if state["azimuths"] < AZIMUTHS:
            level = layer_level(field)
            steps = field.lattice.step_x * 2**level, field.lattice.step_y * 2**level
            heights = np.ascontiguousarray(level_of(field, level, threads))
            rows, columns = heights.shape
            azimuth, found = azimuths()[state["azimuths"]], np.empty(heights.shape, np.float32)
            sweep(heights, steps, azimuth, scale, threads, found)
            sums = state.pop("sky", None)  # while it changes there is none: a fork may come between
            sums = np.zeros(heights.shape, np.float32) if sums is None else sums
            sky = kernels.Sky()
            sky.rows, sky.columns = rows, columns
            sky.per_cell, sky.azimuth = wp.vec2f(scale / steps[0], scale / steps[1]), wp.vec2f(*azimuth)
            sky.share = 1.0 / AZIMUTHS
            sky.heights, sky.horizons, sky.out = (flat(a, wp.float32) for a in (heights, found, sums))
            launch.spread(kernels.add_sky, rows, [sky], step="light", threads=threads, cost=columns)
            state |= {"sky": sums, "azimuths": state["azimuths"] + 1}
            if state["azimuths"] == AZIMUTHS:
                _keep_in_store(field, scale, sums)
        return state


def _begun(field: HeightField, scale: float) -> dict:
    """What is there of the layer, in memory or in the store."""
    if (LAYER, scale) not in field.found:
        _recall(field, scale)
    state = _kept(field, LAYER, scale)
    if "sky" not in state:
        state["azimuths"] = 0
    return state


def _recall(field: HeightField, scale: float) -> None:
    """Take it from the store, if that has it."""
    shape = shapes(field.lattice)[layer_level(field)]
    sky = read_kept(field, file_of(LAYER, VERSION, (scale,)), shape)
    if sky is not None:
        _kept(field, LAYER, scale).update(azimuths=AZIMUTHS, sky=sky)


def _keep_in_store(field: HeightField, scale: float, sky: np.ndarray) -> None:
    """Those of scales before the last MOST_SCALES are taken away."""
    file = file_of(LAYER, VERSION, (scale,))
    store.keep(field, file, sky)
    folder = store.data_folder(field)
    if folder is None or not owned_files.is_real_folder(field.path):
        return  # through a link that leads to a store nothing is removed
    with suppress(OSError, NotOursError):  # another process may do the same
        others = [f for f in folder.glob(f"effect_{LAYER}_*.npy") if f.stem != file]
        for old in sorted(others, key=lambda f: f.stat().st_mtime_ns)[: len(others) + 1 - MOST_SCALES]:
            owned_files.remove_file(old)


def preview_horizons(field: HeightField, scale: float, threads: int) -> kernels.SkyLayer:
    """The horizons of a coarser raster along the first PREVIEW_AZIMUTHS azimuths, one layer behind the other."""
    level = level_with(field.lattice, PREVIEW_SAMPLES, PREVIEW_LEVEL)
    with caching:
        state = _kept(field, PREVIEW, scale)
        if "horizons" not in state:
            heights = np.ascontiguousarray(level_of(field, level, threads))
            steps = field.lattice.step_x * 2**level, field.lattice.step_y * 2**level
            found = np.empty((PREVIEW_AZIMUTHS, *heights.shape), np.float32)
            for azimuth, out in zip(azimuths(), found, strict=False):
                sweep(heights, steps, azimuth, scale, threads, out)
            state["horizons"] = found
    return _layer(field, state["horizons"], level)


def sweep(
    heights: np.ndarray,
    steps: tuple[float, float],
    azimuth: np.ndarray,
    scale: float,
    threads: int,
    out: np.ndarray,
    first: tuple[int, int] = (0, 0),
) -> None:
    """Fill `out` (float32 [rows, columns]) with the slope of each sample's horizon, at least 0.

    heights: float32 [rows, columns], at least 2 each, metres, which count `scale` times; steps: metres of a cell.
    azimuth: float64 [2], unit length. first: row and column of sample [0, 0] in a larger raster, whose lines are taken.
    """
    rows, columns = heights.shape
    east, north = azimuth[0] / steps[0], azimuth[1] / steps[1]
    s, upright = kernels.Sweep(), abs(north) > abs(east)
    s.heights, s.scale = flat(heights, wp.float32), scale
    s.major, s.minor = (rows, columns) if upright else (columns, rows)
    s.major_stride, s.minor_stride = (columns, 1) if upright else (1, columns)
    along, across = (north, east) if upright else (east, north)
    s.backwards, s.slope, s.metres = int(along < 0.0), across / along, 1.0 / abs(along)
    s.phase = s.slope * first[0 if upright else 1] % 1.0
    reach = s.slope * (s.major - 1)
    s.first = int(np.floor(min(-reach, 0.0) - s.phase))
    # One line beyond the last sample: a sample is between a line, on which it may be, and the next.
    s.lines = int(np.floor(s.minor - 1 + max(-reach, 0.0))) - s.first + 2
    items = -(-s.lines // kernels.LINES)
    points = items * s.major
    s.profiles, s.hulls = flat(np.empty(points), wp.float64), flat(np.empty(points, np.int32), wp.int32)
    s.slopes, s.out = flat(np.empty(2 * points, np.float32), wp.float32), flat(out, wp.float32)
    launch.spread(kernels.sweep, items, [s], step="light", threads=threads, cost=2.0 * kernels.LINES * s.major)


def _kept(field: HeightField, kind: str, scale: float) -> dict:
    """What is kept of a kind under a vertical scale; that of scales before the last MOST_SCALES is dropped."""
    if (kind, scale) not in field.found:
        others = [key for key in field.found if key[0] == kind]
        for key in others[: len(others) + 1 - MOST_SCALES]:
            del field.found[key]
        field.found[kind, scale] = {}
    return field.found[kind, scale]


def _layer(field: HeightField, values: np.ndarray, level: int) -> kernels.SkyLayer:
    made, lattice = kernels.SkyLayer(), field.lattice
    made.values = flat(values, wp.float32)
    made.rows, made.columns = values.shape[-2:]
    made.west, made.south, _, _ = lattice.rectangle()
    made.step_x, made.step_y = lattice.step_x * 2**level, lattice.step_y * 2**level
    return made
