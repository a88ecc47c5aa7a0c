# SPDX-License-Identifier: GPL-3.0-or-later
"""A coarse look at what a stack makes of a raster: for a viewport, while a slider moves."""

from collections.abc import Mapping

import numpy as np

from ..field.build import from_array
from ..field.heightfield import HeightField
from .level_work import LevelGround
from .shape import Shaping, run_levels
from .stack import Stack
from .stack_layers import joined, key_with
from .tile_cache import TileCache
from .tiles import levels_of


def preview(
    heights: HeightField, stack: Stack, images: Mapping[str, np.ndarray] | None = None, *, threads: int = 1, **asked
) -> HeightField:
    """The finest level that is worked on as a whole (513 samples along its longer side at most), as a field in memory.

    asked: cache, on_progress and finish as of `shape`. The field's key is that of what it holds.
    """
    levels = levels_of(heights.lattice)
    none = [{} for _ in levels]
    run = Shaping(heights, stack.active, images or {}, none, asked.pop("cache", None) or TileCache(), threads, **asked)
    state, _ = run_levels(run)
    level = next(level for level in levels if level.is_whole) if state is None else state.level
    ground = LevelGround.of(heights, level)
    samples = np.array(ground.heights, np.float32)
    layers = {name: np.ascontiguousarray(layer) for name, layer in ground.layers.items()}
    if state is not None:
        samples += state.total
        layers = joined(layers, state.layers, run.depths)
    if ground.missing is not None:
        samples[ground.missing] = np.nan
    details = {"origin": heights.origin, "crs": heights.crs, "holes": heights.valid is not None, "threads": threads}
    made = from_array(samples, level.step_x, level.step_y, source_max=heights.source_max, **details)
    made.layers = layers
    made.key = key_with(made.key, layers)
    return made
