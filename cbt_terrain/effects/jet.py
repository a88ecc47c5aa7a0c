# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects that are functions of the ground's height and its derivatives at a place: one kernel makes all that are
wanted, because it takes the derivatives once."""

from collections.abc import Mapping

import numpy as np
import warp as wp

from ...kernels.effects import jet as kernels
from ..run import launch
from ..run.buffers import flat, shared
from .decals import tilt
from .effect import Places, Wanted
from .pyramid import ground

SOURCE = "Uniform cubic B-spline over a [1 2 1] pyramid (Burt 1981)"
HALO = "2 samples of the level"
# Effects -> fields of the kernel's Values, Warp's and numpy's shape of an element, and the bit that asks for it.
MADE = {
    "height": ("height", wp.float32, (), kernels.HEIGHT),
    "slope": ("slope", wp.float32, (), kernels.SLOPE),
    "aspect": ("aspect", wp.vec2f, (2,), kernels.ASPECT),
    "mean_curvature": ("mean_curvature", wp.float32, (), kernels.MEAN_CURVATURE),
    "profile_curvature": ("profile_curvature", wp.float32, (), kernels.PROFILE_CURVATURE),
    "plan_curvature": ("plan_curvature", wp.float32, (), kernels.PLAN_CURVATURE),
    "detail_normal": ("normal", wp.vec3f, (3,), kernels.NORMAL),
}


def make(places: Places, wanted: Wanted, read: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """See Make in effect.py."""
    values, made = kernels.Values(), {}
    for name in wanted:
        field, dtype, shape, _ = MADE[name]
        made[name] = np.empty((len(places), *shape), np.float32)
        setattr(values, field, shared(made[name], dtype))
    values.wanted = sum(MADE[name][3] for name in wanted)
    heights = ground(places.field, places.vertical_scale, places.vertical_offset, places.threads)
    inputs = [heights, shared(places.positions, wp.vec3f), flat(places.level, wp.float32), values]
    launch.spread(kernels.from_jets, len(places), inputs, step="jets", threads=places.threads, cost=6)
    if "detail_normal" in made:
        tilt(made["detail_normal"], wanted["detail_normal"].get("decals", ()), places)
    return made
