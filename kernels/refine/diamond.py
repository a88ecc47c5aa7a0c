# SPDX-License-Identifier: GPL-3.0-or-later
"""How much too coarse a diamond is: its error, its box, and what a view makes of them.

A diamond is known by its split vertex (x, y in lattice units) and its depth inside a root square. Its box covers every
vertex that can come below it, so the children's boxes lie inside it; heights of the box and its error are saturated the
same way. All that is done with them below is monotone, also in rounded arithmetic, so a child never exceeds a parent.
"""

import warp as wp

from ..field.codes import error_of, sample_at
from ..field.domain import Domain
from ..field.layout import tile_index
from ..unchecked import code_at, entry_at, number_at, prefetch_byte
from .hiding import Rings, is_bare, is_hidden

wp.set_module_options({"enable_backward": False})

PERSPECTIVE = wp.constant(0)
ORTHOGRAPHIC = wp.constant(1)
PANORAMIC = wp.constant(2)
CLEAR = wp.constant(1)
OUTSIDE = wp.constant(0)
CROSSED = wp.constant(-1)
UP = wp.constant(wp.float32(1.0 + 2.0**-22))  # above what a sum of two float32 rounds
# What is known of a box, and so of those inside it, by all views: bits.
IN_FRAME = wp.constant(1)  # the frustum holds it
BARE = wp.constant(2)  # nearer ground hides none of it
HIDDEN = wp.constant(4)  # ... all of it
MAX_PLANES = wp.constant(6)
planes_type = wp.types.matrix(shape=(6, 4), dtype=wp.float64)


@wp.struct
class LocalView:
    """A view from the terrain's own space. Lengths of camera space are in metres of the terrain's height."""

    kind: wp.int32
    plane_count: wp.int32
    eye: wp.vec3d  # metres
    weight: wp.vec3d  # squared metres of camera space per squared metre along each axis
    depth: wp.vec4d  # depth along the view = depth . (x, y, z, 1), metres
    pixel2: wp.float64  # squared metres of a pixel; of perspective at unit depth, of a panorama at unit distance
    cosine2: wp.float64  # squared least depth over distance inside the frame
    near2: wp.float64  # squared distance below which nothing is seen
    off_screen2: wp.float64  # squared factor by which pixels are coarser outside the frustum
    hidden2: wp.float64  # ... of what nearer ground hides
    rings: Rings
    planes: planes_type  # positive towards the frustum


@wp.struct
class Asked:
    """What is asked, squared; infinity is off."""

    view_count: wp.int32
    measures_edges: wp.int32
    error_px2: wp.float64
    metres2: wp.float64
    edge_px2: wp.float64
    area_px2: wp.float64  # twice the area: squared legs of a right triangle
    limit: wp.float64  # all of these times this: 1, or more to meet a budget
    diagonal2: wp.float64  # squared length of a lattice unit's diagonal, the longer one, in camera space
    axis2: wp.float64  # squared length of a lattice unit's side, the longer one, in camera space
    view: LocalView  # the first view
    views: wp.array(dtype=LocalView)  # all of them
    slopes: wp.array(dtype=wp.float32)  # their horizons, see hiding.py


@wp.func
def smaller(a: wp.float64, b: wp.float64) -> wp.float64:
    """wp.min without its care for NaN, which costs four instructions for one; NaN in `a` gives `b`."""
    return wp.where(a < b, a, b)


@wp.func
def larger(a: wp.float64, b: wp.float64) -> wp.float64:
    """As `smaller`, of wp.max."""
    return wp.where(a > b, a, b)


@wp.func
def most_of(plane: wp.vec4d, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """The most that plane . (x, y, z, 1) is in a box."""
    most = plane[3] + larger(plane[0] * low[0], plane[0] * high[0])
    most += larger(plane[1] * low[1], plane[1] * high[1])
    most += larger(plane[2] * low[2], plane[2] * high[2])
    return most


@wp.func
def least_of(plane: wp.vec4d, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """The least that plane . (x, y, z, 1) is in a box."""
    least = plane[3] + smaller(plane[0] * low[0], plane[0] * high[0])
    least += smaller(plane[1] * low[1], plane[1] * high[1])
    least += smaller(plane[2] * low[2], plane[2] * high[2])
    return least


@wp.func
def stand_of(view: LocalView, low: wp.vec3d, high: wp.vec3d) -> wp.int32:
    """Whether the frustum holds a box (CLEAR), none of it (OUTSIDE), or may hold a part (CROSSED)."""
    zero = wp.float64(0.0)
    stand = CLEAR
    for p in range(view.plane_count):
        if most_of(view.planes[p], low, high) < zero:
            stand = OUTSIDE
            break
        if least_of(view.planes[p], low, high) < zero:
            stand = CROSSED
    return stand


@wp.func
def cell_entry(domain: Domain, group: wp.int32, i: wp.int32, j: wp.int32) -> wp.float32:
    """What `group` of the errors, the cells or the bends, holds for raster cell (i, j)."""
    e = wp.float32(0.0)
    if i >= 0 and j >= 0 and i < domain.cell_columns and j < domain.cell_rows:
        index = entry_at(domain.base, group) + tile_index(i, j, domain.cell_pages)
        e = error_of(domain.table, group, domain.error, index)
    return e


@wp.func
def cell_error(domain: Domain, i: wp.int32, j: wp.int32) -> wp.float32:
    """Saturated error of the diamond in the middle of raster cell (i, j): the last level that is stored."""
    return cell_entry(domain, domain.cell_group, i, j)


@wp.func
def group_of(levels: wp.int32, depth: wp.int32) -> wp.int32:
    """The group of a depth above the raster's cells."""
    return (levels - 1 - ((depth - 1) >> 1)) >> 1


@wp.func
def place(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.int64:
    """Where the errors hold the diamond split at (x, y), above the raster's cells: see kernels/field/layout.py."""
    group = group_of(domain.levels, depth)
    shift = domain.unit_bits - domain.levels + 2 * group
    return entry_at(domain.base, group) + tile_index(x >> shift, y >> shift, number_at(domain.pages, group))


@wp.func
def reach_of(unit_bits: wp.int32, depth: wp.int32) -> wp.int32:
    """Lattice units that a diamond's box reaches from its split vertex along each axis.

    With s for half a side of the cell, or half the edge, offsets to the vertices below add up to 3 s from a cell's
    centre and 2 s from an edge's middle.
    """
    s = wp.int32(1) << (unit_bits - ((depth - 1) >> 1) - 1)
    return 2 * s + (depth & 1) * s


@wp.func
def is_beyond(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.bool:
    """Whether the box of the diamond split at (x, y) is beyond the raster's rim: boxes are nested, and so is this."""
    beyond = wp.bool(False)
    if x > domain.east or y > domain.north:
        reach = reach_of(domain.unit_bits, depth)
        beyond = x - reach >= domain.east or y - reach >= domain.north
    return beyond


@wp.func
def raster_error_at(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.float32:
    """Saturated error of the diamond split at (x, y), without detail: metres, before scaling."""
    error = wp.float32(0.0)
    finer = depth - 2 * domain.levels - 1
    if is_beyond(domain, x, y, depth):
        error = wp.float32(0.0)
    elif finer < 0:
        index = place(domain, x, y, depth)
        error = error_of(domain.table, group_of(domain.levels, depth), domain.error, index)
    else:
        bits = domain.unit_bits - domain.levels
        i = x >> bits
        j = y >> bits
        group = wp.where(finer > 0, domain.bend_group, domain.cell_group)
        error = cell_entry(domain, group, i, j)
        if (depth & 1) == 0:
            # the middle of an edge that two raster cells share
            if (i << bits) == x:
                error = wp.max(error, cell_entry(domain, group, i - 1, j))
            if (j << bits) == y:
                error = wp.max(error, cell_entry(domain, group, i, j - 1))
        # A bilinear patch halved has a quarter of the twist; bends of a bicubic one halve with each bisection.
        halvings = finer + wp.where(domain.bicubic == 0, finer & 1, 0)
        error = error / wp.float32(wp.int64(1) << wp.int64(halvings))
    return error


@wp.func
def detail_missed(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32, leaf_depth: wp.int32) -> wp.float32:
    """What leaves at `leaf_depth` in the diamond split at (x, y) miss of a detail, at most: metres, before scaling.

    Beyond the rim the surface goes on level, so a triangle that reaches over it may miss all.
    """
    at = leaf_depth
    if leaf_depth <= domain.detail_rim:
        reach = reach_of(domain.unit_bits, depth)
        if x + reach > domain.east or y + reach > domain.north:
            at = 0
    return domain.detail[at][0]


@wp.func
def error_at(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.float32:
    """Saturated error of the diamond split at (x, y): metres, before scaling."""
    error = raster_error_at(domain, x, y, depth)
    if domain.detailed == 1 and not is_beyond(domain, x, y, depth):
        error = (error + detail_missed(domain, x, y, depth, depth)) * UP
    return error


@wp.func
def leaves_tile(domain: Domain, depth: wp.int32) -> wp.bool:
    """Whether the diamonds below those of `depth` are in other tiles of the arrays: every four bisections."""
    return (depth & 1) == 0 and ((domain.levels - 1 - ((depth - 1) >> 1)) & 1) == 0 and depth < 2 * domain.levels


@wp.func
def fetch_ahead(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32):
    """Bring the errors about the diamond split at (x, y) into the cache; nothing is read."""
    prefetch_byte(domain.error, place(domain, x, y, depth))


@wp.struct
class Diamond:
    """What a view needs to know of a diamond."""

    low: wp.vec3d  # its box, metres of the terrain's space
    high: wp.vec3d
    rise: wp.float64  # metres, the most that an edge of it can climb
    rim: wp.int32  # 0: no padding is in it, 1: some is, 2: nothing else


@wp.func
def patches_range(domain: Domain, x: wp.int32, y: wp.int32, reach: wp.int32):
    """Lowest and highest control height of the bicubic patches that a diamond's box touches."""
    bits = domain.unit_bits - domain.levels
    i1 = wp.min((x + reach - 1) >> bits, domain.width - 2)
    j1 = wp.min((y + reach - 1) >> bits, domain.height - 2)
    least = wp.int32(65535)
    most = wp.int32(0)
    for j in range(wp.max((y - reach) >> bits, 0), j1 + 1):
        for i in range(wp.max((x - reach) >> bits, 0), i1 + 1):
            index = wp.int64(2) * (domain.range_cells + tile_index(i, j, domain.cell_pages))
            least = wp.min(least, wp.int32(domain.ranges[index]))
            most = wp.max(most, wp.int32(domain.ranges[index + wp.int64(1)]))
    low = domain.range_base + wp.float64(least) * domain.range_step
    return low, domain.range_base + wp.float64(most) * domain.range_step


@wp.func
def narrowed(domain: Domain, x: wp.int32, y: wp.int32, finer: wp.int32, r: wp.vec2i) -> wp.vec2i:
    """What the range `r` and the stored one of a diamond, `finer` bisections above the finest that are, have in common.

    That of a diamond beside the domain is all heights.
    """
    if x >= 0 and y >= 0 and x <= (domain.columns << domain.unit_bits) and y <= (domain.rows << domain.unit_bits):
        group = finer >> 2
        shift = domain.unit_bits - domain.levels + 1 + 2 * group
        entry = tile_index(x >> shift, y >> shift, number_at(domain.range_pages, group))
        index = wp.int64(2) * (entry_at(domain.range_first, group) + entry)
        low = wp.int32(code_at(domain.ranges, index))
        high = wp.int32(code_at(domain.ranges, index + wp.int64(1)))
        r = wp.vec2i(wp.max(r[0], low), wp.min(r[1], high))
    return r


@wp.func
def range_at(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.vec2i:
    """Codes between which the heights of a diamond's box lie, above the raster's cells.

    Of the two finest depths the stored parents say it, or theirs: what all of them have in common is nested, too.
    """
    r = wp.vec2i(0, 65535)
    finer = 2 * domain.levels - 2 - depth
    if finer >= 0:
        r = narrowed(domain, x, y, finer, r)
    elif domain.levels > 1:
        u = wp.int32(1) << (domain.unit_bits - domain.levels)
        # The middles of sides of 4 x 4 cells are 2 u apart along both axes, where the sum of their numbers is odd.
        if finer == -1:  # the centre of a cell of 2 x 2: two of its corners
            turned = ((((x - u) + (y - u)) / (2 * u)) & 1) == 0
            v = wp.where(turned, -u, u)
            r = narrowed(domain, x - u, y - v, 0, r)
            r = narrowed(domain, x + u, y + v, 0, r)
        else:  # the middle of a side of one: one of the side's ends, and what is 2 u beside the other end
            along = wp.where((x & u) != 0, u, 0)
            across = u - along
            ends = wp.where((((x - along) + (y - across)) / (2 * u) & 1) == 1, 1, -1)
            along = along * ends
            across = across * ends
            r = narrowed(domain, x - along, y - across, 0, r)
            r = narrowed(domain, x + along + 2 * across, y + across + 2 * along, 0, r)
            r = narrowed(domain, x + along - 2 * across, y + across - 2 * along, 0, r)
    return r


@wp.func
def diamond_at(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> Diamond:
    """The box of the diamond split at (x, y)."""
    half = (depth - 1) >> 1
    odd = depth & 1
    reach = reach_of(domain.unit_bits, depth)
    low = wp.float64(0.0)
    high = wp.float64(0.0)
    beyond = is_beyond(domain, x, y, depth)
    if beyond:
        high = low
    elif depth <= 2 * domain.levels:
        r = range_at(domain, x, y, depth)
        low = domain.range_base + wp.float64(r[0]) * domain.range_step
        high = domain.range_base + wp.float64(r[1]) * domain.range_step
    elif domain.bicubic == 1:
        low, high = patches_range(domain, x, y, reach)
    else:
        bits = domain.unit_bits - domain.levels
        i0 = wp.max((x - reach) >> bits, 0)
        j0 = wp.max((y - reach) >> bits, 0)
        ahead = (wp.int32(1) << bits) - 1
        i1 = wp.min((x + reach + ahead) >> bits, domain.width - 1)
        j1 = wp.min((y + reach + ahead) >> bits, domain.height - 1)
        least = sample_at(domain.samples, wp.int64(j0) * wp.int64(domain.width) + wp.int64(i0))
        most = least
        for b in range(j0, j1 + 1):
            row = wp.int64(b) * wp.int64(domain.width)
            for a in range(i0, i1 + 1):
                h = sample_at(domain.samples, row + wp.int64(a))
                least = wp.where(h < least, h, least)
                most = wp.where(h > most, h, most)
        low = wp.float64(least)
        high = wp.float64(most)
    d = Diamond()
    if x + reach > domain.east or y + reach > domain.north:
        d.rim = 1
    if beyond or low > high:  # its box may touch the raster where no diamond below it does: then it has no range
        d.rim = 2
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
        # Inside a bilinear patch heights change in proportion to |dx| + |dy|; of a bicubic one by three times that at
        # most: its slopes are means of three times the differences of its control heights.
        part = wp.float64(wp.int64(1) << wp.int64(half - domain.levels))
        climb = wp.float64((1 + odd) * wp.where(domain.bicubic == 1, 3, 1))
        d.rise = d.rise * smaller(climb / part, wp.float64(1.0))
    if domain.detailed == 1 and d.rim < 2:
        more = wp.vec3d(wp.float64(0.0), wp.float64(0.0), domain.detail_most * domain.error_scale)
        d.low = d.low - more
        d.high = d.high + more
        d.rise += wp.float64(domain.detail[depth][1]) * domain.error_scale
    return d


@wp.func
def sizes(asked: Asked, unit_bits: wp.int32, depth: wp.int32):
    """Of the two level triangles at a diamond: squared length of the longest edge and twice the area."""
    side = wp.float64(wp.int32(1) << (unit_bits - ((depth - 1) >> 1)))
    side2 = side * side
    long2 = asked.diagonal2 * side2
    legs2 = asked.axis2 * side2
    if (depth & 1) == 0:
        long2 = legs2
        legs2 = asked.diagonal2 * side2 * wp.float64(0.25)
    return long2, legs2


@wp.func
def rest_of(domain: Domain, d: Diamond) -> wp.float64:
    """Metres by which float32 positions may be off in a diamond's box, see `rounding` in cbt_terrain/refine/terms.py.
    Boxes are nested, and so is this."""
    return domain.rounding + smaller(domain.lean * (d.high[2] - d.low[2]), domain.most_lean)


@wp.func
def metres2_of(domain: Domain, error: wp.float32, rest: wp.float64) -> wp.float64:
    """Squared metres of height that an error stands for, as the criterion weighs it.

    All error is the diamond's own, what rounding to float32 adds, and what the source had rounded. Only the first can
    be refined away. Where the second comes near what was asked, the weighed error asks for a quarter of that from the
    first, and no more; where the source's rounding does, for four fifths. Where the first is a quarter of what both
    take everywhere, nothing is gained any more: it weighs nothing.
    """
    e = wp.float64(error) * domain.error_scale
    own = smaller(e + rest, wp.float64(4.0) * e)
    weighed = smaller(own + domain.source, wp.float64(1.25) * own)
    return wp.where(e > domain.enough, weighed * weighed, wp.float64(0.0))


@wp.func
def own_for(domain: Domain, metres: wp.float64, rest: wp.float64) -> wp.float64:
    """The own error, metres, up to which `metres2_of` weighs no more than `metres`."""
    left = larger(metres - domain.source, wp.float64(0.8) * metres)
    return larger(larger(left - rest, wp.float64(0.25) * left), domain.enough)


@wp.func
def pixel2_at(view: LocalView, dx: wp.float64, dy: wp.float64, dz: wp.float64, deep: wp.float64) -> wp.float64:
    """Squared metres that a pixel spans, (dx, dy, dz) metres from the eye of a view that is not orthographic.

    A segment of length e at depth z (`deep`) and distance r moves by at most f e r / z^2 pixels.
    """
    far2 = view.weight[0] * (dx * dx) + view.weight[1] * (dy * dy) + view.weight[2] * (dz * dz)
    far2 = larger(far2, view.near2)
    if view.kind == PERSPECTIVE:
        ahead = larger(deep, wp.float64(0.0))
        far2 = larger(ahead * ahead, far2 * view.cosine2)
    return view.pixel2 * far2


@wp.func
def nearest_pixel2(view: LocalView, d: Diamond) -> wp.float64:
    """Squared metres that a pixel spans at least, wherever in the box."""
    zero = wp.float64(0.0)
    pixel2 = view.pixel2
    if view.kind != ORTHOGRAPHIC:
        # Squared distance of camera space from the eye to the box.
        dx = larger(larger(d.low[0] - view.eye[0], view.eye[0] - d.high[0]), zero)
        dy = larger(larger(d.low[1] - view.eye[1], view.eye[1] - d.high[1]), zero)
        dz = larger(larger(d.low[2] - view.eye[2], view.eye[2] - d.high[2]), zero)
        pixel2 = pixel2_at(view, dx, dy, dz, least_of(view.depth, d.low, d.high))
    return pixel2


@wp.func
def farthest_pixel2(view: LocalView, d: Diamond) -> wp.float64:
    """Squared metres that a pixel spans at most, in whatever box inside this one."""
    pixel2 = view.pixel2
    if view.kind != ORTHOGRAPHIC:
        dx = larger(d.high[0] - view.eye[0], view.eye[0] - d.low[0])
        dy = larger(d.high[1] - view.eye[1], view.eye[1] - d.low[1])
        dz = larger(d.high[2] - view.eye[2], view.eye[2] - d.low[2])
        pixel2 = pixel2_at(view, dx, dy, dz, most_of(view.depth, d.low, d.high))
    return pixel2


@wp.func
def veil_of(
    view: LocalView, slopes: wp.array(dtype=wp.float32), low: wp.vec3d, high: wp.vec3d, known: wp.int32
) -> wp.int32:
    """Whether nearer ground hides all of a box (HIDDEN), none of it (BARE), or perhaps some of it (0)."""
    veil = known & (BARE | HIDDEN)
    if view.rings.count == 0:
        veil = BARE
    elif veil == 0:
        if is_hidden(view.rings, slopes, low - view.eye, high - view.eye):
            veil = HIDDEN
        elif is_bare(view.rings, slopes, low - view.eye, high - view.eye):
            veil = BARE
    return veil


@wp.func
def finest_in(view: LocalView, slopes: wp.array(dtype=wp.float32), d: Diamond, known: wp.int32) -> wp.float64:
    """Squared metres that a pixel spans at least, wherever in the box; coarser, as was asked, outside the frustum and
    where nearer ground hides it."""
    zero = wp.float64(0.0)
    coarser2 = wp.float64(1.0)
    if (known & IN_FRAME) == 0:
        for p in range(view.plane_count):
            if most_of(view.planes[p], d.low, d.high) < zero:
                coarser2 = view.off_screen2
                break
    if view.rings.count > 0 and (known & BARE) == 0 and coarser2 < view.hidden2:
        if (known & HIDDEN) != 0 or is_hidden(view.rings, slopes, d.low - view.eye, d.high - view.eye):
            coarser2 = view.hidden2
    return nearest_pixel2(view, d) * coarser2


@wp.func
def coarsest_in(view: LocalView, slopes: wp.array(dtype=wp.float32), d: Diamond, known: wp.int32):
    """Squared metres that a pixel spans at most, in whatever box inside this one; and what is known of it."""
    zero = wp.float64(0.0)
    coarser2 = wp.float64(1.0)
    inside = wp.int32(IN_FRAME)
    if (known & IN_FRAME) == 0:
        for p in range(view.plane_count):
            if least_of(view.planes[p], d.low, d.high) < zero:
                coarser2 = view.off_screen2
                inside = 0
                break
    veil = veil_of(view, slopes, d.low, d.high, known)
    if veil != BARE:
        coarser2 = larger(coarser2, view.hidden2)
    return farthest_pixel2(view, d) * coarser2, inside | veil


@wp.func
def finest(asked: Asked, d: Diamond, known: wp.int32) -> wp.float64:
    """Squared metres of the finest pixel that any view has on the box: infinite beyond the rim. One view is at hand."""
    pixel2 = wp.float64(wp.inf)
    if asked.view_count > 0 and d.rim < 2:
        pixel2 = finest_in(asked.view, asked.slopes, d, known)
        for v in range(1, asked.view_count):
            pixel2 = smaller(pixel2, finest_in(asked.views[v], asked.slopes, d, known))
    return pixel2


@wp.func
def coarsest(asked: Asked, d: Diamond, known: wp.int32):
    """As `coarsest_in`, of the view that has the finest pixels there; known is what holds for all views.

    Some of the boxes inside one that reaches beyond the rim are wholly beyond it: none is certain to be split.
    """
    pixel2 = wp.float64(wp.inf)
    told = wp.int32(IN_FRAME)
    if asked.view_count > 0:
        pixel2, told = coarsest_in(asked.view, asked.slopes, d, known)
        for v in range(1, asked.view_count):
            p2, t = coarsest_in(asked.views[v], asked.slopes, d, known)
            pixel2 = smaller(pixel2, p2)
            told = told & t
    if d.rim > 0:
        pixel2 = wp.float64(wp.inf)
    return pixel2, told


@wp.func
def too_coarse_at(
    asked: Asked, limit: wp.float64, pixel2: wp.float64, metres2: wp.float64, long2: wp.float64, legs2: wp.float64
):
    """Whether a diamond is to be split at `limit` times what is asked, where a pixel spans sqrt(pixel2)."""
    px2 = limit * pixel2
    coarse = metres2 > px2 * asked.error_px2 or metres2 > limit * asked.metres2
    return coarse or long2 > px2 * asked.edge_px2 or legs2 > px2 * asked.area_px2
