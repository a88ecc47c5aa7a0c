# SPDX-License-Identifier: GPL-3.0-or-later
"""The distance of a mesh from the reference surface: its triangles are walked, sample by sample and edge by edge.

Points are measured in raster cells from the south-west corner. Which triangle owns a point is decided in integers:
2^bits lattice units a cell, fine enough that float32 positions round to their own lattice point and to no other. A
triangle's plane goes through its three float32 positions as they were delivered, evaluated in float64. Heights are
metres after vertical scaling. Detail is the height of all displacement layers. `ground` is the reference surface, f a
triangle of the mesh.

The code that makes bounds and fits (criterion.py, hierarchy.py, fitting/) is not used here, though fitting/facet.py
finds the same maximum: a fault in one of the two shows in the other.

`ground` has the samples in metres before scaling: a height is sample * scale + offset. Where it has finer tiles, they
replace the samples.
"""

import warp as wp

from ..field.codes import Samples, corners_of, sample_at, sample_index
from ..field.detail import PackedLayers
from ..field.finer import SIDE, STRIDE, PackedTiles, tile_at
from ..unchecked import put
from .cubic import cubic_at
from .detail import detail_height


@wp.struct
class Reference:
    """The reference surface: bilinear or C1 bicubic between the samples, z = sample * scale + offset, metres."""

    bits: wp.int32  # 2**bits lattice units a cell
    bicubic: wp.int32  # 1, or 0: bilinear
    curved: wp.int32  # 0: bilinear without detail, so that extrema have a closed form
    layers: PackedLayers
    max_detail: wp.float64  # largest magnitude of displacement layers and finer tiles' change, metres before scaling
    has_finer: wp.int32  # 1: some squares have finer tiles
    finer: wp.array(dtype=PackedTiles)  # ... [1]
    west: wp.float64  # metres
    south: wp.float64
    step_x: wp.float64
    step_y: wp.float64
    scale: wp.float64
    offset: wp.float64
    samples: Samples


@wp.struct
class DeliveredMesh:
    """A mesh as it was delivered: vertices in metres, and three entries of `corners` for each triangle."""

    positions: wp.array(dtype=wp.vec3f)
    normals: wp.array(dtype=wp.vec3f)
    corners: wp.array(dtype=wp.int32)


@wp.struct
class MeasuredFacet:
    """A triangle: its corners in lattice units and its plane, in metres over cells."""

    x: wp.types.vector(length=3, dtype=wp.int64)
    y: wp.types.vector(length=3, dtype=wp.int64)
    west: wp.int64  # the box of its corners
    south: wp.int64
    east: wp.int64
    north: wp.int64
    area2: wp.int64  # twice the area, square lattice units; 0 where it covers nothing
    u: wp.float64  # a point of the plane: cells, cells and metres
    v: wp.float64
    z: wp.float64
    slope_u: wp.float64  # metres a cell
    slope_v: wp.float64


@wp.func
def to_cells(ground: Reference, position: wp.vec3f):
    """Return a delivered position (metres) as cells east and north of the raster's south-west corner."""
    u = (wp.float64(position[0]) - ground.west) / ground.step_x
    v = (wp.float64(position[1]) - ground.south) / ground.step_y
    return u, v


@wp.func
def to_lattice(cells: wp.float64, bits: wp.int32) -> wp.int64:
    """Return the nearest lattice coordinate of a position in cells; 2^bits units are a cell."""
    return wp.int64(wp.floor(cells * wp.float64(wp.int64(1) << wp.int64(bits)) + wp.float64(0.5)))


@wp.func
def facet_of(ground: Reference, mesh: DeliveredMesh, t: wp.int32) -> MeasuredFacet:
    """Return triangle t of a mesh as a plane with integer corners.

    If float32 rounding has folded the triangle over or taken three quarters of its area, the plane goes through the
    lattice points instead. A triangle that covers nothing has a level plane.
    """
    f = MeasuredFacet()
    u = wp.vec3d()
    v = wp.vec3d()
    z = wp.vec3d()
    for k in range(3):
        position = mesh.positions[mesh.corners[3 * t + k]]
        cells_x, cells_y = to_cells(ground, position)
        u[k] = cells_x
        v[k] = cells_y
        z[k] = wp.float64(position[2])
        f.x[k] = to_lattice(cells_x, ground.bits)
        f.y[k] = to_lattice(cells_y, ground.bits)
    f.west = wp.min(f.x[0], wp.min(f.x[1], f.x[2]))
    f.south = wp.min(f.y[0], wp.min(f.y[1], f.y[2]))
    f.east = wp.max(f.x[0], wp.max(f.x[1], f.x[2]))
    f.north = wp.max(f.y[0], wp.max(f.y[1], f.y[2]))
    f.area2 = (f.x[1] - f.x[0]) * (f.y[2] - f.y[0]) - (f.x[2] - f.x[0]) * (f.y[1] - f.y[0])
    units_a_cell = wp.float64(wp.int64(1) << wp.int64(ground.bits))
    area2 = (u[1] - u[0]) * (v[2] - v[0]) - (u[2] - u[0]) * (v[1] - v[0])  # as delivered, square cells
    if area2 * units_a_cell * units_a_cell < wp.float64(0.25) * wp.float64(f.area2):  # spoilt by rounding
        for k in range(3):
            u[k] = wp.float64(f.x[k]) / units_a_cell
            v[k] = wp.float64(f.y[k]) / units_a_cell
        area2 = wp.float64(f.area2) / (units_a_cell * units_a_cell)
    f.u = u[0]
    f.v = v[0]
    f.z = z[0]
    if f.area2 > wp.int64(0):  # otherwise the plane stays level
        rise_1 = z[1] - z[0]
        rise_2 = z[2] - z[0]
        f.slope_u = (rise_1 * (v[2] - v[0]) - rise_2 * (v[1] - v[0])) / area2
        f.slope_v = (rise_2 * (u[1] - u[0]) - rise_1 * (u[2] - u[0])) / area2
    return f


@wp.func
def plane_at(f: MeasuredFacet, u: wp.float64, v: wp.float64) -> wp.float64:
    """Return the height of the triangle's plane, metres, u cells east and v cells north of the south-west corner."""
    return f.z + f.slope_u * (u - f.u) + f.slope_v * (v - f.v)


@wp.func
def detail_in(ground: Reference, u: wp.float64, v: wp.float64) -> wp.float64:
    """Return the height of all displacement layers at (u, v) cells, metres before vertical scaling."""
    z = wp.float64(0.0)
    if ground.layers.count > 0:
        z = detail_height(ground.layers, ground.west + u * ground.step_x, ground.south + v * ground.step_y)
    return z


@wp.func
def finer_height(finer: PackedTiles, tile: wp.int32, u: wp.float64, v: wp.float64) -> wp.float64:
    """Return the height, metres before scaling, of a finer tile at (u, v) finer cells from the raster's corner.

    finer.heights has the tiles one above the other, STRIDE rows each. A tile has SIDE x SIDE cells.
    """
    x = wp.floor(u)
    y = wp.floor(v)
    row = tile * STRIDE + 1 + (wp.int32(y) & (SIDE - 1))  # a row and a column precede those of the tile
    south = sample_index(finer.heights, 1 + (wp.int32(x) & (SIDE - 1)), row)
    north = south + wp.int64(finer.heights.columns)
    one = wp.int64(1)
    a = wp.float64(sample_at(finer.heights, south))
    b = wp.float64(sample_at(finer.heights, south + one))
    c = wp.float64(sample_at(finer.heights, north))
    d = wp.float64(sample_at(finer.heights, north + one))
    return a + (b - a) * (u - x) + ((c - a) + (a - b - c + d) * (u - x)) * (v - y)


@wp.func
def cubic_off_corners(
    samples: Samples, i: wp.int32, j: wp.int32, s: wp.float64, t: wp.float64, finer_cells: wp.float64
) -> wp.float64:
    """Return the bicubic surface minus its bilinear interpolation between the corners of a finer cell, metres.

    (i, j): the raster cell, which has `finer_cells` finer cells a side. s, t: position in the raster cell, 0 .. 1.
    """
    one = wp.float64(1.0)
    west = wp.min(wp.floor(s * finer_cells), finer_cells - one)
    south = wp.min(wp.floor(t * finer_cells), finer_cells - one)
    x = s * finer_cells - west
    y = t * finer_cells - south
    z = cubic_at(samples, i, j, s, t)
    k = wp.int32(0)
    while k < 4:  # Warp does not unroll this loop
        across = wp.float64(k & 1)
        up = wp.float64(k >> 1)
        weight = (across * x + (one - across) * (one - x)) * (up * y + (one - up) * (one - y))
        z -= weight * cubic_at(samples, i, j, (west + across) / finer_cells, (south + up) / finer_cells)
        k += 1
    return z


@wp.func
def reference_in_cell(ground: Reference, i: wp.int32, j: wp.int32, u: wp.float64, v: wp.float64) -> wp.float64:
    """Return the height of the reference surface at (u, v), metres, with detail and vertical scaling.

    (i, j): the cell that contains the point; u, v: cells from the raster's south-west corner. A finer tile there
    replaces the cell's surface. A bicubic surface goes through the tile's samples: it is the patch plus the bilinear
    interpolation of the samples' differences from the patch.
    """
    p = corners_of(ground.samples, i, j)
    s = u - wp.float64(i)
    t = v - wp.float64(j)
    low = p[0] + (p[1] - p[0]) * s
    high = p[2] + (p[3] - p[2]) * s
    z = low + (high - low) * t
    if ground.bicubic == 1:
        z = cubic_at(ground.samples, i, j, s, t)
    if ground.has_finer == 1:
        bits = ground.finer[0].bits
        finer_per_cell = wp.float64(wp.int32(1) << bits)
        tile = tile_at(ground.finer[0], wp.int32(wp.floor(u * finer_per_cell)), wp.int32(wp.floor(v * finer_per_cell)))
        if tile >= 0:
            z = finer_height(ground.finer[0], tile, u * finer_per_cell, v * finer_per_cell)
            if ground.bicubic == 1:
                z += cubic_off_corners(ground.samples, i, j, s, t, finer_per_cell)
    z += detail_in(ground, u, v)
    return z * ground.scale + ground.offset


@wp.func
def reference_at(ground: Reference, u: wp.float64, v: wp.float64) -> wp.float64:
    """Return the height of the reference surface, metres, u cells east and v cells north of the south-west corner."""
    i = wp.clamp(wp.int32(wp.floor(u)), 0, ground.samples.columns - 2)
    j = wp.clamp(wp.int32(wp.floor(v)), 0, ground.samples.rows - 2)
    return reference_in_cell(ground, i, j, u, v)


@wp.func
def reference_sample(ground: Reference, i: wp.int32, j: wp.int32) -> wp.float64:
    """Return the height of the reference surface at sample (i, j), metres, with detail and vertical scaling."""
    z = wp.float64(sample_at(ground.samples, sample_index(ground.samples, i, j)))
    if ground.has_finer == 1:
        bits = ground.finer[0].bits
        tile = tile_at(ground.finer[0], i << bits, j << bits)
        if tile >= 0:
            z = finer_height(ground.finer[0], tile, wp.float64(i << bits), wp.float64(j << bits))
    z += detail_in(ground, wp.float64(i), wp.float64(j))
    return z * ground.scale + ground.offset


@wp.func
def toward_zero(value: wp.float64) -> wp.float32:
    """Return a value as the nearest float32 that is not larger in magnitude, so that no measurement is overstated."""
    single = wp.float32(value)
    if wp.abs(wp.float64(single)) > wp.abs(value):
        single = wp.cast(wp.cast(single, wp.int32) - 1, wp.float32)  # the float32 before: its bits as a number, less 1
    return single


@wp.func
def left_of(side: wp.int64, dx: wp.int64, dy: wp.int64, shift_x: wp.int64, shift_y: wp.int64) -> wp.bool:
    """Return whether a point is to the left of a directed edge (dx, dy). side: their cross product, 0 on the line.

    A point on the line is moved a hair away from it: in x by the sign `shift_x`, and far less in y by the sign
    `shift_y` (1 or -1). So every point belongs to exactly one triangle.
    """
    is_left = side > wp.int64(0)
    if side == wp.int64(0):  # on the line
        is_left = dy * shift_x < wp.int64(0) or (dy == wp.int64(0) and dx * shift_y > wp.int64(0))
    return is_left


@wp.func
def shift_of(at: wp.int64, end: wp.int64) -> wp.int64:
    """Return the direction (1 or -1) in which a point on an edge is moved off it, so that it has one owner.

    It is 1, east or north, but -1, inward, at the far border of the domain. at: the point's coordinate. end: that of
    the border.
    """
    return wp.where(at >= end, wp.int64(-1), wp.int64(1))


@wp.func
def covers(
    f: MeasuredFacet, per_unit: wp.int64, x: wp.int64, y: wp.int64, shift_x: wp.int64, shift_y: wp.int64
) -> wp.bool:
    """Return whether the triangle owns the point (x, y): contains it, after a point on an edge is moved off the edge.

    x, y: units of which a lattice unit has `per_unit`. shift_x, shift_y: 1 or -1, the direction in which a point on an
    edge is moved, from `shift_of`, so that it has one owner.
    """
    is_owned = f.area2 > wp.int64(0)
    for k in range(3):
        if is_owned:
            n = (k + 1) % 3
            dx = f.x[n] - f.x[k]
            dy = f.y[n] - f.y[k]
            side = dx * (y - f.y[k] * per_unit) - dy * (x - f.x[k] * per_unit)
            is_owned = left_of(side, dx, dy, shift_x, shift_y)
    return is_owned


@wp.func
def owns(ground: Reference, f: MeasuredFacet, i: wp.int32, j: wp.int32) -> wp.bool:
    """Return whether the triangle owns sample (i, j): each sample inside the mesh has exactly one owner."""
    bits = wp.int64(ground.bits)
    shift_x = shift_of(wp.int64(i), wp.int64(ground.samples.columns - 1))
    shift_y = shift_of(wp.int64(j), wp.int64(ground.samples.rows - 1))
    per_unit = wp.int64(1)  # the sample's coordinates are lattice units
    return covers(f, per_unit, wp.int64(i) << bits, wp.int64(j) << bits, shift_x, shift_y)


@wp.func
def sample_box(ground: Reference, f: MeasuredFacet) -> wp.vec4i:
    """Return the samples in the bounding box of a triangle: first and last column, then first and last row.

    f.west .. f.north: the box in lattice units.
    """
    bits = wp.int64(ground.bits)
    to_next = (wp.int64(1) << bits) - wp.int64(1)
    return wp.vec4i(
        wp.int32((f.west + to_next) >> bits),
        wp.int32(f.east >> bits),
        wp.int32((f.south + to_next) >> bits),
        wp.int32(f.north >> bits),
    )


@wp.kernel
def differences(
    first: wp.int32,
    end: wp.int32,
    ground: Reference,
    mesh: DeliveredMesh,
    difference: wp.array(dtype=wp.float32),
    worst: wp.array(dtype=wp.float64),
):
    """Write mesh minus reference, metres, to `difference` at every sample that triangles first .. end - 1 own.

    Write the largest magnitude of triangle t to worst[t], 0 if it owns none. Other samples keep their value.
    """
    for t in range(first, end):
        f = facet_of(ground, mesh, t)
        box = sample_box(ground, f)
        largest = wp.float64(0.0)
        for j in range(box[2], box[3] + 1):
            for i in range(box[0], box[1] + 1):
                if owns(ground, f, i, j):
                    d = plane_at(f, wp.float64(i), wp.float64(j)) - reference_sample(ground, i, j)
                    put(difference, sample_index(ground.samples, i, j), toward_zero(d))
                    largest = wp.max(largest, wp.abs(d))
        worst[t] = largest
