# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a diamond's box is hidden by nearer ground, by a polar map of horizons about the eye.

The map is in squares, not circles: a point is at the distance max(|dx|, |dy|), in one of four sides of the eye, and
in one of BINS bins of the side by dy / dx (or dx / dy). So arcs are straight, and no sine and no logarithm is needed,
which differ from machine to machine. Slopes are heights above the eye by that distance: they order the rays of one
azimuth. Radii of the rings are the numbers with five bits behind their first: 2 - 3 % apart. (Of the demo's flight
twice as many rings save 1 % more triangles, four times as many bins 1 %.) Bins go once around the eye, from the south-
east on: those of the north and the west side against their dx / dy and dy / dx.

kernels/refine/horizon_map.py fills the map. Each entry has the slope below which all rays of its bin are behind ground
that is no farther than the ring, whatever mesh keeps what is asked; so entries rise with the ring. A box is hidden if
all rays to it are below the entries of the ring that is just nearer than all of it.

**Nested.** A box inside a hidden box is hidden: it begins no nearer, so its ring is no nearer and has no lower entries;
it meets none but the bins of the other; and no ray to it is higher. All this is done by differences, quotients and
comparisons, which are monotone in rounded arithmetic, too.

**It hides itself consistently.** Hidden ground, and ground outside the frame, is coarser than the map allows for the
ground in front. It needs no further lowering. Take a ray to a hidden box, in the frame, and of all rings whose entry
is above it the nearest. There the ray is lower than the surface less what the mesh may be off. The triangle that has
this place cannot be hidden: the ray would meet its box or pass below it, so be below a nearer ring's entry. If it is
outside the frame, its box does not hold the ray, which is in the frame; nor is the ray above the box, for it is below
the surface there: so it passes below the box, and below the triangle in it. If neither, the mesh keeps what is asked.
In all cases the ray is below the mesh, having been above it where it began. So the mesh hides the box. (So does the
surface itself: what true heights show is never called hidden.)

**By degrees.** Where points rise nothing may change at once. There a box is `covered` in part: by how far the highest
ray to it is below the entries, of a ramp; the last ring counts the more, the nearer it comes to the next, the one
before it wholly; and a bin beside the box counts less, the farther it is away, up to a bin. All of it goes on evenly
with the eye, as do the entries (`steady_least` in kernels/refine/horizon_map.py). Nothing is covered that is not
hidden; a box inside another is covered no less, in rounded arithmetic, too.
"""

import warp as wp

BINS = wp.constant(256)  # of each of the four sides
ROW = wp.constant(1024)  # of all: entries of a ring
RING_BITS = wp.constant(47)  # of a float64's 52 behind the first that tell no rings apart
# A box that meets more is not called hidden; so those below it that are hidden are found one by one.
MAX_BINS = wp.constant(256)


@wp.struct
class Rings:
    """A view's part of the map: first a row of floors, then a row a ring. No rings: nothing is hidden."""

    first: wp.int32  # number of the nearest ring
    count: wp.int32
    at: wp.int32  # entry of the floors: rays below them may have passed below the mesh before it begins


@wp.func
def ring_of(distance: wp.float64) -> wp.int32:
    """Number of the largest ring that is no farther."""
    return wp.int32(wp.cast(distance, wp.int64) >> wp.int64(RING_BITS))


@wp.func
def radius_of(ring: wp.int32) -> wp.float64:
    return wp.cast(wp.int64(ring) << wp.int64(RING_BITS), wp.float64)


@wp.func
def nearest_of(low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """Least distance, as above, of a box from the eye at 0."""
    across = wp.max(wp.max(low[0], -high[0]), wp.max(low[1], -high[1]))
    return wp.max(across, wp.float64(0.0))


@wp.func
def farthest_of(low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    return wp.max(wp.max(high[0], -low[0]), wp.max(high[1], -low[1]))


@wp.func
def bin_at(t: wp.float64) -> wp.int32:
    """The bin of dy / dx = t, which is -1 .. 1."""
    return wp.min(wp.int32((t + wp.float64(1.0)) * wp.float64(BINS / 2)), BINS - 1)


@wp.func
def reach_on(side: wp.int32, low: wp.vec3d, high: wp.vec3d, near: wp.float64) -> wp.vec2d:
    """Least and most dy / dx that a box at `near` has on a side (0 .. 3: east, north, west, south); (1, -1): none."""
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    along = side & 1  # the axis along which the side lies
    begin = wp.where(side < 2, low[along], -high[along])
    end = wp.where(side < 2, high[along], -low[along])
    begin = wp.max(begin, near)
    found = wp.vec2d(one, -one)
    if begin <= end:
        least = low[1 - along]
        most = high[1 - along]
        t0 = wp.where(least >= zero, least / end, least / begin)
        t1 = wp.where(most >= zero, most / begin, most / end)
        if t0 <= one and t1 >= -one:
            found = wp.vec2d(wp.max(t0, -one), wp.min(t1, one))
    return found


@wp.func
def is_turned(side: wp.int32) -> wp.bool:
    """Whether the bins of a side go against its dy / dx."""
    return side == 1 or side == 2


@wp.func
def bin_of(side: wp.int32, k: wp.int32) -> wp.int32:
    """Number of the k-th bin of a side along its dy / dx; or the other way round."""
    return side * BINS + wp.where(is_turned(side), BINS - 1 - k, k)


@wp.func
def bins_of(side: wp.int32, low: wp.vec3d, high: wp.vec3d, near: wp.float64) -> wp.vec2i:
    """First and last bin of a side that a box at `near` meets; (0, -1): none."""
    reach = reach_on(side, low, high, near)
    found = wp.vec2i(0, -1)
    if reach[0] <= reach[1]:
        a = bin_of(side, bin_at(reach[0]))
        b = bin_of(side, bin_at(reach[1]))
        found = wp.vec2i(wp.min(a, b), wp.max(a, b))
    return found


@wp.func
def is_hidden(rings: Rings, slopes: wp.array(dtype=wp.float32), low: wp.vec3d, high: wp.vec3d) -> wp.bool:
    """Whether a box is hidden; metres of the terrain's space from the eye."""
    zero = wp.float64(0.0)
    near = nearest_of(low, high)
    ring = wp.min(ring_of(near) - rings.first, rings.count - 1)
    hidden = ring >= 0
    if hidden:
        far = farthest_of(low, high)
        top = wp.where(high[2] > zero, high[2] / near, high[2] / far)
        bottom = wp.where(low[2] > zero, low[2] / far, low[2] / near)
        row = rings.at + (ring + 1) * ROW
        left = wp.int32(MAX_BINS)
        side = wp.int32(0)
        while hidden and side < 4:
            bins = bins_of(side, low, high, near)
            left -= bins[1] - bins[0] + 1
            hidden = left >= 0
            k = bins[0]
            while hidden and k <= bins[1]:
                hidden = wp.float64(slopes[row + k]) > top and wp.float64(slopes[rings.at + k]) <= bottom
                k += 1
            side += 1
    return hidden


@wp.func
def share_of(slope: wp.float64, above: wp.float64, ramp: wp.float64) -> wp.float64:
    """How much of the ramp a slope is below another one: 0 to 1."""
    return wp.clamp((above - slope) / ramp, wp.float64(0.0), wp.float64(1.0))


@wp.func
def covered(
    rings: Rings, ramp: wp.float64, slopes: wp.array(dtype=wp.float32), low: wp.vec3d, high: wp.vec3d
) -> wp.float64:
    """How much of a box's way to being hidden is done: 0 (something of it may be seen) to 1 (it is a slope of `ramp`
    below what hides it)."""
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    half = wp.float64(BINS / 2)
    near = nearest_of(low, high)
    ring = wp.min(ring_of(near) - rings.first, rings.count - 1)
    part = zero
    if ring >= 0:
        part = one
        far = farthest_of(low, high)
        top = wp.where(high[2] > zero, high[2] / near, high[2] / far)
        bottom = wp.where(low[2] > zero, low[2] / far, low[2] / near)
        inner = radius_of(rings.first + ring)
        to_come = wp.max(one - (near - inner) / (radius_of(rings.first + ring + 1) - inner), zero)
        row = rings.at + (ring + 1) * ROW
        left = wp.float64(MAX_BINS)
        side = wp.int32(0)
        while part > zero and side < 4:
            reach = reach_on(side, low, high, near)
            if reach[0] <= reach[1]:
                middle = wp.float64(side * BINS) + half
                first = wp.where(is_turned(side), middle - reach[1] * half, middle + reach[0] * half)
                last = wp.where(is_turned(side), middle - reach[0] * half, middle + reach[1] * half)
                left -= last - first
                part = wp.where(left > zero, part, zero)
                k = wp.int32(first) - 1
                while part > zero and k <= wp.int32(last) + 1:
                    i = k & (ROW - 1)
                    here = wp.max(share_of(top, wp.float64(slopes[row + i]), ramp) - to_come, zero)
                    if ring > 0:  # there is one before it
                        here = wp.max(share_of(top, wp.float64(slopes[row - ROW + i]), ramp), here)
                    here = wp.min(share_of(wp.float64(slopes[rings.at + i]), bottom, ramp), here)
                    beside = wp.max(first - wp.float64(k + 1), wp.float64(k) - last)
                    part = wp.min(here + wp.max(beside, zero), part)
                    k += 1
            side += 1
    return part
