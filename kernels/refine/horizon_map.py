# SPDX-License-Identifier: GPL-3.0-or-later
"""Computation of the polar horizon map from minimum heights; kernels/refine/hiding.py describes and proves the map.

The eye is surrounded by square rings of growing radius, whose four sides are divided into bins of directions. For each
ring and bin the map has a slope (height above the eye over the radius): rays below it are behind nearer ground. The
map is in `criterion.slopes` from `rings.at` on: a row of floors, then one for each ring, of ROW bins each. A slope
hides all rays below it down to the floor; a ray below the floor may pass below the mesh before the mesh begins.

An entry's arc is straight: x or y is the ring's radius. The mesh over it is no lower than the minimum height around it
minus the mesh's permitted error, and every ray of the bin crosses the arc. Raster and mesh have no gap, so a ray that
is above the mesh on a nearer arc and below it on this one has met it in between. Beyond the raster nothing hides.

With an occlusion fade (`LocalView.ramp`) minimum heights are continuous in the eye's position: see `steady_min`.

`blocks`: stored bounds of heights over blocks of 2^level x 2^level cells.
"""

import warp as wp

from ..field.codes import bilinear, corners_of
from ..field.domain import Domain
from ..unchecked import item_at, put
from .diamond import heights_of_cells, larger, smaller
from .hiding import BINS, ROW, bin_of, radius_of
from .local_view import LocalView
from .pixels import CriterionArrays
from .tight_box import heights_between

FINEST = wp.constant(2)  # the smallest blocks have 4 x 4 cells
FEW_CELLS = wp.constant(8)  # along a rectangle: up to this size cells are read, beyond it blocks
MAX_BLOCKS = wp.constant(6)  # ... along a side
NOTHING = wp.constant(wp.float64(-1e30))  # a slope below all rays: nothing is hidden
OUTWARD = wp.constant(wp.float64(2e-7))  # relative: above the rounding of float32


@wp.struct
class HorizonBlocks:
    """Bounds of the surface's heights over blocks of 2^level x 2^level cells, metres before scaling."""

    low: wp.array(dtype=wp.float32)  # per block, from level FINEST, row by row from the south-west
    high: wp.array(dtype=wp.float32)
    outward: wp.float64  # fraction of itself by which a stored bound may be inside the surface's range
    first: wp.array(dtype=wp.int64)  # per level: number of its first block
    wide: wp.array(dtype=wp.int32)  # per level: blocks in a row


@wp.func
def min_of_cells(domain: Domain, i0: wp.int32, j0: wp.int32, i1: wp.int32, j1: wp.int32, up: wp.float64):
    """Return the minimum of up * height over cells (i0, j0) .. (i1, j1), metres before scaling.

    up: 1 for the lowest height, -1 for the negated highest.
    """
    low, high = heights_of_cells(domain, i0, j0, i1, j1)
    return wp.where(up > wp.float64(0.0), low, -high)


@wp.kernel
def fill_blocks(offset: int, domain: Domain, wide: wp.int32, min_height: wp.array(dtype=wp.float32)):
    """Write to `min_height` the lowest and the negated highest height of each smallest block of row `offset + tid`.

    They are rounded outwards. min_height: two values for each block, row by row. wide: blocks in a row.
    """
    j = (offset + wp.tid()) << FINEST
    last = (wp.int32(1) << FINEST) - 1
    j1 = wp.min(j + last, domain.samples.rows - 2)
    for k in range(wide):
        i = k << FINEST
        i1 = wp.min(i + last, domain.samples.columns - 2)
        low, high = heights_of_cells(domain, i, j, i1, j1)
        entry = wp.int64(2) * (wp.int64(j >> FINEST) * wp.int64(wide) + wp.int64(k))
        put(min_height, entry, wp.float32(low - wp.abs(low) * OUTWARD))
        put(min_height, entry + wp.int64(1), wp.float32(-high - wp.abs(high) * OUTWARD))


@wp.func
def min_of_block(domain: Domain, blocks: HorizonBlocks, level: wp.int32, i: wp.int32, j: wp.int32, up: wp.float64):
    """Return the minimum of up * height in block (i, j) of a level, metres before scaling; level 0 is a cell.

    Stored bounds, from level FINEST on, may be inside the true ones and are moved outwards by `blocks.outward` of
    themselves. up: 1 for the lowest height, -1 for the negated highest.
    """
    min_height = wp.float64(0.0)
    if level > 0:
        block = item_at(blocks.first, level) + wp.int64(j) * wp.int64(item_at(blocks.wide, level)) + wp.int64(i)
        if up > wp.float64(0.0):
            min_height = wp.float64(item_at(blocks.low, block))
        else:
            min_height = -wp.float64(item_at(blocks.high, block))
        min_height = wp.float64(wp.float32(min_height - wp.abs(min_height) * blocks.outward))
    else:
        min_height = min_of_cells(domain, i, j, i, j, up)
    return min_height


@wp.func
def min_over(
    domain: Domain, blocks: HorizonBlocks, x0: wp.int32, y0: wp.int32, x1: wp.int32, y1: wp.int32, sign: wp.float64
):
    """Return the minimum of sign * height, metres after scaling, in the lattice rectangle (x0, y0) .. (x1, y1).

    Displacement is included. Of rectangles over more than FEW_CELLS cells a side the minimum is that of the blocks that
    they meet, at most MAX_BLOCKS a side, so it may be lower. sign: 1 for the lowest height, -1 for the negated highest.
    """
    bits = domain.unit_bits - domain.levels
    i0 = wp.max(x0, 0) >> bits
    j0 = wp.max(y0, 0) >> bits
    i1 = wp.min(x1 >> bits, domain.samples.columns - 2)
    j1 = wp.min(y1 >> bits, domain.samples.rows - 2)
    up = wp.where(domain.height_scale < wp.float64(0.0), -sign, sign)  # the sign before scaling
    min_height = wp.float64(wp.inf)
    if wp.max(i1 - i0, j1 - j0) <= FEW_CELLS:
        min_height = min_of_cells(domain, i0, j0, i1, j1, up)
    else:
        level = wp.int32(FINEST)
        while wp.max((i1 >> level) - (i0 >> level), (j1 >> level) - (j0 >> level)) >= MAX_BLOCKS:
            level += 1
        for j in range(j0 >> level, (j1 >> level) + 1):
            for i in range(i0 >> level, (i1 >> level) + 1):
                min_height = smaller(min_of_block(domain, blocks, level, i, j, up), min_height)
    return to_scaled(domain, min_height, sign)


@wp.func
def to_scaled(domain: Domain, min_height: wp.float64, sign: wp.float64) -> wp.float64:
    """Convert `min_height`, a minimum of the raster's heights, to one of the displaced surface, metres after scaling.

    sign: 1 for a minimum of heights, -1 for one of negated heights. `min_height` is already negated where the vertical
    scale is negative, so it is multiplied by the scale's magnitude, `error_scale`.
    """
    if domain.detailed == 1:
        min_height -= domain.max_change
    return min_height * domain.error_scale + sign * domain.height_offset


@wp.func
def bilinear_at(domain: Domain, x: wp.float64, y: wp.float64) -> wp.float64:
    """Return the height of the bilinear surface at (x, y) cells from the south-west corner, metres before scaling."""
    i = wp.min(wp.int32(x), domain.samples.columns - 2)
    j = wp.min(wp.int32(y), domain.samples.rows - 2)
    return bilinear(corners_of(domain.samples, i, j), x - wp.float64(i), y - wp.float64(j))


@wp.func
def min_bilinear(domain: Domain, low: wp.vec2d, high: wp.vec2d, up: wp.float64) -> wp.float64:
    """Return the minimum of up * height, metres before scaling, in the rectangle low .. high, in cells.

    The rectangle is inside the raster. In each cell the minimum is at a corner of the intersection of cell and
    rectangle. up: 1 or -1.
    """
    min_height = wp.float64(wp.inf)
    for j in range(wp.int32(low[1]), wp.int32(high[1]) + 2):
        y = wp.clamp(wp.float64(j), low[1], high[1])
        for i in range(wp.int32(low[0]), wp.int32(high[0]) + 2):
            min_height = smaller(up * bilinear_at(domain, wp.clamp(wp.float64(i), low[0], high[0]), y), min_height)
    return min_height


@wp.func
def min_of_windows(
    domain: Domain, blocks: HorizonBlocks, level: wp.int32, corner: wp.vec2d, size: wp.vec2d, up: wp.float64
) -> wp.float64:
    """Interpolate the minima of up * height, metres before scaling, between two windows of blocks along each axis.

    All four windows contain the rectangle (corner, size; in blocks). The weights are the position of the corner in its
    block, so a window has weight 0 when its set of blocks changes: the result is continuous. The second window of an
    axis begins with the block of the corner, the first one a block before; both have the same number of blocks.
    """
    inf = wp.float64(wp.inf)
    i = wp.int32(wp.floor(corner[0]))
    j = wp.int32(wp.floor(corner[1]))
    i_end = i + wp.int32(size[0]) + 1  # the last of the first window
    j_end = j + wp.int32(size[1]) + 1
    south = wp.vec2d(inf, inf)  # minima of the two southern windows: the western, the eastern
    north = wp.vec2d(inf, inf)
    for y in range(wp.max(j - 1, 0), wp.min(j_end + 1, (domain.samples.rows - 2) >> level) + 1):
        row = wp.vec2d(inf, inf)
        for x in range(wp.max(i - 1, 0), wp.min(i_end + 1, (domain.samples.columns - 2) >> level) + 1):
            h = min_of_block(domain, blocks, level, x, y, up)
            if x <= i_end:
                row[0] = smaller(h, row[0])
            if x >= i:
                row[1] = smaller(h, row[1])
        if y <= j_end:
            south = wp.min(south, row)
        if y >= j:
            north = wp.min(north, row)
    east_weight = corner[0] - wp.float64(i)
    south_min = south[0] + east_weight * (south[1] - south[0])
    north_min = north[0] + east_weight * (north[1] - north[0])
    largest = larger(larger(south[0], south[1]), larger(north[0], north[1]))
    # Rounding must not exceed all four.
    return smaller(south_min + (corner[1] - wp.float64(j)) * (north_min - south_min), largest)


@wp.func
def steady_min(
    domain: Domain, blocks: HorizonBlocks, margin_units: wp.int32, corner: wp.vec2d, size: wp.vec2d
) -> wp.float64:
    """Bound the ground from below, metres after scaling, over a lattice rectangle and `margin_units` units around it.

    corner, size: the rectangle's south-west corner and size, lattice units. The bound is continuous in the rectangle's
    position: the exact minimum over up to FEW_CELLS bilinear cells a side, else `min_of_windows` of blocks so large
    that fewer than MAX_BLOCKS are a side's length.
    """
    cell = wp.float64(wp.int32(1) << (domain.unit_bits - domain.levels))
    margin = wp.float64(margin_units + 2)  # the rectangle that `fill_horizon` passes to `min_over` is no larger
    corner = (corner - wp.vec2d(margin, margin)) / cell
    size = (size + wp.float64(2.0) * wp.vec2d(margin, margin)) / cell
    longest = wp.max(size[0], size[1])
    up = wp.where(domain.height_scale < wp.float64(0.0), wp.float64(-1.0), wp.float64(1.0))
    min_height = wp.float64(0.0)
    if longest <= wp.float64(FEW_CELLS) and domain.bicubic == 0:
        last = wp.vec2d(wp.float64(domain.samples.columns - 1), wp.float64(domain.samples.rows - 1))
        min_height = min_bilinear(domain, wp.max(corner, wp.vec2d()), wp.min(corner + size, last), up)
    else:
        level = wp.int32(0)
        if longest > wp.float64(FEW_CELLS):
            level = FINEST
            while longest >= wp.float64(wp.int32(MAX_BLOCKS) << level):
                level += 1
        blocks_per_cell = wp.float64(1.0) / wp.float64(wp.int32(1) << level)
        min_height = min_of_windows(domain, blocks, level, corner * blocks_per_cell, size * blocks_per_cell, up)
    return to_scaled(domain, min_height, wp.float64(1.0))


@wp.func
def max_mesh_offset(
    domain: Domain,
    criterion: CriterionArrays,
    view: LocalView,
    reach2: wp.float64,
    relaxation: wp.float64,
    across2: wp.float64,
    rise: wp.float64,
) -> wp.float64:
    """Bound the height difference, metres, of mesh and surface at a point, if the mesh meets the criterion.

    relaxation: factor on the criterion. across2: squared horizontal distance of the point from the eye, metres. rise:
    its height above the eye, metres. reach2: squared largest factor from a length in terrain space to a range in camera
    space (`reach2_of`). Only error criteria bound the difference; without one it is infinite.
    """
    error2_per_range2 = relaxation * relaxation * criterion.error_px2 * view.pixel2 * view.max_gain2
    metres2 = relaxation * relaxation * criterion.metres2
    # The permitted error must grow more slowly than the height: otherwise higher ground might have a lower mesh. At
    # sqrt(0.5) of the distance or less it does. Nothing nearer than sqrt(view.near2) metres is visible.
    if error2_per_range2 * reach2 < wp.float64(0.5):
        metres2 = smaller(metres2, error2_per_range2 * larger(reach2 * (across2 + rise * rise), view.near2))
    # Errors up to `enough` are never refined. Rounding to float32 adds `rounding` by heights and up to `max_lean` by
    # coordinates in the plan, which moves facets sideways.
    return larger(wp.sqrt(metres2), domain.enough) + domain.rounding + domain.max_lean


@wp.func
def reach2_of(view: LocalView) -> wp.float64:
    """Return the squared largest factor from a length in terrain space to a depth or distance in camera space."""
    depth = view.depth
    weight = larger(larger(view.weight[0], view.weight[1]), view.weight[2])
    return larger(depth[0] * depth[0] + depth[1] * depth[1] + depth[2] * depth[2], weight)


@wp.func
def ground_near(
    domain: Domain, blocks: HorizonBlocks, x: wp.float64, y: wp.float64, reach: wp.float64, margin_units: wp.int32
):
    """Return an upper bound of the ground's height in a square with the eye in its middle.

    It is metres after vertical scaling, with displacement. x, y: the eye, lattice units. reach: half of the square's
    side, lattice units; the result is infinite if the square crosses the raster's border or is outside. margin_units:
    lattice units to add on each side, where the raster has them. Small squares of a bilinear surface are searched
    sample by sample, others by stored blocks of cells.
    """
    bits = domain.unit_bits - domain.levels
    east = wp.float64((domain.samples.columns - 1) << bits)
    north = wp.float64((domain.samples.rows - 1) << bits)
    high = wp.float64(wp.inf)
    # The square is inside the raster.
    if x - reach > wp.float64(1.0) and y - reach > wp.float64(1.0):
        if x + reach < east - wp.float64(1.0) and y + reach < north - wp.float64(1.0):
            x0 = wp.max(wp.int32(x - reach) - 1 - margin_units, 0)
            y0 = wp.max(wp.int32(y - reach) - 1 - margin_units, 0)
            x1 = wp.int32(wp.min(x + reach + wp.float64(2 + margin_units), east))
            y1 = wp.int32(wp.min(y + reach + wp.float64(2 + margin_units), north))
            if domain.bicubic == 0 and wp.max(x1 - x0, y1 - y0) < 1 << (bits + FINEST):
                low_h, high_h = heights_between(domain, x0, y0, x1, y1)
                z = wp.max(low_h * domain.height_scale, high_h * domain.height_scale)
                if domain.detailed == 1:
                    z += domain.max_change * domain.error_scale
                high = z + domain.height_offset
            else:
                # With the sign -1, `min_over` returns the negated maximum.
                high = -min_over(domain, blocks, x0, y0, x1, y1, wp.float64(-1.0))
    return high


@wp.func
def arc_of(domain: Domain, side: wp.int32, t0: wp.float64, t1: wp.float64):
    """Return both ends of a bin's arc, relative to the eye, in lattice units per metre of the ring's radius.

    side: side of the square around the eye: 0 east, 1 north, 2 west, 3 south. t0, t1: tangents at which the bin begins
    and ends along that side.
    """
    ahead = wp.where(side < 2, wp.float64(1.0), wp.float64(-1.0))
    arc_begin = wp.vec2d(ahead / domain.unit_x, t0 / domain.unit_y)
    arc_end = wp.vec2d(ahead / domain.unit_x, t1 / domain.unit_y)
    if (side & 1) == 1:
        arc_begin = wp.vec2d(t0 / domain.unit_x, ahead / domain.unit_y)
        arc_end = wp.vec2d(t1 / domain.unit_x, ahead / domain.unit_y)
    return arc_begin, arc_end


@wp.kernel
def fill_horizon(
    offset: int,
    domain: Domain,
    blocks: HorizonBlocks,
    criterion: CriterionArrays,
    number: wp.int32,
    start: wp.float64,
    margin_units: wp.int32,
    relaxation: wp.float64,
):
    """Write bin `offset + tid` of view `number`'s map of horizons: its floor, and its slope on every ring.

    start: metres, a distance within which nothing may be drawn. margin_units: size of a leaf at the depth limit,
    lattice units; such a leaf may exceed the criterion, but its corners are on the surface. relaxation: factor on the
    criterion.
    """
    one = wp.float64(1.0)
    k = offset + wp.tid()
    view = criterion.views[number]
    rings = view.rings
    reach2 = reach2_of(view)
    side = k / BINS
    # The bin spans the directions t0 .. t1 (dy / dx, or dx / dy in the north and south); `bin_of` is its own inverse.
    t0 = wp.float64(bin_of(side, k - side * BINS) - side * BINS) / wp.float64(BINS / 2) - one
    t1 = t0 + one / wp.float64(BINS / 2)
    max_t = wp.max(wp.abs(t0), wp.abs(t1))
    slant2 = one + max_t * max_t
    bits = domain.unit_bits - domain.levels
    east = wp.float64((domain.samples.columns - 1) << bits)
    north = wp.float64((domain.samples.rows - 1) << bits)
    x = (view.eye[0] - domain.west) / domain.unit_x
    y = (view.eye[1] - domain.south) / domain.unit_y
    floor = wp.float64(wp.inf)
    begun = wp.int32(0)  # 1: the floor is known; 2: the bin has left the raster, behind which nothing hides
    high = ground_near(domain, blocks, x, y, start / wp.min(domain.unit_x, domain.unit_y), margin_units)
    if high < wp.float64(wp.inf):  # the eye is over the raster
        begun = 1
        rise = high - view.eye[2]
        # The corners of the square around the eye are the square root of 2 times `start` away.
        mesh_offset = max_mesh_offset(
            domain, criterion, view, reach2, relaxation, wp.float64(2.0) * start * start, rise
        )
        floor = (rise + mesh_offset) / start
    arc_begin, arc_end = arc_of(domain, side, t0, t1)
    max_slope = NOTHING
    cell = wp.float64(wp.int32(1) << bits) * wp.min(domain.unit_x, domain.unit_y)
    next_radius = wp.float64(0.0)  # rings closer together than cells add nothing
    for ring in range(rings.count):
        radius = radius_of(rings.first + ring)
        u0 = x + radius * arc_begin[0]
        v0 = y + radius * arc_begin[1]
        u1 = x + radius * arc_end[0]
        v1 = y + radius * arc_end[1]
        inside = u0 > one and v0 > one and u1 < east - one and v1 < north - one
        if inside and begun < 2 and radius >= next_radius:
            next_radius = radius + cell
            x0 = wp.int32(u0) - 1 - margin_units
            y0 = wp.int32(v0) - 1 - margin_units
            x1 = wp.int32(u1) + 2
            y1 = wp.int32(v1) + 2
            x1 = x1 + wp.min(margin_units, wp.int32(east) - x1)
            y1 = y1 + wp.min(margin_units, wp.int32(north) - y1)
            across2 = radius * radius * slant2
            if begun == 0:  # the eye is outside the raster: rays must come in above the ground
                begun = 1
                rise = -min_over(domain, blocks, x0, y0, x1, y1, -one) - view.eye[2]  # of the highest ground
                floor = (rise + max_mesh_offset(domain, criterion, view, reach2, relaxation, across2, rise)) / radius
            rise = -view.eye[2]
            if view.ramp > wp.float64(0.0):
                rise += steady_min(domain, blocks, margin_units, wp.vec2d(u0, v0), radius * (arc_end - arc_begin))
            else:
                rise += min_over(domain, blocks, x0, y0, x1, y1, one)
            if rise > max_slope * radius:
                max_slope = larger(
                    max_slope,
                    (rise - max_mesh_offset(domain, criterion, view, reach2, relaxation, across2, rise)) / radius,
                )
        elif not inside and begun == 1 and max_slope > NOTHING:  # it has left the raster
            begun = 2
        criterion.slopes[rings.at + (ring + 1) * ROW + k] = wp.float32(max_slope - wp.abs(max_slope) * OUTWARD)
    criterion.slopes[rings.at + k] = wp.float32(floor + wp.abs(floor) * OUTWARD)
