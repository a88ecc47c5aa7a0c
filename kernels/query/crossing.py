# SPDX-License-Identifier: GPL-3.0-or-later
"""A ray in one cell: where it meets the surface there.

Ray minus bilinear surface is a parabola along the ray, whose root is solved for. Over a bicubic surface, or one with
displacement layers (detail), the ray advances by steps that Taylor's formula allows: with the second derivative bounded
by 2 G along the ray, height e and its slope e', nothing is met before e + e' d - G d^2 = 0 (as in Kalra and Barr 1989,
"Guaranteed ray intersections with implicit surfaces"). Near a crossing these are Newton's steps. All arithmetic is
float64. Heights are metres after vertical scaling.

After t metres a ray is at column u + t du and row v + t dv, in cells, and at the height z + t dz, metres. NOWHERE is
an infinite t. `part`: the segment of the ray in cell (i, j) from t = `first` to `last`, and the side where it begins.
`height_ranges`: stored ranges of heights over blocks of cells, widened by the displacement, and bounds of curvature.
"""

import warp as wp

from ..field.codes import corners_of, error_of, twist_of
from ..field.finer import finer_corners
from ..field.layout import stored_entry, tile_index
from ..refine.diamond import larger, smaller
from ..unchecked import item_at
from .surface import QueriedSurface, add_detail, finer_tile, height_and_slopes, in_finer_cell

NOWHERE = wp.constant(wp.float64(wp.inf))  # t of a ray that meets nothing
MAX_STEPS = wp.constant(100_000)  # far more than a cell ever takes; heights of a damaged store may be anything
CLOSE = wp.constant(wp.float64(1e-15))  # of the way along the ray: a step that is shorter has arrived


@wp.struct
class HeightRanges:
    """Ranges of heights, of blocks of 2^2, 2^4 .. 2^top cells a side and, of a bicubic surface, of cells."""

    top: wp.int32  # 0: there are no blocks
    low_z: wp.float64  # lowest and highest height of the whole surface, metres
    high_z: wp.float64
    spare: wp.float64  # metres, more than the rounding of these two
    base: wp.float64  # a height is base + q * step metres
    step: wp.float64
    widening: wp.float64  # metres by which the ranges are widened: the displacement, which they leave out, and rounding
    first: wp.array(dtype=wp.int64)  # of each group of levels: its first entry
    pages: wp.array(dtype=wp.int32)
    ranges: wp.array(dtype=wp.uint16)  # lowest and highest q of each entry
    range_places: wp.array(dtype=wp.int32)  # ... `places` of their pages, see `stored_entry`
    cells: wp.int64  # of a bicubic surface: the first entry of the raster's cells in the ranges
    curvatures: wp.int64  # ... and in the errors
    cell_pages: wp.int32
    curvature_group: wp.int32
    table: wp.array(dtype=wp.float32)  # metres of the codes in `error`, by group
    error: wp.array(dtype=wp.uint8)  # codes of errors and curvatures
    error_places: wp.array(dtype=wp.int32)
    detail_curvature: wp.float64  # second derivative of the detail, 1 / metre before scaling, at most


@wp.struct
class Ray:
    """Points (u, v, z) + t * (du, dv, dz): cells, metres; t is metres."""

    u: wp.float64
    v: wp.float64
    z: wp.float64
    du: wp.float64
    dv: wp.float64
    dz: wp.float64
    per_u: wp.float64  # 1 / du
    per_v: wp.float64


@wp.struct
class RaySegment:
    """A part of a ray inside one cell or block."""

    i: wp.int32  # the cell, or one of the block
    j: wp.int32
    first: wp.float64  # t
    last: wp.float64
    side: wp.float64  # where the ray comes from: 1 above the surface, -1 below, 0 unknown
    slack: wp.float64  # metres that it has to be beyond the surface for a crossing


@wp.func
def range_at(height_ranges: HeightRanges, entry: wp.int64):
    """Return the lowest and highest height (metres, displacement included) of an entry of the stored ranges."""
    index = wp.int64(2) * stored_entry(height_ranges.range_places, entry)
    a = height_ranges.base + wp.float64(item_at(height_ranges.ranges, index)) * height_ranges.step
    b = height_ranges.base + wp.float64(item_at(height_ranges.ranges, index + wp.int64(1))) * height_ranges.step
    return smaller(a, b) - height_ranges.widening, larger(a, b) + height_ranges.widening


@wp.func
def side_of(e: wp.float64) -> wp.float64:
    """Return the side of a point that is e metres above the surface: 1 above, -1 below, 0 on it."""
    side = wp.float64(0.0)
    if e > wp.float64(0.0):
        side = wp.float64(1.0)
    if e < wp.float64(0.0):
        side = wp.float64(-1.0)
    return side


@wp.func
def first_root(a: wp.float64, b: wp.float64, c: wp.float64) -> wp.float64:
    """Return the smallest t > 0 with a t^2 + b t + c = 0 for c > 0; infinite without one.

    It uses the form of the solution that does not cancel.
    """
    t = NOWHERE
    d = b * b - wp.float64(4.0) * a * c
    if d >= wp.float64(0.0):
        root = wp.sqrt(d)
        if b < wp.float64(0.0):
            t = wp.float64(2.0) * c / (root - b)
        elif a < wp.float64(0.0):
            t = (b + root) / (wp.float64(-2.0) * a)
    return t


@wp.func
def in_bilinear(surface: QueriedSurface, p: wp.vec4d, ray: Ray, part: RaySegment):
    """Return (t, side): where the ray meets the bilinear patch with the corners p, and the side on which it is before.

    t is infinite if they meet nowhere; the side is then that at the segment's end, too. They meet where the ray is
    `part.slack` metres beyond the surface. side: 1 above, -1 below, 0 if it is unknown and the segment begins on the
    surface.
    """
    zero = wp.float64(0.0)
    first = part.first
    s = ray.u + first * ray.du - wp.float64(part.i)
    r = ray.v + first * ray.dv - wp.float64(part.j)
    low = p[0] + (p[1] - p[0]) * s
    high = p[2] + (p[3] - p[2]) * s
    per_s = (p[1] - p[0]) * surface.scale
    per_r = (p[2] - p[0]) * surface.scale
    twist = (p[3] - p[1] - p[2] + p[0]) * surface.scale
    # The ray's height above the surface, t metres after the segment's beginning, is a t^2 + b t + c.
    a = -twist * ray.du * ray.dv
    b = ray.dz - per_s * ray.du - per_r * ray.dv - twist * (s * ray.dv + r * ray.du)
    c = ray.z + first * ray.dz - ((low + (high - low) * r) * surface.scale + surface.offset)
    length = part.last - first
    side = part.side
    if side == zero:
        side = side_of(c)
    clearance = side * c + part.slack
    hit = NOWHERE
    if clearance <= zero:
        hit = first
    else:
        root = first_root(side * a, side * b, clearance)
        if root <= length:
            hit = first + root
        elif side * ((a * length + b) * length) + clearance <= zero:
            hit = part.last  # rounding has hidden the root: the ray is beyond the surface at the end
    return hit, side


@wp.func
def cell_range(surface: QueriedSurface, height_ranges: HeightRanges, i: wp.int32, j: wp.int32):
    """Return bounds of the surface's height in cell (i, j), lower and upper, metres, displacement included.

    The cell has no finer tiles.
    """
    low = wp.float64(0.0)
    high = wp.float64(0.0)
    if surface.bicubic == 1:
        low, high = range_at(height_ranges, height_ranges.cells + tile_index(i, j, height_ranges.cell_pages))
    else:
        p = corners_of(surface.samples, i, j)
        a = wp.min(p) * surface.scale + surface.offset
        b = wp.max(p) * surface.scale + surface.offset
        low = smaller(a, b) - height_ranges.widening
        high = larger(a, b) + height_ranges.widening
    return low, high


@wp.func
def cell_curvature(height_ranges: HeightRanges, i: wp.int32, j: wp.int32) -> wp.float64:
    """Return an upper bound of a quarter of the norm of the bicubic surface's second derivatives in cell (i, j).

    The unit is metres before scaling, over squared cells.
    """
    entry = height_ranges.curvatures + tile_index(i, j, height_ranges.cell_pages)
    index = stored_entry(height_ranges.error_places, entry)
    return wp.float64(error_of(height_ranges.table, height_ranges.curvature_group, height_ranges.error, index))


@wp.func
def half_curvature_along(
    surface: QueriedSurface, height_ranges: HeightRanges, ray: Ray, i: wp.int32, j: wp.int32, finer_twist: wp.float64
) -> wp.float64:
    """Return an upper bound of half the second derivative of the surface along the ray in cell (i, j).

    Displacement is included. The unit is metres over squared metres along the ray. finer_twist: |h00 + h11 - h10 - h01|
    of the cell of a finer tile that the ray is in, metres, scaled to a squared raster cell; negative outside of such
    tiles.
    """
    cells2 = ray.du * ray.du + ray.dv * ray.dv
    curvature = wp.float64(0.0)
    if surface.bicubic == 1:
        # A quarter of the norm of the bicubic surface's second derivatives, metres over squared cells.
        quarter_norm = cell_curvature(height_ranges, i, j)
        curvature = wp.float64(2.0) * quarter_norm * cells2
        if finer_twist >= wp.float64(0.0):
            # The surface is bicubic plus the bilinear interpolation of differences at the finer cell's corners. Their
            # twist is at most the finer samples' plus the bicubic surface's.
            curvature += (finer_twist + wp.float64(4.0) * quarter_norm) * wp.abs(ray.du * ray.dv)
    elif finer_twist >= wp.float64(0.0):  # in a finer cell
        curvature = finer_twist * wp.abs(ray.du * ray.dv)
    else:
        p = corners_of(surface.samples, i, j)
        curvature = wp.abs(((p[3] - p[2]) - (p[1] - p[0])) * ray.du * ray.dv)
    x = ray.du * surface.step_x
    y = ray.dv * surface.step_y
    return wp.abs(surface.scale) * (curvature + wp.float64(0.5) * height_ranges.detail_curvature * (x * x + y * y))


@wp.func
def in_curved(
    surface: QueriedSurface,
    height_ranges: HeightRanges,
    ray: Ray,
    part: RaySegment,
    finer_twist: wp.float64,
    finer: wp.vec2i,
):
    """Return (t, side): where the ray meets a bicubic or displaced surface in a segment, and the ray's side before.

    t is infinite if they meet nowhere; the side is then that at the segment's end, too. They meet where the ray is
    `part.slack` metres beyond the surface. side: 1 above, -1 below, 0 if it is unknown and the ray is on the surface.
    finer_twist: in the finer cell `finer`, the absolute second difference of its corner heights (see
    `half_curvature_along`); negative in a raster cell. The ray advances by steps in which the bounded second derivative
    rules out a crossing. After MAX_STEPS, which only a damaged store can need, it meets nothing.
    """
    zero = wp.float64(0.0)
    curvature = half_curvature_along(surface, height_ranges, ray, part.i, part.j, finer_twist)
    side = part.side
    hit = NOWHERE
    t = part.first
    k = wp.int32(0)
    while k < MAX_STEPS:
        k += 1
        s = ray.u + t * ray.du - wp.float64(part.i)  # position in the raster cell, 0 .. 1
        r = ray.v + t * ray.dv - wp.float64(part.j)
        g = wp.vec3d()  # height and slopes (metres a metre) of the surface, before scaling
        if finer_twist >= zero:
            # Rounding must not choose the cell: a surface between finer samples has other slopes in each.
            bits = surface.finer[0].bits
            count = wp.float64(wp.int32(1) << bits)
            u = s * count - wp.float64(finer[0] - (part.i << bits))
            v = r * count - wp.float64(finer[1] - (part.j << bits))
            g = add_detail(surface, part.i, part.j, s, r, in_finer_cell(surface, finer[0], finer[1], u, v))
        else:
            g = height_and_slopes(surface, part.i, part.j, s, r)
        e = ray.z + t * ray.dz - (g[0] * surface.scale + surface.offset)
        climb = g[1] * surface.step_x * ray.du + g[2] * surface.step_y * ray.dv
        slope = ray.dz - climb * surface.scale
        if side == zero:
            side = side_of(e)
        clearance = side * e + part.slack
        if clearance <= zero:
            hit = t
            break
        if t >= part.last:
            break
        step = first_root(-curvature, side * slope, clearance)
        if not (step > CLOSE * (wp.abs(t) + part.last - part.first)):  # it has arrived, or is NaN in a damaged store
            if step >= zero:
                hit = t
            break
        t = wp.min(t + step, part.last)
    return hit, side


@wp.func
def clear_of(low: wp.float64, high: wp.float64, ray: Ray, part: RaySegment) -> wp.float64:
    """Return the side of the heights low .. high on which a segment of a ray is: 1 above, -1 below, 0 for neither.

    The segment must be `part.slack` metres away from them.
    """
    z0 = ray.z + part.first * ray.dz
    z1 = ray.z + part.last * ray.dz
    side = wp.float64(0.0)
    if smaller(z0, z1) > high + part.slack:
        side = wp.float64(1.0)
    if larger(z0, z1) < low - part.slack:
        side = wp.float64(-1.0)
    return side


@wp.func
def passed(part: RaySegment, on_side: wp.float64):
    """Return (t, side) of a segment that is clear of the surface on the side `on_side`: 1 above, -1 below.

    If the ray came from the other side, it has met the surface at the segment's first point; else t is infinite.
    """
    hit = NOWHERE
    if part.side * on_side < wp.float64(0.0):
        hit = part.first
    return hit, on_side


@wp.func
def in_finer_cells(surface: QueriedSurface, height_ranges: HeightRanges, ray: Ray, part: RaySegment):
    """Return (t, side): where the ray meets the surface in a segment in a raster cell of finer tiles, cell by cell.

    t is infinite if they meet nowhere. side: 1 if the ray is above the surface before that or at the segment's end, -1
    below, 0 on it.
    """
    zero = wp.float64(0.0)
    bits = surface.finer[0].bits
    count = wp.int32(1) << bits
    scale = wp.float64(count)
    fine = ray  # in finer cells
    fine.u = ray.u * scale
    fine.v = ray.v * scale
    fine.du = ray.du * scale
    fine.dv = ray.dv * scale
    east = wp.where(ray.du > zero, 1, 0)  # 1: the ray leaves cells by their eastern side
    north = wp.where(ray.dv > zero, 1, 0)
    tile = finer_tile(surface, part.i, part.j)
    west_end = part.i << bits
    south_end = part.j << bits
    i = wp.clamp(wp.int32(wp.floor(fine.u + part.first * fine.du)), west_end, west_end + count - 1)
    j = wp.clamp(wp.int32(wp.floor(fine.v + part.first * fine.dv)), south_end, south_end + count - 1)
    piece = part
    hit = NOWHERE
    side = part.side
    goes_on = wp.bool(True)
    while goes_on and hit == NOWHERE:
        to_x = NOWHERE
        to_y = NOWHERE
        if ray.du != zero:
            to_x = (wp.float64(i + east) - fine.u) / fine.du
        if ray.dv != zero:
            to_y = (wp.float64(j + north) - fine.v) / fine.dv
        out = smaller(to_x, to_y)
        piece.last = larger(piece.first, smaller(out, part.last))
        piece.side = side
        corners = finer_corners(surface.finer[0], tile, i, j)
        if surface.layers.count == 0 and surface.bicubic == 0:  # in finer cells, else in raster cells
            piece.i = i
            piece.j = j
            hit, side = in_bilinear(surface, corners, fine, piece)
        else:
            piece.i = part.i
            piece.j = part.j
            # scale^2: from squared finer cells to squared raster cells, as the twist is a second derivative.
            hit, side = in_curved(surface, height_ranges, ray, piece, twist_of(corners) * scale * scale, wp.vec2i(i, j))
        piece.first = piece.last
        if to_x <= to_y:
            i += 2 * east - 1
        else:
            j += 2 * north - 1
        goes_on = (
            out < part.last and i >= west_end and j >= south_end and i < west_end + count and j < south_end + count
        )
    return hit, side


@wp.func
def in_one_cell(surface: QueriedSurface, height_ranges: HeightRanges, ray: Ray, part: RaySegment):
    """Return (t, side): where the ray meets the surface in a segment in one cell, and the ray's side before that.

    t is NOWHERE if they do not meet; the side is then that at the segment's end, too. side: 1 above the surface, -1
    below, 0 on it.
    """
    hit = NOWHERE
    side = wp.float64(0.0)
    if finer_tile(surface, part.i, part.j) >= 0:
        hit, side = in_finer_cells(surface, height_ranges, ray, part)
    elif surface.bicubic == 0 and surface.layers.count == 0:
        hit, side = in_bilinear(surface, corners_of(surface.samples, part.i, part.j), ray, part)
    else:
        low, high = cell_range(surface, height_ranges, part.i, part.j)
        on_side = clear_of(low, high, ray, part)
        if on_side == wp.float64(0.0):
            hit, side = in_curved(
                surface, height_ranges, ray, part, wp.float64(-1.0), wp.vec2i()
            )  # -1: in no finer cell
        else:
            hit, side = passed(part, on_side)
    return hit, side
