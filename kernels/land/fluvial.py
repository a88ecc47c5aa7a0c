# SPDX-License-Identifier: GPL-3.0-or-later
"""What rivers do to a ground in a step, along the drainage of kernels/effects/routing.py: cut, creep and lay down.

Rows are C snippets (tests/kernels/test_fluvial_rows.py says in numpy what they stand for); no product and sum stand in
one statement, which some processors would round otherwise.
"""

import warp as wp

from ..effects.routing import ROOT, Grid, axis, towards
from ..field.noise import value_noise

wp.set_module_options({"enable_backward": False})


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


@wp.kernel
def cut_down(
    grid: Grid,
    drop: wp.vec3f,
    to: wp.array(dtype=wp.uint8),
    order: wp.array(dtype=wp.int32),
    part: wp.array(dtype=wp.float32),
    rate: wp.array(dtype=wp.float32),
    h: wp.array(dtype=wp.float32),
):
    """Serial, from the outlets up: the implicit step of Braun and Willett (2013), equation 20, whatever its length.

    `drop`: metres that a sample may stand above its receiver, by axis. What lies below its receiver is a lake's floor
    and rests.
    """
    n = grid.width * grid.height
    for q in range(n):
        i = order[n - 1 - q]
        if to[i] != ROOT:
            k = wp.int32(to[i])
            low = h[towards(i, k, grid.width)]
            high = h[i]
            if high > low:
                v = low + (high - low) / (wp.float32(1.0) + rate[i])
                over = wp.max(v - (low + drop[axis(k)]), wp.float32(0.0))
                h[i] = v - over * part[i]


@wp.func_native("""
    const float* __restrict m = old.data + (size_t)y * width;
    const float* __restrict s = m - width;
    const float* __restrict n = m + width;
    const float* __restrict p = part.data + (size_t)y * width;
    const unsigned char* __restrict stops = base.data + (size_t)y * width;
    float* __restrict out = h.data + (size_t)y * width;
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 1; x < width - 1; ++x) {
        float twice = m[x] + m[x];
        float u = (m[x - 1] + m[x + 1] - twice) * ew;
        float v = (s[x] + n[x] - twice) * ns;
        v = (u + v) * p[x];
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
    old: wp.array(dtype=wp.float32),
    h: wp.array(dtype=wp.float32),
):
    """Row `offset + tid` + 1: an explicit step of diffusion; `ew`, `ns`: diffusivity times years over squared steps."""
    creep_of_row(offset + wp.tid() + 1, grid.width, ew, ns, base, part, old, h)


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

    A lake (where `filled`, the surface before the step, is above the ground then) catches all that fits below its
    surface; a channel lays down `deposition` over its area in samples of what it carries (Davy and Lague 2009; Yuan et
    al. 2019, equation 7), but no more than half of what it was just cut by and a twentieth of the load; of that the cut
    leaves 1 / (1 + F), as of any height above its receiver. `before`: heights before the step, lifted.
    `load`: 0 before; after it metres times samples that have come to each; at roots, what has left. The differences of
    stored heights are what is carried, so that mass is lost to no rounding of heights.
    """
    for q in range(grid.width * grid.height):
        i = order[q]
        if to[i] != ROOT:
            come = load[i]
            cut = wp.float64(before[i]) - wp.float64(h[i])
            most = wp.max(come, wp.float64(0.0))
            laid = wp.min(most, wp.max(wp.float64(filled[i]) - wp.float64(h[i]), wp.float64(0.0)))
            if filled[i] <= before[i]:
                limit = wp.float64(0.5) * wp.max(cut, wp.float64(0.0)) + wp.float64(0.05) * most
                laid = most * wp.min(deposition / area[i], wp.float64(1.0))
                laid = wp.min(laid, limit) / (wp.float64(1.0) + wp.float64(rate[i]))
            h[i] = wp.float32(wp.float64(h[i]) + laid * wp.float64(part[i]))
            j = towards(i, wp.int32(to[i]), grid.width)
            load[j] = load[j] + come + (wp.float64(before[i]) - wp.float64(h[i]))


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
