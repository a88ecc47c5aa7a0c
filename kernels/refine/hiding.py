# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a diamond's box is hidden by nearer ground, by a polar map of horizons about the eye.

The map is in squares, not circles: a point is at the distance max(|dx|, |dy|), in one of four sides of the eye, and
in one of BINS bins of the side by dy / dx (or dx / dy). So arcs are straight, and no sine and no logarithm is needed,
which differ from machine to machine. Slopes are heights above the eye by that distance: they order the rays of one
azimuth. Radii of the rings are the numbers with five bits behind their first: 2 - 3 % apart. (Of the demo's flight
twice as many rings save 1 % more triangles, four times as many bins 1 %.)

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
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

BINS = wp.constant(256)  # of each of the four sides
ROW = wp.constant(1024)  # of all: entries of a ring
RING_BITS = wp.constant(47)  # of a float64's 52 behind the first that tell no rings apart
# A box that meets more is not called hidden, nor bare; so those below it that are hidden are found one by one.
MOST_BINS = wp.constant(256)


@wp.struct
class Rings:
    """A view's part of the map: first a row of BINS * 4 floors, then a row a ring. No rings: nothing is hidden."""

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
def bins_of(side: wp.int32, low: wp.vec3d, high: wp.vec3d, near: wp.float64) -> wp.vec2i:
    """First and last bin of a side (0 .. 3: east, north, west, south) that a box at `near` meets; (0, -1): none."""
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    along = side & 1  # the axis along which the side lies
    begin = wp.where(side < 2, low[along], -high[along])
    end = wp.where(side < 2, high[along], -low[along])
    begin = wp.max(begin, near)
    found = wp.vec2i(0, -1)
    if begin <= end:
        least = low[1 - along]
        most = high[1 - along]
        t0 = wp.where(least >= zero, least / end, least / begin)
        t1 = wp.where(most >= zero, most / begin, most / end)
        if t0 <= one and t1 >= -one:
            found = wp.vec2i(bin_at(wp.max(t0, -one)), bin_at(wp.min(t1, one)))
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
        left = wp.int32(MOST_BINS)
        side = wp.int32(0)
        while hidden and side < 4:
            bins = bins_of(side, low, high, near)
            left -= bins[1] - bins[0] + 1
            hidden = left >= 0
            k = bins[0]
            while hidden and k <= bins[1]:
                i = side * BINS + k
                hidden = wp.float64(slopes[row + i]) > top and wp.float64(slopes[rings.at + i]) <= bottom
                k += 1
            side += 1
    return hidden


@wp.func
def is_bare(rings: Rings, slopes: wp.array(dtype=wp.float32), low: wp.vec3d, high: wp.vec3d) -> wp.bool:
    """Whether it is certain that no box inside this one is hidden: none is as low as the entries of the
    last ring in it, which are the highest."""
    zero = wp.float64(0.0)
    near = nearest_of(low, high)
    far = farthest_of(low, high)
    last = wp.min(ring_of(far) - rings.first, rings.count - 1)
    bare = near > zero or last < 0
    if bare and last >= 0:
        lowest = wp.where(low[2] < zero, low[2] / near, low[2] / far)
        row = rings.at + (last + 1) * ROW
        left = wp.int32(MOST_BINS)
        side = wp.int32(0)
        while bare and side < 4:
            bins = bins_of(side, low, high, near)
            left -= bins[1] - bins[0] + 1
            bare = left >= 0
            k = bins[0]
            while bare and k <= bins[1]:
                bare = wp.float64(slopes[row + side * BINS + k]) <= lowest
                k += 1
            side += 1
    return bare
