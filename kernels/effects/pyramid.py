# SPDX-License-Identifier: GPL-3.0-or-later
"""The pyramid of prefiltered heights, and the jet of the ground at a point and a scale.

Level l has the samples at multiples of 2**l, each a mean of the level below with the weights [1 2 1] x [1 2 1] / 16
(P. J. Burt, "Fast filter transforms for image processing", 1981). A jet is the height with its first and second
derivatives, of the uniform cubic B-spline over 4 x 4 samples (whose second derivatives are continuous), linear between
two levels. Boundary: heights are extrapolated linearly, h(-1) = 2 h(0) - h(1), so that a plane is exact everywhere.

`ground` is the pyramid of the terrain's heights, or of a layer's values.
"""

import warp as wp

from ..field.codes import Samples, sample_at
from ..unchecked import item_at, put

# Height in metres; d/dx, d/dy; d2/dx2, d2/dxdy, d2/dy2: x to the east, y to the north, per metre.
Jet = wp.types.vector(length=6, dtype=wp.float64)


@wp.struct
class Pyramid:
    """The prefiltered heights of a terrain, areas or values of a layer, and their position.

    Heights share their memory with the height field.
    """

    samples: Samples  # level 0
    coarser: wp.array(dtype=wp.float32)  # the coarser levels, concatenated; heights in metres before vertical scaling
    first: wp.array(dtype=wp.int64)  # [levels]: index of the first sample of each level there; unused for level 0
    columns: wp.array(dtype=wp.int32)  # [levels]: samples in a row
    rows: wp.array(dtype=wp.int32)
    levels: wp.int32
    step_x: wp.float64  # metres between samples of level 0
    step_y: wp.float64
    per_x: wp.float64  # 1 / step_x
    per_y: wp.float64
    west: wp.float64  # position of the first sample in metres
    south: wp.float64
    height_scale: wp.float64
    height_offset: wp.float64


@wp.func
def filtered_height(ground: Pyramid, level: wp.int32, i: wp.int64) -> wp.float64:
    """Return value i of a level of the pyramid, row by row: metres before vertical scaling if it holds heights."""
    h = wp.float32(0.0)
    if level == 0:
        h = sample_at(ground.samples, i)
    else:
        h = item_at(ground.coarser, ground.first[level] + i)
    return wp.float64(h)


@wp.func
def row_height(ground: Pyramid, level: wp.int32, x: wp.int32, y: wp.int32) -> wp.float64:
    """Return sample x of row y of a level, metres before vertical scaling; beyond the row's ends it is extrapolated.

    The extrapolation is 2 last - mirrored, which continues slopes.
    """
    last = ground.columns[level] - 1
    edge = wp.clamp(x, 0, last)
    row = wp.int64(y) * wp.int64(last + 1)
    h = filtered_height(ground, level, row + wp.int64(edge))
    if x != edge:
        h = wp.float64(2.0) * h - filtered_height(ground, level, row + wp.int64(2 * edge - x))
    return h


@wp.func
def extended_height(ground: Pyramid, level: wp.int32, x: wp.int32, y: wp.int32) -> wp.float64:
    """Return sample (x, y) of a level, metres before vertical scaling.

    Beyond the border it is 2 last - mirrored, which continues slopes.
    """
    edge = wp.clamp(y, 0, ground.rows[level] - 1)
    h = row_height(ground, level, x, edge)
    if y != edge:
        h = wp.float64(2.0) * h - row_height(ground, level, x, 2 * edge - y)
    return h


@wp.func
def filtered_row(ground: Pyramid, level: wp.int32, x: wp.int32, y: wp.int32, inner: wp.bool) -> wp.float64:
    """Return four times the [1 2 1] / 4 mean along x at sample (x, y) of a level, metres before vertical scaling.

    inner: no sample is beyond the border, so that the fast reads are safe.
    """
    west = wp.float64(0.0)
    here = wp.float64(0.0)
    east = wp.float64(0.0)
    if inner:
        index = wp.int64(y) * wp.int64(ground.columns[level]) + wp.int64(x)
        west = filtered_height(ground, level, index - wp.int64(1))
        here = filtered_height(ground, level, index)
        east = filtered_height(ground, level, index + wp.int64(1))
    else:
        west = extended_height(ground, level, x - 1, y)
        here = extended_height(ground, level, x, y)
        east = extended_height(ground, level, x + 1, y)
    return (west + east) + wp.float64(2.0) * here


@wp.kernel
def halve_level(offset: int, ground: Pyramid, level: int, out: wp.array(dtype=wp.float32)):
    """Compute row `offset + tid` of `level` from the next finer level: means with the weights [1 2 1] x [1 2 1] / 16.

    out: ground.coarser. The finer level has at least two cells in each direction.
    """
    row = offset + wp.tid()
    finer = level - 1
    y = 2 * row
    is_inner_row = y > 0 and y < ground.rows[finer] - 1
    to = ground.first[level] + wp.int64(row) * wp.int64(ground.columns[level])
    for column in range(ground.columns[level]):
        x = 2 * column
        is_inner = is_inner_row and x > 0 and x < ground.columns[finer] - 1
        h = filtered_row(ground, finer, x, y - 1, is_inner) + filtered_row(ground, finer, x, y + 1, is_inner)
        h += wp.float64(2.0) * filtered_row(ground, finer, x, y, is_inner)
        put(out, to + wp.int64(column), wp.float32(h * wp.float64(0.0625)))


# The jet at u, v of the cell of sample (x + 1, y + 1), from the samples x .. x + 3 of the rows y .. y + 3. Heights are
# relative to that sample, in float32, so that only differences are rounded; derivatives are per cell. The first
# derivative is the quadratic spline of neighbours' differences, the second the linear one of second differences, so
# that a plane has one slope and no curvature but for rounding. C code, twice as fast as Warp's vectors.


@wp.func_native("""
    typedef float four __attribute__((ext_vector_type(4), aligned(4)));
    const auto& samples = ground.samples;
    const bool coded = level == 0 && samples.coded;
    const wp::uint16* numbers = samples.numbers.data;
    const float* floats = level ? ground.coarser.data + ground.first.data[level] : samples.floats.data;
    const int columns = ground.columns.data[level], rows = ground.rows.data[level];
    auto height = [&](wp::int64 i) __attribute__((always_inline)) {
        return coded ? (float)((numbers[i] + samples.first) * samples.scale + samples.offset) : floats[i];
    };
    four r[4];  // 4 x 4 heights, row by row; beyond the border they are extrapolated
    if (x >= 0 && x + 3 < columns && y >= 0 && y + 3 < rows)
        for (int k = 0; k < 4; ++k) {
            const wp::int64 i = wp::int64(y + k) * columns + x;
            if (coded) r[k] = four{height(i), height(i + 1), height(i + 2), height(i + 3)};
            else r[k] = *(const four*)(floats + i);
        }
    else {
        for (int k = 0; k < 16; ++k)
            r[k / 4][k % 4] = height(wp::int64(wp::clamp(y + k / 4, 0, rows - 1)) * columns
                                     + wp::clamp(x + k % 4, 0, columns - 1));
        for (int k = 0; k < 4; ++k) {
            if (x < 0) r[k][0] = 2.0f * r[k][1] - r[k][2];
            if (x + 3 == columns) r[k][3] = 2.0f * r[k][2] - r[k][1];
        }
        if (y < 0) r[0] = 2.0f * r[1] - r[2];
        if (y + 3 == rows) r[3] = 2.0f * r[2] - r[1];
    }
    const float s = 1.0f - u, t = 1.0f - v, sixth = 1.0f / 6.0f, base = r[1][1];
    for (int k = 0; k < 4; ++k) r[k] -= base;
    // Along each column: height z, slope g and second derivative k at v.
    const four a = r[1] - r[0], b = r[2] - r[1], c = r[3] - r[2];
    const four z = (t * t * t * r[0] + (4.0f - v * v * (6.0f - 3.0f * v)) * r[1]
                    + (4.0f - t * t * (6.0f - 3.0f * t)) * r[2] + v * v * v * r[3]) * sixth;
    const four g = 0.5f * t * t * a + (0.5f + t * v) * b + 0.5f * v * v * c;
    const four k = t * (b - a) + v * (c - b);
    // Across the columns at u: weights w of values, and d of differences for the slope.
    const float w0 = s * s * s * sixth, w1 = (4.0f - u * u * (6.0f - 3.0f * u)) * sixth;
    const float w2 = (4.0f - s * s * (6.0f - 3.0f * s)) * sixth, w3 = u * u * u * sixth;
    const float d0 = 0.5f * s * s, d1 = 0.5f + s * u, d2 = 0.5f * u * u;
    const float e0 = z[1] - z[0], e1 = z[2] - z[1], e2 = z[3] - z[2];
    wp::vec_t<6, wp::float64> q;
    q.c[0] = (wp::float64)base + (w0 * z[0] + w1 * z[1] + w2 * z[2] + w3 * z[3]);
    q.c[1] = d0 * e0 + d1 * e1 + d2 * e2;
    q.c[2] = w0 * g[0] + w1 * g[1] + w2 * g[2] + w3 * g[3];
    q.c[3] = s * (e1 - e0) + u * (e2 - e1);
    q.c[4] = d0 * (g[1] - g[0]) + d1 * (g[2] - g[1]) + d2 * (g[3] - g[2]);
    q.c[5] = w0 * k[0] + w1 * k[1] + w2 * k[2] + w3 * k[3];
    return q;
""")
def jet_of(ground: Pyramid, level: int, x: int, y: int, u: wp.float32, v: wp.float32) -> Jet:
    """Return the jet at (u, v), 0 .. 1, of the cell whose south-west sample is (x + 1, y + 1) of a level.

    A jet is (z, zx, zy, zxx, zxy, zyy) of the cubic B-spline over the 4 x 4 samples from (x, y) on: metres before
    vertical scaling, derivatives per cell.
    """
    ...


@wp.func
def inverse_power(level: wp.int32) -> wp.float64:
    """Return 2**-level, made from its exponent bits."""
    return wp.cast(wp.int64(1023 - level) << wp.int64(52), wp.float64)


@wp.func
def level_jet(ground: Pyramid, level: wp.int32, x: wp.float64, y: wp.float64) -> Jet:
    """Return the jet (z, zx, zy, zxx, zxy, zyy) of one level at (x, y) cells of that level from its first sample.

    z: metres before vertical scaling. The derivatives are per metre.
    """
    i = wp.min(wp.int32(x), item_at(ground.columns, level) - 2)
    j = wp.min(wp.int32(y), item_at(ground.rows, level) - 2)
    q = jet_of(ground, level, i - 1, j - 1, wp.float32(x - wp.float64(i)), wp.float32(y - wp.float64(j)))
    scale = inverse_power(level)
    per_x = ground.per_x * scale
    per_y = ground.per_y * scale
    return Jet(q[0], q[1] * per_x, q[2] * per_y, q[3] * per_x * per_x, q[4] * per_x * per_y, q[5] * per_y * per_y)


@wp.func
def jet_at(ground: Pyramid, x: wp.float64, y: wp.float64, level: wp.float32) -> Jet:
    """Return the jet (z, zx, zy, zxx, zxy, zyy) at x, y metres in the terrain's space and a fractional level.

    It is after vertical scaling, derivatives per metre. Points outside the raster are clamped to its border, and levels
    to those of the pyramid.
    """
    last_x = wp.float64(ground.columns[0] - 1)
    last_y = wp.float64(ground.rows[0] - 1)
    cell_x = wp.clamp((x - ground.west) * ground.per_x, wp.float64(0.0), last_x)
    cell_y = wp.clamp((y - ground.south) * ground.per_y, wp.float64(0.0), last_y)
    pyramid_level = wp.clamp(level, wp.float32(0.0), wp.float32(ground.levels - 1))
    lower_level = wp.int32(pyramid_level)
    fraction = wp.float64(pyramid_level) - wp.float64(lower_level)
    q = Jet()
    for k in range(wp.where(fraction > wp.float64(0.0), 2, 1)):
        cells_factor = inverse_power(lower_level + k)
        weight = wp.where(k == 0, wp.float64(1.0) - fraction, fraction)
        q += level_jet(ground, lower_level + k, cell_x * cells_factor, cell_y * cells_factor) * weight
    q *= ground.height_scale
    q[0] = q[0] + ground.height_offset
    return q
