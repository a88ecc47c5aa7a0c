# SPDX-License-Identifier: GPL-3.0-or-later
"""The error of a diamond, from the arrays of the height field.

A diamond is known by its split vertex (x, y in lattice units) and its depth inside a root square. A saturated error is
no less than the errors of all descendants. The twist of a cell is 4 times the distance of its bilinear patch from a
plane. Errors are stored in groups of four depths, finest first, and those of the raster's cells in a last group. A root
square has 2^unit_bits lattice units and 2^levels raster cells a side; finer tiles divide cells into 2^finer.bits. The
factors UP and UP_MASKS are above the rounding of sums.
"""

import warp as wp

from ..field.codes import corners_of, error_of, twist_of
from ..field.domain import Domain
from ..field.finer import STORED_BITS, cell_change, limits_over, stored_bound, stored_change
from ..field.hierarchy import round_up
from ..field.layout import stored_entry, tile_index
from ..unchecked import item_at, prefetch

UP = wp.constant(wp.float32(1.0 + 2.0**-22))  # above the rounding of a sum of two float32
SATURATED = wp.constant(80)  # finer cells, more than the steps after which a quarter of a quarter .. is 0 in float32
SURE = wp.constant(wp.float64(0.5))  # an error inside the raster's cells is at least this fraction of the stored one
RINGS = wp.constant(5)  # rings of cells whose twists are evaluated; beyond them a code counts at most 4^-6
UP_MASKS = wp.constant(wp.float32(1.0 + 2.0**-19))  # above the rounding of a sum of a dozen


@wp.func
def cell_entry(domain: Domain, group: wp.int32, i: wp.int32, j: wp.int32) -> wp.float32:
    """Return the stored error of raster cell (i, j) in a group, metres before scaling; 0 outside the raster.

    group: domain.cell_group, or domain.curvature_group of a bicubic surface.
    """
    error = wp.float32(0.0)
    if i >= 0 and j >= 0 and i < domain.cell_columns and j < domain.cell_rows:
        index = item_at(domain.base, group) + tile_index(i, j, domain.cell_pages)
        error = error_of(domain.table, group, domain.error, stored_entry(domain.error_places, index))
    return error


@wp.func
def cell_error(domain: Domain, i: wp.int32, j: wp.int32) -> wp.float32:
    """Return the saturated error of the diamond of raster cell (i, j), the last stored level; metres before scaling."""
    return cell_entry(domain, domain.cell_group, i, j)


@wp.func
def twist_error(domain: Domain, i: wp.int32, j: wp.int32) -> wp.float32:
    """Return the error, metres before scaling, of the diamond in raster cell (i, j) from the cell's twist alone.

    If leaves are drawn as meshlets of 4^m triangles, it is the error of those: each of m halvings of an edge quarters
    it. Leaves are then at most 2 * (levels - m) bisections deep, which is `domain.border_depth`.
    """
    twist = wp.float64(0.0)
    if i < domain.samples.columns - 1 and j < domain.samples.rows - 1:  # a meshlet's errors reach beyond the raster
        twist = wp.float64(0.25) * twist_of(corners_of(domain.samples, i, j))
    return round_up(twist / wp.float64(wp.int64(1) << wp.int64(2 * domain.levels - domain.border_depth)))


@wp.func
def exact_cell_error(domain: Domain, i: wp.int32, j: wp.int32) -> wp.float32:
    """Return the saturated error of raster cell (i, j) from twists if it is less than `cell_error`, a rounded-up code.

    The saturated error is the maximum of T(b) / 4^d over all cells b, with the twist error T and the distance d in
    steps between neighbours. So a neighbour's error is at most four times this. Twists are evaluated up to RINGS steps
    away; the codes of the next ring bound those of all farther cells. The search ends at the first ring on which no
    code over 4^d exceeds the maximum so far: codes are saturated, too, so none of a later ring does. The result is at
    least SURE times the cell's code, so that intervals can decide without reading twists.
    """
    stored = wp.float32(0.0)
    largest = wp.float32(0.0)
    may_be_larger = wp.bool(True)
    ring = wp.int32(0)
    factor = wp.float32(1.0)  # 4^-ring
    while may_be_larger and ring <= RINGS + 1:
        may_be_larger = wp.bool(False)
        largest_before = largest
        for k in range(wp.max(4 * ring, 1)):  # cells `ring` steps away: four sides of a rhombus
            t = k % wp.max(ring, 1)
            side = k / wp.max(ring, 1)
            x = wp.where((side & 1) == 0, ring - t, -t)
            y = wp.where((side & 1) == 0, t, ring - t)
            x = i + wp.where(side < 2, x, -x)
            y = j + wp.where(side < 2, y, -y)
            error = factor * cell_error(domain, x, y)
            if ring == 0:
                stored = error
            if error > largest_before:
                may_be_larger = wp.bool(True)
            if error > largest:
                if ring <= RINGS:
                    error = factor * twist_error(domain, x, y)
                largest = wp.max(error, largest)
        if ring == 0:
            largest = wp.max(largest, wp.float32(SURE) * stored)
        may_be_larger = may_be_larger and largest < stored
        ring += 1
        factor = wp.float32(0.25) * factor
    return wp.min(largest, stored)


@wp.func
def group_of(levels: wp.int32, depth: wp.int32) -> wp.int32:
    """Return the group of depths in which the error of a diamond is stored. depth: above the raster's cells.

    Group g has the four depths whose squares have sides of 2 * 4^g and 4 * 4^g cells. levels: a root square has
    2^levels cells a side.
    """
    return (levels - 1 - ((depth - 1) >> 1)) >> 1


@wp.func
def error_index(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.int64:
    """Return the entry, in the array of errors, of the diamond split at (x, y), above the raster's cells.

    The order of entries: see kernels/field/layout.py.
    """
    group = group_of(domain.levels, depth)
    shift = domain.unit_bits - domain.levels + 2 * group  # vertices of a group are 4^group cells apart
    return item_at(domain.base, group) + tile_index(x >> shift, y >> shift, item_at(domain.pages, group))


@wp.func
def reach_of(unit_bits: wp.int32, depth: wp.int32) -> wp.int32:
    """Return the half-width, lattice units, of a diamond's box around its split vertex.

    At an odd depth the diamond is an upright square of side 2 s, split at its centre; at an even one its vertex is the
    middle of an edge of length 2 s. The offsets to the vertices of descendants, which halve every other bisection, add
    up to 3 s from a centre and to 2 s from an edge's middle. The centre of a square of one unit is rounded down, and
    3 s = 1.5 up to 2. unit_bits: a root square has 2^unit_bits lattice units a side.
    """
    return (((2 + (depth & 1)) << (unit_bits - ((depth - 1) >> 1))) + 1) >> 1


@wp.func
def is_beyond(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.bool:
    """Return whether the box of the diamond split at (x, y) is completely outside the raster.

    It is nested: true for all descendants, too.
    """
    beyond = wp.bool(False)
    if x > domain.east or y > domain.north:
        reach = reach_of(domain.unit_bits, depth)
        beyond = x - reach >= domain.east or y - reach >= domain.north
    return beyond


@wp.func
def halvings_at(domain: Domain, depth: wp.int32) -> wp.int32:
    """Return how many times the error of a raster cell is halved at a depth inside it.

    A bilinear patch of half the side has a quarter of the twist: the error is halved twice in the first of each two
    bisections. The curvatures of a bicubic patch, and so its errors, halve with each bisection.
    """
    below_cells = depth - 2 * domain.levels - 1
    return below_cells + wp.where(domain.bicubic == 0, below_cells & 1, 0)


@wp.func
def raster_error_at(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.float32:
    """Return the saturated error of the diamond split at (x, y) without displacement, metres before scaling."""
    error = wp.float32(0.0)
    below_cells = depth - 2 * domain.levels - 1  # bisections inside a cell; negative above the cells
    if is_beyond(domain, x, y, depth):
        error = wp.float32(0.0)
    elif below_cells < 0:
        index = stored_entry(domain.error_places, error_index(domain, x, y, depth))
        error = error_of(domain.table, group_of(domain.levels, depth), domain.error, index)
    else:
        bits = domain.unit_bits - domain.levels
        i = x >> bits
        j = y >> bits
        # The group of curvatures has the errors that halve below the cells; a bilinear surface has only that of cells.
        group = wp.where(below_cells > 0, domain.curvature_group, domain.cell_group)
        error = cell_entry(domain, group, i, j)
        if (depth & 1) == 0:
            # the middle of an edge that two raster cells share
            if (i << bits) == x:
                error = wp.max(error, cell_entry(domain, group, i - 1, j))
            if (j << bits) == y:
                error = wp.max(error, cell_entry(domain, group, i, j - 1))
        error = error / wp.float32(wp.int64(1) << wp.int64(halvings_at(domain, depth)))
    return error


@wp.func
def exact_raster_error_at(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.float32:
    """Return the saturated error of the diamond split at (x, y) in a raster cell, metres before scaling.

    It is for bilinear surfaces, whose cells deviate from planes by their twists, and does not include displacement.
    Stored errors are rounded up; this one comes from exact twists, which may save triangles.
    """
    bits = domain.unit_bits - domain.levels
    i = x >> bits
    j = y >> bits
    error = wp.float32(0.0)
    for k in range(3):  # the cell north-east of the vertex, and those west and south of it that share the diamond
        shares = (depth & 1) == 0 and wp.where(k == 1, (i << bits) == x, (j << bits) == y)
        if k == 0 or shares:
            error = wp.max(error, exact_cell_error(domain, i - wp.int32(k == 1), j - wp.int32(k == 2)))
    return error / wp.float32(wp.int64(1) << wp.int64(halvings_at(domain, depth)))


@wp.func
def max_of_mask(domain: Domain, mask: wp.int32, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.int32:
    """Return the maximum, 0 .. 255, of a mask over the box of the diamond split at (x, y).

    mask: its number among the layers' masks. It is looked up in blocks of cells at least as wide as the box, so at most
    2 x 2 are read. Boxes and blocks are nested, and so is the result.
    """
    bits = domain.unit_bits - domain.levels
    reach = reach_of(domain.unit_bits, depth)
    # Blocks have 2^level cells a side. The box is 2 sides of the diamond's square wide at an even depth and 3 at an odd
    # one, here rounded up to 4. The last entry of `mask_first` is the number of entries of one mask.
    level = wp.clamp(domain.levels - ((depth - 1) >> 1) + 1 + (depth & 1), 0, domain.mask_top)
    last_column = (domain.samples.columns - 2) >> level
    last_row = (domain.samples.rows - 2) >> level
    first = wp.int64(mask) * item_at(domain.mask_first, domain.mask_top + 1) + item_at(domain.mask_first, level)
    shift = bits + level
    i1 = wp.min((x + reach - 1) >> shift, last_column)
    j1 = wp.min((y + reach - 1) >> shift, last_row)
    max_weight = wp.int32(0)
    for j in range(wp.max((y - reach) >> shift, 0), j1 + 1):
        for i in range(wp.max((x - reach) >> shift, 0), i1 + 1):
            entry = first + wp.int64(j) * wp.int64(last_column + 1) + wp.int64(i)
            max_weight = wp.max(max_weight, wp.int32(item_at(domain.mask_max, entry)))
    return max_weight


@wp.func
def change_limits(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.vec2f:
    """Bound the magnitude (metres) and slope (metres a metre) by which finer tiles change heights in a diamond's box.

    Both are before scaling. (x, y): where the diamond is split. The result is nested, as boxes are.
    """
    reach = reach_of(domain.unit_bits, depth)
    shift = domain.unit_bits - domain.levels - domain.finer[0].bits
    # The box is 2 sides of the diamond's square wide at an even depth, 3 (rounded up to 4) at an odd one. Limits are
    # stored for squares of several sizes; those at least as wide are read.
    log2_width = domain.unit_bits - ((depth - 1) >> 1) + 1 + (depth & 1)
    return limits_over(domain.finer[0], x - reach, y - reach, x + reach, y + reach, shift, log2_width)


@wp.func
def change_missed(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.float32:
    """Return the error, metres before scaling, of the finer tiles' change of heights at the diamond split at (x, y).

    It is saturated. For diamonds larger than those with stored errors it is the range of the change in their boxes.
    """
    levels = domain.levels + domain.finer[0].bits
    shift = domain.unit_bits - levels
    i = x >> shift
    j = y >> shift
    below_cells = depth - 2 * levels - 1  # bisections inside a finer cell; negative above the finer cells
    error = wp.float32(0.0)
    if depth <= 2 * (levels - STORED_BITS):
        # A stored error counts those of cells up to SATURATED away, so the box is extended by them. The extended box is
        # looked up as twice as wide as the box itself (`log2_width`), which keeps the result nested.
        reach = reach_of(domain.unit_bits, depth) + (wp.int32(SATURATED) << shift)
        log2_width = domain.unit_bits - ((depth - 1) >> 1) + 2 + (depth & 1)
        limits = limits_over(domain.finer[0], x - reach, y - reach, x + reach, y + reach, shift, log2_width)
        error = wp.float32(2.0) * limits[0]  # from minus to plus the largest magnitude
    elif below_cells < 0:
        error = stored_change(domain.finer[0], i, j, group_of(levels, depth))
    else:
        error = cell_change(domain.finer[0], i, j)
        if (depth & 1) == 0:  # the middle of an edge that two finer cells share
            if (i << shift) == x:
                error = wp.max(error, cell_change(domain.finer[0], i - 1, j))
            if (j << shift) == y:
                error = wp.max(error, cell_change(domain.finer[0], i, j - 1))
        # It falls to a quarter with the first bisection below the finer cell and with every second one after that.
        error = error / wp.float32(wp.int64(1) << wp.int64(below_cells + (below_cells & 1)))
    return error


@wp.func
def layers_missed(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32, leaf_depth: wp.int32) -> wp.float32:
    """Bound the displacement layers, metres before scaling, that leaves at `leaf_depth` in a diamond do not represent.

    (x, y): where the diamond is split. Beyond the raster's border the surface is level, so a triangle that crosses the
    border may miss all displacement.
    """
    # `detail` has (distance from a leaf, climb): 64 entries for all unmasked layers, then 64 for each mask at 1 of 255.
    table_entry = leaf_depth
    if leaf_depth <= domain.border_depth:
        reach = reach_of(domain.unit_bits, depth)
        if x + reach > domain.east or y + reach > domain.north:
            table_entry = 0  # all of it
    missed = domain.detail[table_entry][0]
    for k in range(domain.masked):
        weight = wp.float32(max_of_mask(domain, k, x, y, depth))
        missed += weight * domain.detail[64 * (k + 1) + table_entry][0]
    if domain.masked > 0:
        missed = missed * UP_MASKS
    return missed


@wp.func
def detail_missed(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32, leaf_depth: wp.int32) -> wp.float32:
    """Bound the displacement, metres before scaling, that leaves at `leaf_depth` in a diamond do not represent.

    (x, y), depth: where the diamond is split, and its depth. leaf_depth: `depth` or more. The part of finer tiles is
    that of leaves at `depth`: deeper leaves miss no more.
    """
    missed = layers_missed(domain, x, y, depth, leaf_depth)
    if domain.has_finer == 1:
        missed = (missed + change_missed(domain, x, y, depth)) * UP
    return missed


@wp.func
def bicubic_missed(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32, leaf_depth: wp.int32) -> wp.float32:
    """Return the stored bound of the whole error of a diamond on a bicubic surface with finer tiles, or infinity.

    The bound, metres before scaling, is of leaves at `leaf_depth`: of the raster's heights and of the layers'
    displacement. Only diamonds of up to 2^STORED_BITS finer cells a side have one. Callers take the smaller of it and
    another bound, which infinity leaves as it is. (x, y): where the diamond is split.
    """
    bound = wp.float32(wp.inf)
    if domain.bicubic == 1 and domain.has_finer == 1:
        levels = domain.levels + domain.finer[0].bits
        if depth > 2 * (levels - STORED_BITS) and depth <= 2 * levels:
            shift = domain.unit_bits - levels
            bound = stored_bound(domain.finer[0], x >> shift, y >> shift, group_of(levels, depth))
            bound = (bound + layers_missed(domain, x, y, depth, leaf_depth)) * UP_MASKS
    return bound


@wp.func
def stored_error_at(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.float32:
    """Return the diamond's error from stored codes plus that of the displacement, metres before scaling.

    It is cheaper than `error_at`, and equal to it unless `may_be_less`; then it is up to twice as large. On a bicubic
    surface with finer tiles, the stored bound of everything together may be lower than the sum, and then replaces it.
    """
    error = raster_error_at(domain, x, y, depth)
    if domain.detailed == 1 and not is_beyond(domain, x, y, depth):
        error = (error + detail_missed(domain, x, y, depth, depth)) * UP
        error = wp.min(error, bicubic_missed(domain, x, y, depth, depth))
    return error


@wp.func
def may_be_less(domain: Domain, depth: wp.int32) -> wp.bool:
    """Return whether the error of a diamond at a depth may be less than the stored one, so that computing it helps."""
    return depth > 2 * domain.levels and domain.bicubic == 0 and domain.is_raised == 0


@wp.func
def error_at(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.float32:
    """Return the saturated error of the diamond split at (x, y), metres before scaling: it decides the split.

    It is the stored one or, where that may be too large, one from the twists of the raster's cells.
    """
    error = stored_error_at(domain, x, y, depth)
    if may_be_less(domain, depth) and error > wp.float32(0.0):
        error = exact_raster_error_at(domain, x, y, depth)
        if domain.detailed == 1:  # plus the displacement that leaves at this depth miss
            error = (error + detail_missed(domain, x, y, depth, depth)) * UP
    return error


@wp.func
def leaves_tile(domain: Domain, depth: wp.int32) -> wp.bool:
    """Return whether the errors of the next depth are in other tiles of the array, as after every fourth bisection."""
    return (depth & 1) == 0 and ((domain.levels - 1 - ((depth - 1) >> 1)) & 1) == 0 and depth < 2 * domain.levels


@wp.func
def fetch_ahead(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32):
    """Prefetch the error of the diamond split at (x, y), and with it those of its tile; above the raster's cells."""
    prefetch(domain.error, stored_entry(domain.error_places, error_index(domain, x, y, depth)))
