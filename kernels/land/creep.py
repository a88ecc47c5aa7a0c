# SPDX-License-Identifier: GPL-3.0-or-later
"""Diffusion of heights: over a few samples in explicit steps, over many in one implicit step.

The implicit one goes first along the columns and then along the rows, stable at any length (the locally one-dimensional
scheme of Yanenko 1971). Sums of Thomas's algorithm, whose divisors are above 1. It is solved for the change: of heights
of thousands of metres in single precision millimetres would be lost.
"""

import warp as wp

from ..effects.rows import Grid


@wp.struct
class Soil:
    """A step; what is of `base`, as all of the rim is, keeps its height. Of `old`, `scratch` and `change` one kind of
    steps has no use."""

    grid: Grid
    ew: wp.float32  # diffusivity times years over squared metres from sample to sample
    ns: wp.float32
    base: wp.array(dtype=wp.uint8)
    part: wp.array(dtype=wp.float32)  # of the effect
    kept: wp.array(dtype=wp.float32)  # metres of what would move that do not, where that has their sign
    old: wp.array(dtype=wp.float32)
    scratch: wp.array(dtype=wp.float32)
    change: wp.array(dtype=wp.float32)
    h: wp.array(dtype=wp.float32)


@wp.func_native("""
    const int width = soil.grid.width;
    const float* __restrict m = soil.old.data + (size_t)y * width;
    const float* __restrict s = m - width;
    const float* __restrict n = m + width;
    const float* __restrict p = soil.part.data + (size_t)y * width;
    const float* __restrict stays = soil.kept.data + (size_t)y * width;
    const unsigned char* __restrict stops = soil.base.data + (size_t)y * width;
    float* __restrict out = soil.h.data + (size_t)y * width;
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 1; x < width - 1; ++x) {
        float twice = m[x] + m[x];
        float u = (m[x - 1] + m[x + 1] - twice) * soil.ew;
        float v = (s[x] + n[x] - twice) * soil.ns;
        v = u + v;
        const float low = stays[x] < 0.0f ? stays[x] : 0.0f, high = stays[x] > 0.0f ? stays[x] : 0.0f;
        u = v < low ? low : v;
        u = u > high ? high : u;
        v = (v - u) * p[x];
        out[x] = stops[x] ? m[x] : m[x] + v;
    }
""")
def creep_of_row(soil: Soil, y: int): ...


@wp.kernel
def creep(offset: int, soil: Soil):
    """Row `offset + tid` + 1: an explicit step, from `old` to `h`."""
    creep_of_row(soil, offset + wp.tid() + 1)


@wp.func_native("""
    const int width = soil.grid.width, height = soil.grid.height;
    const float* __restrict p = soil.part.data;
    const unsigned char* __restrict stops = soil.base.data;
    float *z = soil.h.data, *c = soil.scratch.data, *d = soil.change.data;
    for (int x = first; x < end; ++x) c[x] = d[x] = d[(long long)(height - 1) * width + x] = 0.0f;
    for (int y = 1; y < height - 1; ++y) {
        const long long row = (long long)y * width;
        #pragma clang loop vectorize(enable) interleave(enable)
        for (int x = first; x < end; ++x) {
            const long long i = row + x;
            float a = p[i] * soil.ns;
            a = stops[i] ? 0.0f : a;
            const float bend = (z[i - width] - z[i]) - (z[i] - z[i + width]), around = bend + d[i - width];
            const float twice = a + a, back = a * c[i - width], come = a * around;
            const float whole = 1.0f + twice, divisor = whole - back;
            c[i] = a / divisor;
            d[i] = come / divisor;
        }
    }
    for (int y = height - 2; y > 0; --y) {
        const long long row = (long long)y * width;
        #pragma clang loop vectorize(enable) interleave(enable)
        for (int x = first; x < end; ++x) {
            const float more = c[row + x] * d[row + x + width];
            d[row + x] = d[row + x] + more;
            z[row + x] = z[row + x] + d[row + x];
        }
    }
""")
def diffuse_columns(soil: Soil, first: int, end: int): ...


@wp.func_native("""
    const int width = soil.grid.width;
    const float* __restrict p = soil.part.data + (size_t)y * width;
    const unsigned char* __restrict stops = soil.base.data + (size_t)y * width;
    float *z = soil.h.data + (size_t)y * width;
    float *c = soil.scratch.data + (size_t)y * width, *d = soil.change.data + (size_t)y * width;
    c[0] = d[0] = d[width - 1] = 0.0f;
    for (int x = 1; x < width - 1; ++x) {
        float a = p[x] * soil.ew;
        a = stops[x] ? 0.0f : a;
        const float bend = (z[x - 1] - z[x]) - (z[x] - z[x + 1]), around = bend + d[x - 1];
        const float twice = a + a, back = a * c[x - 1], come = a * around;
        const float whole = 1.0f + twice, divisor = whole - back;
        c[x] = a / divisor;
        d[x] = come / divisor;
    }
    for (int x = width - 2; x > 0; --x) {
        const float more = c[x] * d[x + 1];
        d[x] = d[x] + more;
        z[x] = z[x] + d[x];
    }
""")
def diffuse_row(soil: Soil, y: int): ...


@wp.kernel
def creep_along_columns(offset: int, block: int, soil: Soil):
    """Columns `block * (offset + tid)` and on: an implicit step of `h`."""
    first = block * (offset + wp.tid())
    diffuse_columns(soil, first, wp.min(first + block, soil.grid.width))


@wp.kernel
def creep_along_rows(offset: int, soil: Soil):
    """Row `offset + tid`, likewise."""
    diffuse_row(soil, offset + wp.tid())
