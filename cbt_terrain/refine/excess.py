# SPDX-License-Identifier: GPL-3.0-or-later
"""What a refinement could not keep to: the search for the ground that has most of it."""

import math
from dataclasses import dataclass

import warp as wp

from ...kernels.refine import excess as kernels
from ...kernels.refine.diamond import Asked, Domain
from ...kernels.refine.excess import AREA, EDGE, ERROR, FIXED, METRES
from ..run import launch
from ..run.buffers import Buffers

__all__ = ["AREA", "EDGE", "ERROR", "FIXED", "METRES", "Excess", "greatest"]


@dataclass(frozen=True)
class Excess:
    """The most that ground has of something: spans of a pixel, or metres. Of errors also the metres of it that cannot
    be refined away there, float32's and the source's, and all metres of it."""

    most: float
    fixed: float
    total: float


def greatest(domain: Domain, asked: Asked, what: int, depth: int, least: float, buffers: Buffers) -> Excess | None:
    """The most of `what` (FIXED, ERROR, EDGE, AREA: on ground in view; METRES: anywhere) that leaves at `depth` have,
    rounded up by a thousandth; None where none has more than `least`."""
    stack = buffers.get("excess_stack", kernels.STACK, kernels.Triangle)
    found = buffers.get("excess", 3, wp.float64)
    inputs = [domain, asked, what, depth, math.copysign(least * least, least), stack, found]
    launch.once(kernels.find_most, inputs, step="bound")
    most2, fixed, total = buffers.numpy("excess")[:3].tolist()
    return None if total < 0.0 else Excess(math.sqrt(most2), fixed, total)
