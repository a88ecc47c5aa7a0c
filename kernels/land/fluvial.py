# SPDX-License-Identifier: GPL-3.0-or-later
"""A step of rivers along the drainage of kernels/effects/routing.py: incision and deposition.

Each sample drains to one of its eight neighbours, its receiver; an outlet has none. `r`: the arrays and parameters of
a step.

The loops are C snippets, as in kernels/effects/rows.py; tests/kernels/test_fluvial.py has them in numpy. No statement
has a product and a sum, which some processors would fuse and round differently.
"""

import warp as wp

from ..effects.rows import Grid
from ..field.noise import value_noise


@wp.struct
class River:
    """A step of a level, samples in rows, with their receivers (kernels/effects/routing.py)."""

    grid: Grid
    cell: wp.float32  # area of a sample in m2
    hillslope: wp.float32  # A0 in m2, added to the drainage area
    strength: wp.float32  # K times years
    drop: wp.vec3f  # largest height in metres above the receiver: east-west, north-south, diagonally
    lakes: wp.int32  # 1: compute `filled`
    deposition: wp.float64  # G
    to: wp.array(dtype=wp.uint8)  # direction of the receiver, 3 * (dy + 1) + dx + 1; 4: an outlet
    order: wp.array(dtype=wp.int32)  # samples, donors before receivers
    area: wp.array(dtype=wp.float64)  # A in samples
    erodibility: wp.array(dtype=wp.float32)  # factor on K
    weight: wp.array(dtype=wp.float32)  # of the mask
    rate: wp.array(dtype=wp.float32)  # F: samples that erosion travels upstream in the step
    raised: wp.array(dtype=wp.float32)  # heights before the step, with uplift
    filled: wp.array(dtype=wp.float32)  # surface of the water after incision
    load: wp.array(dtype=wp.float64)  # sediment that comes to a sample, metres times samples
    h: wp.array(dtype=wp.float32)  # metres


@wp.func_native("""
    const double* __restrict a = r.area.data + (size_t)y * r.grid.width;
    const float* __restrict p = r.erodibility.data + (size_t)y * r.grid.width;
    const unsigned char* __restrict k = r.to.data + (size_t)y * r.grid.width;
    float* __restrict out = r.rate.data + (size_t)y * r.grid.width;
    const float ew = r.grid.inverse_distance[0], ns = r.grid.inverse_distance[1], across = r.grid.inverse_distance[2];
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 0; x < r.grid.width; ++x) {
        float m2 = (float)a[x] * r.cell;
        m2 = m2 + r.hillslope;
        float near = (k[x] & 1) == 0 ? across : (k[x] == 3 || k[x] == 5) ? ew : ns;
        out[x] = __builtin_sqrtf(m2) * near * p[x] * r.strength;
    }
""")
def rate_of_row(r: River, y: int):
    """Compute F = K dt (A + A0)^(1/2) / dx in row y: samples that erosion travels upstream in the step.

    dx: distance to the receiver. K: with the factor of `erodibility`.
    """
    ...


@wp.kernel
def find_rates(offset: int, r: River):
    """Compute F = K dt (A + A0)^(1/2) / dx of row `offset + tid`: samples that erosion travels upstream in the step."""
    rate_of_row(r, offset + wp.tid())


@wp.func_native("""
    const int width = r.grid.width;
    const int away[9] = {-width - 1, -width, 1 - width, -1, 0, 1, width - 1, width, width + 1};
    const float ew = r.drop[0], ns = r.drop[1], across = r.drop[2];
    const float most[9] = {across, ns, across, ew, 0.0f, ew, across, ns, across};
    float *z = r.h.data, *w = r.filled.data;
    for (int q = width * r.grid.height - 1; q >= 0; --q) {
        const int i = r.order.data[q], k = r.to.data[i], j = i + away[k];
        const float high = z[i], low = z[j];
        if (k != 4 && high > low && r.rate.data[i] > 0.0f) {
            const float left = (high - low) / (1.0f + r.rate.data[i]);
            const float v = low + left, top = low + most[k];
            float over = v - top;
            over = over > 0.0f ? over : 0.0f;
            over = over * r.weight.data[i];
            z[i] = v - over;
        }
        if (r.lakes) w[i] = k == 4 || z[i] > w[j] ? z[i] : w[j];
    }
""")
def cut_samples(r: River):
    """Incise all samples from the outlets upstream: h_i = (h_i + F h_r) / (1 + F), r the receiver; then limit slopes.

    F, `r.rate`: the samples that erosion travels upstream in the step. A height of more than `r.drop` metres above the
    receiver is also reduced, by the fraction `r.weight` of the excess. `r.filled` becomes the water's surface if
    `r.lakes` is 1.
    """
    ...


@wp.kernel
def cut_down(r: River):
    """Incise all samples, serially from the outlets upstream: h_i = (h_i + F h_r) / (1 + F), r the receiver.

    This is the implicit step of Braun and Willett (2013), equation 20, stable at any length. F, `rate`: the samples
    that erosion travels upstream in the step. Heights above the receiver are then limited to `drop`, by the fraction
    `weight` of the excess. Samples below their receiver (lake floors) and samples with zero rate are not eroded.
    `filled` becomes the water's surface if `lakes` is 1.
    """
    cut_samples(r)


@wp.func_native("""
    const int width = r.grid.width;
    const int away[9] = {-width - 1, -width, 1 - width, -1, 0, 1, width - 1, width, width + 1};
    double* l = r.load.data;
    float* z = r.h.data;
    for (int q = 0; q < width * r.grid.height; ++q) {
        const int i = r.order.data[q], k = r.to.data[i];
        if (k == 4) continue;
        const float raised = r.raised.data[i], water = r.filled.data[i];
        const double flux = l[i], load = flux > 0.0 ? flux : 0.0, cut = (double)raised - z[i];
        double deposit = (double)water - z[i];
        if (deposit > 0.0) {
            deposit = 0.25 * deposit;
            deposit = deposit < load ? deposit : load;
        }
        else {
            const double half = cut > 0.0 ? 0.5 * cut : 0.0, twentieth = 0.05 * load, limit = half + twentieth;
            double share = r.deposition / r.area.data[i];
            share = share < 1.0 ? share : 1.0;
            deposit = load * share;
            deposit = deposit < limit ? deposit : limit;
            deposit = deposit / (1.0 + r.rate.data[i]);
        }
        deposit = deposit * r.weight.data[i];
        z[i] = (float)(z[i] + deposit);
        double out = (double)raised - z[i];
        out = flux + out;
        l[i + away[k]] += out;
    }
""")
def deposit_samples(r: River):
    """Carry eroded material downstream and deposit a part of it at each sample; `deposit` explains which part."""
    ...


@wp.kernel
def deposit(r: River):
    """Carry eroded material downstream, serially from the springs, and deposit a part of it.

    A channel deposits G / A of its load, A in samples (Davy and Lague 2009; Yuan et al. 2019, equation 7), but at most
    half of its incision plus a twentieth of the load; this is divided by 1 + F, as the incision divides heights above
    the receiver. A lake, where `filled` is above the ground, deposits up to a quarter of its depth in a step: so it
    does not fill along one path first. Both are multiplied by the mask's `weight`. load: the inflow of a tile or 0 at
    first; then metres times samples that came to each sample, and at outlets the sediment that has left. It sums
    differences of stored heights, so that rounding loses no mass.
    """
    deposit_samples(r)


@wp.func_native("""
    const unsigned char* __restrict l = lake.data;
    const float* __restrict r = rock.data;
    const int away = apart * width, segments = first.shape[0];
    for (int pass = 0; pass < 2 * pairs; ++pass) {
        const float* __restrict m = pass & 1 ? scratch.data : sediment.data;
        float* __restrict out = pass & 1 ? sediment.data : scratch.data;
        const auto flux = [=](int i, int j) {
            float v = r[j] + m[j], h = r[i] + m[i];
            v = v - h;
            v = v * 0.2f;
            const float low = -0.2f * m[i], high = 0.2f * m[j];
            v = v < low ? low : v;
            v = v > high ? high : v;
            return v * (float)(l[i] & l[j]);
        };
        for (int s = 0; s < segments; ++s) {
            const int end = last.data[s] + 1;
            #pragma clang loop vectorize(enable) interleave(enable)
            for (int i = first.data[s]; i < end; ++i) {
                const float v = flux(i, i - away) + flux(i, i + away), u = flux(i, i - apart) + flux(i, i + apart);
                out[i] = m[i] + (u + v);
            }
        }
    }
""")
def settle_segments(
    pairs: wp.int32,
    width: wp.int32,
    apart: wp.int32,
    first: wp.array(dtype=wp.int32),
    last: wp.array(dtype=wp.int32),
    lake: wp.array(dtype=wp.uint8),
    rock: wp.array(dtype=wp.float32),
    sediment: wp.array(dtype=wp.float32),
    scratch: wp.array(dtype=wp.float32),
):
    """Move sediment downhill between lake samples `apart` samples away from each other, in `pairs` pairs of passes.

    first, last: first and last sample of each segment of samples to update. lake: 1 in lakes. rock: metres of ground
    under the sediment. sediment: metres, read and written in turn with `scratch`. width: samples in a row.
    """
    ...


@wp.kernel
def settle(
    pairs: int,
    width: int,
    apart: int,
    first: wp.array(dtype=wp.int32),
    last: wp.array(dtype=wp.int32),
    lake: wp.array(dtype=wp.uint8),
    rock: wp.array(dtype=wp.float32),
    sediment: wp.array(dtype=wp.float32),
    scratch: wp.array(dtype=wp.float32),
):
    """Move sediment under water downhill in `pairs` pairs of passes, serially.

    A pass moves, between lake samples `apart` samples away from each other along rows and columns, a fifth of the
    difference of heights, at most a fifth of the upper one's sediment: four neighbours may take it. first, last: the
    samples of each segment, all at least `apart` rows from the raster's border; the segments cover the lakes. lake: 1
    in lakes, which are at least `apart` columns from the border. rock: metres of ground under the sediment. sediment,
    scratch: metres of sediment, equal at first. width: samples in a row.
    """
    settle_segments(pairs, width, apart, first, last, lake, rock, sediment, scratch)


@wp.kernel
def vary_rock(
    offset: int,
    grid: Grid,
    first: wp.vec2i,
    steps: wp.vec2d,
    longest: wp.float64,
    octaves: int,
    strength: wp.float64,
    seed: wp.uint32,
    erodibility: wp.array(dtype=wp.float32),
):
    """Multiply the erodibility of row `offset + tid` by a function of the position, so that rivers are not alike.

    The factor (1 + t) / (1 - t), 1/9 to 9, is about exp(2 t), and has the same bits on every machine; t is
    `strength` times the noise. The noise has `octaves` of equal amplitude, the first with waves of `longest` metres.
    first: row and column of sample [0, 0] in the whole level. steps: metres between samples to the east and north.
    """
    y = offset + wp.tid()
    for x in range(grid.width):
        east = wp.float64(first[1] + x) * steps[0] / longest
        north = wp.float64(first[0] + y) * steps[1] / longest
        total = wp.float64(0.0)
        scale = wp.float64(1.0)
        for octave in range(octaves):  # seeds a step of 2^32 over the golden ratio apart
            noise = value_noise(east * scale, north * scale, seed + wp.uint32(octave) * wp.uint32(-0x61C88647))
            total += noise[2]
            scale *= wp.float64(2.0)
        t = wp.clamp(strength * total, wp.float64(-0.8), wp.float64(0.8))
        i = y * grid.width + x
        erodibility[i] = erodibility[i] * wp.float32((wp.float64(1.0) + t) / (wp.float64(1.0) - t))
