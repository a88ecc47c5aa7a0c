# SPDX-License-Identifier: GPL-3.0-or-later
"""What rivers do to a ground in a step, along the drainage of kernels/effects/routing.py: cut and lay down.

The loops are C snippets, as in kernels/effects/rows.py (tests/kernels/test_fluvial.py says in numpy what they stand
for); no product and sum stand in one statement, which some processors would round otherwise.
"""

import warp as wp

from ..effects.rows import Grid
from ..field.noise import value_noise


@wp.struct
class River:
    """A step of a level; samples in rows, and where they drain (kernels/effects/routing.py)."""

    grid: Grid
    cell: wp.float32  # m2 of a sample
    hillslope: wp.float32  # m2 that count besides
    strength: wp.float32  # erodibility times years
    drop: wp.vec3f  # metres that a sample may stand above its receiver, by axis
    lakes: wp.int32  # 1: the surface of the water is wanted
    deposition: wp.float64
    to: wp.array(dtype=wp.uint8)
    order: wp.array(dtype=wp.int32)
    area: wp.array(dtype=wp.float64)  # samples
    soft: wp.array(dtype=wp.float32)  # times the strength, by the rock
    part: wp.array(dtype=wp.float32)  # of the effect
    rate: wp.array(dtype=wp.float32)  # see `find_rates`
    before: wp.array(dtype=wp.float32)  # heights before the step, lifted
    filled: wp.array(dtype=wp.float32)  # the surface of the water after the cut
    load: wp.array(dtype=wp.float64)  # see `lay_down`
    h: wp.array(dtype=wp.float32)  # metres


@wp.func_native("""
    const double* __restrict a = r.area.data + (size_t)y * r.grid.width;
    const float* __restrict p = r.soft.data + (size_t)y * r.grid.width;
    const unsigned char* __restrict k = r.to.data + (size_t)y * r.grid.width;
    float* __restrict out = r.rate.data + (size_t)y * r.grid.width;
    const float ew = r.grid.nearness[0], ns = r.grid.nearness[1], across = r.grid.nearness[2];
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 0; x < r.grid.width; ++x) {
        float m2 = (float)a[x] * r.cell;
        m2 = m2 + r.hillslope;
        float near = (k[x] & 1) == 0 ? across : (k[x] == 3 || k[x] == 5) ? ew : ns;
        out[x] = __builtin_sqrtf(m2) * near * p[x] * r.strength;
    }
""")
def rate_of_row(r: River, y: int): ...


@wp.kernel
def find_rates(offset: int, r: River):
    """Row `offset + tid`: how many samples a wave of erosion runs up in the step, the factor F of Braun and Willett."""
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
            over = over * r.part.data[i];
            z[i] = v - over;
        }
        if (r.lakes) w[i] = k == 4 || z[i] > w[j] ? z[i] : w[j];
    }
""")
def cut_samples(r: River): ...


@wp.kernel
def cut_down(r: River):
    """Serial, from the outlets up: the implicit step of Braun and Willett (2013), equation 20, whatever its length.

    What lies below its receiver is a lake's floor and rests, and so does what has no rate.
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
        const float was = r.before.data[i], water = r.filled.data[i];
        const double come = l[i], most = come > 0.0 ? come : 0.0, cut = (double)was - z[i];
        double laid = (double)water - z[i];
        if (laid > 0.0) {
            laid = 0.25 * laid;
            laid = laid < most ? laid : most;
        }
        else {
            const double half = cut > 0.0 ? 0.5 * cut : 0.0, twentieth = 0.05 * most, limit = half + twentieth;
            double share = r.deposition / r.area.data[i];
            share = share < 1.0 ? share : 1.0;
            laid = most * share;
            laid = laid < limit ? laid : limit;
            laid = laid / (1.0 + r.rate.data[i]);
        }
        laid = laid * r.part.data[i];
        z[i] = (float)(z[i] + laid);
        double out = (double)was - z[i];
        out = come + out;
        l[i + away[k]] += out;
    }
""")
def lay_down_samples(r: River): ...


@wp.kernel
def lay_down(r: River):
    """Serial, from the springs down: what the step has taken is carried along, and a part of it laid down.

    A lake (where `filled` is above the ground) catches what comes, a quarter of its depth in a step at most, so that no
    path through it fills first; a channel lays down `deposition` over its area in samples of what it carries (Davy and
    Lague 2009; Yuan et al. 2019, equation 7), but no more than half of what it was just cut by and a twentieth of the
    load; of that the cut leaves 1 / (1 + F), as of any height above its receiver. `load`: 0 before; after it metres
    times samples that have come to each; at roots, what has left. The differences of stored heights are what is
    carried, so that mass is lost to no rounding of heights.
    """
    lay_down_samples(r)


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
