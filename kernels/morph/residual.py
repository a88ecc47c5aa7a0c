# SPDX-License-Identifier: GPL-3.0-or-later
"""How far below its place on the surface a point of the lattice still is.

A split vertex rises by W of its surplus, which is its height less the mean of the ends of the edge that it splits:

    z(v) = (z(l) + z(r)) / 2 + W(ratio(v)) (h(v) - (h(l) + h(r)) / 2)

So h - z, the residual, is the sum over v and all that it comes from of its *lag*, (1 - W) times its surplus, halved
with each edge. Ratios are nested: what v comes from is nearer to its place than v is. Where W is 1 the sum ends.

Warp passes structs by value, and the compiler undoes that only of a function with one caller: here all have one.
"""

import warp as wp

from ..detail.displace import with_detail
from ..field.detail import Coats
from ..field.domain import Domain
from ..mesh.displace import surface_at
from ..refine.band import ABOVE
from ..refine.diamond import Diamond, diamond_at, larger, metres2_of, rest_of
from ..refine.pixels import Asked, finest, sizes
from ..refine.stored_errors import error_at, reach_of
from .lattice import SplitVertex, above, depth_of, split_vertex

REMEMBERED = wp.constant(1 << 12)  # lags in a table: neighbours on the curve come from the same points
FRONT = wp.constant(8)  # points that are still to be looked at: three at most
IN_PLACE = wp.constant(wp.float64(wp.inf))  # the lag of a point whose W is 1
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
    height: wp.float64  # of the surface at the point itself, metres before scaling, as the surplus
    surplus: wp.float64  # NaN: not known, and where the vertex itself is meant, it is in its place


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

    surface: wp.vec3d  # height and gradient (metres a cell) of the surface there
    residual: wp.float64  # metres, before scaling, by which the point is below it (negative: above)


@wp.struct
class Ahead:
    """A point that the one at hand comes from."""

    point: wp.vec2i
    depth: wp.int32
    part: wp.float64  # of its lag that counts


@wp.struct
class Memory:
    """Scratch of one thread: all begin at entry `slot` times their size."""

    slot: wp.int32
    points: wp.array(dtype=wp.vec2i)  # whose lags are remembered; NOWHERE: none is
    lags: wp.array(dtype=wp.float64)
    front: wp.array(dtype=Ahead)


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
    k.surplus = wp.float64(wp.nan)
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
def missing(ramp: Ramp, ratio2: wp.float64) -> wp.float64:
    """1 - W: 1 up to a ratio of 1, 0 from k on."""
    one = wp.float64(1.0)
    part = wp.float64(0.0)
    if ratio2 < ramp.end2:
        u = wp.clamp((one - one / wp.sqrt(larger(ratio2, one))) * ramp.steep, wp.float64(0.0), one)
        part = one - u * u * (wp.float64(3.0) - wp.float64(2.0) * u)
    return part


@wp.func
def entry_of(memory: Memory, p: wp.vec2i) -> wp.int32:
    """Where the lag of a point is remembered."""
    mixed = p[0] * 73856093 ^ p[1] * 19349663
    return memory.slot * REMEMBERED + ((mixed ^ (mixed >> 15)) & (REMEMBERED - 1))


@wp.func
def forget_all(memory: Memory):
    for k in range(REMEMBERED):
        memory.points[memory.slot * REMEMBERED + k] = wp.vec2i(NOWHERE, NOWHERE)


@wp.func
def look_ahead(memory: Memory, count: wp.int32, unit_bits: wp.int32, p: wp.vec2i, part: wp.float64) -> wp.int32:
    """Put p among what is still to be looked at, once; returns how many there are. Corners are in their places."""
    first = memory.slot * FRONT
    k = wp.int32(0)
    while k < count and not (memory.front[first + k].point == p):
        k += 1
    if k < count:
        memory.front[first + k].part = memory.front[first + k].part + part
    else:
        depth = depth_of(unit_bits, p)
        if depth > 0 and count < FRONT:
            memory.front[first + k].point = p
            memory.front[first + k].depth = depth
            memory.front[first + k].part = part
            count += 1
    return count


@wp.func
def take_deepest(memory: Memory, count: wp.int32) -> Ahead:
    """Take the deepest of what is still to be looked at: nothing that is left comes from it."""
    first = memory.slot * FRONT
    best = wp.int32(0)
    for k in range(1, count):
        if memory.front[first + k].depth > memory.front[first + best].depth:
            best = k
    taken = memory.front[first + best]
    memory.front[first + best] = memory.front[first + count - 1]
    return taken


@wp.func
def see(domain: Domain, rising: Rising, v: SplitVertex, is_own: wp.bool, vertex: wp.int32, last: wp.int64):
    """The lag of a point, metres before scaling; and if it is that of the vertex at hand itself, the surface there (of
    one that was in the last frame the height alone), and what is known of it is kept."""
    lag = wp.float64(wp.inf)
    part = wp.float64(0.0)
    known = Known()
    was_there = is_own and last >= wp.int64(0)
    if was_there:
        known = rising.last_known[last]
    if v.depth > rising.ramp.bisections:
        judged = above(domain.unit_bits, v, rising.ramp.bisections)
        if not was_there:
            known = known_of(domain, judged)
        part = missing(rising.ramp, ratio2_of(domain, rising.asked, judged, known) / rising.ramp.limit)
    own = wp.vec3d(known.height, wp.float64(0.0), wp.float64(0.0))
    surplus = known.height
    is_new = part > wp.float64(0.0) and wp.isnan(known.surplus)
    for place in range(wp.int32(was_there), wp.where(is_new, 3, wp.int32(is_own))):
        p = v.point
        weight = wp.float64(1.0)
        if place > 0:
            p = wp.where(place == 1, v.left, v.right)
            weight = wp.float64(-0.5)
        g = surface_of(domain, rising.ramp.coats, p)
        surplus += weight * g[0]
        if place == 0:
            own = g
    known.height = own[0]
    if is_new:
        known.surplus = surplus
    if part > wp.float64(0.0):
        lag = part * known.surplus
    else:
        known.surplus = wp.float64(wp.nan)
    if is_own:
        rising.known[vertex] = known
    return lag, own


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
    found = wp.isnan(known.surplus) and known.metres2 > settled
    if found:
        entry = entry_of(memory, p)
        memory.points[entry] = p
        memory.lags[entry] = IN_PLACE
        rising.known[vertex] = known
    return found


@wp.func
def risen(domain: Domain, rising: Rising, memory: Memory, p: wp.vec2i, vertex: wp.int32, last: wp.int64) -> Risen:
    """A vertex at the lattice point p; `last`: which vertex of the last frame it was, -1: none."""
    found = Risen()
    at = Ahead()
    at.point = p
    at.part = wp.float64(1.0)
    is_own = wp.bool(True)
    count = wp.int32(0)  # points that are still to be looked at, beside this one
    while count >= 0:
        v = split_vertex(domain.unit_bits, at.point)
        entry = entry_of(memory, at.point)
        if is_own or not (memory.points[entry] == at.point):
            lag, surface = see(domain, rising, v, is_own, vertex, last)
            memory.points[entry] = at.point
            memory.lags[entry] = lag
            if is_own:
                found.surface = surface
            is_own = False
        if memory.lags[entry] != IN_PLACE:
            half = wp.float64(0.5) * at.part
            found.residual += at.part * memory.lags[entry]
            for side in range(2):
                count = look_ahead(memory, count, domain.unit_bits, wp.where(side == 0, v.left, v.right), half)
        count -= 1
        if count >= 0:
            at = take_deepest(memory, count + 1)
    return found
