# SPDX-License-Identifier: GPL-3.0-or-later
"""Sky: the visible fraction of the sky at a point.

Sweeps compute it once for every sample, and points interpolate it, so that a flight, another camera or a map costs next
to nothing. A raster of more than 2^25 samples uses a coarser level of its heights.
"""

import math
from collections.abc import Mapping

import numpy as np

from ..run import launch
from .attribute import AttributeDeclaration, Evaluate, Parameter, SamplePoints, Wanted
from .light import azimuths

FULL, PREVIEW = "FULL", "PREVIEW"


def make(points: SamplePoints, wanted: Wanted, read: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Compute the visible fraction of the sky at points, 0 to 1, from sweeps over the whole raster.

    wanted: {"sky": {"quality": FULL or PREVIEW}}; a preview uses coarse heights and fewer azimuths. read: unused.
    Returns {"sky": float32 [n]}.
    """
    from ...kernels import wp
    from ...kernels.effects.sweep import layer_at_points, sky_between
    from .occluder import launch_at_points, occluder_without_blocks
    from .sky_layer import PREVIEW_AZIMUTHS, preview_horizons, sky_layer

    field, scale, out = points.field, points.vertical_scale, np.empty(len(points), np.float32)
    if wanted["sky"]["quality"] == PREVIEW:
        directions = wp.array(azimuths()[:PREVIEW_AZIMUTHS], dtype=wp.vec2d, device=launch.DEVICE)
        inputs = [occluder_without_blocks(field, scale), preview_horizons(field, scale, points.threads), directions]
        launch_at_points(sky_between, points, inputs, out, cost=25.0)
    else:
        launch_at_points(layer_at_points, points, [sky_layer(field, scale, points.threads)], out, cost=2.0)
    return {"sky": out}


def example(evaluate: Evaluate) -> None:
    """Assert that a level plane sees all of the sky, and one of 60 degrees (1 + cos 60) / 2 = 3 / 4."""
    assert (evaluate("sky", np.zeros((9, 9)), step=5.0) == 1.0).all()
    steep = np.tile(np.arange(9) * 5.0 * math.sqrt(3.0), (9, 1))
    assert abs(evaluate("sky", steep, step=5.0) - 0.75).max() < 0.003


SKY = AttributeDeclaration(
    name="sky",
    about="Share of the sky that a point sees, weighted by the cosine about the ground's normal: 1 is all of it",
    unit="1",
    span=(0.0, 1.0),
    make=make,
    kernels=("effects.light", "effects.pyramid", "effects.sweep"),
    example=example,
    parameters=(Parameter("quality", FULL, 0, 0, "", f"{PREVIEW}: from coarse heights, for a view until it rests"),),
    scaled=False,
    halo="the whole raster",
    cost_ns=41000,
    source="Timonen and Westerholm 2010 (horizons, their integral); Tevs, Ihrke and Seidel 2008 (max mipmap)",
)
