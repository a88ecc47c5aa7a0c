# SPDX-License-Identifier: GPL-3.0-or-later
"""Seams of tiles: each tile shows the pattern with another shift, and their points keep a distance.

A point that is too near to one of lower rank in another tile appears only at a density where all points may be as near,
so that points up to any rank keep their distance over seams, too.
"""

import warp as wp

from ..field.noise import scramble

UNIT_BITS = wp.constant(16)  # a side has 2^16 units
SHIFT_BITS = wp.constant(3)  # shifts are eighths of a side
SQUARE_BITS = wp.constant(4)  # the smallest squares are sixteenths
PER_RANK = wp.constant(wp.float64(6.103515625e-05))  # 2^-14, 1 / points of the tile
# With n points in a tile, the least distance over seams is this / sqrt(n) sides; inside of a tile few are nearer.
APART = wp.constant(wp.float64(0.6))


@wp.struct
class Pattern:
    """The tile and its position.

    `place`: position of each rank in units. `order`: ascending ranks of each window (see Tile). `first`: indices there
    of the smallest squares.
    """

    place: wp.array(dtype=wp.vec2i)
    order: wp.array(dtype=wp.int32)
    first: wp.array(dtype=wp.int32)
    west: wp.float64  # metres, of tile (0, 0)
    south: wp.float64
    side: wp.float64
    seed: wp.uint32


@wp.func
def tile_hash(seed: wp.uint32, x: wp.int32, y: wp.int32) -> wp.uint32:
    """Return a random number for tile (x, y), the same in every call with this seed."""
    return scramble(scramble(wp.uint32(y) + seed) + wp.uint32(x))


@wp.func
def shift_of(seed: wp.uint32, x: wp.int32, y: wp.int32) -> wp.vec2i:
    """Return the shift of the pattern in tile (x, y) to the east and north, eighths of its side."""
    drawn = wp.int32(tile_hash(seed, x, y) >> wp.uint32(32 - 2 * SHIFT_BITS))
    return wp.vec2i(drawn & ((1 << SHIFT_BITS) - 1), drawn >> SHIFT_BITS)


@wp.func
def shifted(q: wp.vec2i, shift: wp.vec2i) -> wp.vec2i:
    """Return the position of point q of the pattern in a tile with this shift, units of the pattern."""
    bits = UNIT_BITS - SHIFT_BITS
    last = (1 << UNIT_BITS) - 1
    return wp.vec2i((q[0] + (shift[0] << bits)) & last, (q[1] + (shift[1] << bits)) & last)


@wp.kernel
def shifts(offset: int, seed: wp.uint32, tiles: wp.array(dtype=wp.vec2i), found: wp.array(dtype=wp.vec2i)):
    """Write the shift of the pattern in tile tiles[offset + tid], eighths of its side."""
    t = offset + wp.tid()
    found[t] = shift_of(seed, tiles[t][0], tiles[t][1])


@wp.func
def distance_outside(at: wp.int32) -> wp.int32:
    """Return by how many units the coordinate `at` is outside its tile, which has 2^UNIT_BITS; 0 inside."""
    return wp.max(wp.max(-at, at - (1 << UNIT_BITS)), 0)


@wp.func
def nearest2(pattern: Pattern, shift: wp.vec2i, q: wp.vec2i, ranks: wp.int32, limit: wp.float64) -> wp.float64:
    """Return the squared distance from q to the nearest point of a tile with a rank below `ranks`, at most `limit`.

    Lengths are in units of the tile. shift: displacement of the pattern in that tile, eighths of a side.
    """
    nearest = limit
    bits = UNIT_BITS - SQUARE_BITS
    last = (1 << SQUARE_BITS) - 1
    radius = wp.int32(wp.sqrt(limit))
    turn_x = shift[0] << (SQUARE_BITS - SHIFT_BITS)
    turn_y = shift[1] << (SQUARE_BITS - SHIFT_BITS)
    for j in range(wp.max((q[1] - radius) >> bits, 0), wp.min((q[1] + radius) >> bits, last) + 1):
        for i in range(wp.max((q[0] - radius) >> bits, 0), wp.min((q[0] + radius) >> bits, last) + 1):
            square = (((j - turn_y) & last) << SQUARE_BITS) + ((i - turn_x) & last)
            for k in range(pattern.first[square], pattern.first[square + 1]):
                rank = pattern.order[k]
                if rank >= ranks:
                    break
                p = shifted(pattern.place[rank], shift)
                x = wp.float64(p[0] - q[0])
                y = wp.float64(p[1] - q[1])
                nearest = wp.min(nearest, x * x + y * y)
    return nearest


@wp.func
def seam_density(pattern: Pattern, x: wp.int32, y: wp.int32, rank: wp.int32, q: wp.vec2i) -> wp.float64:
    """Return the density factor, 0 .. 1, of a point at q (units of the tile) with this rank in tile (x, y).

    It is 1, less if points of other tiles are too near for its rank, and 0 if they are so for all ranks.
    """
    side = wp.int32(1) << UNIT_BITS
    number = wp.float64(rank) + wp.float64(0.5)
    apart2 = APART * APART * wp.float64(side) * wp.float64(side) / number
    inside = wp.float64(wp.min(wp.min(q[0], q[1]), side - wp.max(q[0], q[1])))
    if inside * inside >= apart2:
        return wp.float64(1.0)
    nearest = apart2
    for j in range(wp.max(y - 1, 0), y + 2):
        for i in range(wp.max(x - 1, 0), x + 2):
            p = wp.vec2i(q[0] + ((x - i) << UNIT_BITS), q[1] + ((y - j) << UNIT_BITS))
            away_x = wp.float64(distance_outside(p[0]))
            away_y = wp.float64(distance_outside(p[1]))
            if (i != x or j != y) and away_x * away_x + away_y * away_y < nearest:
                # Of two points of one rank, the one of the tile further south or west comes first.
                ranks = rank + wp.where(j < y or (j == y and i < x), 1, 0)
                nearest = nearest2(pattern, shift_of(pattern.seed, i, j), p, ranks, nearest)
    factor = nearest / apart2
    return wp.where(number * PER_RANK > factor, wp.float64(0.0), factor)
