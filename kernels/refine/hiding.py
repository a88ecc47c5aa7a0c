# SPDX-License-Identifier: GPL-3.0-or-later
"""Occlusion: test whether nearer ground hides a diamond's box, with a polar map of horizons around the eye.

The map uses squares, not circles. A point has the distance max(|dx|, |dy|), belongs to one of four sides of the eye,
and to one of BINS bins of the side by dy / dx (or dx / dy). So arcs are straight, and neither sines nor logarithms are
needed, whose last bits differ between machines. A slope is the height above the eye over that distance; slopes order
the rays of one azimuth. Radii of the rings are the float64 numbers with five mantissa bits, 2 - 3 % apart. (In the
demo's flight, twice the rings save 1 % more triangles, and four times the bins another 1 %.) Bins run once around the
eye, from the south-east: on the north and the west side in the direction of falling dx / dy and dy / dx.

kernels/refine/horizon_map.py fills the map. An entry is a slope: every ray of its bin below it is behind ground that is
no farther than the ring, for every mesh that satisfies the criterion. So entries rise with the ring. A box is hidden if
all rays to it are below the entries of the last ring that is nearer than the whole box.

**Nested.** A box inside a hidden box is hidden: it begins no nearer, so its ring is no nearer and has no lower entries;
it meets no other bins; and no ray to it is higher. The test uses only differences, quotients and comparisons, which are
monotone in rounded arithmetic, too.

**Consistent.** Hidden ground, and ground outside the frame, is coarser than the map assumes for the ground in front.
The map needs no further lowering. Take a ray in the frame to a hidden box, and the nearest ring whose entry is above
the ray. There the ray is lower than the surface minus the permitted error of the mesh. The triangle at this point
cannot be hidden: the ray would meet its box or pass below it, and so be below a nearer ring's entry. If the triangle is
outside the frame, its box does not contain the ray, which is in the frame; nor is the ray above the box, since it is
below the surface there: so it passes below the box, and below the triangle in it. Otherwise the mesh satisfies the
criterion. In all cases the ray is below the mesh, and it began above it. So the mesh hides the box. (So does the
surface: ground that the true heights show is never called hidden.)

**Occlusion fade.** With geomorphing the mesh must change continuously. So a box is `covered` in part: by the distance
of the highest ray below the entries, over a ramp. The last ring counts more, the nearer the box comes to the next ring;
the ring before counts fully. A bin beside the box counts less with its distance, up to one bin. The result is
continuous in the eye's position, as are the entries (`steady_min` in kernels/refine/horizon_map.py). A box that is
not hidden is not covered, and a box inside another is covered no less, in rounded arithmetic, too.

`rings` locates a view in the map: number of its nearest ring (`first`), their `count`, and the entry `at` of its row of
floors, after which the rings' rows of ROW entries follow.
"""

import warp as wp

BINS = wp.constant(256)  # bins of one side
ROW = wp.constant(1024)  # bins of all four sides: entries of a ring
RING_BITS = wp.constant(47)  # low mantissa bits of a float64, of 52, that do not distinguish rings
# A box that meets more bins is not called hidden; its hidden descendants are found one by one.
MAX_BINS = wp.constant(256)


@wp.struct
class Rings:
    """A view's rows in the map: first a row of floors, then one per ring. Without rings no box is hidden."""

    first: wp.int32  # number of the nearest ring, see `ring_of`
    count: wp.int32  # rings
    at: wp.int32  # entry of the row of floors: a ray below its floor may pass below the mesh before the mesh begins


@wp.func
def ring_of(distance: wp.float64) -> wp.int32:
    """Return the number of the largest horizon ring whose radius is at most `distance` (metres).

    It is the upper bits of the float64: its exponent and five bits of its mantissa.
    """
    return wp.int32(wp.cast(distance, wp.int64) >> wp.int64(RING_BITS))


@wp.func
def radius_of(ring: wp.int32) -> wp.float64:
    """Return the radius max(|x|, |y|) of a horizon ring, metres from the eye; `ring` is the float64's upper bits."""
    return wp.cast(wp.int64(ring) << wp.int64(RING_BITS), wp.float64)


@wp.func
def nearest_of(low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """Return the smallest distance max(|x|, |y|) of a box from the eye, metres.

    low, high: its corners relative to the eye.
    """
    across = wp.max(wp.max(low[0], -high[0]), wp.max(low[1], -high[1]))
    return wp.max(across, wp.float64(0.0))


@wp.func
def farthest_of(low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """Return the largest distance max(|x|, |y|) of a box from the eye, metres.

    low, high: its corners relative to the eye.
    """
    return wp.max(wp.max(high[0], -low[0]), wp.max(high[1], -low[1]))


@wp.func
def bin_at(t: wp.float64) -> wp.int32:
    """Return the bin of a side for a direction t = dy / dx, -1 .. 1."""
    return wp.min(wp.int32((t + wp.float64(1.0)) * wp.float64(BINS / 2)), BINS - 1)


@wp.func
def reach_on(side: wp.int32, low: wp.vec3d, high: wp.vec3d, near: wp.float64) -> wp.vec2d:
    """Return the range of dy / dx that a box spans on a side of the eye (0 .. 3: east, north, west, south).

    On the north and south side it is that of dx / dy. (1, -1): the box does not meet the side. low, high: the box,
    metres from the eye. near: its least distance max(|x|, |y|), metres, above 0.
    """
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    along = side & 1  # the axis along which the side lies
    begin = wp.where(side < 2, low[along], -high[along])
    end = wp.where(side < 2, high[along], -low[along])
    begin = wp.max(begin, near)
    reach = wp.vec2d(one, -one)
    if begin <= end:
        low_end = low[1 - along]
        high_end = high[1 - along]
        # A ratio falls with the distance along the axis if it is positive, and rises if it is negative.
        t0 = wp.where(low_end >= zero, low_end / end, low_end / begin)
        t1 = wp.where(high_end >= zero, high_end / begin, high_end / end)
        if t0 <= one and t1 >= -one:  # the box meets the side
            reach = wp.vec2d(wp.max(t0, -one), wp.min(t1, one))
    return reach


@wp.func
def is_turned(side: wp.int32) -> wp.bool:
    """Return whether the bins of a side (0 .. 3) are in the order of falling dy / dx."""
    return side == 1 or side == 2


@wp.func
def bin_of(side: wp.int32, k: wp.int32) -> wp.int32:
    """Return the number of the k-th bin of a side in the order of rising dy / dx. The order is its own inverse."""
    return side * BINS + wp.where(is_turned(side), BINS - 1 - k, k)


@wp.func
def bins_of(side: wp.int32, low: wp.vec3d, high: wp.vec3d, near: wp.float64) -> wp.vec2i:
    """Return the first and the last bin of a side that a box at distance `near` covers; (0, -1) for none.

    low, high: corners of the box, metres relative to the eye. near: its least distance max(|x|, |y|), metres.
    """
    reach = reach_on(side, low, high, near)
    bins = wp.vec2i(0, -1)
    if reach[0] <= reach[1]:  # the box meets the side
        # `bin_at` counts bins in the order of rising dy / dx, `bin_of` in that of the map.
        a = bin_of(side, bin_at(reach[0]))
        b = bin_of(side, bin_at(reach[1]))
        bins = wp.vec2i(wp.min(a, b), wp.max(a, b))
    return bins


@wp.func
def is_hidden(rings: Rings, slopes: wp.array(dtype=wp.float32), low: wp.vec3d, high: wp.vec3d) -> wp.bool:
    """Return whether nearer ground hides a box from the eye. low, high: the box, metres relative to the eye.

    slopes: the map of horizons, a row of floors (the lowest slopes that it is valid for) and then a row of slopes for
    each ring. In every bin of directions that the box meets, the entry of the last ring before the box must be above
    the box's highest ray, and the floor not above its lowest. The result is false without such a ring, and for a box
    that meets more than MAX_BINS bins.
    """
    zero = wp.float64(0.0)
    near = nearest_of(low, high)
    ring = wp.min(ring_of(near) - rings.first, rings.count - 1)
    hidden = ring >= 0
    if hidden:
        far = farthest_of(low, high)
        top = wp.where(high[2] > zero, high[2] / near, high[2] / far)
        bottom = wp.where(low[2] > zero, low[2] / far, low[2] / near)
        row = rings.at + (ring + 1) * ROW
        bins_left = wp.int32(MAX_BINS)
        side = wp.int32(0)
        while hidden and side < 4:
            bins = bins_of(side, low, high, near)
            bins_left -= bins[1] - bins[0] + 1
            hidden = bins_left >= 0
            k = bins[0]
            while hidden and k <= bins[1]:
                hidden = wp.float64(slopes[row + k]) > top and wp.float64(slopes[rings.at + k]) <= bottom
                k += 1
            side += 1
    return hidden


@wp.func
def ramp_fraction(slope: wp.float64, above: wp.float64, ramp: wp.float64) -> wp.float64:
    """Return how far `slope` is below the slope `above`, as a fraction of `ramp`, clamped to 0 .. 1."""
    return wp.clamp((above - slope) / ramp, wp.float64(0.0), wp.float64(1.0))


@wp.func
def covered(
    rings: Rings, ramp: wp.float64, slopes: wp.array(dtype=wp.float32), low: wp.vec3d, high: wp.vec3d
) -> wp.float64:
    """Return how far a box is hidden: 0 (part of it may be visible) to 1 (a slope of `ramp` below the horizon).

    It is the minimum over all bins near the box, and limited in the same way by how far the lowest ray is above the
    floor. low, high: the box, metres relative to the eye. slopes: the map of horizons, from rings.at on: a row of
    floors (the lowest slopes that it is valid for) and then a row for each ring.
    """
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    half = wp.float64(BINS / 2)
    near = nearest_of(low, high)
    ring = wp.min(ring_of(near) - rings.first, rings.count - 1)
    fraction = zero
    if ring >= 0:
        fraction = one
        far = farthest_of(low, high)
        top = wp.where(high[2] > zero, high[2] / near, high[2] / far)
        bottom = wp.where(low[2] > zero, low[2] / far, low[2] / near)
        inner = radius_of(rings.first + ring)
        # How much less the last ring counts: 1 for a box that begins on the ring, 0 at the next ring.
        still_ahead = wp.max(one - (near - inner) / (radius_of(rings.first + ring + 1) - inner), zero)
        row = rings.at + (ring + 1) * ROW
        bins_left = wp.float64(MAX_BINS)
        side = wp.int32(0)
        while fraction > zero and side < 4:
            reach = reach_on(side, low, high, near)
            if reach[0] <= reach[1]:  # the box meets the side
                middle = wp.float64(side * BINS) + half
                # Positions among the bins around the eye; on turned sides bins are in the order of falling ratios.
                first = wp.where(is_turned(side), middle - reach[1] * half, middle + reach[0] * half)
                last = wp.where(is_turned(side), middle - reach[0] * half, middle + reach[1] * half)
                bins_left -= last - first
                fraction = wp.where(bins_left > zero, fraction, zero)
                k = wp.int32(first) - 1
                while fraction > zero and k <= wp.int32(last) + 1:
                    i = k & (ROW - 1)  # bins go round: after the last one comes the first
                    hidden_here = wp.max(ramp_fraction(top, wp.float64(slopes[row + i]), ramp) - still_ahead, zero)
                    if ring > 0:  # the ring before counts fully
                        hidden_here = wp.max(ramp_fraction(top, wp.float64(slopes[row - ROW + i]), ramp), hidden_here)
                    # The lowest ray must be above the floor.
                    hidden_here = wp.min(ramp_fraction(wp.float64(slopes[rings.at + i]), bottom, ramp), hidden_here)
                    # By how many bins the box misses this one; below 0 if it meets the bin.
                    bins_away = wp.max(first - wp.float64(k + 1), wp.float64(k) - last)
                    fraction = wp.min(hidden_here + wp.max(bins_away, zero), fraction)
                    k += 1
            side += 1
    return fraction
