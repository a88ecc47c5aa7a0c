# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface of queries: a height field at full resolution, as the displacement samples it.

Cell (i, j) is in column i and row j, counted from the south-west. A raster cell has 2^finer.bits finer cells a side
where it has a finer tile. Metres after scaling are height * surface.scale + surface.offset.
"""

import warp as wp

from ..bicubic.surface import in_patch, off_corners
from ..field.cells import in_cell
from ..field.codes import Samples, corners_of
from ..field.detail import PackedLayers, detail_at
from ..field.finer import PackedTiles, finer_at, finer_corners, tile_at
from ..field.holes import is_whole


@wp.struct
class QueriedSurface:
    """Metres are height * scale + offset; memory is shared with the height field (cbt_terrain/query/surface.py)."""

    west: wp.float64  # metres
    south: wp.float64
    step_x: wp.float64  # metres between samples
    step_y: wp.float64
    per_x: wp.float64  # samples a metre
    per_y: wp.float64
    border_x: wp.float64  # cells that a point may be beyond the border: the rounding of float32 positions
    border_y: wp.float64
    scale: wp.float64
    offset: wp.float64
    bicubic: wp.int32  # 1, or 0: bilinear
    samples: Samples
    layers: PackedLayers
    has_finer: wp.int32  # 1: some squares have finer tiles
    finer: wp.array(dtype=PackedTiles)  # ... [1]
    holed: wp.int32  # 1: some samples are missing
    valid: wp.array(dtype=wp.uint8)  # of each sample, 0 where it is missing; one entry without holes


@wp.func
def cell_of(u: wp.float64, cells: wp.int32) -> wp.int32:
    """Return the cell that contains a point u cells from the border; the border itself belongs to the last cell."""
    return wp.clamp(wp.int32(wp.floor(u)), 0, cells - 1)


@wp.func
def is_whole_cell(surface: QueriedSurface, i: wp.int32, j: wp.int32) -> wp.bool:
    """Return whether cell (i, j) is in the raster and none of its four samples is missing."""
    is_complete = i >= 0 and j >= 0 and i < surface.samples.columns - 1 and j < surface.samples.rows - 1
    if is_complete:
        is_complete = is_whole(surface.valid, surface.samples.columns, i, j)
    return is_complete


@wp.func
def is_ground(surface: QueriedSurface, i: wp.int32, j: wp.int32, on_west: wp.bool, on_south: wp.bool) -> wp.bool:
    """Return whether there is ground at a point in cell (i, j), that is, whether the point is in no hole.

    on_west, on_south: whether the point is on that side of the cell. A side belongs to both cells, so the border of a
    hole is ground.
    """
    has_ground = surface.holed == 0
    if not has_ground:
        has_ground = is_whole_cell(surface, i, j)
        if not has_ground and on_west:
            has_ground = is_whole_cell(surface, i - 1, j)
        if not has_ground and on_south:
            has_ground = is_whole_cell(surface, i, j - 1)
        if not has_ground and on_west and on_south:
            has_ground = is_whole_cell(surface, i - 1, j - 1)
    return has_ground


@wp.func
def finer_tile(surface: QueriedSurface, i: wp.int32, j: wp.int32) -> wp.int32:
    """Return the number of the finer tile that holds raster cell (i, j); -1 for none."""
    tile = wp.int32(-1)
    if surface.has_finer == 1:
        bits = surface.finer[0].bits  # a raster cell has 2^bits finer cells a side
        tile = tile_at(surface.finer[0], i << bits, j << bits)
    return tile


@wp.func
def finer_cell(surface: QueriedSurface, i: wp.int32, s: wp.float64):
    """Return the finer cell at `s` (0 .. 1) of raster cell `i` along one axis, and the position in it, 0 .. 1."""
    bits = surface.finer[0].bits
    position = s * wp.float64(wp.int32(1) << bits)
    k = wp.clamp(wp.int32(wp.floor(position)), 0, (wp.int32(1) << bits) - 1)
    return (i << bits) + k, position - wp.float64(k)


@wp.func
def bilinear_patch(p: wp.vec4d, s: wp.float64, t: wp.float64) -> wp.vec3d:
    """Return height (metres) and slopes (metres a cell) of the bilinear patch with the corners p, before scaling.

    s, t: position in the cell, 0 .. 1.
    """
    east = p[1] - p[0]
    north = p[2] - p[0]
    twist = p[3] - p[2] - east
    return wp.vec3d(p[0] + east * s + (north + twist * s) * t, east + twist * t, north + twist * s)


@wp.func
def add_detail(
    surface: QueriedSurface, i: wp.int32, j: wp.int32, s: wp.float64, t: wp.float64, g: wp.vec3d
) -> wp.vec3d:
    """Return `g` with displacement added, and its slopes in metres a metre instead of metres a cell.

    g: height (metres before scaling) and slopes (metres a cell) in cell (i, j) at (s, t), 0 .. 1.
    """
    detailed = wp.vec3d(g[0], g[1] * surface.per_x, g[2] * surface.per_y)
    if surface.layers.count > 0:
        x = surface.west + (wp.float64(i) + s) * surface.step_x
        y = surface.south + (wp.float64(j) + t) * surface.step_y
        detailed += detail_at(surface.layers, x, y)
    return detailed


@wp.func
def in_finer_cell(surface: QueriedSurface, x: wp.int32, y: wp.int32, u: wp.float64, v: wp.float64) -> wp.vec3d:
    """Return height (metres) and slopes (metres a raster cell) in finer cell (x, y) of a tile, without displacement.

    u, v: position in the finer cell, 0 .. 1, or a rounding beyond: the slopes are still those of this cell.
    """
    tile = tile_at(surface.finer[0], x, y)
    finer_per_cell = wp.float64(wp.int32(1) << surface.finer[0].bits)
    g = bilinear_patch(finer_corners(surface.finer[0], tile, x, y), u, v)
    g = wp.vec3d(g[0], g[1] * finer_per_cell, g[2] * finer_per_cell)
    if surface.bicubic == 1:
        # The bicubic surface less its bilinear interpolation between the finer cell's corners.
        g += off_corners(surface.samples, surface.finer[0].bits, x, y, u, v)
    return g


@wp.func
def height_and_slopes(surface: QueriedSurface, i: wp.int32, j: wp.int32, s: wp.float64, t: wp.float64) -> wp.vec3d:
    """Return height (metres) and slopes (metres a metre) in cell (i, j), before scaling, displacement included.

    s, t: position in the cell, 0 .. 1. Slopes have steps between bilinear cells; `shaded_in` has smooth ones.
    """
    g = wp.vec3d()
    if finer_tile(surface, i, j) >= 0:
        x, u = finer_cell(surface, i, s)
        y, v = finer_cell(surface, j, t)
        g = in_finer_cell(surface, x, y, u, v)
    elif surface.bicubic == 1:
        g = in_patch(surface.samples, i, j, s, t)
    else:
        g = bilinear_patch(corners_of(surface.samples, i, j), s, t)
    return add_detail(surface, i, j, s, t, g)


@wp.func
def shaded_in(surface: QueriedSurface, i: wp.int32, j: wp.int32, s: wp.float64, t: wp.float64) -> wp.vec3d:
    """Return height (metres) and slopes (metres a metre) in cell (i, j), before scaling, for shading.

    s, t: position in the cell, 0 .. 1. Displacement is included. On a bilinear surface and in finer tiles the slopes
    are interpolated between samples, so that shading has no steps.
    """
    g = wp.vec3d()
    tile = finer_tile(surface, i, j)
    if tile >= 0:
        x, u = finer_cell(surface, i, s)
        y, v = finer_cell(surface, j, t)
        g = finer_at(surface.finer[0], tile, x, y, u, v)
        if surface.bicubic == 1:
            more = off_corners(surface.samples, surface.finer[0].bits, x, y, u, v)
            g = wp.vec3d(g[0] + more[0], g[1], g[2])
    elif surface.bicubic == 1:
        g = in_patch(surface.samples, i, j, s, t)
    else:
        g = in_cell(surface.samples, i, j, s, t)
    return add_detail(surface, i, j, s, t, g)
