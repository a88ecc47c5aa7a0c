# SPDX-License-Identifier: GPL-3.0-or-later
"""Diamonds: their boxes, the height differences along their edges, and the weight of their errors.

A diamond's box contains all vertices of its descendants, so the children's boxes are inside it. The heights of the box
and its error are saturated the same way. All computations with them are monotone, also in rounded arithmetic, so a
child never exceeds a parent.

A diamond is given by its depth and by the lattice point (x, y) at which it is split. A root square has 2^unit_bits
lattice units and 2^levels raster cells a side; where the raster ends before the squares do, they are padded. Stored
heights and ranges are metres before vertical scaling, ranges as codes of 16 bits. Finer tiles are squares of finer
samples that replace the raster in places; a raster cell has 2^finer.bits finer cells a side.
"""

import warp as wp

from ..field.codes import sample_at
from ..field.domain import Domain
from ..field.finer import STORED_BITS, covers, finer_sample, range_in_tile
from ..field.layout import stored_entry, tile_index
from ..unchecked import item_at, prefetch
from .stored_errors import change_limits, is_beyond, reach_of


@wp.func
def smaller(a: wp.float64, b: wp.float64) -> wp.float64:
    """Return the smaller value; `b` if either is NaN. wp.min takes four instructions instead of one."""
    return wp.where(a < b, a, b)


@wp.func
def larger(a: wp.float64, b: wp.float64) -> wp.float64:
    """Return the larger value; `b` if either is NaN."""
    return wp.where(a > b, a, b)


@wp.struct
class Diamond:
    """The properties of a diamond that do not depend on the view."""

    low: wp.vec3d  # its box, metres in terrain space
    high: wp.vec3d
    rise: wp.float64  # largest height difference along one of its edges, metres
    border: wp.int32  # 0: it contains no padding, 1: some padding, 2: only padding


@wp.func
def heights_of_cells(domain: Domain, i0: wp.int32, j0: wp.int32, i1: wp.int32, j1: wp.int32):
    """Return the lowest and highest metres, before scaling, over the raster cells from (i0, j0) to (i1, j1) inclusive.

    A bilinear surface takes them from the samples. A bicubic one takes them from the control heights of its patches,
    which are stored as codes that are rounded outwards. Displacement is not included.
    """
    low = wp.float64(0.0)
    high = wp.float64(0.0)
    if domain.bicubic == 1:
        min_code = wp.int32(65535)
        max_code = wp.int32(0)
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                # From entry 2 * range_cells on, `ranges` has two codes for each raster cell.
                entry = domain.range_cells + tile_index(i, j, domain.cell_pages)
                index = wp.int64(2) * stored_entry(domain.range_places, entry)
                min_code = wp.min(min_code, wp.int32(item_at(domain.ranges, index)))
                max_code = wp.max(max_code, wp.int32(item_at(domain.ranges, index + wp.int64(1))))
        low = domain.range_base + wp.float64(min_code) * domain.range_step
        high = domain.range_base + wp.float64(max_code) * domain.range_step
    else:
        lowest = sample_at(domain.samples, wp.int64(j0) * wp.int64(domain.samples.columns) + wp.int64(i0))
        highest = lowest
        for j in range(j0, j1 + 2):
            row = wp.int64(j) * wp.int64(domain.samples.columns)
            for i in range(i0, i1 + 2):
                h = sample_at(domain.samples, row + wp.int64(i))
                lowest = wp.where(h < lowest, h, lowest)
                highest = wp.where(h > highest, h, highest)
        low = wp.float64(lowest)
        high = wp.float64(highest)
    return low, high


@wp.func
def range_entry(domain: Domain, x: wp.int32, y: wp.int32, levels_up: wp.int32) -> wp.int64:
    """Return the index of the lower code of a diamond's height range in `domain.ranges`; the upper one follows.

    (x, y): where the diamond is split. levels_up: bisections above the finest diamonds that have stored ranges. Four
    depths form a group with one array, which has an entry for each vertex of a grid of 2 * 4^group cells a step. Each
    diamond of these depths is split at another vertex of this grid, so none share an entry.
    """
    group = levels_up >> 2
    shift = domain.unit_bits - domain.levels + 1 + 2 * group  # log2 of the grid's step, lattice units
    entry = item_at(domain.range_first, group) + tile_index(x >> shift, y >> shift, item_at(domain.range_pages, group))
    return wp.int64(2) * stored_entry(domain.range_places, entry)


@wp.func
def leaves_range_tile(domain: Domain, depth: wp.int32) -> wp.bool:
    """Return whether the ranges of the next depth are elsewhere in memory: each four depths share an array.

    Ranges are stored down to depth 2 * levels - 2, and arrays are counted from there up. The result is false if no
    ranges are stored below `depth`.
    """
    levels_up = 2 * domain.levels - 2 - depth
    return (levels_up & 3) == 0 and levels_up > 0


@wp.func
def fetch_range(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32):
    """Prefetch the height range of the diamond split at (x, y); ranges of its depth must be stored."""
    prefetch(domain.ranges, range_entry(domain, x, y, 2 * domain.levels - 2 - depth))


@wp.func
def intersect_range(
    domain: Domain, x: wp.int32, y: wp.int32, levels_up: wp.int32, in_tiles: wp.bool, r: wp.vec2i
) -> wp.vec2i:
    """Return the intersection of range r (codes) with the stored range of the diamond split at (x, y).

    A diamond outside the domain leaves r unchanged. levels_up: bisections above the finest diamonds with stored ranges,
    which are stored in groups of four depths. in_tiles: the range is that of a finer tile; without a tile there, r is
    unchanged, too.
    """
    if in_tiles:
        shift = domain.unit_bits - domain.levels - domain.finer[0].bits
        entry = range_in_tile(domain.finer[0], x >> shift, y >> shift, levels_up >> 2)
        if entry >= wp.int64(0):
            low = wp.int32(item_at(domain.finer[0].ranges, entry))
            high = wp.int32(item_at(domain.finer[0].ranges, entry + wp.int64(1)))
            r = wp.vec2i(wp.max(r[0], low), wp.min(r[1], high))
    elif x >= 0 and y >= 0 and x <= (domain.columns << domain.unit_bits) and y <= (domain.rows << domain.unit_bits):
        index = range_entry(domain, x, y, levels_up)
        low = wp.int32(item_at(domain.ranges, index))
        high = wp.int32(item_at(domain.ranges, index + wp.int64(1)))
        r = wp.vec2i(wp.max(r[0], low), wp.min(r[1], high))
    return r


@wp.func
def range_at(
    domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32, levels: wp.int32, in_tiles: wp.bool
) -> wp.vec2i:
    """Return the lowest and highest height code in the box of a diamond that is coarser than the cells.

    Ranges of the two finest depths are not stored. They are the intersection of the nearest stored ancestors' ranges,
    which is nested, too. levels: a root square has 2^levels cells a side; of 2 or fewer cells no range is stored, and
    the result is all codes. in_tiles: the cells are those of finer tiles. The lowest code is above the highest if no
    height is in the box.
    """
    r = wp.vec2i(0, 65535)
    levels_up = 2 * levels - 2 - depth
    if levels_up >= 0:
        r = intersect_range(domain, x, y, levels_up, in_tiles, r)
    elif levels > 1:
        cell = wp.int32(1) << (domain.unit_bits - levels)
        # The finest stored diamonds, of which this one is a child or grandchild, are split at the middles of sides of
        # squares of 4 x 4 cells: in units of 2 cells, at points of which the sum of both coordinates is odd.
        if levels_up == -1:  # (x, y) is the centre of a square of 2 x 2 cells: two of its corners are such points
            # Whether they are the ends of the falling or of the rising diagonal.
            is_falling = ((((x - cell) + (y - cell)) / (2 * cell)) & 1) == 0
            cell_y = wp.where(is_falling, -cell, cell)
            r = intersect_range(domain, x - cell, y - cell_y, 0, in_tiles, r)
            r = intersect_range(domain, x + cell, y + cell_y, 0, in_tiles, r)
        else:  # (x, y) is the middle of a side of such a square: (dx, dy) is half of the side
            dx = wp.where((x & cell) != 0, cell, 0)
            dy = cell - dx
            # Such points are one end of the side, and the two points that are 2 cells beside its other end.
            towards_other = wp.where((((x - dx) + (y - dy)) / (2 * cell) & 1) == 1, 1, -1)
            dx = dx * towards_other
            dy = dy * towards_other
            r = intersect_range(domain, x - dx, y - dy, 0, in_tiles, r)
            r = intersect_range(domain, x + dx + 2 * dy, y + dy + 2 * dx, 0, in_tiles, r)
            r = intersect_range(domain, x + dx - 2 * dy, y + dy - 2 * dx, 0, in_tiles, r)
    return r


@wp.func
def meets_tiles_alone(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.bool:
    """Return whether the box of the diamond split at (x, y) is inside finer tiles that have ranges for its depth.

    It is nested: true for all descendants, too.
    """
    levels = domain.levels + domain.finer[0].bits  # a root square has 2^levels finer cells a side
    is_inside = wp.bool(False)
    if depth > 2 * (levels - STORED_BITS):  # tiles have ranges of squares of up to 2^STORED_BITS finer cells a side
        reach = reach_of(domain.unit_bits, depth)
        finer_cell_bits = domain.unit_bits - levels
        cell_bits = domain.unit_bits - domain.levels
        x1 = wp.min(x + reach, (domain.samples.columns - 1) << cell_bits)
        y1 = wp.min(y + reach, (domain.samples.rows - 1) << cell_bits)
        i0 = wp.max(x - reach, 0) >> finer_cell_bits
        j0 = wp.max(y - reach, 0) >> finer_cell_bits
        is_inside = covers(domain.finer[0], i0, j0, x1 >> finer_cell_bits, y1 >> finer_cell_bits)
    return is_inside


@wp.func
def heights_in_tiles(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32):
    """Return the lowest and highest metres of finer tiles, before scaling, in the box of the diamond at (x, y).

    Tiles must cover the box (`meets_tiles_alone`). (x, y): where the diamond is split, lattice units.
    """
    levels = domain.levels + domain.finer[0].bits
    finer_cell_bits = domain.unit_bits - levels
    low = wp.float64(0.0)
    high = wp.float64(0.0)
    if depth <= 2 * levels:
        r = range_at(domain, x, y, depth, levels, wp.bool(True))  # in finer tiles
        low = domain.finer[0].range_base + wp.float64(r[0]) * domain.finer[0].range_step
        high = domain.finer[0].range_base + wp.float64(r[1]) * domain.finer[0].range_step
    else:
        reach = reach_of(domain.unit_bits, depth)
        i1 = wp.min((x + reach - 1) >> finer_cell_bits, ((domain.samples.columns - 1) << domain.finer[0].bits) - 1)
        j1 = wp.min((y + reach - 1) >> finer_cell_bits, ((domain.samples.rows - 1) << domain.finer[0].bits) - 1)
        i0 = wp.max((x - reach) >> finer_cell_bits, 0)
        j0 = wp.max((y - reach) >> finer_cell_bits, 0)
        lowest = finer_sample(domain.finer[0], i0, j0)
        highest = lowest
        for j in range(j0, j1 + 2):
            for i in range(i0, i1 + 2):
                h = finer_sample(domain.finer[0], i, j)
                lowest = wp.where(h < lowest, h, lowest)
                highest = wp.where(h > highest, h, highest)
        # `off`: metres, at most, between a bicubic surface and the bilinear one through the samples.
        low = wp.float64(lowest) - domain.finer[0].off
        high = wp.float64(highest) + domain.finer[0].off
    return low, high


@wp.func
def inside_tiles(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32, d: Diamond) -> Diamond:
    """Return diamond d with the smaller box and rise that the heights of finer tiles allow; they must cover its box.

    (x, y): where the diamond is split, lattice units. rise: the largest height difference along an edge, metres.
    """
    levels = domain.levels + domain.finer[0].bits
    low, high = heights_in_tiles(domain, x, y, depth)
    z0 = low * domain.height_scale + domain.height_offset
    z1 = high * domain.height_scale + domain.height_offset
    detail = domain.max_detail * domain.error_scale
    rise = wp.abs(z1 - z0)
    if depth > 2 * levels:
        # In a finer cell the surface is bilinear plus a bicubic difference of at most `off` metres. The difference
        # climbs at most 6 `off` over a cell, of which `rise` includes 2. An edge at an odd depth is a diagonal and
        # counts as two sides.
        parts_a_side = wp.float64(wp.int64(1) << wp.int64(((depth - 1) >> 1) - levels))
        steepest = rise + wp.float64(4.0) * domain.finer[0].off * domain.error_scale
        rise = smaller(steepest * (wp.float64(1 + (depth & 1)) / parts_a_side), rise)
    # the climb of the displacement along an edge
    rise += wp.float64(domain.detail[depth][1]) * domain.error_scale
    d.low = wp.vec3d(d.low[0], d.low[1], larger(d.low[2], smaller(z0, z1) - detail))
    d.high = wp.vec3d(d.high[0], d.high[1], smaller(d.high[2], larger(z0, z1) + detail))
    d.rise = smaller(d.rise, rise)
    return d


@wp.func
def diamond_at(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> Diamond:
    """Return box, largest height difference along an edge, and border state of the diamond split at (x, y).

    (x, y): lattice units. The box contains all vertices of its descendants. Border state: 0 inside the raster, 1 across
    its border, 2 wholly in the padding outside, where the heights have no meaning.
    """
    halvings = (depth - 1) >> 1
    odd = depth & 1
    reach = reach_of(domain.unit_bits, depth)
    low = wp.float64(0.0)
    high = wp.float64(0.0)
    beyond = is_beyond(domain, x, y, depth)
    if beyond:
        high = low
    elif depth <= 2 * domain.levels:
        r = range_at(domain, x, y, depth, domain.levels, wp.bool(False))  # not in finer tiles
        low = domain.range_base + wp.float64(r[0]) * domain.range_step
        high = domain.range_base + wp.float64(r[1]) * domain.range_step
    else:
        bits = domain.unit_bits - domain.levels
        i1 = wp.min((x + reach - 1) >> bits, domain.samples.columns - 2)
        j1 = wp.min((y + reach - 1) >> bits, domain.samples.rows - 2)
        low, high = heights_of_cells(domain, wp.max((x - reach) >> bits, 0), wp.max((y - reach) >> bits, 0), i1, j1)
    d = Diamond()
    if x + reach > domain.east or y + reach > domain.north:
        d.border = 1
    if beyond or low > high:  # a box may touch the raster although no descendant does: its range is empty
        d.border = 2
    z0 = low * domain.height_scale + domain.height_offset
    z1 = high * domain.height_scale + domain.height_offset
    d.low = wp.vec3d(
        domain.west + wp.float64(x - reach) * domain.unit_x,
        domain.south + wp.float64(y - reach) * domain.unit_y,
        smaller(z0, z1),
    )
    d.high = wp.vec3d(
        domain.west + wp.float64(x + reach) * domain.unit_x,
        domain.south + wp.float64(y + reach) * domain.unit_y,
        larger(z0, z1),
    )
    d.rise = d.high[2] - d.low[2]
    if depth > 2 * domain.levels:
        # Inside a bilinear patch a height changes by at most the box's height times |dx| + |dy|, in cells. A bicubic
        # patch is up to three times as steep: the slope of a cubic Bezier curve is a mean of three times the
        # differences of adjacent control heights, which the box contains. The longest edge is a diagonal of a square at
        # odd depths, with |dx| + |dy| of two sides, and a side at even depths.
        parts_a_side = wp.float64(wp.int64(1) << wp.int64(halvings - domain.levels))
        climb = wp.float64((1 + odd) * wp.where(domain.bicubic == 1, 3, 1))
        d.rise = d.rise * smaller(climb / parts_a_side, wp.float64(1.0))
    if domain.detailed == 1 and d.border < 2:
        max_displacement = domain.max_detail
        climb = wp.float64(domain.detail[depth][1])  # of the layers, along an edge
        if domain.has_finer == 1:
            change = change_limits(domain, x, y, depth)  # by finer tiles: largest magnitude and slope
            side = wp.float64(wp.int32(1) << (domain.unit_bits - halvings))  # of the square, lattice units
            longest = side * (domain.unit_x + domain.unit_y)  # |dx| + |dy| of its diagonal, metres
            max_displacement += wp.float64(change[0])
            # The changes at an edge's ends differ by at most twice the magnitude, and by at most slope times length.
            climb += smaller(wp.float64(2.0) * wp.float64(change[0]), wp.float64(change[1]) * longest)
        displacement = wp.vec3d(wp.float64(0.0), wp.float64(0.0), max_displacement * domain.error_scale)
        d.low = d.low - displacement
        d.high = d.high + displacement
        d.rise += climb * domain.error_scale
        if domain.has_finer == 1:
            if meets_tiles_alone(domain, x, y, depth):  # the heights of these tiles may allow a smaller box
                d = inside_tiles(domain, x, y, depth, d)
    return d


@wp.func
def rest_of(domain: Domain, d: Diamond) -> wp.float64:
    """Bound the error, metres, that float32 positions add in the box of diamond d; it is nested, as boxes are.

    It is the rounding of heights plus `lean`: rounded plane coordinates move a facet sideways, and so change its height
    by up to that distance times its slope. The height of the box bounds the slope. Near the anchor, the zero of the
    coordinates, `lean` is smaller: near_x, near_y are the fraction of it per metre of distance.
    """
    lean = smaller(domain.lean * (d.high[2] - d.low[2]), domain.max_lean)
    if domain.near_x + domain.near_y > wp.float64(0.0):
        far_x = larger(wp.abs(d.low[0]), wp.abs(d.high[0]))
        far_y = larger(wp.abs(d.low[1]), wp.abs(d.high[1]))
        lean *= smaller(domain.near_x * far_x + domain.near_y * far_y, wp.float64(1.0))
    return domain.rounding + lean


@wp.func
def metres2_of(domain: Domain, error: wp.float32, rest: wp.float64) -> wp.float64:
    """Return the squared metres of height that the criterion compares for a diamond's stored error.

    error: metres before scaling. rest: metres, from `rest_of`. The total error is the sum of the stored (geometric)
    error e, float32 rounding (`rest`), and the source's rounding. Refinement reduces e only, so roundings count only up
    to a multiple of e: with float32's the sum is at most 4 e, with the source's at most 1.25 times that. So no split is
    required once e is a fifth of the tolerance. If e is at most `domain.enough`, a quarter of the two roundings,
    refining gains nothing, and the result is 0.
    """
    e = wp.float64(error) * domain.error_scale
    with_rest = smaller(e + rest, wp.float64(4.0) * e)
    weighed = smaller(with_rest + domain.source, wp.float64(1.25) * with_rest)
    return wp.where(e > domain.enough, weighed * weighed, wp.float64(0.0))


@wp.func
def max_error_for(domain: Domain, metres: wp.float64, rest: wp.float64) -> wp.float64:
    """Return the largest stored error, metres after scaling, whose weighed error `metres2_of` is at most metres^2.

    Each step of `metres2_of` is inverted. rest: metres that float32 rounding adds.
    """
    left = larger(metres - domain.source, wp.float64(0.8) * metres)
    return larger(larger(left - rest, wp.float64(0.25) * left), domain.enough)
