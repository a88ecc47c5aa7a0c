# SPDX-License-Identifier: GPL-3.0-or-later
"""Diffusion of heights, dh / dt = D lap h: explicit steps over a few samples, one implicit step over many.

The implicit step goes along the columns and then along the rows and is stable at any length (locally one-dimensional
scheme, Yanenko 1971). Each line is a tridiagonal system solved by Thomas's algorithm, whose divisors are 1 or more, for
the change of heights: single precision would lose millimetres of heights of thousands of metres. Boundary: border and
`base` samples keep their heights. `soil`: the arrays and parameters of a step; `ew`, `ns`: D dt over the squared
spacing along x and y.
"""

import warp as wp

from ..effects.rows import Grid


@wp.struct
class Soil:
    """A step of diffusion of heights. Explicit steps read `old`; the implicit one uses `scratch` and `change`."""

    grid: Grid
    ew: wp.float32  # D dt / dx^2
    ns: wp.float32  # D dt / dy^2
    base: wp.array(dtype=wp.uint8)  # 1 where heights are constant, which includes the border
    weight: wp.array(dtype=wp.float32)  # factor on the change
    preserved: wp.array(dtype=wp.float32)  # of explicit steps: metres of the change left out where the sign is the same
    old: wp.array(dtype=wp.float32)  # heights before the step, metres
    scratch: wp.array(dtype=wp.float32)  # coefficients of Thomas's algorithm
    change: wp.array(dtype=wp.float32)  # change of heights in the implicit step, metres
    h: wp.array(dtype=wp.float32)  # heights after it, metres


@wp.func_native("""
    const int width = soil.grid.width;
    const float* __restrict m = soil.old.data + (size_t)y * width;
    const float* __restrict s = m - width;
    const float* __restrict n = m + width;
    const float* __restrict p = soil.weight.data + (size_t)y * width;
    const float* __restrict preserved = soil.preserved.data + (size_t)y * width;
    const unsigned char* __restrict constant = soil.base.data + (size_t)y * width;
    float* __restrict out = soil.h.data + (size_t)y * width;
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 1; x < width - 1; ++x) {
        float twice = m[x] + m[x];
        float u = (m[x - 1] + m[x + 1] - twice) * soil.ew;
        float v = (s[x] + n[x] - twice) * soil.ns;
        v = u + v;
        const float low = preserved[x] < 0.0f ? preserved[x] : 0.0f, high = preserved[x] > 0.0f ? preserved[x] : 0.0f;
        u = v < low ? low : v;
        u = u > high ? high : u;
        v = (v - u) * p[x];
        out[x] = constant[x] ? m[x] : m[x] + v;
    }
""")
def creep_of_row(soil: Soil, y: int):
    """Take an explicit step of diffusion in row y: write `soil.h` from the heights `soil.old`.

    The change of a sample is reduced by up to `preserved` metres of the same sign, and multiplied by `weight`.
    """
    ...


@wp.kernel
def creep(offset: int, soil: Soil):
    """Take an explicit step of diffusion, from the heights `soil.old` to `soil.h`, in row offset + tid + 1."""
    creep_of_row(soil, offset + wp.tid() + 1)


@wp.func_native("""
    const int width = soil.grid.width, height = soil.grid.height;
    const float* __restrict p = soil.weight.data;
    const unsigned char* __restrict constant = soil.base.data;
    float *z = soil.h.data, *c = soil.scratch.data, *d = soil.change.data;
    for (int x = first; x < end; ++x) c[x] = d[x] = d[(long long)(height - 1) * width + x] = 0.0f;
    for (int y = 1; y < height - 1; ++y) {
        const long long row = (long long)y * width;
        #pragma clang loop vectorize(enable) interleave(enable)
        for (int x = first; x < end; ++x) {
            const long long i = row + x;
            float a = p[i] * soil.ns;
            a = constant[i] ? 0.0f : a;
            const float curvature = (z[i - width] - z[i]) - (z[i] - z[i + width]), around = curvature + d[i - width];
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
def diffuse_columns(soil: Soil, first: int, end: int):
    """Take an implicit step of diffusion along columns first .. end - 1 of `h`.

    Thomas's algorithm, from south to north and back, solves (1 + 2 a) d[y] - a d[y - 1] - a d[y + 1] = a lap h[y] for
    the changes d of heights, with a = `weight` * `ns`, 0 where heights are constant.
    """
    ...


@wp.func_native("""
    const int width = soil.grid.width;
    const float* __restrict p = soil.weight.data + (size_t)y * width;
    const unsigned char* __restrict constant = soil.base.data + (size_t)y * width;
    float *z = soil.h.data + (size_t)y * width;
    float *c = soil.scratch.data + (size_t)y * width, *d = soil.change.data + (size_t)y * width;
    c[0] = d[0] = d[width - 1] = 0.0f;
    for (int x = 1; x < width - 1; ++x) {
        float a = p[x] * soil.ew;
        a = constant[x] ? 0.0f : a;
        const float curvature = (z[x - 1] - z[x]) - (z[x] - z[x + 1]), around = curvature + d[x - 1];
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
def diffuse_row(soil: Soil, y: int):
    """Take an implicit step of diffusion along row y of `h`: Thomas's algorithm, west to east and back.

    It solves (1 + 2 a) d[x] - a d[x - 1] - a d[x + 1] = a lap h[x] for the changes d of heights, with a = `weight` *
    `ew`, 0 where heights are constant.
    """
    ...


@wp.kernel
def creep_along_columns(offset: int, block: int, soil: Soil):
    """Take an implicit step of diffusion of `soil.h` along `block` columns, from column block * (offset + tid) on."""
    first = block * (offset + wp.tid())
    diffuse_columns(soil, first, wp.min(first + block, soil.grid.width))


@wp.kernel
def creep_along_rows(offset: int, soil: Soil):
    """Take an implicit step of diffusion of `soil.h` along row `offset + tid`."""
    diffuse_row(soil, offset + wp.tid())
