# SPDX-License-Identifier: GPL-3.0-or-later
"""How high the ground stands against the sky, seen from a place on it: its horizon along one azimuth.

The ground is the raster's profile over the azimuth: its crossings with the lines of the raster, and straight between
them. A horizon is the largest slope, metres of height per metre of way, from the place to a crossing. A crossing is a
function of its line and the ray alone, so any order of visits gives the same bits, and those that cannot count may be
left out: blocks of 2^l cells a side whose highest sample stays below the horizon so far are skipped (Tevs, Ihrke and
Seidel 2008, "Maximum mipmaps for fast, accurate, and scalable dynamic height field rendering"). A few crossings that
are farther and farther apart are looked at first: they raise the horizon early, so that more is skipped.
"""

import warp as wp

from ..field.codes import Samples, sample_at

wp.set_module_options({"enable_backward": False})

# The smallest blocks have 2^FINEST cells a side; inside them crossings are visited one by one.
FINEST = 2


@wp.struct
class Ground:
    """The raster, and the highest samples of its blocks. Heights count `scale` times, metres."""

    samples: Samples
    columns: wp.int32  # samples
    rows: wp.int32
    west: wp.float64  # of the first sample, metres
    south: wp.float64
    step_x: wp.float64
    step_y: wp.float64
    scale: wp.float64
    tops: wp.array(dtype=wp.float32)  # of a negative scale the lowest samples
    first: wp.array(dtype=wp.int32)  # of level l from first[l] on
    wide: wp.array(dtype=wp.int32)  # with wide[l] blocks in a row
    levels: wp.int32  # l is below it; 0: no blocks, every crossing is visited
    highest: wp.float64  # after scaling
    margin: wp.float64  # metres, above what rounding can add to a height of the profile


@wp.kernel
def finest_tops(offset: int, ground: Ground, sign: wp.float32, tops: wp.array(dtype=wp.float32)):
    """Row `offset + tid` of the smallest blocks: the highest of their samples, or of sign -1 the lowest."""
    y = offset + wp.tid()
    wide = ((ground.columns - 2) >> FINEST) + 1
    side = 1 << FINEST
    for x in range(wide):
        top = wp.float32(-wp.inf)
        for j in range(y * side, wp.min((y + 1) * side, ground.rows - 1) + 1):
            for i in range(x * side, wp.min((x + 1) * side, ground.columns - 1) + 1):
                top = wp.max(top, sign * sample_at(ground.samples, wp.int64(j) * wp.int64(ground.columns) + wp.int64(i)))
        tops[y * wide + x] = sign * top


@wp.func
def surface(g: Ground, x: wp.float64, y: wp.float64):
    """Height, scaled, of the bilinear surface `x` and `y` cells from the first sample, inside the raster."""
    i = wp.min(wp.int32(x), g.columns - 2)
    j = wp.min(wp.int32(y), g.rows - 2)
    at = wp.int64(j) * wp.int64(g.columns) + wp.int64(i)
    north = at + wp.int64(g.columns)
    u = x - wp.float64(i)
    v = y - wp.float64(j)
    a = wp.float64(sample_at(g.samples, at))
    b = wp.float64(sample_at(g.samples, at + wp.int64(1)))
    c = wp.float64(sample_at(g.samples, north))
    d = wp.float64(sample_at(g.samples, north + wp.int64(1)))
    a += (b - a) * u
    c += (d - c) * u
    return g.scale * (a + (c - a) * v)


@wp.func
def cells_of(metres: wp.float64, origin: wp.float64, step: wp.float64, cells: wp.int32):
    """Cells from the first sample; beyond the rim the rim, and 0 of what is not a number."""
    at = (metres - origin) / step
    return wp.where(at >= wp.float64(0.0), wp.min(at, wp.float64(cells)), wp.float64(0.0))


@wp.func
def gradient(g: Ground, x: wp.float64, y: wp.float64):
    """Metres of height per metre east and north: central differences of one cell, one-sided at the rim."""
    one = wp.float64(1.0)
    w = wp.max(x - one, wp.float64(0.0))
    e = wp.min(x + one, wp.float64(g.columns - 1))
    s = wp.max(y - one, wp.float64(0.0))
    n = wp.min(y + one, wp.float64(g.rows - 1))
    return wp.vec2d(
        (surface(g, e, y) - surface(g, w, y)) / ((e - w) * g.step_x),
        (surface(g, x, n) - surface(g, x, s)) / ((n - s) * g.step_y),
    )


@wp.func_native("""
#pragma clang fp contract(off)
    const int FINEST = 2;
    // The ray against the lines of one direction. Of a cell's two lines the one ahead is cell + ahead.
    struct Axis {
        double from, per_metre, metres;  // cells, cells a metre, metres a cell
        int ahead, cells;
        bool goes;
        // Metres to a line.
        double at(int line) const { return goes ? (line - from) * metres : 1e300; }
        int start() const {
            int cell = (int)from;
            cell -= goes && !ahead && cell == from;
            return cell < cells ? cell : cells - 1;
        }
        // The cell that the ray is in at `way`: lines before it are crossed, and with `too` the one that is just there.
        int cell_at(double way, bool too) const {
            if (!goes) return start();
            int cell = (int)(from + way * per_metre);
            auto crossed = [&](int line) { return too ? at(line) <= way : at(line) < way; };
            if (ahead) {
                while (cell > 0 && !crossed(cell)) cell--;
                while (crossed(cell + 1)) cell++;
            } else {
                while (crossed(cell)) cell--;
                while (cell + 1 < cells && !crossed(cell + 1)) cell++;
            }
            return cell;
        }
        bool holds(int cell) const { return cell >= 0 && cell < cells; }
    };
    const Axis ax = {x0, dx, 1.0 / dx, dx > 0.0, g.columns - 1, dx != 0.0};
    const Axis ay = {y0, dy, 1.0 / dy, dy > 0.0, g.rows - 1, dy != 0.0};
    double best = least;
    auto height = [&](long long k) -> double {
        const float h = g.samples.coded
            ? (float)((double)(g.samples.numbers.data[k] + g.samples.first) * g.samples.scale + g.samples.offset)
            : g.samples.floats.data[k];
        return g.scale * (double)h;
    };
    // A crossing `way` metres off, between the samples k and k + next, `part` of the way from one to the other.
    auto meet = [&](double way, long long k, long long next, double part) {
        const double a = height(k), b = height(k + next), slope = (a + (b - a) * part - z0) / way;
        if (way > near && way <= far && slope > best) best = slope;
    };
    auto meet_x = [&](int line, int j, double way) {
        meet(way, (long long)j * g.columns + line, g.columns, y0 + way * dy - j);
    };
    auto meet_y = [&](int line, int i, double way) {
        meet(way, (long long)line * g.columns + i, 1, x0 + way * dx - i);
    };
    int i = ax.start(), j = ay.start();
    if (g.levels) {
        const bool by_x = (dx < 0 ? -dx : dx) > (dy < 0 ? -dy : dy);
        const Axis &along = by_x ? ax : ay, &across = by_x ? ay : ax;
        for (int k = 0;; k += k / 2 + 1) {
            const int line = (by_x ? i : j) + (along.ahead ? k + 1 : -k);
            const double way = along.at(line);
            if (line < 0 || line > along.cells || way > far) break;
            const int cell = across.cell_at(way, !by_x);
            if (!across.holds(cell)) break;
            if (by_x) meet_x(line, cell, way); else meet_y(line, cell, way);
        }
    }
    int l = 0;  // 0: a cell; else a block of 2^l cells a side
    double way = 0.0;
    while (ax.holds(i) && ay.holds(j) && best < enough && way <= far) {
        const int bi = i >> l, bj = j >> l;
        const int line_x = (bi + ax.ahead) << l, line_y = (bj + ay.ahead) << l;
        const double to_x = ax.at(line_x), to_y = ay.at(line_y);
        const bool by_x = to_x <= to_y;
        const double out = by_x ? to_x : to_y;
        if (l) {
            const double top = g.scale * g.tops.data[g.first.data[l] + bj * g.wide.data[l] + bi] - z0 + g.margin;
            // Of a horizon that falls the far end of the way through the block counts.
            if (top > best * (best < 0.0 ? out : way)) {
                l = l > FINEST ? l - 1 : 0;
                continue;
            }
            if (best >= 0.0 && g.highest - z0 + g.margin <= best * way) break;
        } else if (by_x) {
            meet_x(line_x, j, out);
        } else {
            meet_y(line_y, i, out);
        }
        if (by_x) {
            i = line_x - !ax.ahead;
            if (l) j = ay.cell_at(out, false);
        } else {
            j = line_y - !ay.ahead;
            if (l) i = ax.cell_at(out, true);
        }
        way = out;
        const int up = l ? l + 1 : FINEST;
        if (up < g.levels && ((i >> up) != (bi << l >> up) || (j >> up) != (bj << l >> up))) l = up;
    }
    return best < enough ? best : enough;
""")
def walk(
    g: Ground,
    x0: wp.float64,
    y0: wp.float64,
    z0: wp.float64,
    dx: wp.float64,
    dy: wp.float64,
    near: wp.float64,
    far: wp.float64,
    least: wp.float64,
    enough: wp.float64,
) -> wp.float64:
    """The horizon, at least `least`, of crossings between `near` and `far` metres; the walk may stop at `enough`.

    x0, y0: cells from the first sample, inside the raster; z0: metres, scaled. dx, dy: cells per metre along the ray.
    Lines are crossed in order, of two at the same distance the one that runs north first; a skip ends in the state in
    which a visit of every crossing would be there, so none is lost and none is made up at a corner of cells.
    """
    ...


@wp.func
def horizon(
    g: Ground,
    x: wp.float64,
    y: wp.float64,
    z: wp.float64,
    azimuth: wp.vec2d,
    far: wp.float64,
    least: wp.float64,
    enough: wp.float64,
):
    """See `walk`; azimuth: unit length, in metres. What is nearer than 1/1024 of a cell is the place itself: positions
    are float32, and a difference of heights over nothing is no slope."""
    near = wp.min(g.step_x, g.step_y) * wp.float64(0.0009765625)
    return walk(g, x, y, z, azimuth[0] / g.step_x, azimuth[1] / g.step_y, near, far, least, enough)

