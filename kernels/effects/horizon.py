# SPDX-License-Identifier: GPL-3.0-or-later
"""The horizon of a point of the ground along one azimuth.

The ground is the raster's profile over the azimuth: its crossings with the lines of the raster, linear between them. A
horizon is the largest slope from the point to a crossing. A crossing is a function of its line and the ray alone, so
that the order of visits does not change bits, and crossings that cannot raise the horizon may be skipped: blocks of 2^l
cells a side whose maximum is below the horizon so far (Tevs, Ihrke and Seidel 2008, "Maximum mipmaps for fast,
accurate, and scalable dynamic height field rendering"). A few crossings at growing distances are visited first; they
raise the horizon early. Crossings in holes do not count. `g` is the ground: the raster and the maxima of its blocks,
which include the fill of holes, as bounds may.
"""

import warp as wp

from ..field.codes import Samples, corners_of

# The smallest blocks have 2^FINEST cells a side; every crossing inside them is visited.
FINEST = 2


@wp.struct
class Occluder:
    """The raster and the maxima of its blocks; heights in metres are multiplied by `scale`."""

    samples: Samples
    west: wp.float64  # of the first sample, metres
    south: wp.float64
    step_x: wp.float64
    step_y: wp.float64
    scale: wp.float64
    tops: wp.array(dtype=wp.float32)  # maxima of blocks, minima for a negative scale
    first: wp.array(dtype=wp.int64)  # [levels]: first block of each level
    wide: wp.array(dtype=wp.int32)  # [levels]: blocks in a row
    levels: wp.int32  # 0 for no blocks; every crossing is visited then
    holed: wp.int32  # 1 if cells are cut out, which hide nothing
    valid: wp.array(dtype=wp.uint8)  # 0 at missing samples; unused without holes
    highest: wp.float64  # after scaling
    margin: wp.float64  # metres, more than the rounding of a height of the profile


@wp.func
def surface(g: Occluder, x: wp.float64, y: wp.float64):
    """Return the height, metres, of the bilinear surface times the vertical scale.

    x, y: cells from the first sample, inside the raster.
    """
    i = wp.min(wp.int32(x), g.samples.columns - 2)
    j = wp.min(wp.int32(y), g.samples.rows - 2)
    p = corners_of(g.samples, i, j)
    u = x - wp.float64(i)
    low = p[0] + (p[1] - p[0]) * u
    high = p[2] + (p[3] - p[2]) * u
    return g.scale * (low + (high - low) * (y - wp.float64(j)))


@wp.func
def cells_of(metres: wp.float64, origin: wp.float64, step: wp.float64, cells: wp.int32):
    """Return a position in metres as cells from the first sample, clamped to 0 .. `cells`; 0 for NaN.

    origin: the first sample's position, metres. step: metres between samples.
    """
    position = (metres - origin) / step
    return wp.where(position >= wp.float64(0.0), wp.min(position, wp.float64(cells)), wp.float64(0.0))


@wp.func
def gradient(g: Occluder, x: wp.float64, y: wp.float64):
    """Return the slopes of `surface` to the east and north, metres a metre, by central differences of one cell.

    They are one-sided at the border. x, y: cells from the first sample, inside the raster.
    """
    one = wp.float64(1.0)
    w = wp.max(x - one, wp.float64(0.0))
    e = wp.min(x + one, wp.float64(g.samples.columns - 1))
    s = wp.max(y - one, wp.float64(0.0))
    n = wp.min(y + one, wp.float64(g.samples.rows - 1))
    return wp.vec2d(
        (surface(g, e, y) - surface(g, w, y)) / ((e - w) * g.step_x),
        (surface(g, x, n) - surface(g, x, s)) / ((n - s) * g.step_y),
    )


@wp.func_native("""
#pragma clang fp contract(off)
    const int FINEST = 2;
    const double dx = azimuth[0] / g.step_x, dy = azimuth[1] / g.step_y;  // cells a metre
    // Nearer crossings are the point itself: positions are float32, and a height over no distance is no slope.
    const double near = (g.step_x < g.step_y ? g.step_x : g.step_y) / 1024.0;
    // The ray against the lines of one direction. In a cell it runs from line cell + behind to line cell + ahead.
    struct Axis {
        double from, per_metre, metres;  // the ray's start in cells, cells a metre, metres a cell
        int cells, ahead, behind, on;  // on: step to the ray's next cell, 1 or -1
        bool goes;  // it is not parallel to these lines
        double at(int line) const { return goes ? (line - from) * metres : 1e300; }  // metres to a line
        int start() const {
            const int cell = (int)from - (goes && behind && (int)from == from);
            return cell < cells ? cell : cells - 1;
        }
        // The ray's cell after `way` metres. A line that it meets just there counts as crossed if `too`.
        int cell_at(double way, bool too) const {
            if (!goes) return start();
            int cell = (int)(from + way * per_metre);
            auto crossed = [&](int line) { const double e = at(line); return e < way || (too && e == way); };
            while (crossed(cell + ahead)) cell += on;
            while (!crossed(cell + behind)) cell -= on;
            return cell;
        }
        bool holds(int cell) const { return (unsigned)cell < (unsigned)cells; }
    };
    const int columns = g.samples.columns, rows = g.samples.rows;
    const Axis axes[2] = {{x0, dx, 1.0 / dx, columns - 1, dx > 0.0, !(dx > 0.0), dx > 0.0 ? 1 : -1, dx != 0.0},
                          {y0, dy, 1.0 / dy, rows - 1, dy > 0.0, !(dy > 0.0), dy > 0.0 ? 1 : -1, dy != 0.0}};
    const long long strides[2] = {1, columns};
    const float *const floats = g.samples.floats.data, *const tops = g.tops.data;
    // Blocks: their maxima `tops`, level by level; each level's first entry, and its blocks in a row.
    const wp::int64 *const first = g.first.data;
    const int *const wide = g.wide.data, levels = g.levels;
    // Less the point's height, with a margin above rounding.
    const double highest = g.highest - z0 + g.margin, below = z0 - g.margin, scale = g.scale;
    double best = lowest;
    auto height = [&](long long k) __attribute__((always_inline)) {
        return scale * (g.samples.coded
            ? (float)((double)(g.samples.numbers.data[k] + g.samples.first) * g.samples.scale + g.samples.offset)
            : floats[k]);
    };
    // Whether a cell beside the line, at sample k, is ground: cells with a missing sample are cut out.
    auto is_ground = [&](int d, int line, long long k) {
        const wp::uint8 *const valid = g.valid.data;
        auto known = [&](long long i) { return valid[i] && valid[i + strides[!d]]; };
        return known(k) && ((line > 0 && known(k - strides[d])) || (line < axes[d].cells && known(k + strides[d])));
    };
    // Raise `best` to the slope of the crossing `way` metres off with a line of axis d, inside `cell` of the other.
    auto meet = [&](int d, int line, int cell, double way) __attribute__((always_inline)) {
        const Axis &other = axes[!d];
        const long long k = line * strides[d] + cell * strides[!d];
        const double a = height(k), b = height(k + strides[!d]);
        const double slope = (a + (b - a) * (other.from + way * other.per_metre - cell) - z0) / way;
        if (way > near && way <= far && slope > best && (!g.holed || is_ground(d, line, k))) best = slope;
    };
    int cell[2] = {axes[0].start(), axes[1].start()};
    if (levels) {  // first some crossings at growing distances, which raise the horizon early
        const int d = (dx < 0 ? -dx : dx) <= (dy < 0 ? -dy : dy);
        for (int k = 0;; k += k / 2 + 1) {
            const int line = cell[d] + axes[d].ahead + k * axes[d].on;
            const double way = axes[d].at(line);
            if (line < 0 || line > axes[d].cells || way > far) break;
            const int other = axes[!d].cell_at(way, d);
            if (!axes[!d].holds(other)) break;
            meet(d, line, other, way);
        }
    }
    int l = 0;  // 0: a cell; else a block of 2^l cells a side
    double way = 0.0;
    while (axes[0].holds(cell[0]) && axes[1].holds(cell[1]) && best < enough && way <= far) {
        const int block[2] = {cell[0] >> l, cell[1] >> l};
        const int line[2] = {(block[0] + axes[0].ahead) << l, (block[1] + axes[1].ahead) << l};
        const double to[2] = {axes[0].at(line[0]), axes[1].at(line[1])};
        const int d = to[0] > to[1];
        const double out = to[d];
        if (l) {
            const double top = scale * tops[first[l] + (wp::int64)block[1] * wide[l] + block[0]] - below;
            // For a negative horizon the far end of the path through the block counts.
            if (top > best * (best < 0.0 ? out : way)) {
                l = l > FINEST ? l - 1 : 0;
                continue;
            }
            if (best >= 0.0 && highest <= best * way) break;  // no ground from here on is high enough
            cell[!d] = axes[!d].cell_at(out, d);
        } else {
            meet(d, line[d], cell[!d], out);
        }
        cell[d] = line[d] - axes[d].behind;
        way = out;
        const int up = l ? l + 1 : FINEST;  // go on by the next larger block where the ray enters one
        if (up < levels && ((cell[0] >> up) ^ (block[0] << l >> up) | (cell[1] >> up) ^ (block[1] << l >> up))) l = up;
    }
    return best < enough ? best : enough;
""")
def horizon(
    g: Occluder,
    x0: wp.float64,
    y0: wp.float64,
    z0: wp.float64,
    azimuth: wp.vec2d,
    far: wp.float64,
    lowest: wp.float64,
    enough: wp.float64,
) -> wp.float64:
    """Return the horizon, a slope of `lowest` .. `enough`, of crossings up to `far` metres away.

    The walk stops once the horizon is at least `enough`. x0, y0: cells from the first sample, inside the raster; z0:
    scaled metres. azimuth: unit vector (east, north). Lines are crossed in order, of two at the same distance the one
    that runs north first. After a skipped block the walk is in the same cell as one that visits every crossing, so that
    no crossing is lost or added at a corner of cells.
    """
    ...
