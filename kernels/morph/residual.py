# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a point of the lattice stands while it rises to its place, and the normal that it has there.

A split vertex rises by W of its surplus, which is its height less the mean of the ends of the edge that it splits:

    z(v) = (z(l) + z(r)) / 2 + W(ratio(v)) (h(v) - (h(l) + h(r)) / 2)

Its normal turns by the same weight, from the mean of the two ends' normals to that of the surface, n:

    N(v) = unit((1 - W) (N(l) + N(r)) / 2 + W n(v))

Ratios are nested: what v comes from is nearer to its place than v is. Where W is 1 the recursion ends.

Warp passes structs by value, and the compiler undoes that only of a function with one caller: here all have one.
"""

import warp as wp

from ..detail.displace import with_detail
from ..field.detail import Coats
from ..field.domain import Domain
from ..mesh.displace import normal_of, surface_at
from ..refine.band import ABOVE
from ..refine.diamond import Diamond, diamond_at, larger, metres2_of, rest_of
from ..refine.pixels import Asked, finest, sizes
from ..refine.stored_errors import error_at, reach_of
from .lattice import SplitVertex, above, split_vertex

REMEMBERED = wp.constant(1 << 12)  # points in a table: neighbours on the curve come from the same ones
PENDING = wp.constant(64)  # points that wait for those they come from: at most one of each depth
NOWHERE = wp.constant(-1)


@wp.struct
class Ramp:
    """Where W rises from 0 to 1."""

    limit: wp.float64  # squares of ratios are those to what is asked over this
    end2: wp.float64  # squared ratio k at which a point is in its place
    steep: wp.float64  # 1 / (1 - 1 / k)
    bisections: wp.int32  # of meshlets: a point is judged by the diamond so many bisections above
    coats: Coats  # none: there is no detail


@wp.struct
class Known:
    """What no view changes of a point: of the diamond that it is judged by, and of itself."""

    low: wp.float64  # heights of the diamond's box, metres; infinite beyond the rim
    high: wp.float64
    rise: wp.float64  # as in Diamond
    metres2: wp.float64  # see `metres2_of`
    height: wp.float64  # of the surface at the point itself, metres before scaling
    normal: wp.vec3f  # of the surface there
    is_settled: wp.int32  # 1: its W was 1 in the frame that this is known of


@wp.struct
class Rising:
    """What points rise by; and what is known of each vertex, for the next frame and from the last one."""

    asked: Asked
    ramp: Ramp
    known: wp.array(dtype=Known)
    last_known: wp.array(dtype=Known)


@wp.struct
class Risen:
    """Where a point is."""

    point: wp.vec2i
    height: wp.float64  # of the surface, metres before scaling
    z: wp.float64  # of the point, metres before scaling
    normal: wp.vec3f


@wp.struct
class Ends:
    """Sums over the two ends of the edge that a point splits."""

    height: wp.float64
    z: wp.float64
    normal: wp.vec3d


@wp.struct
class Pending:
    """A point that waits for the two that it comes from."""

    left: wp.vec2i
    right: wp.vec2i
    own: Risen  # in its place
    weight: wp.float64  # its W
    seen: wp.int32  # how many of the two are in the sums
    ends: Ends


@wp.struct
class Memory:
    """Scratch of one thread: both begin at entry `slot` times their size."""

    slot: wp.int32
    points: wp.array(dtype=Risen)  # at NOWHERE: none
    pending: wp.array(dtype=Pending)


@wp.func
def surface_of(domain: Domain, coats: Coats, p: wp.vec2i) -> wp.vec3d:
    """Height and gradient (metres a cell) of the surface with its detail."""
    g = surface_at(domain, p)
    if coats.count > 0:
        g = with_detail(domain, coats, p, g)
    return g


@wp.func
def known_of(domain: Domain, a: SplitVertex) -> Known:
    """What can be known of a point that is judged by the diamond of `a` before any view sees it."""
    k = Known()
    d = diamond_at(domain, a.point[0], a.point[1], a.depth)
    k.low = wp.where(d.rim == 2, wp.float64(wp.inf), d.low[2])
    k.high = wp.where(d.rim == 2, wp.float64(wp.inf), d.high[2])
    k.rise = d.rise
    k.metres2 = metres2_of(domain, error_at(domain, a.point[0], a.point[1], a.depth), rest_of(domain, d))
    return k


@wp.func
def ratio2_of(domain: Domain, asked: Asked, a: SplitVertex, k: Known) -> wp.float64:
    """Squared: how many times too coarse the diamond of `a` would be, by what is asked for the most of."""
    reach = reach_of(domain.unit_bits, a.depth)
    d = Diamond()
    d.low = wp.vec3d(
        domain.west + wp.float64(a.point[0] - reach) * domain.unit_x,
        domain.south + wp.float64(a.point[1] - reach) * domain.unit_y,
        k.low,
    )
    d.high = wp.vec3d(
        domain.west + wp.float64(a.point[0] + reach) * domain.unit_x,
        domain.south + wp.float64(a.point[1] + reach) * domain.unit_y,
        k.high,
    )
    d.rim = wp.where(k.low == wp.float64(wp.inf), 2, 0)
    pixel2 = finest(asked, d, 0)
    found = larger(k.metres2 / asked.metres2, k.metres2 / (pixel2 * asked.error_px2))
    if asked.measures_edges == 1:
        long2, legs2 = sizes(asked, domain.unit_bits, a.depth)
        climb2 = k.rise * k.rise
        found = larger((long2 + climb2) / (pixel2 * asked.edge_px2), found)
        found = larger((legs2 + climb2) / (pixel2 * asked.area_px2), found)
    return found


@wp.func
def weight_of(ramp: Ramp, ratio2: wp.float64) -> wp.float64:
    """W: 0 up to a ratio of 1, 1 from k on."""
    one = wp.float64(1.0)
    weight = one
    if ratio2 < ramp.end2:
        u = wp.clamp((one - one / wp.sqrt(larger(ratio2, one))) * ramp.steep, wp.float64(0.0), one)
        weight = u * u * (wp.float64(3.0) - wp.float64(2.0) * u)
    return weight


@wp.func
def entry_of(memory: Memory, p: wp.vec2i) -> wp.int32:
    """Return the entry in which a point is remembered."""
    mixed = p[0] * 73856093 ^ p[1] * 19349663
    return memory.slot * REMEMBERED + ((mixed ^ (mixed >> 15)) & (REMEMBERED - 1))


@wp.func
def forget_all(memory: Memory):
    for k in range(REMEMBERED):
        memory.points[memory.slot * REMEMBERED + k].point = wp.vec2i(NOWHERE, NOWHERE)


@wp.func
def see(domain: Domain, rising: Rising, v: SplitVertex, is_own: wp.bool, vertex: wp.int32, last: wp.int64):
    """Return a point's W, what is known of it, and the surface there (not of a vertex of the last frame). What is known
    of the vertex at hand itself is kept."""
    weight = wp.float64(1.0)
    surface = wp.vec3d()
    known = Known()
    was_there = is_own and last >= wp.int64(0)
    if was_there:
        known = rising.last_known[last]
    if v.depth > rising.ramp.bisections:
        judged = above(domain.unit_bits, v, rising.ramp.bisections)
        if not was_there:
            known = known_of(domain, judged)
        weight = weight_of(rising.ramp, ratio2_of(domain, rising.asked, judged, known) / rising.ramp.limit)
    if not was_there:
        surface = surface_of(domain, rising.ramp.coats, v.point)
        known.height = surface[0]
        known.normal = normal_of(domain, surface)
    known.is_settled = wp.where(weight < wp.float64(1.0), 0, 1)
    if is_own:
        rising.known[vertex] = known
    return weight, known, surface


@wp.func
def with_end(ends: Ends, end: Risen) -> Ends:
    ends.height += end.height
    ends.z += end.z
    n = wp.vec3d(wp.float64(end.normal[0]), wp.float64(end.normal[1]), wp.float64(end.normal[2]))
    ends.normal = ends.normal + n
    return ends


@wp.func
def between(own: Risen, weight: wp.float64, ends: Ends) -> Risen:
    """Return where a point is whose place, W and two ends are known."""
    half = wp.float64(0.5)
    found = own
    found.z = half * ends.z + weight * (own.height - half * ends.height)
    n = wp.vec3d(wp.float64(own.normal[0]), wp.float64(own.normal[1]), wp.float64(own.normal[2])) * weight
    n += ends.normal * (half - half * weight)
    per_length = wp.float64(1.0) / wp.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    n = n * per_length
    found.normal = wp.vec3f(wp.float32(n[0]), wp.float32(n[1]), wp.float32(n[2]))
    return found


@wp.func
def settled_from(rising: Rising, coarse: wp.float64) -> wp.float64:
    """From how many `metres2` on points are in their places where no pixel spans more than `coarse` metres."""
    return coarse * coarse * rising.ramp.end2 * rising.ramp.limit * rising.asked.error_px2 * ABOVE


@wp.func
def has_settled(
    rising: Rising, memory: Memory, p: wp.vec2i, vertex: wp.int32, last: wp.int64, settled: wp.float64
) -> wp.bool:
    """Whether the vertex `last` of the last frame was in its place, and is: then what is known of it is kept."""
    known = rising.last_known[last]
    found = known.is_settled == 1 and known.metres2 > settled
    if found:
        there = Risen()
        there.point = p
        there.height = known.height
        there.z = known.height
        there.normal = known.normal
        memory.points[entry_of(memory, p)] = there
        rising.known[vertex] = known
    return found


@wp.func
def risen(domain: Domain, rising: Rising, memory: Memory, p: wp.vec2i, vertex: wp.int32, last: wp.int64):
    """Return where a vertex at the lattice point p is, and the surface there (not of a vertex of the last frame).

    `last`: which vertex of the last frame it was, -1: none.
    """
    first = memory.slot * PENDING
    top = first - 1  # the last of the points that wait
    at = p
    there = Risen()
    own_surface = wp.vec3d()
    is_own = wp.bool(True)
    goes_on = wp.bool(True)
    while goes_on:
        entry = entry_of(memory, at)
        there = memory.points[entry]
        is_known = wp.bool(True)
        if is_own or not (there.point == at):
            v = split_vertex(domain.unit_bits, at)
            weight, known, surface = see(domain, rising, v, is_own, vertex, last)
            if is_own:
                own_surface = surface
            is_own = False
            there.point = at
            there.height = known.height
            there.z = known.height
            there.normal = known.normal
            is_known = weight >= wp.float64(1.0)
            if not is_known:
                # Most often both ends are remembered.
                left = memory.points[entry_of(memory, v.left)]
                right = memory.points[entry_of(memory, v.right)]
                is_known = left.point == v.left and right.point == v.right
                if is_known:
                    there = between(there, weight, with_end(with_end(Ends(), left), right))
                else:
                    top += 1
                    waiting = Pending()
                    waiting.left = v.left
                    waiting.right = v.right
                    waiting.own = there
                    waiting.weight = weight
                    memory.pending[top] = waiting
            if is_known:
                memory.points[entry] = there
        while is_known and top >= first:
            waiting = memory.pending[top]
            waiting.ends = with_end(waiting.ends, there)
            waiting.seen += 1
            is_known = waiting.seen == 2
            if is_known:
                there = between(waiting.own, waiting.weight, waiting.ends)
                memory.points[entry_of(memory, there.point)] = there
                top -= 1
            else:
                memory.pending[top] = waiting
        goes_on = top >= first
        if goes_on:
            at = wp.where(memory.pending[top].seen == 0, memory.pending[top].left, memory.pending[top].right)
    return there, own_surface
