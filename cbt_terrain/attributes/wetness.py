# SPDX-License-Identifier: GPL-3.0-or-later
"""Wetness: the topographic wetness index."""

import math
from collections.abc import Mapping

import numpy as np

from ..run import launch
from ..run.buffers import flat, shared
from .attribute import AttributeDeclaration, Evaluate, SamplePoints, Wanted
from .flow import routed_level

# Smallest tangent of the slope; level ground would be infinitely wet.
MIN_TANGENT = 1e-3


def make(points: SamplePoints, wanted: Wanted, read: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Compute the topographic wetness index at points: ln of drainage area a metre of contour over the slope's tangent.

    The contour of a point has the mean side of a cell that flow was routed over. The tangent is at least MIN_TANGENT.
    wanted: unused, it has no parameters. read: `flow` float32 [n] m2 and `detail_normal` float32 [n, 3]. Returns
    {"wetness": float32 [n]}.
    """
    from ...kernels import wp
    from ...kernels.effects import flow as kernels

    lattice, out = points.field.lattice, np.empty(len(points), np.float32)
    width = math.sqrt(lattice.step_x * lattice.step_y) * 2 ** routed_level(points.field)
    arrays = flat(read["flow"], wp.float32), shared(read["detail_normal"], wp.vec3f), flat(out, wp.float32)
    inputs = [width, MIN_TANGENT, *arrays]
    launch.spread(kernels.wetness_at, len(points), inputs, step="flow", threads=points.threads, cost=2)
    return {"wetness": out}


def example(evaluate: Evaluate) -> None:
    """Assert the index of the second sample below the ridge of a roof of 30 degrees, which drains 2.5 samples.

    evaluate: returns an attribute at the samples of a raster, without the two outermost on each side.
    """
    x = np.arange(17, dtype=np.float32)
    slope = np.float32(10.0 * math.tan(math.radians(30)))
    wetness = evaluate("wetness", np.tile(-abs(x - 8.0) * slope, (9, 1)), step=10.0).reshape(5, 13)
    assert abs(wetness[2, 4] - math.log(25.0 / math.tan(math.radians(30)))) < 1e-4


WETNESS = AttributeDeclaration(
    name="wetness",
    about="Where water gathers: about 3 on slopes and 12 in valleys. The topographic wetness index: ln of the area "
    "that drains through a metre of contour over the slope's tangent",
    unit="",
    make=make,
    kernels=("effects.catchment", "effects.flow", "effects.pyramid", "effects.routing"),
    example=example,
    reads=("flow", "detail_normal"),
    halo="as flow",
    cost_ns=10,
    source="Beven and Kirkby 1979",
)
