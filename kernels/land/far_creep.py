# SPDX-License-Identifier: GPL-3.0-or-later
"""Diffusion over many samples in one step: implicit, first along the columns and then along the rows, stable at any
length (the locally one-dimensional scheme of Yanenko 1971). Sums of Thomas's algorithm, whose divisors are above 1."""

import warp as wp

from ..effects.routing import Grid

wp.set_module_options({"enable_backward": False})


@wp.func_native("""
    const float* __restrict p = part.data;
    const unsigned char* __restrict stops = base.data;
    float *z = h.data, *c = scratch.data;
    for (int x = first; x < end; ++x) c[x] = 0.0f;
    for (int y = 1; y < height; ++y) {
        const long long row = (long long)y * width;
        #pragma clang loop vectorize(enable) interleave(enable)
        for (int x = first; x < end; ++x) {
            const long long i = row + x;
            float a = p[i] * ratio;
            a = stops[i] ? 0.0f : a;
            const float twice = a + a, back = a * c[i - width], come = a * z[i - width];
            const float whole = 1.0f + twice, divisor = whole - back, sum = z[i] + come;
            c[i] = a / divisor;
            z[i] = sum / divisor;
        }
    }
    for (int y = height - 2; y > 0; --y) {
        const long long row = (long long)y * width;
        #pragma clang loop vectorize(enable) interleave(enable)
        for (int x = first; x < end; ++x) {
            const float more = c[row + x] * z[row + x + width];
            z[row + x] = z[row + x] + more;
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
    h: wp.array(dtype=wp.float32),
): ...


@wp.func_native("""
    const float* __restrict p = part.data + (size_t)y * width;
    const unsigned char* __restrict stops = base.data + (size_t)y * width;
    float *z = h.data + (size_t)y * width, *c = scratch.data + (size_t)y * width;
    c[0] = 0.0f;
    for (int x = 1; x < width; ++x) {
        float a = p[x] * ratio;
        a = stops[x] ? 0.0f : a;
        const float twice = a + a, back = a * c[x - 1], come = a * z[x - 1];
        const float whole = 1.0f + twice, divisor = whole - back, sum = z[x] + come;
        c[x] = a / divisor;
        z[x] = sum / divisor;
    }
    for (int x = width - 2; x > 0; --x) {
        const float more = c[x] * z[x + 1];
        z[x] = z[x] + more;
    }
""")
def diffuse_row(
    y: wp.int32,
    width: wp.int32,
    ratio: wp.float32,
    base: wp.array(dtype=wp.uint8),
    part: wp.array(dtype=wp.float32),
    scratch: wp.array(dtype=wp.float32),
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
    h: wp.array(dtype=wp.float32),
):
    """Columns `block * (offset + tid)` and on; `ratio`: diffusivity times years over the squared step; what is of
    `base`, as all of the rim is, keeps its height. `scratch` [n]."""
    first = block * (offset + wp.tid())
    end = wp.min(first + block, grid.width)
    diffuse_columns(first, end, grid.width, grid.height, ratio, base, part, scratch, h)


@wp.kernel
def creep_along_rows(
    offset: int,
    grid: Grid,
    ratio: float,
    base: wp.array(dtype=wp.uint8),
    part: wp.array(dtype=wp.float32),
    scratch: wp.array(dtype=wp.float32),
    h: wp.array(dtype=wp.float32),
):
    """Row `offset + tid`, likewise."""
    diffuse_row(offset + wp.tid(), grid.width, ratio, base, part, scratch, h)
