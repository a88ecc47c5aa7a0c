# SPDX-License-Identifier: GPL-3.0-or-later
"""Height and normal of a point of the lattice while it geomorphs.

A split vertex v rises by W of its surplus, which is its height less the mean of the ends of the edge that it splits:

    z(v) = (z(l) + z(r)) / 2 + W(ratio(v)) (h(v) - (h(l) + h(r)) / 2)

Its normal turns by the same weight, from the mean of the two ends' normals to that of the surface, n:

    N(v) = unit((1 - W) (N(l) + N(r)) / 2 + W n(v))

A point whose W is 1 is *settled*: z = h and N = n. Ratios are nested, so the ends of a settled point are settled, and
the recursion ends there. Sums over two settled ends depend on the terrain only. The next frame reuses them while both
ends are certainly settled.

`metres2` is the squared error of a point's diamond, m2, that the criterion compares; `settled_metres2` is the same of a
settled point, and 0 of others. `morphing`: the ramp of W and the records of both frames. `memory`: a thread's scratch.

Warp passes structs by value, and the compiler undoes that only of a function with one caller: here all have one. A
function that returns several structs still copies them, so the loop over waiting points is in `morphed_point`.
"""

import warp as wp

from ..detail.displace import with_detail
from ..field.detail import PackedLayers
from ..field.domain import Domain
from ..mesh.displace import normal_of, surface_at
from ..refine.diamond import Diamond, diamond_at, larger, metres2_of, rest_of, smaller
from ..refine.interval import ABOVE
from ..refine.pixels import CriterionArrays, finest, ratio2_at
from ..refine.stored_errors import error_at, reach_of
from .lattice import SplitVertex, depth_of, diamond_above, half_edge, split_vertex
from .state import NOWHERE, PENDING, REMEMBERED, Ends, Known, Memory, MorphedPoint, Morphing, Pending, Ramp, Relief


@wp.func
def surface_of(domain: Domain, layers: PackedLayers, p: wp.vec2i) -> wp.vec3d:
    """Return height (metres before scaling) and slopes (metres a cell) at point p, with all displacement layers."""
    g = surface_at(domain, p)
    if layers.count > 0:
        g = with_detail(domain, layers, p, g)
    return g


@wp.func
def relief_of(domain: Domain, a: SplitVertex):
    """Return heights (Relief) and `metres2` of the diamond split at a, on which the morph weight of a depends.

    The heights are metres: the box's lowest (infinite beyond the raster's border) and highest one, and the largest
    difference along an edge (rise).
    """
    r = Relief()
    d = diamond_at(domain, a.point[0], a.point[1], a.depth)
    r.low = wp.where(d.border == 2, wp.float64(wp.inf), d.low[2])
    r.high = d.high[2]
    r.rise = d.rise
    # `rest_of` is the error of float32 positions.
    return r, metres2_of(domain, error_at(domain, a.point[0], a.point[1], a.depth), rest_of(domain, d))


@wp.func
def ratio2_of(
    domain: Domain, criterion: CriterionArrays, a: SplitVertex, r: Relief, metres2: wp.float64, in_frame: wp.int32
):
    """Return the squared ratio of a vertex's diamond to the criterion, and its finest squared pixel footprint.

    The ratio is the largest of error, edges and area to their limits; the vertex's weight W depends on it. r, metres2:
    heights and squared error of the diamond, from `relief_of`. in_frame: 1 if all frustums are known to contain its
    box.
    """
    reach = reach_of(domain.unit_bits, a.depth)
    d = Diamond()
    d.low = wp.vec3d(
        domain.west + wp.float64(a.point[0] - reach) * domain.unit_x,
        domain.south + wp.float64(a.point[1] - reach) * domain.unit_y,
        r.low,
    )
    d.high = wp.vec3d(
        domain.west + wp.float64(a.point[0] + reach) * domain.unit_x,
        domain.south + wp.float64(a.point[1] + reach) * domain.unit_y,
        r.high,
    )
    d.border = wp.where(r.low == wp.float64(wp.inf), 2, 0)  # 2: beyond the raster's border
    pixel2, edge2 = finest(criterion, d, in_frame)
    climb2 = r.rise * r.rise
    return ratio2_at(criterion, domain.unit_bits, a.depth, pixel2, edge2, metres2, climb2), pixel2


@wp.func
def weight_of(ramp: Ramp, ratio2: wp.float64) -> wp.float64:
    """Return the morph weight W of a point: 0 up to a ratio of 1, a smoothstep, and 1 from the ratio k on.

    The smoothstep is one of 1 - 1 / ratio, scaled by `ramp.steep` to reach 1 at k. ratio2: squared ratio of the point's
    diamond to the criterion, from `ratio2_of`. ramp: has the ratio k (`end2` is its square).
    """
    one = wp.float64(1.0)
    weight = one
    if ratio2 < ramp.end2:
        u = wp.clamp((one - one / wp.sqrt(larger(ratio2, one))) * ramp.steep, wp.float64(0.0), one)
        weight = u * u * (wp.float64(3.0) - wp.float64(2.0) * u)
    return weight


@wp.func
def memory_slot(memory: Memory, p: wp.vec2i) -> wp.int32:
    """Return the slot of the thread's hash table for point p; another point may replace it there."""
    mixed = p[0] * 73856093 ^ p[1] * 19349663
    return memory.slot * REMEMBERED + ((mixed ^ (mixed >> 15)) & (REMEMBERED - 1))


@wp.func
def forget_all(memory: Memory):
    """Empty the thread's hash table of points."""
    for k in range(REMEMBERED):
        memory.points[memory.slot * REMEMBERED + k].point = wp.vec2i(NOWHERE, NOWHERE)


@wp.func
def evaluate_point(
    domain: Domain,
    morphing: Morphing,
    point: wp.vec2i,
    depth: wp.int32,
    is_vertex: wp.bool,
    vertex: wp.int32,
    last: wp.int64,
    clear_below: wp.int32,
):
    """Return a point's morph weight W, its record, the surface there, and the squared metres of the finest pixel.

    The pixel is the finest on the point's diamond. point, depth: lattice point and depth of its diamond. is_vertex: it
    is vertex `vertex` itself, not an end that it depends on; record and relief are then written for the next frame.
    last: the vertex's number in the last frame, -1 for none; the record of such a vertex is read, and its surface is
    zero. clear_below: depth; the frustums contain the diamonds of all deeper points. If leaves are drawn as meshlets, a
    point is judged by the diamond `ramp.bisections` levels above, else that is 0. Points up to that depth have no
    diamond that judges them: their W is 1 and their pixel 0.
    """
    weight = wp.float64(1.0)
    pixel2 = wp.float64(0.0)
    surface = wp.vec3d()
    record = Known()
    record.metres2 = wp.float64(wp.inf)
    is_old = is_vertex and last >= wp.int64(0)
    if is_old:
        record = morphing.last_known[last]
    if depth > morphing.ramp.bisections:
        judged = SplitVertex()  # its diamond decides the point's W
        judged.point = point
        judged.depth = depth
        if morphing.ramp.bisections > 0:
            judged = diamond_above(domain.unit_bits, split_vertex(domain.unit_bits, point), morphing.ramp.bisections)
        relief = Relief()
        if is_old and record.is_settled == 0:
            relief = morphing.last_relief[last]
        else:
            relief, metres2 = relief_of(domain, judged)  # new, or settled in the last frame, which stored none
            record.metres2 = metres2
        in_frame = wp.where(is_vertex and depth > clear_below, 1, 0)
        ratio2, finest2 = ratio2_of(domain, morphing.criterion, judged, relief, record.metres2, in_frame)
        if morphing.ramp.limit != wp.float64(1.0):
            ratio2 = ratio2 / morphing.ramp.limit  # a triangle limit coarsens the criterion
        weight = weight_of(morphing.ramp, ratio2)
        pixel2 = finest2
        if is_vertex and weight < wp.float64(1.0):  # not settled, so that the next frame reads it
            morphing.relief[vertex] = relief
    if not is_old:
        surface = surface_of(domain, morphing.ramp.layers, point)
        record.height = surface[0]
        record.normal = normal_of(domain, surface)
    record.is_settled = wp.where(weight < wp.float64(1.0), 0, 1)
    if is_vertex:
        morphing.known[vertex] = record
    return weight, record, surface, pixel2


@wp.func
def add_end(ends: Ends, end: MorphedPoint) -> Ends:
    """Return the sums `ends` with one end of the edge added; of `settled_metres2`, they have the minimum."""
    ends.height += end.height
    ends.z += end.z
    ends.settled_metres2 = smaller(ends.settled_metres2, end.settled_metres2)
    n = wp.vec3d(wp.float64(end.normal[0]), wp.float64(end.normal[1]), wp.float64(end.normal[2]))
    ends.normal = ends.normal + n
    return ends


@wp.func
def morph_between(target: MorphedPoint, weight: wp.float64, ends: Ends) -> MorphedPoint:
    """Return a point in this frame: between the mean of its two ends (W = 0) and its surface (W = 1).

    target: height and normal of the surface at the point. weight: its W. ends: sums over the two ends of the edge that
    the point splits.
    """
    half = wp.float64(0.5)
    morphed = target
    morphed.z = half * ends.z + weight * (target.height - half * ends.height)
    n = wp.vec3d(wp.float64(target.normal[0]), wp.float64(target.normal[1]), wp.float64(target.normal[2])) * weight
    n += ends.normal * (half - half * weight)
    per_length = wp.float64(1.0) / wp.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    n = n * per_length
    morphed.normal = wp.vec3f(wp.float32(n[0]), wp.float32(n[1]), wp.float32(n[2]))
    return morphed


@wp.func
def settled_above(morphing: Morphing, pixel2: wp.float64) -> wp.float64:
    """Return the squared error, metres, above which a point has certainly settled, so that its record is reused.

    pixel2: squared metres that a pixel spans at most on the point's diamond. A point has settled at k times the
    permitted pixels of error: end2 is k squared, `limit` the squared factor by which the criterion is relaxed.
    """
    return pixel2 * morphing.ramp.end2 * morphing.ramp.limit * morphing.criterion.error_px2 * ABOVE


@wp.func
def has_settled(
    morphing: Morphing, memory: Memory, p: wp.vec2i, vertex: wp.int32, last: wp.int64, settled_above2: wp.float64
) -> wp.bool:
    """Return whether vertex `last` of the last frame had reached its final height (was settled) and still has it.

    Its record is then copied to `vertex` of this frame, and the point remembered in `memory`. p: its lattice point.
    settled_above2: squared error, m2, above which a point has settled, from `settled_above`.
    """
    known = morphing.last_known[last]
    is_settled = known.is_settled == 1 and known.metres2 > settled_above2
    if is_settled:
        morphed = MorphedPoint()
        morphed.point = p
        morphed.height = known.height
        morphed.z = known.height
        morphed.settled_metres2 = known.metres2
        morphed.normal = known.normal
        memory.points[memory_slot(memory, p)] = morphed
        morphing.known[vertex] = known
    return is_settled


@wp.func
def was_unsettled(morphing: Morphing, last: wp.int64) -> wp.bool:
    """Return whether vertex `last` of the last frame was not at its final height: only then it has records of its ends.

    The ends are those of the edge that it splits. last: its number, -1 for none, which gives False.
    """
    is_unsettled = wp.bool(False)
    if last >= wp.int64(0):
        is_unsettled = morphing.last_known[last].is_settled == 0
    return is_unsettled


@wp.func
def no_ends() -> Ends:
    """Return empty sums over the two ends of an edge, for `add_end`."""
    ends = Ends()
    ends.settled_metres2 = wp.float64(wp.inf)
    return ends


@wp.func
def wait_for_ends(memory: Memory, entry: wp.int32, target: MorphedPoint, weight: wp.float64, along: wp.vec2i):
    """Put a point on the stack of those that wait for the two ends of the edge that they split.

    entry: index in the stack `memory.pending`. target: the point with a W of 1. weight: its W. along: half of that
    edge, from `half_edge`.
    """
    waiting = Pending()
    waiting.left = target.point - along
    waiting.right = target.point + along
    waiting.target = target
    waiting.weight = weight
    waiting.ends = no_ends()
    memory.pending[entry] = waiting


@wp.func
def morphed_point(
    domain: Domain,
    morphing: Morphing,
    memory: Memory,
    p: wp.vec2i,
    vertex: wp.int32,
    last: wp.int64,
    clear_below: wp.int32,
):
    """Return a vertex at the lattice point p in this frame, and the surface there (zero for one of the last frame).

    Its ends must be known first, and theirs before; points that wait for them are on a stack, since kernels cannot
    recurse. All are remembered in `memory`, and the records of `vertex` are written for the next frame. last: its
    number in the last frame, -1: none. clear_below: depth; the frustums contain the diamonds of all deeper points.
    """
    first = memory.slot * PENDING  # the first entry of this thread's stack
    top = first - 1  # the last of the points that wait
    point = p
    morphed = MorphedPoint()
    ends = Ends()
    vertex_surface = wp.vec3d()
    is_settled = wp.bool(True)
    is_vertex = wp.bool(True)
    is_waiting = wp.bool(True)
    while is_waiting:
        entry = memory_slot(memory, point)
        is_known = wp.bool(False)
        if not is_vertex:
            morphed = memory.points[entry]
            is_known = morphed.point == point
        if not is_known:
            depth = depth_of(domain.unit_bits, point)
            weight, record, surface, pixel2 = evaluate_point(
                domain, morphing, point, depth, is_vertex, vertex, last, clear_below
            )
            is_known = weight >= wp.float64(1.0)  # settled: it needs no ends
            morphed.point = point
            morphed.height = record.height
            morphed.z = record.height
            morphed.settled_metres2 = wp.where(is_known, record.metres2, wp.float64(0.0))
            morphed.normal = record.normal
            if not is_known:
                if is_vertex and was_unsettled(morphing, last):
                    # Pixels on the diamonds of the two ends are no coarser than on this one.
                    ends = morphing.last_ends[last]
                    is_known = ends.settled_metres2 > settled_above(morphing, pixel2)
                if not is_known:  # Most often both ends are remembered.
                    along = half_edge(domain.unit_bits, point, depth)
                    left = memory.points[memory_slot(memory, point - along)]
                    right = memory.points[memory_slot(memory, point + along)]
                    is_known = left.point == point - along and right.point == point + along
                    ends = add_end(add_end(no_ends(), left), right)
                    if not is_known:
                        top += 1
                        wait_for_ends(memory, top, morphed, weight, along)
                if is_known:
                    morphed = morph_between(morphed, weight, ends)
            if is_known:
                memory.points[entry] = morphed
            if is_vertex:
                vertex_surface = surface
                is_settled = weight >= wp.float64(1.0)
            is_vertex = False
        while is_known and top >= first:  # the last point that waits gets an end; with both it is known, too
            waiting = memory.pending[top]
            ends = add_end(waiting.ends, morphed)
            waiting.ends = ends
            waiting.seen += 1
            is_known = waiting.seen == 2
            if is_known:
                morphed = morph_between(waiting.target, waiting.weight, ends)
                memory.points[memory_slot(memory, morphed.point)] = morphed
                top -= 1
            else:
                memory.pending[top] = waiting
        is_waiting = top >= first
        if is_waiting:
            point = wp.where(memory.pending[top].seen == 0, memory.pending[top].left, memory.pending[top].right)
    if not is_settled:
        morphing.ends[vertex] = ends
    return morphed, vertex_surface
