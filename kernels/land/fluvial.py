# SPDX-License-Identifier: GPL-3.0-or-later
"""What rivers do to a ground in a step, along the drainage of kernels/effects/routing.py: cut, creep and lay down.

The loops are C snippets, as in kernels/effects/rows.py (tests/kernels/test_fluvial.py says in numpy what they stand
for); no product and sum stand in one statement, which some processors would round otherwise.
"""

import warp as wp

from ..effects.routing import Grid
from ..field.noise import value_noise


@wp.func_native("""
    const double* __restrict a = area.data + (size_t)y * width;
    const float* __restrict p = soft.data + (size_t)y * width;
    const unsigned char* __restrict k = to.data + (size_t)y * width;
    float* __restrict out = rate.data + (size_t)y * width;
    const float ew = nearness[0], ns = nearness[1], across = nearness[2];
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 0; x < width; ++x) {
        float m2 = (float)a[x] * cell;
        m2 = m2 + hillslope;
        float near = (k[x] & 1) == 0 ? across : (k[x] == 3 || k[x] == 5) ? ew : ns;
        out[x] = __builtin_sqrtf(m2) * near * p[x] * strength;
    }
""")
def rate_of_row(
    y: wp.int32,
    width: wp.int32,
    nearness: wp.vec3f,
    cell: wp.float32,
    hillslope: wp.float32,
    strength: wp.float32,
    to: wp.array(dtype=wp.uint8),
    area: wp.array(dtype=wp.float64),
    soft: wp.array(dtype=wp.float32),
    rate: wp.array(dtype=wp.float32),
): ...


@wp.kernel
def find_rates(
    offset: int,
    grid: Grid,
    cell: float,
    hillslope: float,
    strength: float,
    to: wp.array(dtype=wp.uint8),
    area: wp.array(dtype=wp.float64),
    soft: wp.array(dtype=wp.float32),
    rate: wp.array(dtype=wp.float32),
):
    """Row `offset + tid`: how many samples a wave of erosion runs up in the step, the factor F of Braun and Willett.

    `area`: in samples of `cell` m2; `strength`: erodibility times years; `soft`: times it, by the rock.
    """
    rate_of_row(offset + wp.tid(), grid.width, grid.nearness, cell, hillslope, strength, to, area, soft, rate)


@wp.func_native("""
    const int away[9] = {-width - 1, -width, 1 - width, -1, 0, 1, width - 1, width, width + 1};
    const float ew = drop[0], ns = drop[1], across = drop[2];
    const float most[9] = {across, ns, across, ew, 0.0f, ew, across, ns, across};
    float *z = h.data, *w = filled.data;
    for (int q = n - 1; q >= 0; --q) {
        const int i = order.data[q], k = to.data[i], j = i + away[k];
        const float high = z[i], low = z[j];
        if (k != 4 && high > low && rate.data[i] > 0.0f) {
            const float left = (high - low) / (1.0f + rate.data[i]);
            const float v = low + left, top = low + most[k];
            float over = v - top;
            over = over > 0.0f ? over : 0.0f;
            over = over * part.data[i];
            z[i] = v - over;
        }
        if (lakes) w[i] = k == 4 || z[i] > w[j] ? z[i] : w[j];
    }
""")
def cut_samples(
    n: wp.int32,
    width: wp.int32,
    drop: wp.vec3f,
    lakes: wp.int32,
    to: wp.array(dtype=wp.uint8),
    order: wp.array(dtype=wp.int32),
    part: wp.array(dtype=wp.float32),
    rate: wp.array(dtype=wp.float32),
    filled: wp.array(dtype=wp.float32),
    h: wp.array(dtype=wp.float32),
): ...


@wp.kernel
def cut_down(
    grid: Grid,
    drop: wp.vec3f,
    lakes: int,
    to: wp.array(dtype=wp.uint8),
    order: wp.array(dtype=wp.int32),
    part: wp.array(dtype=wp.float32),
    rate: wp.array(dtype=wp.float32),
    filled: wp.array(dtype=wp.float32),
    h: wp.array(dtype=wp.float32),
):
    """Serial, from the outlets up: the implicit step of Braun and Willett (2013), equation 20, whatever its length.

    `drop`: metres that a sample may stand above its receiver, by axis. What lies below its receiver is a lake's floor
    and rests, and so does what has no rate. `filled`, where `lakes` is 1: the surface of the
    water after the cut.
    """
    cut_samples(grid.width * grid.height, grid.width, drop, lakes, to, order, part, rate, filled, h)


@wp.func_native("""
    const float* __restrict m = old.data + (size_t)y * width;
    const float* __restrict s = m - width;
    const float* __restrict n = m + width;
    const float* __restrict p = part.data + (size_t)y * width;
    const float* __restrict stays = kept.data + (size_t)y * width;
    const unsigned char* __restrict stops = base.data + (size_t)y * width;
    float* __restrict out = h.data + (size_t)y * width;
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 1; x < width - 1; ++x) {
        float twice = m[x] + m[x];
        float u = (m[x - 1] + m[x + 1] - twice) * ew;
        float v = (s[x] + n[x] - twice) * ns;
        v = u + v;
        const float low = stays[x] < 0.0f ? stays[x] : 0.0f, high = stays[x] > 0.0f ? stays[x] : 0.0f;
        u = v < low ? low : v;
        u = u > high ? high : u;
        v = (v - u) * p[x];
        out[x] = stops[x] ? m[x] : m[x] + v;
    }
""")
def creep_of_row(
    y: wp.int32,
    width: wp.int32,
    ew: wp.float32,
    ns: wp.float32,
    base: wp.array(dtype=wp.uint8),
    part: wp.array(dtype=wp.float32),
    kept: wp.array(dtype=wp.float32),
    old: wp.array(dtype=wp.float32),
    h: wp.array(dtype=wp.float32),
): ...


@wp.kernel
def creep(
    offset: int,
    grid: Grid,
    ew: float,
    ns: float,
    base: wp.array(dtype=wp.uint8),
    part: wp.array(dtype=wp.float32),
    kept: wp.array(dtype=wp.float32),
    old: wp.array(dtype=wp.float32),
    h: wp.array(dtype=wp.float32),
):
    """Row `offset + tid` + 1: an explicit step of diffusion; `ew`, `ns`: diffusivity times years over squared steps.
    `kept`: metres of what would move that do not, where that has their sign."""
    creep_of_row(offset + wp.tid() + 1, grid.width, ew, ns, base, part, kept, old, h)


@wp.func_native("""
    const int away[9] = {-width - 1, -width, 1 - width, -1, 0, 1, width - 1, width, width + 1};
    double* l = load.data;
    float* z = h.data;
    for (int q = 0; q < n; ++q) {
        const int i = order.data[q], k = to.data[i];
        if (k == 4) continue;
        const float was = before.data[i], water = filled.data[i];
        const double come = l[i], most = come > 0.0 ? come : 0.0, cut = (double)was - z[i];
        double laid = (double)water - z[i];
        if (laid > 0.0) {
            laid = 0.25 * laid;
            laid = laid < most ? laid : most;
        }
        else {
            const double half = cut > 0.0 ? 0.5 * cut : 0.0, twentieth = 0.05 * most, limit = half + twentieth;
            double share = deposition / area.data[i];
            share = share < 1.0 ? share : 1.0;
            laid = most * share;
            laid = laid < limit ? laid : limit;
            laid = laid / (1.0 + rate.data[i]);
        }
        laid = laid * part.data[i];
        z[i] = (float)(z[i] + laid);
        double out = (double)was - z[i];
        out = come + out;
        l[i + away[k]] += out;
    }
""")
def lay_down_samples(
    n: wp.int32,
    width: wp.int32,
    deposition: wp.float64,
    to: wp.array(dtype=wp.uint8),
    order: wp.array(dtype=wp.int32),
    area: wp.array(dtype=wp.float64),
    part: wp.array(dtype=wp.float32),
    rate: wp.array(dtype=wp.float32),
    before: wp.array(dtype=wp.float32),
    filled: wp.array(dtype=wp.float32),
    load: wp.array(dtype=wp.float64),
    h: wp.array(dtype=wp.float32),
): ...


@wp.kernel
def lay_down(
    grid: Grid,
    deposition: wp.float64,
    to: wp.array(dtype=wp.uint8),
    order: wp.array(dtype=wp.int32),
    area: wp.array(dtype=wp.float64),
    part: wp.array(dtype=wp.float32),
    rate: wp.array(dtype=wp.float32),
    before: wp.array(dtype=wp.float32),
    filled: wp.array(dtype=wp.float32),
    load: wp.array(dtype=wp.float64),
    h: wp.array(dtype=wp.float32),
):
    """Serial, from the springs down: what the step has taken is carried along, and a part of it laid down.

    A lake (where `filled`, the surface of the water, is above the ground) catches what comes, a quarter of its depth in
    a step at most, so that no path through it fills first; a channel lays down `deposition` over its area in samples of
    what it carries (Davy and Lague 2009; Yuan et al. 2019, equation 7), but no more than half of what it was just cut
    by and a twentieth of the load; of that the cut leaves 1 / (1 + F), as of any height above its receiver.
    `before`: heights before the step, lifted.
    `load`: 0 before; after it metres times samples that have come to each; at roots, what has left. The differences of
    stored heights are what is carried, so that mass is lost to no rounding of heights.
    """
    n = grid.width * grid.height
    lay_down_samples(n, grid.width, deposition, to, order, area, part, rate, before, filled, load, h)


@wp.func_native("""
    const unsigned char* __restrict l = lake.data;
    const float* __restrict r = rock.data;
    const float* __restrict m = old.data;
    float* __restrict out = laid.data;
    const int away = apart * width;
    const auto comes = [=](int i, int j) {
        float v = r[j] + m[j], h = r[i] + m[i];
        v = v - h;
        v = v * 0.2f;
        const float least = -0.2f * m[i], most = 0.2f * m[j];
        v = v < least ? least : v;
        v = v > most ? most : v;
        return v * (float)(l[i] & l[j]);
    };
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int i = first; i < end; ++i) {
        const float v = comes(i, i - away) + comes(i, i + away), u = comes(i, i - apart) + comes(i, i + apart);
        out[i] = m[i] + (u + v);
    }
""")
def settle_samples(
    first: wp.int32,
    end: wp.int32,
    width: wp.int32,
    apart: wp.int32,
    lake: wp.array(dtype=wp.uint8),
    rock: wp.array(dtype=wp.float32),
    old: wp.array(dtype=wp.float32),
    laid: wp.array(dtype=wp.float32),
): ...


@wp.kernel
def settle(
    offset: int,
    width: int,
    apart: int,
    first: wp.array(dtype=wp.int32),
    last: wp.array(dtype=wp.int32),
    lake: wp.array(dtype=wp.uint8),
    rock: wp.array(dtype=wp.float32),
    old: wp.array(dtype=wp.float32),
    laid: wp.array(dtype=wp.float32),
):
    """Samples `first` to `last` of part `offset + tid`, all of one row: a pass in which what is `laid` on `rock` under
    water goes to lower samples, so many `apart` along rows and columns: a fifth of the difference of heights, and no
    more than a fifth of what is there. Outside of a `lake` `laid` stays as `old`, and nothing comes from there."""
    part = offset + wp.tid()
    settle_samples(first[part], last[part] + 1, width, apart, lake, rock, old, laid)


@wp.kernel
def vary_rock(
    offset: int,
    grid: Grid,
    first: wp.vec2i,
    steps: wp.vec2d,
    longest: wp.float64,
    octaves: int,
    half: wp.float64,
    seed: wp.uint32,
    soft: wp.array(dtype=wp.float32),
):
    """Row `offset + tid`: `soft` times the rock's softness there, about exp(2 half * noise): `octaves` of noise, alike
    strong, the first with waves of `longest` metres. A function of the place in metres."""
    y = offset + wp.tid()
    for x in range(grid.width):
        east = wp.float64(first[1] + x) * steps[0] / longest
        north = wp.float64(first[0] + y) * steps[1] / longest
        total = wp.float64(0.0)
        scale = wp.float64(1.0)
        for octave in range(octaves):
            noise = value_noise(east * scale, north * scale, seed + wp.uint32(octave) * wp.uint32(-0x61C88647))
            total += noise[2]
            scale *= wp.float64(2.0)
        part = wp.clamp(half * total, wp.float64(-0.8), wp.float64(0.8))
        i = y * grid.width + x
        soft[i] = soft[i] * wp.float32((wp.float64(1.0) + part) / (wp.float64(1.0) - part))
