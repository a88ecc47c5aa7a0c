# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays against the surface: they walk cell by cell, and skip whole blocks of cells above or below.

Blocks are the diamonds at the middles of squares of 2^k cells a side (k = 2, 4 ..), whose ranges of heights every store
has; a ray climbs to larger blocks while it clears them and descends where it does not (Tevs, Ihrke and Seidel 2008,
"Maximum mipmaps for fast, accurate, and scalable dynamic height field rendering"; here with minima, as a ray may also
come from below). Cells are left by their number, never by a rounded coordinate, and a change of sides between two cells
is a crossing, so that no ray slips through. crossing.py solves for the crossing in a cell. `part`: the segment of the
ray in a cell or block. `height_ranges`: the stored ranges of heights over blocks.

After t metres a ray is at column u + t du and row v + t dv, in cells, and at the height z + t dz, metres. A segment is
in cell (i, j) from t = `first` to `last`; `side` is where it begins: 1 above the surface, -1 below, 0 unknown. NOWHERE
is an infinite t.
"""

import warp as wp

from ..field.layout import tile_index
from ..refine.diamond import larger, smaller
from ..unchecked import item_at
from .crossing import NOWHERE, HeightRanges, Ray, RaySegment, clear_of, in_one_cell, passed, range_at, side_of
from .surface import QueriedSurface, cell_of, is_ground

STEP = wp.constant(2)  # from a block to the next larger: 2^2 times its side; the least have 2^2 cells


@wp.func
def block_range(height_ranges: HeightRanges, bits: wp.int32, x: wp.int32, y: wp.int32):
    """Return the lowest and highest height (metres) in block (x, y) of 2^bits cells a side.

    They are stored for the diamond that is split at the block's middle, by coordinates in halves of the block's side.
    """
    group = bits / STEP - 1
    index = tile_index(1 + 2 * x, 1 + 2 * y, item_at(height_ranges.pages, group))
    return range_at(height_ranges, item_at(height_ranges.first, group) + index)


@wp.func
def within(first: wp.float64, last: wp.float64, start: wp.float64, step: wp.float64, low: wp.float64, high: wp.float64):
    """Return the part of first .. last in which start + t * step is between low and high; empty where first > last.

    t: metres along a ray. start, step: the ray's position at t = 0 and its direction along one axis.
    """
    if step == wp.float64(0.0):  # the coordinate is constant along the ray
        if start < low or start > high:
            first = NOWHERE
    else:
        a = (low - start) / step
        b = (high - start) / step
        first = wp.max(first, wp.min(a, b))
        last = wp.min(last, wp.max(a, b))
    return first, last


@wp.func
def enter(surface: QueriedSurface, height_ranges: HeightRanges, ray: Ray, end: wp.float64, known: wp.float64):
    """Return (first, last, side): the part of t = 0 .. end in which the ray may meet the surface, and the ray's side.

    The part is empty if first > last. side: that at the part's beginning; known: that at t = 0; 1 above the surface, -1
    below, 0 unknown. height_ranges: here the surface's lowest and highest height, and `spare`, metres above their
    rounding.
    """
    zero = wp.float64(0.0)
    first, last = within(zero, end, ray.u, ray.du, zero, wp.float64(surface.samples.columns - 1))
    first, last = within(first, last, ray.v, ray.dv, zero, wp.float64(surface.samples.rows - 1))
    # A ray that comes in above or below all heights has a known side, also if it is then cut at the height of a flat
    # surface.
    side = known
    z = ray.z + first * ray.dz
    if side == zero and not (z >= height_ranges.low_z and z <= height_ranges.high_z):
        side = side_of(z - height_ranges.low_z)
    lowest = height_ranges.low_z - height_ranges.spare
    highest = height_ranges.high_z + height_ranges.spare
    first, last = within(first, last, ray.z, ray.dz, lowest, highest)
    return first, last, side


@wp.func
def way_out(
    surface: QueriedSurface, ray: Ray, bits: wp.int32, i: wp.int32, j: wp.int32, first: wp.float64, last: wp.float64
):
    """Return (t, line, i, j): where the ray leaves the block of cell (i, j), by which line, and the cell beyond.

    bits: the block has 2^bits cells a side. first: t where the ray enters it. last: end of the ray, which t does not
    exceed. line: number of the raster's line that is crossed, a row or a column. (i, j) of the cell beyond may be
    outside the raster.
    """
    zero = wp.float64(0.0)
    cells_x = surface.samples.columns - 1
    cells_y = surface.samples.rows - 1
    east = wp.where(ray.du > zero, 1, 0)  # 1: the ray leaves by the eastern side
    north = wp.where(ray.dv > zero, 1, 0)
    x = i >> bits
    y = j >> bits
    line_x = wp.min((x + east) << bits, cells_x)
    line_y = wp.min((y + north) << bits, cells_y)
    to_x = NOWHERE
    to_y = NOWHERE
    if ray.du != zero:
        to_x = (wp.float64(line_x) - ray.u) * ray.per_u
    if ray.dv != zero:
        to_y = (wp.float64(line_y) - ray.v) * ray.per_v
    out = larger(first, smaller(smaller(to_x, to_y), last))
    line = line_x
    if to_x <= to_y:  # it crosses a column
        i = line_x + east - 1  # the cell to the east of the line, or to the west
        j = wp.clamp(wp.int32(wp.floor(ray.v + out * ray.dv)), y << bits, wp.min((y + 1) << bits, cells_y) - 1)
    else:
        line = line_y
        j = line_y + north - 1
        i = wp.clamp(wp.int32(wp.floor(ray.u + out * ray.du)), x << bits, wp.min((x + 1) << bits, cells_x) - 1)
    return out, line, i, j


@wp.func
def hit_in_block(
    surface: QueriedSurface, height_ranges: HeightRanges, ray: Ray, bits: wp.int32, part: RaySegment, known: wp.float64
):
    """Return (t, side, done): where the ray meets the surface in a segment in a block, and the ray's side before that.

    t is infinite if they meet nowhere; the side is then that at the segment's end, too. done: false if the caller has
    to descend into the block; t is then infinite and the side that at the segment's beginning. bits: the block has
    2^bits cells a side. known: side of a ray behind a hole: 1 above, -1 below, 0 unknown.
    """
    zero = wp.float64(0.0)
    hit = NOWHERE
    side = part.side
    done = True
    if bits == 0:  # a cell; the ray may run along its western or southern side
        on_west = ray.du == zero and ray.u == wp.float64(part.i)
        on_south = ray.dv == zero and ray.v == wp.float64(part.j)
        if is_ground(surface, part.i, part.j, on_west, on_south):
            hit, side = in_one_cell(surface, height_ranges, ray, part)
        else:
            side = known
    else:
        low, high = block_range(height_ranges, bits, part.i >> bits, part.j >> bits)
        on_side = clear_of(low, high, ray, part)
        done = on_side != zero
        if done:
            hit, side = passed(part, on_side)  # a hit if the ray has changed sides between segments
    return hit, side, done


@wp.func
def first_hit(
    surface: QueriedSurface,
    height_ranges: HeightRanges,
    ray: Ray,
    end: wp.float64,
    known: wp.float64,
    slack: wp.float64,
    bits: wp.int32,
) -> wp.float64:
    """Return the first t in 0 .. end (metres along the ray) where it meets the surface, infinite where it does not.

    known: the ray's side at the start and behind a hole: 1 above, -1 below, 0 unknown. slack: metres that the ray has
    to be beyond the surface. bits: the first block that is tried has 2^bits cells a side: an even number, 0 for a cell,
    which is fast near the surface.
    """
    part = RaySegment()
    first, last, side = enter(surface, height_ranges, ray, end, known)
    part.first = first
    part.side = side
    part.slack = slack
    hit = NOWHERE
    if not (part.first <= last):  # it misses the surface's box, or is NaN
        return hit
    cells_x = surface.samples.columns - 1
    cells_y = surface.samples.rows - 1
    part.i = cell_of(ray.u + part.first * ray.du, cells_x)
    part.j = cell_of(ray.v + part.first * ray.dv, cells_y)
    bits = wp.min(bits, height_ranges.top)
    if ray.du == wp.float64(0.0) and ray.dv == wp.float64(0.0):  # an upright ray is in one cell
        bits = 0
    while True:
        out, line, next_i, next_j = way_out(surface, ray, bits, part.i, part.j, part.first, last)
        part.last = out
        hit, side, done = hit_in_block(surface, height_ranges, ray, bits, part, known)
        part.side = side
        if hit < NOWHERE:
            break
        # Go on in the next cell, by a larger block if the line that is crossed is a side of one, or descend.
        if done:
            # The ray or the raster ends here.
            if out >= last or next_i < 0 or next_j < 0 or next_i >= cells_x or next_j >= cells_y:
                break
            part.first = out
            part.i = next_i
            part.j = next_j
            coarser = bits + STEP
            if coarser <= height_ranges.top and (line & ((1 << coarser) - 1)) == 0:
                bits = coarser
        else:
            bits -= STEP
    return hit


@wp.func
def ray_of(surface: QueriedSurface, p: wp.vec3d, d: wp.vec3d) -> Ray:
    """Convert a ray from metres to cells: from point p along direction d of length 1, so that its t is metres."""
    ray = Ray()
    ray.u = (p[0] - surface.west) / surface.step_x
    ray.v = (p[1] - surface.south) / surface.step_y
    ray.z = p[2]
    ray.du = d[0] / surface.step_x
    ray.dv = d[1] / surface.step_y
    ray.dz = d[2]
    ray.per_u = wp.float64(1.0) / ray.du
    ray.per_v = wp.float64(1.0) / ray.dv
    return ray


@wp.kernel
def pick(
    offset: int,
    surface: QueriedSurface,
    height_ranges: HeightRanges,
    origins: wp.array(dtype=wp.vec3d),
    directions: wp.array(dtype=wp.vec3d),
    distance: wp.array(dtype=wp.float64),
):
    """Write the distance along ray `offset + tid` to its first hit, metres; infinite if it misses.

    origins: metres, after vertical scaling. directions: of length 1. Each array has an entry for every ray.
    """
    n = offset + wp.tid()
    ray = ray_of(surface, origins[n], directions[n])
    distance[n] = first_hit(surface, height_ranges, ray, NOWHERE, wp.float64(0.0), wp.float64(0.0), height_ranges.top)
