# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights and normals at points of the plan, after vertical scaling: height * surface.scale + surface.offset."""

import warp as wp

from ..effects.jet import arc_tangent
from ..field.codes import prefetch_sample
from ..field.domain import INLINED
from .surface import QueriedSurface, cell_of, is_ground, shaded_in

wp.set_module_options(INLINED)

AHEAD = wp.constant(16)  # points, from the one whose samples are prefetched to the one in use
BLOCK = wp.constant(64)  # points of one call, which reads constants once: 42 ns a point, 53 one by one
NOTHING = wp.constant(wp.float64(wp.nan))


@wp.func
def onto_border(u: wp.float64, cells: wp.int32, slack: wp.float64) -> wp.float64:
    """Return u, moved onto the raster's border if it is at most `slack` cells beyond it, as float32 positions may be.

    u: cells from the first sample along one axis, which has `cells` cells.
    """
    border = wp.float64(cells)
    moved = u
    if u < wp.float64(0.0) and u >= -slack:
        moved = wp.float64(0.0)
    if u > border and u <= border + slack:
        moved = border
    return moved


@wp.func
def fetch_about(surface: QueriedSurface, p: wp.vec2d):
    """Prefetch the samples around point p (metres). Nothing is read, so any point is allowed."""
    i = wp.int64((p[0] - surface.west) * surface.per_x)
    j = wp.int64((p[1] - surface.south) * surface.per_y)
    row = wp.int64(surface.samples.columns)
    index = j * row + i
    prefetch_sample(surface.samples, index)
    prefetch_sample(surface.samples, index + row)
    prefetch_sample(surface.samples, index - row)
    prefetch_sample(surface.samples, index + row + row)


@wp.kernel
def ground_at(
    offset: int,
    count: int,
    surface: QueriedSurface,
    places: wp.array(dtype=wp.vec2d),
    heights: wp.array(dtype=wp.float64),
    normals: wp.array(dtype=wp.vec3d),
    slopes: wp.array(dtype=wp.float64),
    inside: wp.array(dtype=wp.bool),
):
    """Write height, unit normal and slope (radians) of the ground at the points of block `offset + tid`.

    They are NaN, and `inside` is false, where there is no ground. places [count], and so the results: x and y, metres.
    A block has BLOCK points.
    """
    begin = (offset + wp.tid()) * BLOCK
    cells_x = surface.samples.columns - 1
    cells_y = surface.samples.rows - 1
    for n in range(begin, wp.min(begin + BLOCK, count)):
        one = wp.float64(1.0)
        fetch_about(surface, places[wp.min(n + AHEAD, count - 1)])
        p = places[n]
        u = onto_border((p[0] - surface.west) / surface.step_x, cells_x, surface.border_x)
        v = onto_border((p[1] - surface.south) / surface.step_y, cells_y, surface.border_y)
        zero = wp.float64(0.0)
        has_ground = u >= zero and v >= zero and u <= wp.float64(cells_x) and v <= wp.float64(cells_y)
        height = NOTHING
        normal = wp.vec3d(NOTHING, NOTHING, NOTHING)
        slope = NOTHING
        if has_ground:
            i = cell_of(u, cells_x)
            j = cell_of(v, cells_y)
            s = u - wp.float64(i)
            t = v - wp.float64(j)
            has_ground = is_ground(surface, i, j, s == zero, t == zero)
            if has_ground:
                g = shaded_in(surface, i, j, s, t)
                height = g[0] * surface.scale + surface.offset
                nx = -g[1] * surface.scale
                ny = -g[2] * surface.scale
                steep2 = nx * nx + ny * ny
                nz = one / wp.sqrt(steep2 + one)
                normal = wp.vec3d(nx * nz, ny * nz, nz)
                slope = arc_tangent(wp.sqrt(steep2))
        heights[n] = height
        normals[n] = normal
        slopes[n] = slope
        inside[n] = has_ground
