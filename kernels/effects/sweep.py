# SPDX-License-Identifier: GPL-3.0-or-later
"""Horizons of every sample of a raster along one azimuth, and the visible sky.

After Timonen and Westerholm 2010, "Scalable height field self-shadowing".

Parallel lines run along the azimuth, one sample apart. A line's profile has one point at each sample of the direction
that it is nearer to, between two samples of the other. From the far end to the near one, each point's horizon is the
last corner of the convex hull of the points ahead, from which hidden points have been removed: a few operations for a
point, however far it sees. A sample's horizon is interpolated from the two lines next to it. Points beside a missing
sample are no ground: they hide nothing, and are no corners.
"""

import warp as wp

from .horizon import Occluder, cells_of, gradient
from .light import open_fraction

LINES = 64  # in an item of work


@wp.struct
class Sweep:
    """Heights and the lines over them. The *major* direction is the one that lines are nearer to.

    A line has a point at each of the `major` samples and moves by `slope` of the `minor` ones from one to the next. An
    item of work has LINES lines and its own part of the scratch arrays.
    """

    heights: wp.array(dtype=wp.float32)  # metres, multiplied by `scale`
    scale: wp.float64
    major: wp.int32
    minor: wp.int32
    major_stride: wp.int32  # of the array of heights
    minor_stride: wp.int32
    backwards: wp.int32  # 1: the azimuth goes towards sample 0 of the major direction
    slope: wp.float64
    phase: wp.float64  # offset of lines along the minor direction in samples, 0 to 1
    metres: wp.float64  # distance between points of a line
    first: wp.int32  # number of the first line, its minor sample at the major sample 0
    lines: wp.int32
    profiles: wp.array(dtype=wp.float64)  # scratch, [major] of each item
    hulls: wp.array(dtype=wp.int32)  # likewise
    slopes: wp.array(dtype=wp.float32)  # [2 major] of each
    out: wp.array(dtype=wp.float32)  # metres a metre, at least 0
    holed: wp.int32  # 1 if some samples are missing, which hide nothing
    missing: wp.array(dtype=wp.uint8)  # 1 at missing samples; unused without any


@wp.func_native(
    """
#pragma clang fp contract(off)
    // Lines run along the major direction, k = 0 .. n - 1, at the minor position line + phase + slope * k, 0 .. m - 1.
    const int n = s.major, m = s.minor, on = s.backwards ? 1 : -1;
    const long long across = s.minor_stride, along = s.major_stride;
    double *z = s.profiles.data + (long long)item * n;
    int *hull = s.hulls.data + (long long)item * n;
    // The horizons of the last line and of this one.
    float *before = s.slopes.data + (long long)item * 2 * n, *now = before + n;
    const int end = (item + 1) * LINES < s.lines ? (item + 1) * LINES : s.lines;
    // A group repeats the last line of the one before it, for the samples between that and its own first line.
    for (int l = item ? item * LINES - 1 : 0; l < end; l++) {
        const int line = s.first + l;
        int corners = 0;
        for (int k = s.backwards ? 0 : n - 1; k >= 0 && k < n; k += on) {
            const double at = line + s.phase + s.slope * k;
            now[k] = -1.0f;  // outside the raster
            if (!(at >= 0.0 && at <= m - 1)) continue;
            const int j = (int)at < m - 2 ? (int)at : m - 2;
            const long long index = k * along + j * across;
            bool is_ground = true;
            if (s.holed) {
                const bool before = !s.missing.data[index], after = !s.missing.data[index + across];
                is_ground = at == j ? before : at == j + 1 ? after : before && after;
                now[k] = 0.0f;
                if (!before && !after) continue;  // no sample of ground reads the horizon of this point
            }
            const float *p = s.heights.data + index;
            const double height = s.scale * (p[0] + ((double)p[across] - p[0]) * (at - j));
            auto ahead = [&](int i) { return (double)(i > k ? i - k : k - i); };
            int seen = corners;
            while (seen > 1) {  // pass corners below the line from this point to the one behind them
                const int a = hull[seen - 1], b = hull[seen - 2];
                if ((z[b] - height) * ahead(a) < (z[a] - height) * ahead(b)) break;
                seen--;
            }
            const int top = seen ? hull[seen - 1] : k;  // the horizon's point
            const double rise = seen ? (z[top] - height) / (ahead(top) * s.metres) : 0.0;
            now[k] = rise > 0.0 ? (float)rise : 0.0f;
            if (!is_ground) continue;  // it hides nothing, and the corners that it passed stay
            corners = seen;
            z[k] = height;
            hull[corners++] = k;
        }
        for (int k = 0; k < n && l && l >= item * LINES; k++) {  // samples between the line before and this one
            const double at = line - 1 + s.phase + s.slope * k;
            const int j = (int)at + ((int)at < at);
            if (at <= -1.0 || j >= m) continue;
            const float a = before[k], b = now[k];
            s.out.data[k * along + j * across] = a < 0.0f ? b : b < 0.0f ? a : (float)(a + ((double)b - a) * (j - at));
        }
        float *last = before; before = now; now = last;
    }
""".replace("LINES", str(LINES))
)
def sweep_lines(s: Sweep, item: int):
    """Compute the horizons (slopes, metres a metre) of samples along LINES parallel lines over a raster; write them.

    A line keeps the upper hull of the ground ahead of it, on which the horizon's point is. A sample between two lines
    gets the interpolated value; that of a missing sample has no meaning. item: number of the group of lines.
    """
    ...


@wp.kernel
def sweep(offset: int, s: Sweep):
    """Compute the horizons along the lines of group `offset + tid`, and those of samples between by interpolation."""
    sweep_lines(s, offset + wp.tid())


@wp.struct
class Sky:
    """The sky of a raster in one azimuth, rows of `columns` samples."""

    columns: wp.int32
    rows: wp.int32
    per_cell: wp.vec2f  # vertical scale over the size of a cell in metres
    azimuth: wp.vec2f
    share: wp.float32  # fraction of the whole sky
    heights: wp.array(dtype=wp.float32)  # metres
    horizons: wp.array(dtype=wp.float32)  # metres a metre
    out: wp.array(dtype=wp.float32)  # the sky so far


@wp.func_native("""
#pragma clang fp contract(off)
    const int columns = sky.columns, rows = sky.rows;
    const float per_x = sky.per_cell[0], per_y = sky.per_cell[1], share = sky.share;
    const int south = y > 0 ? y - 1 : 0, north = y < rows - 1 ? y + 1 : rows - 1;
    const float *h = sky.heights.data, *low = h + (long long)south * columns, *high = h + (long long)north * columns;
    const float *row = h + (long long)y * columns, *horizon = sky.horizons.data + (long long)y * columns;
    float *sum = sky.out.data + (long long)y * columns;
    const float to_north = per_y / (north - south), c = sky.azimuth[0], s = sky.azimuth[1];
    auto add = [&](int x, int w, int e, float to_east) __attribute__((always_inline)) {
        const float gx = (row[e] - row[w]) * to_east, gy = (high[x] - low[x]) * to_north, plane = gx * c + gy * s;
        const float slope = horizon[x] > plane ? horizon[x] : plane, size = slope < 0.0f ? -slope : slope;
        const float up = 1.0f / __builtin_sqrtf(1.0f + gx * gx + gy * gy), q = 1.0f / (1.0f + slope * slope);
        // Handbook of Mathematical Functions, 4.4.49: the arc tangent to 2e-8.
        const float t = size > 1.0f ? 1.0f / size : size, u = t * t;
        const float part = t + t * u * (-0.3333314528f + u * (0.1999355085f + u * (-0.1420889944f + u * (0.1065626393f
            + u * (-0.0752896400f + u * (0.0429096138f + u * (-0.0161657367f + u * 0.0028662257f)))))));
        const float steep = size > 1.0f ? 1.5707963268f - part : part;
        const float over = 1.5707963268f - (slope < 0.0f ? -steep : steep);
        sum[x] += share * (up * q - plane * up * (over - slope * q));
    };
    add(0, 0, 1, per_x);
    #pragma clang loop vectorize(enable)
    for (int x = 1; x < columns - 1; x++) add(x, x - 1, x + 1, per_x * 0.5f);
    add(columns - 1, columns - 2, columns - 1, per_x);
""")
def add_sky_of_row(sky: Sky, y: int):
    """Add to `sky.out` the visible part of the sky in one azimuth, times `share`, for the samples of row y.

    The horizon is `sky.horizons`, metres a metre. The part is 2 * integral of max(n . w, 0) cos e de over elevations e
    from the horizon to the zenith; n: the ground's normal, w = (cos e azimuth, sin e). This is `open_fraction` in
    light.py, vectorized in single precision, which takes a tenth of the time. Slopes of the ground are central
    differences, one-sided at the border.
    """
    ...


@wp.kernel
def add_sky(offset: int, sky: Sky):
    """Add to `sky.out` the visible part of the sky in one azimuth, times `share`, for row `offset + tid`."""
    add_sky_of_row(sky, offset + wp.tid())


@wp.struct
class SkyLayer:
    """Values at the samples of a raster or of one of its levels."""

    values: wp.array(dtype=wp.float32)
    columns: wp.int32
    rows: wp.int32
    west: wp.float64  # of the first sample, metres
    south: wp.float64
    step_x: wp.float64  # metres between samples
    step_y: wp.float64


@wp.func
def bilinear(layer: SkyLayer, first: wp.int64, x: wp.float64, y: wp.float64) -> wp.float64:
    """Return a layer's value at (x, y) samples from its first one, bilinearly.

    first: entry of the layer in its array.
    """
    i = wp.min(wp.int32(x), layer.columns - 2)
    j = wp.min(wp.int32(y), layer.rows - 2)
    index = first + wp.int64(j) * wp.int64(layer.columns) + wp.int64(i)
    north = index + wp.int64(layer.columns)
    u = x - wp.float64(i)
    low = wp.float64(layer.values[index])
    high = wp.float64(layer.values[north])
    low += (wp.float64(layer.values[index + wp.int64(1)]) - low) * u
    high += (wp.float64(layer.values[north + wp.int64(1)]) - high) * u
    return low + (high - low) * (y - wp.float64(j))


@wp.kernel
def layer_at_points(offset: int, layer: SkyLayer, positions: wp.array(dtype=wp.vec3f), out: wp.array(dtype=wp.float32)):
    """Write to out[offset + tid] a layer's value at a point, 0 .. 1. positions: metres, clamped to the raster."""
    i = offset + wp.tid()
    x = cells_of(wp.float64(positions[i][0]), layer.west, layer.step_x, layer.columns - 1)
    y = cells_of(wp.float64(positions[i][1]), layer.south, layer.step_y, layer.rows - 1)
    out[i] = wp.clamp(wp.float32(bilinear(layer, wp.int64(0), x, y)), wp.float32(0.0), wp.float32(1.0))


@wp.kernel
def sky_between(
    offset: int,
    occluder: Occluder,
    horizons: SkyLayer,
    azimuths: wp.array(dtype=wp.vec2d),
    positions: wp.array(dtype=wp.vec3f),
    out: wp.array(dtype=wp.float32),
):
    """Write to out[offset + tid] the visible part of the sky at a point, 0 .. 1.

    horizons: slopes in metres a metre on a coarser raster, a layer for each of `azimuths`. Where the fine ground
    (occluder) at the point rises more steeply than the horizon, its slope counts instead. positions: metres, clamped to
    the rasters.
    """
    i = offset + wp.tid()
    east = wp.float64(positions[i][0])
    north = wp.float64(positions[i][1])
    fine_x = cells_of(east, occluder.west, occluder.step_x, occluder.samples.columns - 1)
    fine_y = cells_of(north, occluder.south, occluder.step_y, occluder.samples.rows - 1)
    x = cells_of(east, horizons.west, horizons.step_x, horizons.columns - 1)
    y = cells_of(north, horizons.south, horizons.step_y, horizons.rows - 1)
    g = gradient(occluder, fine_x, fine_y)
    layer = wp.int64(horizons.columns) * wp.int64(horizons.rows)
    total = wp.float64(0.0)
    for k in range(azimuths.shape[0]):
        slope = wp.max(bilinear(horizons, layer * wp.int64(k), x, y), wp.dot(g, azimuths[k]))
        total += open_fraction(slope, g, azimuths[k])
    out[i] = wp.clamp(wp.float32(total / wp.float64(azimuths.shape[0])), wp.float32(0.0), wp.float32(1.0))
