# SPDX-License-Identifier: GPL-3.0-or-later
"""How far below its place on the surface a point of the lattice still is.

A split vertex rises by W of its surplus, which is its height less the mean of the ends of the edge that it splits:

    z(v) = (z(l) + z(r)) / 2 + W(ratio(v)) (h(v) - (h(l) + h(r)) / 2)

So h - z, the residual, is the sum over v and all that it comes from of (1 - W) times surplus, halved with each edge.
Ratios are nested: what v comes from is nearer to its place than v is. Where W is 1 the sum is at its end.
"""

import warp as wp

from ..detail.displace import with_detail
from ..field.detail import Coats
from ..field.domain import Domain
from ..mesh.displace import surface_at
from ..refine.band import measured_at
from ..refine.diamond import larger
from ..refine.pixels import Asked
from ..refine.stored_errors import error_at
from .lattice import SplitVertex, above, depth_of, split_vertex

wp.set_module_options({"enable_backward": False})

REMEMBERED = wp.constant(1 << 12)  # lags in a table: neighbours on the curve come from the same points
FRONT = wp.constant(64)  # points that are still to be looked at: there are a few of each depth, and 40 depths
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
class Ahead:
    """A point that the one at hand comes from."""

    point: wp.vec2i
    depth: wp.int32
    part: wp.float64  # of its lag that counts


@wp.struct
class Memory:
    """Scratch of one thread: both begin at entry `slot` times their size."""

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
def ratio2_at(domain: Domain, asked: Asked, v: SplitVertex) -> wp.float64:
    """Squared: how many times too coarse the diamond of v would be, by what is asked for the most of."""
    error = error_at(domain, v.point[0], v.point[1], v.depth)
    m = measured_at(domain, asked, v.point[0], v.point[1], v.depth, error, 0)
    found = larger(m.metres2 / asked.metres2, m.metres2 / (m.pixel2 * asked.error_px2))
    found = larger((m.long2 + m.climb2) / (m.pixel2 * asked.edge_px2), found)
    return larger((m.legs2 + m.climb2) / (m.pixel2 * asked.area_px2), found)


@wp.func
def missing(ramp: Ramp, ratio2: wp.float64) -> wp.float64:
    """1 - W: 1 up to a ratio of 1, 0 from k on."""
    one = wp.float64(1.0)
    u = wp.clamp((one - one / wp.sqrt(larger(ratio2, one))) * ramp.steep, wp.float64(0.0), one)
    return one - u * u * (wp.float64(3.0) - wp.float64(2.0) * u)


@wp.func
def lag_of(domain: Domain, asked: Asked, ramp: Ramp, v: SplitVertex) -> wp.float64:
    """(1 - W) times the surplus of v: metres, before scaling; IN_PLACE where W is 1."""
    lag = wp.float64(wp.inf)
    if v.depth > ramp.bisections:
        judged = above(domain.unit_bits, v, ramp.bisections)
        ratio2 = ratio2_at(domain, asked, judged) / ramp.limit
        if ratio2 < ramp.end2:
            h = surface_of(domain, ramp.coats, v.point)[0]
            ends = surface_of(domain, ramp.coats, v.left)[0] + surface_of(domain, ramp.coats, v.right)[0]
            lag = missing(ramp, ratio2) * (h - wp.float64(0.5) * ends)
    return lag


@wp.func
def remembered_lag(domain: Domain, asked: Asked, ramp: Ramp, memory: Memory, v: SplitVertex) -> wp.float64:
    """As `lag_of`; what was asked for lately is looked up."""
    mixed = v.point[0] * 73856093 ^ v.point[1] * 19349663
    entry = memory.slot * REMEMBERED + ((mixed ^ (mixed >> 15)) & (REMEMBERED - 1))
    if not (memory.points[entry] == v.point):
        memory.points[entry] = v.point
        memory.lags[entry] = lag_of(domain, asked, ramp, v)
    return memory.lags[entry]


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
def residual_at(domain: Domain, asked: Asked, ramp: Ramp, memory: Memory, p: wp.vec2i) -> wp.float64:
    """Metres, before scaling, by which the point is below the surface (above it where negative)."""
    residual = wp.float64(0.0)
    count = look_ahead(memory, 0, domain.unit_bits, p, wp.float64(1.0))
    while count > 0:
        at = take_deepest(memory, count)
        count -= 1
        v = split_vertex(domain.unit_bits, at.point)
        lag = remembered_lag(domain, asked, ramp, memory, v)
        if lag != IN_PLACE:
            residual += at.part * lag
            count = look_ahead(memory, count, domain.unit_bits, v.left, wp.float64(0.5) * at.part)
            count = look_ahead(memory, count, domain.unit_bits, v.right, wp.float64(0.5) * at.part)
    return residual
