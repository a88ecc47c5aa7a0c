# SPDX-License-Identifier: GPL-3.0-or-later
"""A step of shallow water with one signed flux for each face between samples.

    dq / dt = -g d d(z + w) / dx - g n^2 |q| q / d^(7/3),   dw / dt = -div q + rain

q: flux in m2/s, w: depth, z: bed, d: depth of flow over the face, n: Manning's coefficient: the local inertial
equations (Bates, Horritt and Fewtrell 2010). A sample's outflow is limited to its water (Mei, Decaudin and Hu 2007).
Boundary: no flux leaves the raster; the caller sets the depth at outlets after each step.

Arithmetic is float64, in which the sum of depth and bed is exact, so that a lake at rest stays at rest. Rows are loops
in C that the compiler vectorizes, without contraction, so that every processor gives the same bits. Sums add opposite
sides first, which preserves every symmetry of a square. On open water a flux is smoothed with its neighbours along the
same axis, else the shortest waves behind bores would never end (de Almeida, Bates, Freer and Souvignet 2012); on
slopes, where neighbours belong to other streams, hardly. `s`, `water`: the arrays and parameters of a step.
"""

import warp as wp

# Weight of either neighbour in a flux on open, level water.
SMOOTHING = 0.05
# Directions of fluxes for `push_row`.
TO_EAST, TO_NORTH = wp.constant(0), wp.constant(1)


@wp.struct
class FloodStep:
    """Water on a bed and a step of it, samples in rows.

    Fluxes, m^2/s over the faces to the next samples, and `outflow_fraction` have a row before and after the raster's.
    """

    width: wp.int32
    height: wp.int32
    step_x: wp.float64  # metres
    step_y: wp.float64
    seconds: wp.float64
    rough: wp.float64  # Manning's coefficient
    bed: wp.array(dtype=wp.float32)  # metres
    rain: wp.array(dtype=wp.float32)  # m/s
    depth: wp.array(dtype=wp.float64)  # metres
    was_east: wp.array(dtype=wp.float64)  # flux to the east before the step
    was_north: wp.array(dtype=wp.float64)
    east: wp.array(dtype=wp.float64)  # ... and after it
    north: wp.array(dtype=wp.float64)
    outflow_fraction: wp.array(dtype=wp.float64)  # of its outflow, for which a sample has water, at most 1


_PUSH = """
#pragma clang fp contract(off)
    const int across = to_north ? s.width : 1, count = to_north ? s.width : s.width - 1;
    const double dt = s.seconds, rough = s.rough, metres = to_north ? s.step_y : s.step_x;
    const long long first = (long long)y * s.width;
    const float *z0 = s.bed.data + first, *z1 = z0 + across;
    const double *w0 = s.depth.data + first, *w1 = w0 + across;
    const double *q0 = (to_north ? s.was_north : s.was_east).data + first, *before = q0 - across, *after = q0 + across;
    double *__restrict out = (to_north ? s.north : s.east).data + first;
    const double pull = 9.81 * dt / metres, drag = 9.81 * dt * rough * rough;
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 0; x < count; ++x) {
        const double a = z0[x], b = z1[x], ea = a + w0[x], eb = b + w1[x];
        const double d = (ea > eb ? ea : eb) - (a > b ? a : b), s = d > 1e-6 ? d : 1e-6;
        // The cube root in single precision: an estimate from the exponent and two steps of Newton's method.
        const float f = (float)s;
        float c = __builtin_bit_cast(float, (int)(__builtin_bit_cast(int, f) * 0.33333334f) + 709921077);
        c = (2.0f * c + f / (c * c)) * 0.33333334f;
        c = (2.0f * c + f / (c * c)) * 0.33333334f;
        const double rise = a < b ? b - a : a - b, open = SMOOTHING * s / (s + rise), q = q0[x];
        double v = q + open * ((before[x] - q) + (after[x] - q)) - pull * s * (eb - ea);
        // Implicit friction, q + drag |q| q = v, so that steady flow is Manning's for any step.
        v = 2.0 * v / (1.0 + __builtin_sqrt(1.0 + 4.0 * drag / (s * s * c) * (v < 0.0 ? -v : v)));
        const double top = s * __builtin_sqrt(9.81 * s);  // critical flow, Froude number 1, is the limit
        v = v > top ? top : v < -top ? -top : v;
        out[x] = d > 1e-6 ? v : 0.0;
    }
""".replace("SMOOTHING", str(SMOOTHING))


@wp.func_native(_PUSH)
def push_row(s: FloodStep, y: int, to_north: int):
    """Compute the fluxes, m2/s, from the samples of row y to the next ones in one direction.

    They follow the module's equation, with smoothing, and are limited to critical flow; a flow less than a micrometre
    deep is 0. to_north: TO_EAST or TO_NORTH, the direction.
    """
    ...


@wp.kernel
def update_fluxes(offset: int, s: FloodStep):
    """Compute the fluxes from row `offset + tid` to the east and north after the step, from those before it."""
    y = offset + wp.tid()
    push_row(s, y, TO_EAST)
    if y + 1 < s.height:
        push_row(s, y, TO_NORTH)


_LIMIT = """
#pragma clang fp contract(off)
    const long long first = (long long)y * water.width;
    const double per_x = water.seconds / water.step_x, per_y = water.seconds / water.step_y;
    const double *e = water.east.data + first, *n = water.north.data + first, *s = n - water.width;
    const double *w = water.depth.data + first;
    double *__restrict out = water.outflow_fraction.data + first;
    auto over = [](double v) __attribute__((always_inline)) { return v > 0.0 ? v : 0.0; };
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 0; x < water.width; ++x) {
        const double gone = (over(e[x]) + over(-e[x - 1])) * per_x + (over(n[x]) + over(-s[x])) * per_y;
        out[x] = gone > w[x] ? w[x] / gone : 1.0;
    }
"""


@wp.func_native(_LIMIT)
def limit_row(water: FloodStep, y: int):
    """Compute `outflow_fraction` of row y: the fraction of its outflow for which a sample has water, at most 1."""
    ...


@wp.kernel
def limit_outflow(offset: int, water: FloodStep):
    """Compute the fraction of its outflow for which each sample of row `offset + tid` has water, at most 1."""
    limit_row(water, offset + wp.tid())


_MOVE = """
#pragma clang fp contract(off)
    const long long first = (long long)y * water.width;
    const double dt = water.seconds, per_x = dt / water.step_x, per_y = dt / water.step_y;
    const double *e = water.east.data + first, *n = water.north.data + first, *s = n - water.width;
    const double *p = water.outflow_fraction.data + first, *above = p + water.width, *below = p - water.width;
    const float *r = water.rain.data + first;
    double *__restrict w = water.depth.data + first;
    auto over = [](double v) __attribute__((always_inline)) { return v > 0.0 ? v : 0.0; };
    auto flow = [&](double q, double from, double to) __attribute__((always_inline)) {
        return over(q) * from - over(-q) * to;
    };
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 0; x < water.width; ++x) {
        const double out = (flow(e[x], p[x], p[x + 1]) - flow(e[x - 1], p[x - 1], p[x])) * per_x
            + (flow(n[x], p[x], above[x]) - flow(s[x], below[x], p[x])) * per_y;
        w[x] = over(w[x] - out + dt * r[x]);
    }
"""


@wp.func_native(_MOVE)
def move_row(water: FloodStep, y: int):
    """Update the depths of row y by the fluxes, each times the `outflow_fraction` of its source, and by rain.

    A depth is at least 0.
    """
    ...


@wp.kernel
def update_depths(offset: int, water: FloodStep):
    """Update the depths of row `offset + tid` by the limited fluxes and the rain."""
    move_row(water, offset + wp.tid())
