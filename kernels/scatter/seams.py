# SPDX-License-Identifier: GPL-3.0-or-later
"""Seams of tiles: each tile shows the pattern with another shift, and their points keep a distance.

A point that is too near to one of lower rank in another tile appears only at a density where all points may be as near,
so that points up to any rank keep their distance over seams, too.

A tile's side has 2^UNIT_BITS units. `pattern.place` has the position of each rank's point, units; `pattern.order` the
ascending ranks in each square of 1/16 of a side, from entry `pattern.first` of the square on.
"""

import warp as wp

from ..field.noise import scramble

UNIT_BITS = wp.constant(16)  # a side has 2^16 units
SHIFT_BITS = wp.constant(3)  # shifts are eighths of a side
SQUARE_BITS = wp.constant(4)  # the smallest squares are sixteenths
PER_RANK = wp.constant(wp.float64(6.103515625e-05))  # 2^-14, 1 / points of the tile
# With n points in a tile, the smallest distance over seams is this / sqrt(n) sides; inside a tile few are nearer.
APART = wp.constant(wp.float64(0.6))


@wp.struct
class Pattern:
    """The points that each tile repeats, and the position of the tiles."""

    place: wp.array(dtype=wp.vec2i)  # per rank: position of its point, units
    order: wp.array(dtype=wp.int32)  # the ascending ranks of each window, see Tile in cbt_terrain/scatter/tile.py
    first: wp.array(dtype=wp.int32)  # per smallest square: index of its first rank in `order`
    west: wp.float64  # of tile (0, 0), metres
    south: wp.float64
    side: wp.float64  # of a tile, metres
    first_x: wp.int32  # column and row of the raster's south-western tile
    first_y: wp.int32
    seed: wp.uint32


@wp.func
def tile_hash(seed: wp.uint32, x: wp.int32, y: wp.int32) -> wp.uint32:
    """Return a random number for tile (x, y), the same in every call with this seed."""
    return scramble(scramble(wp.uint32(y) + seed) + wp.uint32(x))


@wp.func
def shift_of(seed: wp.uint32, x: wp.int32, y: wp.int32) -> wp.vec2i:
    """Return the shift of the pattern in tile (x, y) to the east and north, eighths of its side."""
    bits = wp.int32(tile_hash(seed, x, y) >> wp.uint32(32 - 2 * SHIFT_BITS))
    return wp.vec2i(bits & ((1 << SHIFT_BITS) - 1), bits >> SHIFT_BITS)


@wp.func
def shift_point(q: wp.vec2i, shift: wp.vec2i) -> wp.vec2i:
    """Return the position of point q of the pattern in a tile with this shift, units of the pattern."""
    bits = UNIT_BITS - SHIFT_BITS
    last = (1 << UNIT_BITS) - 1
    return wp.vec2i((q[0] + (shift[0] << bits)) & last, (q[1] + (shift[1] << bits)) & last)


@wp.kernel
def write_shifts(offset: int, seed: wp.uint32, tiles: wp.array(dtype=wp.vec2i), found: wp.array(dtype=wp.vec2i)):
    """Write to found[offset + tid] the shift of the pattern in tile tiles[offset + tid], eighths of its side."""
    t = offset + wp.tid()
    found[t] = shift_of(seed, tiles[t][0], tiles[t][1])


@wp.func
def distance_outside(coordinate: wp.int32) -> wp.int32:
    """Return by how many units a coordinate is outside its tile, which has 2^UNIT_BITS of them a side; 0 inside."""
    return wp.max(wp.max(-coordinate, coordinate - (1 << UNIT_BITS)), 0)


@wp.func
def nearest2(pattern: Pattern, shift: wp.vec2i, q: wp.vec2i, ranks: wp.int32, limit: wp.float64) -> wp.float64:
    """Return the squared distance from q to the nearest point of a tile with a rank below `ranks`, at most `limit`.

    Lengths are in units of the tile, from its corner; q may be outside. shift: displacement of the pattern in that
    tile, eighths of a side.
    """
    smallest2 = limit
    bits = UNIT_BITS - SQUARE_BITS
    last = (1 << SQUARE_BITS) - 1
    radius = wp.int32(wp.sqrt(limit))
    # The shift in smallest squares.
    shift_x = shift[0] << (SQUARE_BITS - SHIFT_BITS)
    shift_y = shift[1] << (SQUARE_BITS - SHIFT_BITS)
    for j in range(wp.max((q[1] - radius) >> bits, 0), wp.min((q[1] + radius) >> bits, last) + 1):
        for i in range(wp.max((q[0] - radius) >> bits, 0), wp.min((q[0] + radius) >> bits, last) + 1):
            square = (((j - shift_y) & last) << SQUARE_BITS) + ((i - shift_x) & last)
            for k in range(pattern.first[square], pattern.first[square + 1]):
                rank = pattern.order[k]
                if rank >= ranks:
                    break  # ranks ascend
                p = shift_point(pattern.place[rank], shift)
                x = wp.float64(p[0] - q[0])
                y = wp.float64(p[1] - q[1])
                smallest2 = wp.min(smallest2, x * x + y * y)
    return smallest2


@wp.func
def seam_density(pattern: Pattern, x: wp.int32, y: wp.int32, rank: wp.int32, q: wp.vec2i) -> wp.float64:
    """Return the factor, 0 .. 1, on the density at a point at q (units of the tile) with this rank in tile (x, y).

    A point appears where density times factor reaches its rank as a fraction of all ranks. The factor is 1, or less if
    a point of another tile is too near: the squared distance to it over the one required at this rank, APART sides over
    the root of the number of points. If even density 1 would not reach the rank, the factor is 0.
    """
    side = wp.int32(1) << UNIT_BITS
    num_points = wp.float64(rank) + wp.float64(0.5)  # of the tile at the density at which this one appears
    apart2 = APART * APART * wp.float64(side) * wp.float64(side) / num_points
    to_border = wp.float64(wp.min(wp.min(q[0], q[1]), side - wp.max(q[0], q[1])))
    if to_border * to_border >= apart2:  # no other tile is near
        return wp.float64(1.0)
    smallest2 = apart2
    for j in range(wp.max(y - 1, pattern.first_y), y + 2):
        for i in range(wp.max(x - 1, pattern.first_x), x + 2):
            p = wp.vec2i(q[0] + ((x - i) << UNIT_BITS), q[1] + ((y - j) << UNIT_BITS))
            outside_x = wp.float64(distance_outside(p[0]))
            outside_y = wp.float64(distance_outside(p[1]))
            if (i != x or j != y) and outside_x * outside_x + outside_y * outside_y < smallest2:
                # Of two points of one rank, the one of the tile further south or west comes first.
                ranks = rank + wp.where(j < y or (j == y and i < x), 1, 0)
                smallest2 = nearest2(pattern, shift_of(pattern.seed, i, j), p, ranks, smallest2)
    factor = smallest2 / apart2
    return wp.where(num_points * PER_RANK > factor, wp.float64(0.0), factor)
