# SPDX-License-Identifier: GPL-3.0-or-later
"""Where moving vertices is not enough: the fit splits triangles, or returns vertices to the surface.

The *walk*, which made the mesh, refines from the root triangles and splits each diamond whose stored error is too
large; it runs again after the errors `m.codes` have been raised. Of the mesh m (FitMesh): `active`, the list of
triangles to look at; `worst`, a triangle's distance from the surface, and `bound`, the largest allowed one, metres
after scaling; `level`, its bisections, of which 2 levels + 1 lead to the raster's cells; `push`, two numbers a vertex,
free for other uses here; `state`, whether a vertex is PINNED. `corner_verts` [3 T] has the vertices of triangles (left,
apex, right), and `point` their positions, lattice units.
"""

import warp as wp

from ..leb.halfway import halfway, middle_between
from ..refine.diamond import metres2_of
from ..refine.stored_errors import cell_error, error_at
from .finer import in_tile, missed_change
from .mesh import PINNED, FitMesh, list_marked, mark, mark_around, put_on_surface, split
from .raising import raise_cells


@wp.kernel
def refine(count: int, max_depth: int, min_share: wp.float64, m: FitMesh, found: wp.array(dtype=wp.int32)):
    """Split triangles beyond the bound that interpolation would split too; move the vertices of others to the surface.

    Interpolation is the mesh without a fit: all vertices on the surface. count: listed triangles. max_depth: level
    whose triangles are not split. min_share: split only triangles whose excess is at least this fraction of the largest
    among the triangles that they touch, since one split may help them all. `m.active` becomes the list for the next
    sweep. Triangles above the raster's cells are split in place if the arrays have room. For those in cells only the
    errors `m.codes` are raised, so that the next walk splits them; but not in finer tiles, where the walk has already
    split what interpolation would split. `found` [7] holds the numbers of triangles [1] and vertices [2], and receives
    the numbers of triangles that are listed now [0], of triangles [1], vertices [2], splits [3], vertices put on the
    surface [4], splits that wait for the next walk [5], and triangles too coarse at the deepest level [6]. One thread.
    """
    d = m.domain
    size = wp.vec2i(found[1], found[2])
    splits = wp.int32(0)
    pins = wp.int32(0)
    postponed = wp.int32(0)
    num_too_coarse = wp.int32(0)
    _spread_excess(m, count)
    for k in range(count):
        t = m.active[k]
        excess = m.worst[t] - m.bound
        if excess > wp.float64(0.0):
            m.awake[t] = m.round + 1  # it pushes its corners in the next round
            mark(m, t)
            if excess >= min_share * _max_excess_around(m, t):
                below = m.level[t] - 2 * d.levels - 1  # bisections below the raster's cells
                cell = _cell_of(m, t)
                error = _error_on_surface(m, t, below, cell)
                # Float32 positions add at most rounding + max_lean to the error. m.error: the requested error, metres.
                too_coarse = metres2_of(d, error, d.rounding + d.max_lean) > m.error * m.error
                can_split = m.level[t] < max_depth and not (below >= 0 and in_tile(d, cell[0], cell[1]))
                if can_split and (too_coarse or _needs_split_on_surface(m, t, error)):
                    splits += 1
                    if below >= 0:
                        halvings = (below + 1) >> 1  # of the cell's sides; two bisections halve them
                        raise_cells(d, cell[0], cell[1], halvings, m.raised, m.codes, m.climbing)
                        postponed += 1
                    elif size[0] + 2 * m.level[t] + 2 < m.capacity:  # a split adds at most two triangles a level
                        size = split(m, t, size)
                    else:
                        postponed += 1
                else:
                    pins += _pin_corners(m, t)
                    num_too_coarse += wp.where(too_coarse and m.level[t] >= max_depth, 1, 0)
    listed = list_marked(m, size[0])
    for k in range(listed):
        t = m.active[k]
        for c in range(3):
            v = m.corner_verts[3 * t + c]
            m.push[2 * v] = wp.float64(0.0)
            m.push[2 * v + 1] = wp.float64(0.0)
    found[0] = listed
    found[1] = size[0]
    found[2] = size[1]
    found[3] = splits
    found[4] = pins
    found[5] = postponed
    found[6] = num_too_coarse


@wp.func
def _spread_excess(m: FitMesh, count: int):
    """Write to each vertex the largest excess over the bound of the `count` listed triangles around it.

    The excess is in metres after vertical scaling. It is stored in the vertex' sum of pushes, which is 0 and not needed
    then.
    """
    for k in range(count):
        t = m.active[k]
        excess = m.worst[t] - m.bound
        if excess > wp.float64(0.0):
            for c in range(3):
                v = m.corner_verts[3 * t + c]
                m.push[2 * v] = wp.max(m.push[2 * v], excess)


@wp.func
def _max_excess_around(m: FitMesh, t: int):
    """Return the largest excess over the bound of any listed triangle that touches triangle t, metres; 0 for none.

    The excess is `worst` - `bound` of a triangle; `_spread_excess` has written it to the triangle's corners.
    """
    largest = wp.float64(0.0)
    for c in range(3):
        largest = wp.max(largest, m.push[2 * m.corner_verts[3 * t + c]])
    return largest


@wp.func
def _cell_of(m: FitMesh, t: int):
    """Return the raster's cell of a triangle within one: between its apex and the middle of its longest edge."""
    bits = m.domain.unit_bits - m.domain.levels
    middle = _middle(m, t)
    return wp.vec2i(
        halfway(middle[0], m.point[m.corner_verts[3 * t + 1]][0]) >> bits,
        halfway(middle[1], m.point[m.corner_verts[3 * t + 1]][1]) >> bits,
    )


@wp.func
def _middle(m: FitMesh, t: int):
    """Return the middle of a triangle's longest edge, lattice units."""
    return middle_between(m.point[m.corner_verts[3 * t]], m.point[m.corner_verts[3 * t + 2]])


@wp.func
def _error_on_surface(m: FitMesh, t: int, below: int, cell: wp.vec2i):
    """Return the stored error of triangle t if its vertices were on the surface, metres before scaling.

    below: bisections below the raster's cells, negative above them; in a cell the error divides by four with each two
    bisections. cell: the triangle's cell, used only if it is within one.
    """
    if below < 0:
        middle = _middle(m, t)
        return error_at(m.domain, middle[0], middle[1], m.level[t])
    # A factor of four already at the first of two bisections, which halves the cell's diagonal.
    error = cell_error(m.domain, cell[0], cell[1]) / wp.float32(wp.int64(1) << wp.int64(below + (below & 1)))
    if m.domain.has_finer == 1:
        left = m.point[m.corner_verts[3 * t]]
        right = m.point[m.corner_verts[3 * t + 2]]
        error += wp.float32(missed_change(m.domain, left, right, m.level[t]) / m.domain.error_scale)
    return error


@wp.func
def _needs_split_on_surface(m: FitMesh, t: int, error: wp.float32):
    """Return whether only a split can help: all vertices of triangle t are on the surface, and its error is large.

    The vertices must have been there before this round: the distance of t is not known after they have moved. error:
    stored error, metres before scaling.
    """
    common_state = PINNED
    num_new = wp.float64(0.0)
    for c in range(3):
        v = m.corner_verts[3 * t + c]
        common_state = common_state & m.state[v]
        num_new += m.push[2 * v + 1]  # 1 if `_pin_corners` has just moved it
    is_large = wp.float64(error) * m.domain.error_scale > wp.float64(0.5) * m.bound
    return common_state != wp.uint8(0) and num_new == wp.float64(0.0) and is_large


@wp.func
def _pin_corners(m: FitMesh, t: int):
    """Put the corners of triangle t back on the surface for good; return how many were moved."""
    pins = wp.int32(0)
    for c in range(3):
        v = m.corner_verts[3 * t + c]
        if (m.state[v] & PINNED) == wp.uint8(0):
            m.state[v] = m.state[v] | PINNED
            m.push[2 * v + 1] = wp.float64(1.0)  # for `_needs_split_on_surface`: distances here are out of date
            put_on_surface(m, v)
            pins += 1
            mark_around(m, v)
    return pins
