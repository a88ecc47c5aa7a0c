# SPDX-License-Identifier: GPL-3.0-or-later
"""Diffusion over many samples in one step: implicit, first along the columns and then along the rows, stable at any
length (the locally one-dimensional scheme of Yanenko 1971). Sums of Thomas's algorithm, whose divisors are above 1.

It is solved for the change: of heights of thousands of metres in single precision millimetres would be lost.
"""

import warp as wp

from ..effects.routing import Grid


@wp.func_native("""
    const float* __restrict p = part.data;
    const unsigned char* __restrict stops = base.data;
    float *z = h.data, *c = scratch.data, *d = change.data;
    for (int x = first; x < end; ++x) c[x] = d[x] = d[(long long)(height - 1) * width + x] = 0.0f;
    for (int y = 1; y < height - 1; ++y) {
        const long long row = (long long)y * width;
        #pragma clang loop vectorize(enable) interleave(enable)
        for (int x = first; x < end; ++x) {
            const long long i = row + x;
            float a = p[i] * ratio;
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
def diffuse_columns(
    first: wp.int32,
    end: wp.int32,
    width: wp.int32,
    height: wp.int32,
    ratio: wp.float32,
    base: wp.array(dtype=wp.uint8),
    part: wp.array(dtype=wp.float32),
    scratch: wp.array(dtype=wp.float32),
    change: wp.array(dtype=wp.float32),
    h: wp.array(dtype=wp.float32),
): ...


@wp.func_native("""
    const float* __restrict p = part.data + (size_t)y * width;
    const unsigned char* __restrict stops = base.data + (size_t)y * width;
    float *z = h.data + (size_t)y * width, *c = scratch.data + (size_t)y * width, *d = change.data + (size_t)y * width;
    c[0] = d[0] = d[width - 1] = 0.0f;
    for (int x = 1; x < width - 1; ++x) {
        float a = p[x] * ratio;
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
def diffuse_row(
    y: wp.int32,
    width: wp.int32,
    ratio: wp.float32,
    base: wp.array(dtype=wp.uint8),
    part: wp.array(dtype=wp.float32),
    scratch: wp.array(dtype=wp.float32),
    change: wp.array(dtype=wp.float32),
    h: wp.array(dtype=wp.float32),
): ...


@wp.kernel
def creep_along_columns(
    offset: int,
    block: int,
    grid: Grid,
    ratio: float,
    base: wp.array(dtype=wp.uint8),
    part: wp.array(dtype=wp.float32),
    scratch: wp.array(dtype=wp.float32),
    change: wp.array(dtype=wp.float32),
    h: wp.array(dtype=wp.float32),
):
    """Columns `block * (offset + tid)` and on; `ratio`: diffusivity times years over the squared step; what is of
    `base`, as all of the rim is, keeps its height. `scratch`, `change` [n]."""
    first = block * (offset + wp.tid())
    end = wp.min(first + block, grid.width)
    diffuse_columns(first, end, grid.width, grid.height, ratio, base, part, scratch, change, h)


@wp.kernel
def creep_along_rows(
    offset: int,
    grid: Grid,
    ratio: float,
    base: wp.array(dtype=wp.uint8),
    part: wp.array(dtype=wp.float32),
    scratch: wp.array(dtype=wp.float32),
    change: wp.array(dtype=wp.float32),
    h: wp.array(dtype=wp.float32),
):
    """Row `offset + tid`, likewise."""
    diffuse_row(offset + wp.tid(), grid.width, ratio, base, part, scratch, change, h)
