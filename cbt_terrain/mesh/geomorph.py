# SPDX-License-Identifier: GPL-3.0-or-later
"""Arguments of the geomorph kernels; cbt_terrain/view/morph.py defines the ramp."""

from dataclasses import dataclass

from ...kernels.field.detail import PackedLayers
from ...kernels.morph import state as kernels
from ...kernels.morph.state import PENDING, REMEMBERED, Ends, Known, Memory, MorphedPoint, Pending, Relief
from ...kernels.refine.pixels import CriterionArrays
from ..history.frame_history import FrameHistory
from ..run.buffers import Buffers, bind

RECORDS = {"known": Known, "relief": Relief, "ends": Ends}


@dataclass(frozen=True)
class Geomorph:
    """Parameters of the ramp on which points morph.

    `criterion`: the criterion that the leaves were refined for. `end`: the ratio of error to criterion, more than 1,
    at which a point is on the surface. `relaxed`: the factor by which a triangle limit coarsened the criterion; the
    ramp begins there.
    """

    criterion: CriterionArrays
    end: float
    relaxed: float

    def pack(
        self, layers: "PackedLayers | None", meshlet: int, vertices: int, history: FrameHistory
    ) -> kernels.Morphing:
        """Return the arguments of the geomorph kernels.

        They have the last frame's records of points (surface and error at each), from `history`, and room for those of
        the next frame. layers: packed displacement, None without one. meshlet: leaves are drawn as 4**meshlet
        triangles. vertices: number of points for which room is needed.
        """
        packed = kernels.Morphing()
        packed.criterion, ramp = self.criterion, packed.ramp
        ramp.limit, ramp.end2 = self.relaxed * self.relaxed, self.end * self.end  # the kernels compare squares
        # Times 1 - 1 / ratio, a point's fraction of the ramp: 1 where the ratio is `end`.
        ramp.steep = 1.0 / (1.0 - 1.0 / self.end)
        ramp.bisections = 2 * meshlet
        if layers:
            ramp.layers = layers
        for name, dtype in RECORDS.items():
            written, last = history.next.arrays.get(name, vertices, dtype), history.last.arrays.get(name, 1, dtype)
            bind(packed, **{name: written, f"last_{name}": last})
        return packed


def thread_memories(buffers: Buffers, threads: int) -> list[Memory]:
    """Return the scratch memory that each of `threads` slices needs to move points, with its number as `slot`."""
    arrays = {
        "points": buffers.get("morph_points", threads * int(REMEMBERED), MorphedPoint),
        "pending": buffers.get("morph_pending", threads * int(PENDING), Pending),
    }
    memories = [Memory() for _ in range(threads)]
    for slot, memory in enumerate(memories):
        bind(memory, slot=slot, **arrays)
    return memories
