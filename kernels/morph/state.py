# SPDX-License-Identifier: GPL-3.0-or-later
"""State of geomorphing: the ramp, records of vertices that the next frame reuses, and scratch of one thread."""

import warp as wp

from ..field.detail import PackedLayers
from ..refine.pixels import CriterionArrays

REMEMBERED = wp.constant(1 << 12)  # points in a table: neighbours on the curve come from the same ones
PENDING = wp.constant(64)  # points that wait for those they come from: at most one of each depth
NOWHERE = wp.constant(-1)  # a coordinate of no lattice point


@wp.struct
class Ramp:
    """Parameters of the ramp on which the weight W increases from 0 to 1."""

    limit: wp.float64  # divisor of squared ratios: above 1 if a triangle limit coarsens the criterion
    end2: wp.float64  # squared ratio k at which a point reaches the surface
    steep: wp.float64  # 1 / (1 - 1 / k)
    bisections: wp.int32  # of meshlets: a point is judged by the diamond this number of bisections above
    layers: PackedLayers  # displacement layers; may be none


@wp.struct
class Known:
    """Surface at a vertex and the error of its diamond. No view changes them."""

    metres2: wp.float64  # squared metres that the criterion compares; infinite: its W is always 1
    height: wp.float64  # of the surface at the vertex, metres before scaling
    normal: wp.vec3f  # of the surface there
    is_settled: wp.int32  # 1: its W was 1 in the frame of this record


@wp.struct
class MorphedPoint:
    """Height and normal of a point in this frame."""

    point: wp.vec2i  # lattice units
    height: wp.float64  # of the surface, metres before scaling
    z: wp.float64  # of the point, metres before scaling
    settled_metres2: wp.float64  # its `metres2` if its W is 1, else 0
    normal: wp.vec3f


@wp.struct
class Ends:
    """Sums over the two ends of the edge that a point splits."""

    height: wp.float64  # of the surface, metres before scaling
    z: wp.float64  # of the points in this frame, metres before scaling
    normal: wp.vec3d
    settled_metres2: wp.float64  # minimum of the two, not their sum


@wp.struct
class Relief:
    """Heights of the diamond that a vertex is judged by, metres; `low` is infinite beyond the border."""

    low: wp.float64
    high: wp.float64
    rise: wp.float64  # largest height difference along one of its edges


@wp.struct
class Morphing:
    """The ramp, and records of each vertex for the next frame and from the last one."""

    criterion: CriterionArrays
    ramp: Ramp
    known: wp.array(dtype=Known)  # [vertices] of this frame; `last_` arrays are those of the last frame
    last_known: wp.array(dtype=Known)
    relief: wp.array(dtype=Relief)  # only of vertices that are not settled, as are their ends
    last_relief: wp.array(dtype=Relief)
    ends: wp.array(dtype=Ends)
    last_ends: wp.array(dtype=Ends)


@wp.struct
class Pending:
    """A point that waits for the two ends of the edge that it splits."""

    left: wp.vec2i  # the ends, lattice units
    right: wp.vec2i
    target: MorphedPoint  # the point with a W of 1
    weight: wp.float64  # its W
    seen: wp.int32  # number of ends in the sums, 0 .. 2
    ends: Ends


@wp.struct
class Memory:
    """Scratch of one thread: REMEMBERED entries of `points`, a hash table, and PENDING of `pending`, a stack."""

    slot: wp.int32  # number of the thread: its entries begin at `slot` times their number
    points: wp.array(dtype=MorphedPoint)  # an entry whose point is at NOWHERE is empty
    pending: wp.array(dtype=Pending)


for record in (Known, Relief, Ends):

    @wp.func_native("__builtin_prefetch(a.data + i);")
    def fetch(a: wp.array(dtype=record), i: wp.int64):
        """Start loading a[i] into the processor's cache. Nothing is read, so any index is allowed."""
        ...


@wp.func
def fetch_records(morphing: Morphing, last: wp.int64):
    """Prefetch the records of vertex `last` of the last frame into the processor's cache."""
    fetch(morphing.last_known, last)
    fetch(morphing.last_relief, last)
    fetch(morphing.last_ends, last)
