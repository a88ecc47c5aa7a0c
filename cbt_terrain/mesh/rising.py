# SPDX-License-Identifier: GPL-3.0-or-later
"""How points rise to their places, as the kernels read it: cbt_terrain/view/morph.py says by what."""

from dataclasses import dataclass

from ...kernels.morph import state as kernels
from ...kernels.morph.state import PENDING, REMEMBERED, Ends, Known, Memory, MorphedPoint, Pending, Relief
from ...kernels.refine.pixels import CriterionArrays
from ..history.frame_history import FrameHistory
from ..run.buffers import Buffers, bind

RECORDS = {"known": Known, "relief": Relief, "ends": Ends}


@dataclass(frozen=True)
class Rising:
    """`asked`: what the leaves were refined for. `end`: the ratio, more than 1, at which a point is in its place.
    `relaxed`: the factor by which a triangle limit coarsened what was asked: where the ramp begins."""

    asked: CriterionArrays
    end: float
    relaxed: float

    def pack(self, layers, meshlet: int, vertices: int, history: FrameHistory) -> kernels.Morphing:
        """Return what the kernel reads. `coats`: of the detail, or None."""
        rising = kernels.Morphing()
        rising.asked, ramp = self.asked, rising.ramp
        ramp.limit, ramp.end2, ramp.steep = (
            self.relaxed * self.relaxed,
            self.end * self.end,
            1.0 / (1.0 - 1.0 / self.end),
        )
        ramp.bisections = 2 * meshlet
        if layers:
            ramp.layers = layers
        for name, dtype in RECORDS.items():
            written, last = history.next.arrays.get(name, vertices, dtype), history.last.arrays.get(name, 1, dtype)
            bind(rising, **{name: written, f"last_{name}": last})
        return rising


def memories(buffers: Buffers, threads: int) -> list[Memory]:
    """Scratch of so many threads."""
    arrays = {
        "points": buffers.get("rising_points", threads * int(REMEMBERED), MorphedPoint),
        "pending": buffers.get("rising_pending", threads * int(PENDING), Pending),
    }
    made = [Memory() for _ in range(threads)]
    for slot, memory in enumerate(made):
        bind(memory, slot=slot, **arrays)
    return made
