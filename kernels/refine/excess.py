# SPDX-License-Identifier: GPL-3.0-or-later
"""The excess of a mesh: the largest error, edge or area that refinement could not reduce to the request.

It is found by branch and bound. A triangle's upper bound holds for all triangles below it, since errors, height ranges
and boxes are nested. So the triangle with the larger bound is searched first, and triangles whose bound is not above
the largest value found are skipped.

Each triangle is judged by its tight box (tight_box.py).

A leaf that is large compared with its distance is divided further. Each part counts with its distance, and with the
largest distance of the surface in it from the triangle that is drawn there.

The leaves are those at a given depth, or all leaves of the tree. Lengths in the plan are lattice units: a root square
has 2^unit_bits units and 2^levels raster cells a side, so a triangle deeper than 2 * levels is inside a cell.

`t`: the triangle. `criterion`: limits of errors and edges, and the views.
"""

import warp as wp

from ..field.codes import bilinear, corners_of, twist_of
from ..field.domain import INLINED, Domain
from ..leb.halfway import halfway, middle_between
from ..tree.bitfield import Bitfield, is_leaf
from .diamond import Diamond, diamond_at, larger, max_error_for, rest_of, smaller
from .pixels import CriterionArrays, sizes
from .stored_errors import bicubic_missed, detail_missed, halvings_at, is_beyond, raster_error_at
from .tight_box import MARGIN, NEARLY_EQUAL, box_between, finest_seen_in

# Quantities to search for.
FIXED = wp.constant(0)  # rounding of float32 and of the source, which cannot be refined away: pixel footprints
ERROR = wp.constant(1)  # total error: pixel footprints
EDGE = wp.constant(2)  # longest edge: pixel footprints
AREA = wp.constant(3)  # twice the area: squared pixel footprints
METRES = wp.constant(4)  # total error, in view or not: metres
ANY = wp.constant(0)  # instead of the depth of leaves: all leaves of the tree
STACK = wp.constant(80)  # triangles: one per level, and both of the last
# The search ends within this factor of the largest square; for errors on screen, whose leaves it divides, within the
# second.
NEARLY = wp.constant(wp.float64(1.002))
NEARLY_ON_SCREEN = wp.constant(wp.float64(1.02))
UNSEEN = wp.constant(wp.float64(-1.0))  # bound of a triangle that no view sees

wp.set_module_options(INLINED)


@wp.struct
class Triangle:
    """A triangle on the stack of the search, with its upper bound."""

    left: wp.vec2i  # ends of the longest edge, lattice units
    apex: wp.vec2i
    right: wp.vec2i
    depth: wp.int32
    node: wp.uint64  # its heap id in the tree
    leaf_depth: wp.int32  # depth of the leaf that it contains or is in; ANY if it contains leaves of the tree
    bound2: wp.float64  # squared upper bound of the quantity; UNSEEN if the triangle is out of view
    is_small: wp.bool  # squared pixel footprints hardly differ in it
    is_drawn: wp.bool  # it is a part of a drawn triangle, whose plane is known
    drawn: wp.vec2i  # apex of the drawn triangle
    plane: wp.vec3d  # height at that apex, metres before scaling, and slopes along x and y, metres per lattice unit
    fixed: wp.float64  # metres of error that no refinement removes: rounding of float32 and of the source
    total: wp.float64  # ... and the error of its leaves; of a part of a leaf, both are the leaf's


@wp.func
def finest_seen(domain: Domain, criterion: CriterionArrays, of_edges: wp.bool, d: Diamond, t: Triangle):
    """Return the squared finest pixel footprint on a triangle in all views, metres; and whether it is nearly constant.

    of_edges: footprints of edges instead of heights. d: the triangle's diamond. The footprint is infinite out of view
    and beyond the raster's border.
    """
    x0 = wp.min(t.apex[0], wp.min(t.left[0], t.right[0]))
    y0 = wp.min(t.apex[1], wp.min(t.left[1], t.right[1]))
    x1 = wp.min(wp.max(t.apex[0], wp.max(t.left[0], t.right[0])), domain.east)
    y1 = wp.min(wp.max(t.apex[1], wp.max(t.left[1], t.right[1])), domain.north)
    pixel2 = wp.float64(wp.inf)
    coarse2 = wp.float64(0.0)
    if x0 < x1 and y0 < y1:  # not beyond the raster's border
        box = box_between(domain, d, x0, y0, x1, y1, t.depth)
        for v in range(criterion.view_count):
            fine2, far2 = finest_seen_in(criterion.views[v], box, of_edges)
            if fine2 < pixel2:
                pixel2 = fine2
                coarse2 = far2
    return pixel2, coarse2 < NEARLY_EQUAL * pixel2


@wp.func
def error_below(domain: Domain, t: Triangle, x: wp.int32, y: wp.int32, deepest: wp.int32) -> wp.float64:
    """Bound the error, metres, of leaves at depth `deepest` in a triangle of the diamond split at (x, y).

    A diamond larger than a raster cell may pass its whole error to its leaves. Inside a cell the error falls with each
    bisection. A bilinear surface begins with a quarter of the cell's twist, a bicubic one with the diamond's error. If
    a bicubic diamond contains no side of its cell, descendants on a side take the error of the next cell, which is at
    most twice this cell's. The missed displacement depends on the depth of the leaves alone.
    """
    error = wp.float64(raster_error_at(domain, x, y, t.depth))
    if t.depth > 2 * domain.levels:  # inside a cell
        bits = domain.unit_bits - domain.levels
        i = wp.min(t.apex[0], wp.min(t.left[0], t.right[0])) >> bits
        j = wp.min(t.apex[1], wp.min(t.left[1], t.right[1])) >> bits
        # 1 if a descendant may take the next cell's error, up to twice this one's.
        halvings_lost = wp.where((t.depth & 1) == 0, 0, 1)
        falls = wp.max(halvings_at(domain, deepest) - halvings_at(domain, t.depth) - halvings_lost, 0)
        if domain.bicubic == 0 and i < domain.samples.columns - 1 and j < domain.samples.rows - 1:
            # A leaf is drawn as a meshlet, whose triangles are 2 * levels - border_depth bisections deeper (0 if it is
            # drawn as itself).
            falls = halvings_at(domain, deepest) + 2 * domain.levels - domain.border_depth
            error = wp.float64(0.25) * twist_of(corners_of(domain.samples, i, j))
        error = error / wp.float64(wp.int64(1) << wp.int64(falls))
    error = error * domain.error_scale
    if domain.detailed == 1 and not is_beyond(domain, x, y, t.depth):
        error += wp.float64(detail_missed(domain, x, y, t.depth, deepest)) * domain.error_scale
        error = smaller(error, wp.float64(bicubic_missed(domain, x, y, t.depth, deepest)) * domain.error_scale)
    return error


@wp.func
def surface_height(domain: Domain, p: wp.vec2i) -> wp.float64:
    """Return the height of the bilinear surface at lattice point p, clamped to the raster; metres before scaling."""
    bits = domain.unit_bits - domain.levels
    per_unit = wp.float64(1.0) / wp.float64(wp.int32(1) << bits)
    i = wp.min(p[0] >> bits, domain.samples.columns - 2)
    j = wp.min(p[1] >> bits, domain.samples.rows - 2)
    east = smaller(wp.float64(p[0] - (i << bits)) * per_unit, wp.float64(1.0))
    north = smaller(wp.float64(p[1] - (j << bits)) * per_unit, wp.float64(1.0))
    return bilinear(corners_of(domain.samples, i, j), east, north)


@wp.func
def plane_of(domain: Domain, t: Triangle) -> wp.vec3d:
    """Return the plane through the surface at a triangle's corners: height at the apex, slopes along x and y.

    The height is metres before scaling, slopes are metres per lattice unit. The legs are perpendicular and equally long
    in lattice units.
    """
    base = surface_height(domain, t.apex)
    first = surface_height(domain, t.left) - base
    second = surface_height(domain, t.right) - base
    u = t.left - t.apex
    v = t.right - t.apex
    length2 = wp.float64(u[0]) * wp.float64(u[0]) + wp.float64(u[1]) * wp.float64(u[1])
    slope_x = (first * wp.float64(u[0]) + second * wp.float64(v[0])) / length2
    slope_y = (first * wp.float64(u[1]) + second * wp.float64(v[1])) / length2
    return wp.vec3d(base, slope_x, slope_y)


@wp.func
def distance_from_plane(domain: Domain, t: Triangle) -> wp.float64:
    """Return the largest distance, metres before scaling, of the surface from the plane of the drawn triangle.

    It is rounded up and taken over the bounding rectangle of a triangle inside one cell. There the difference is a
    saddle, whose extremes are at corners. t.drawn: apex of the drawn triangle, which contains t. t.plane: height there,
    and slopes along x and y in metres per lattice unit.
    """
    x0 = wp.min(t.apex[0], wp.min(t.left[0], t.right[0]))
    y0 = wp.min(t.apex[1], wp.min(t.left[1], t.right[1]))
    x1 = wp.max(t.apex[0], wp.max(t.left[0], t.right[0]))
    y1 = wp.max(t.apex[1], wp.max(t.left[1], t.right[1]))
    largest = wp.float64(0.0)
    for k in range(4):
        p = wp.vec2i(wp.where((k & 1) == 0, x0, x1), wp.where((k & 2) == 0, y0, y1))
        height = surface_height(domain, p)
        rise = t.plane[1] * wp.float64(p[0] - t.drawn[0]) + t.plane[2] * wp.float64(p[1] - t.drawn[1])
        magnitude = wp.abs(height) + wp.abs(t.plane[0]) + wp.abs(rise)
        largest = larger(largest, wp.abs(height - t.plane[0] - rise) + MARGIN * magnitude)
    return largest


@wp.func
def with_bound(
    domain: Domain, criterion: CriterionArrays, quantity: wp.int32, tolerance2: wp.float64, tree: Bitfield, t: Triangle
) -> Triangle:
    """Return t with an upper bound of a quantity (FIXED .. METRES) for its leaves, or for the leaf that contains it.

    The bound is UNSEEN if t is out of view in all views. tolerance2: squared tolerance, in units of the quantity, which
    no leaf of the tree exceeds unless rounding prevents that. It is used only if t.leaf_depth is ANY; if t is a leaf of
    the tree, its depth replaces ANY. Also set: `fixed`, metres of rounding that no refinement removes, `total`, those
    plus the error of leaves, and `is_small`, which ends the division of a leaf.
    """
    x = halfway(t.left[0], t.right[0])
    y = halfway(t.left[1], t.right[1])
    d = diamond_at(domain, x, y, t.depth)
    if t.leaf_depth == ANY:
        if is_leaf(tree, t.node):
            t.leaf_depth = t.depth
    deepest = wp.where(t.leaf_depth == ANY, t.depth, t.leaf_depth)  # with ANY, the error at t bounds that of its leaves
    if t.depth <= deepest:  # a part of a leaf keeps the leaf's errors
        t.fixed = rest_of(domain, d) + domain.source  # rounding of float32 and of the source
        t.total = t.fixed
        if quantity == ERROR or quantity == METRES:
            t.total += error_below(domain, t, x, y, deepest)
    if quantity == ERROR and domain.bicubic == 0 and domain.detailed == 0:
        # A leaf, or a triangle of the meshlet that is drawn for it, 2 * levels - border_depth bisections deeper.
        if t.depth == deepest + 2 * domain.levels - domain.border_depth:
            t.is_drawn = wp.bool(True)
            t.drawn = t.apex
            t.plane = plane_of(domain, t)
        if t.is_drawn and t.depth > 2 * domain.levels:
            t.total = smaller(t.fixed + distance_from_plane(domain, t) * domain.error_scale, t.total)
    quantity2 = t.total * t.total
    if quantity == EDGE or quantity == AREA:
        long2, legs2 = sizes(criterion, domain.unit_bits, deepest)  # squared edge, and twice the area: the squared legs
        quantity2 = wp.where(quantity == EDGE, long2, legs2) + d.rise * d.rise
    t.is_small = quantity != FIXED and quantity != ERROR  # only searches for these two divide leaves
    pixel2 = wp.float64(1.0)
    if quantity != METRES:
        pixel2, is_small = finest_seen(domain, criterion, quantity == EDGE or quantity == AREA, d, t)
        t.is_small = t.is_small or is_small
    if t.leaf_depth == ANY:
        # No leaf below exceeds the criterion: with the finest footprint its error is at most `allowed_m`. With larger
        # ones the ratio of error and footprint, which is what this bounds, is no larger than there or the tolerance.
        allowed_m = t.fixed + max_error_for(domain, wp.sqrt(tolerance2 * pixel2), t.fixed - domain.source)
        quantity2 = smaller(larger(allowed_m * allowed_m, tolerance2 * pixel2), quantity2)
    t.bound2 = wp.where(pixel2 < wp.float64(wp.inf), quantity2 / pixel2, UNSEEN)
    return t


@wp.func
def root_triangle(domain: Domain, n: wp.int32, leaf_depth: wp.int32, squares: wp.uint64) -> Triangle:
    """Return half n (two for each root square) as a Triangle of the search.

    squares: the tree's node for the first square. leaf_depth: depth of the leaves, or ANY.
    """
    side = wp.int32(1) << domain.unit_bits
    square = n >> 1
    x0 = (square % domain.columns) << domain.unit_bits
    y0 = (square / domain.columns) << domain.unit_bits
    t = Triangle()
    t.left = wp.vec2i(x0, y0 + side)
    t.apex = wp.vec2i(x0, y0)
    t.right = wp.vec2i(x0 + side, y0)
    if (n & 1) == 1:
        t.left = wp.vec2i(x0 + side, y0)
        t.apex = wp.vec2i(x0 + side, y0 + side)
        t.right = wp.vec2i(x0, y0 + side)
    t.depth = 1
    t.node = wp.uint64(2) * squares + wp.uint64(n)
    t.leaf_depth = leaf_depth
    return t


@wp.func
def half_of(t: Triangle, number: wp.int32) -> Triangle:
    """Return half 0 or 1 (`number`) of a triangle, with the values that both inherit."""
    half = Triangle()
    half.left = t.left
    half.right = t.apex
    if number == 1:
        half.left = t.apex
        half.right = t.right
    half.apex = middle_between(t.left, t.right)
    half.depth = t.depth + 1
    half.node = wp.uint64(2) * t.node + wp.uint64(number)
    half.leaf_depth = t.leaf_depth
    half.is_drawn = t.is_drawn
    half.drawn = t.drawn
    half.plane = t.plane
    half.fixed = t.fixed
    half.total = t.total
    return half


@wp.kernel
def find_largest(
    domain: Domain,
    criterion: CriterionArrays,
    quantity: wp.int32,
    leaf_depth: wp.int32,
    min2: wp.float64,
    tree: Bitfield,
    squares: wp.uint64,
    stack: wp.array(dtype=Triangle),
    found: wp.array(dtype=wp.float64),
):
    """Find the largest value of a quantity (FIXED .. METRES) among leaves at depth `leaf_depth`, or all leaves (ANY).

    found [3]: its square, rounded up, and its triangle's metres of error without (`fixed`: only roundings) and with
    refinable errors (`total`); `min2`, -1 and -1 if no square is above `min2`. With ANY, `min2` is the squared
    tolerance. squares: the tree's node for the first square. stack [STACK]: scratch. One thread searches all squares.
    A leaf is divided until pixel footprints hardly differ in it (`is_small`). The found square is raised by a factor
    NEARLY.., so that triangles that may exceed it by less than that are not searched.
    """
    bound2 = min2  # largest square found, rounded up
    fixed = wp.float64(-1.0)
    total = wp.float64(-1.0)
    for n in range(2 * domain.columns * domain.rows):
        stack[0] = with_bound(domain, criterion, quantity, min2, tree, root_triangle(domain, n, leaf_depth, squares))
        top = wp.int32(0)
        while top >= 0:
            t = stack[top]
            top -= 1
            if t.bound2 >= wp.float64(0.0) and t.bound2 > bound2:  # in view, with a bound above the value found
                is_in_leaf = t.leaf_depth != ANY and t.depth >= t.leaf_depth
                # A leaf is divided down to the lattice's smallest triangles.
                if is_in_leaf and (t.is_small or t.depth >= 2 * domain.unit_bits - 1):
                    bound2 = t.bound2 * wp.where(quantity == ERROR, NEARLY_ON_SCREEN, NEARLY)
                    fixed = t.fixed
                    total = t.total
                else:
                    a = with_bound(domain, criterion, quantity, min2, tree, half_of(t, 0))
                    b = with_bound(domain, criterion, quantity, min2, tree, half_of(t, 1))
                    # The half with the larger bound is on top, and is searched first.
                    if a.bound2 > b.bound2:
                        stack[top + 1] = b
                        stack[top + 2] = a
                    else:
                        stack[top + 1] = a
                        stack[top + 2] = b
                    top += 2
    found[0] = bound2
    found[1] = fixed
    found[2] = total
