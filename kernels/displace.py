# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement: lattice points to positions, normals and texture coordinates by the height field at full resolution."""

import warp as wp

from .criterion import Domain

wp.set_module_options({"enable_backward": False})


@wp.func
def sample(domain: Domain, i: wp.int32, j: wp.int32) -> wp.float64:
    return wp.float64(domain.samples[wp.int64(j) * wp.int64(domain.width) + wp.int64(i)])


@wp.func
def gradient(domain: Domain, i: wp.int32, j: wp.int32) -> wp.vec2d:
    """Metres a cell at a sample: central differences, one-sided on the border."""
    i0 = wp.max(i - 1, 0)
    i1 = wp.min(i + 1, domain.width - 1)
    j0 = wp.max(j - 1, 0)
    j1 = wp.min(j + 1, domain.height - 1)
    gx = (sample(domain, i1, j) - sample(domain, i0, j)) / wp.float64(i1 - i0)
    gy = (sample(domain, i, j1) - sample(domain, i, j0)) / wp.float64(j1 - j0)
    return wp.vec2d(gx, gy)


@wp.kernel
def displace(
    offset: wp.int32,
    domain: Domain,
    point_base: wp.int64,
    vertex_base: wp.int32,
    point: wp.array(dtype=wp.vec2i),
    positions: wp.array(dtype=wp.vec3f),
    normals: wp.array(dtype=wp.vec3f),
    uv: wp.array(dtype=wp.vec2f),
):
    """Everything in float64 about the local origin, cast to float32 last; bilinear between samples."""
    v = wp.tid() + offset
    p = point[point_base + wp.int64(v)]
    bits = domain.unit_bits - domain.levels
    one = wp.float64(wp.int32(1) << bits)
    i = wp.min(p[0] >> bits, domain.width - 2)
    j = wp.min(p[1] >> bits, domain.height - 2)
    # exact: a power of two below float64's 53 bits
    s = wp.float64(p[0] - (i << bits)) / one
    t = wp.float64(p[1] - (j << bits)) / one
    h = wp.float64(0.0)
    g = wp.vec2d(wp.float64(0.0), wp.float64(0.0))
    whole = wp.float64(1.0)
    if (s == wp.float64(0.0) or s == whole) and (t == wp.float64(0.0) or t == whole):
        i += wp.int32(s)
        j += wp.int32(t)
        h = sample(domain, i, j)
        g = gradient(domain, i, j)
    else:
        a = (whole - s) * (whole - t)
        b = s * (whole - t)
        c = (whole - s) * t
        d = s * t
        h = sample(domain, i, j) * a + sample(domain, i + 1, j) * b
        h += sample(domain, i, j + 1) * c + sample(domain, i + 1, j + 1) * d
        g = gradient(domain, i, j) * a + gradient(domain, i + 1, j) * b
        g += gradient(domain, i, j + 1) * c + gradient(domain, i + 1, j + 1) * d
    x = domain.west + wp.float64(p[0]) * domain.unit_x
    y = domain.south + wp.float64(p[1]) * domain.unit_y
    z = h * domain.height_scale + domain.height_offset
    o = vertex_base + v
    positions[o] = wp.vec3f(wp.float32(x), wp.float32(y), wp.float32(z))
    nx = -g[0] * domain.height_scale / (domain.unit_x * one)
    ny = -g[1] * domain.height_scale / (domain.unit_y * one)
    n = wp.normalize(wp.vec3d(nx, ny, whole))
    normals[o] = wp.vec3f(wp.float32(n[0]), wp.float32(n[1]), wp.float32(n[2]))
    uv[o] = wp.vec2f(
        wp.float32(wp.float64(p[0]) / (one * wp.float64(domain.width - 1))),
        wp.float32(wp.float64(p[1]) / (one * wp.float64(domain.height - 1))),
    )
