# SPDX-License-Identifier: GPL-3.0-or-later
"""Slope, aspect, curvatures and the normal from a jet; one kernel computes all requested ones.

A jet is (z, zx, zy, zxx, zxy, zyy): a height in metres, with its first and second derivatives along x and y per metre.
"""

import warp as wp

from .finer_jet import FinerHeights, finer_jet_at
from .pyramid import Jet, Pyramid, inverse_power, jet_at

# Bits of Values.wanted.
HEIGHT = wp.constant(1)
SLOPE = wp.constant(2)
ASPECT = wp.constant(4)
MEAN_CURVATURE = wp.constant(8)
PROFILE_CURVATURE = wp.constant(16)
PLAN_CURVATURE = wp.constant(32)
NORMAL = wp.constant(64)
# Values that need the length of the gradient, or that of the normal.
OF_GRADIENT = wp.constant(2 | 4 | 16 | 32)
OF_SURFACE = wp.constant(8 | 16 | 64)

HIGHEST = wp.constant(wp.float64(3.4028234663852886e38))
# Ground of a smaller slope is level and has no direction.
LEVEL_GROUND = wp.constant(wp.float64(1e-9))


@wp.struct
class Values:
    """The requested values as bits, and their arrays; others are unused."""

    wanted: wp.int32
    height: wp.array(dtype=wp.float32)
    slope: wp.array(dtype=wp.float32)
    aspect: wp.array(dtype=wp.vec2f)
    mean_curvature: wp.array(dtype=wp.float32)
    profile_curvature: wp.array(dtype=wp.float32)
    plan_curvature: wp.array(dtype=wp.float32)
    normal: wp.array(dtype=wp.vec3f)


@wp.func
def to_single(x: wp.float64) -> wp.float32:
    """Convert to float32, clamped to finite values."""
    return wp.float32(wp.clamp(x, -HIGHEST, HIGHEST))


@wp.func
def arc_tangent(t: wp.float64) -> wp.float64:
    """Return atan(t), t >= 0, by arithmetic alone (Cephes, atan.c); bits of the C library differ by processor."""
    x = t
    base = wp.float64(0.0)
    if t > wp.float64(2.414213562373095):
        base = wp.float64(1.5707963267948966)
        x = -wp.float64(1.0) / t
    elif t > wp.float64(0.66):
        base = wp.float64(0.7853981633974483)
        x = (t - wp.float64(1.0)) / (t + wp.float64(1.0))
    z = x * x
    p = wp.float64(-8.750608600031904122785e-1) * z - wp.float64(1.615753718733365076637e1)
    p = p * z - wp.float64(7.500855792314704667340e1)
    p = p * z - wp.float64(1.228866684490136173410e2)
    p = p * z - wp.float64(6.485021904942025371773e1)
    q = z + wp.float64(2.485846490142306297962e1)
    q = q * z + wp.float64(1.650270098316988542046e2)
    q = q * z + wp.float64(4.328810604912902668951e2)
    q = q * z + wp.float64(4.853903996359136964868e2)
    q = q * z + wp.float64(1.945506571482613964425e2)
    return base + (x + x * z * (p / q))


@wp.func
def mean_curvature_of(q: Jet, r: wp.float64) -> wp.float64:
    """Return -((1 + zy^2) zxx - 2 zx zy zxy + (1 + zx^2) zyy) / 2 r^3, 1/m, positive on a summit.

    q: jet (z, zx, zy, zxx, zxy, zyy), metres. r: 1 / sqrt(1 + zx^2 + zy^2).
    """
    one = wp.float64(1.0)
    sum = (one + q[2] * q[2]) * q[3] - wp.float64(2.0) * q[1] * q[2] * q[4] + (one + q[1] * q[1]) * q[5]
    return wp.float64(-0.5) * sum * (r * r * r)


@wp.func
def profile_curvature_of(q: Jet, r: wp.float64, run: wp.float64) -> wp.float64:
    """Return -(zxx zx^2 + 2 zxy zx zy + zyy zy^2) run^2 r^3, 1/m, positive where the slope steepens downhill.

    q: jet (z, zx, zy, zxx, zxy, zyy), metres. r: 1 / sqrt(1 + zx^2 + zy^2). run: 1 / sqrt(zx^2 + zy^2), 0 on level
    ground.
    """
    sum = q[3] * q[1] * q[1] + wp.float64(2.0) * q[4] * q[1] * q[2] + q[5] * q[2] * q[2]
    return -sum * (run * run) * (r * r * r)


@wp.func
def plan_curvature_of(q: Jet, run: wp.float64) -> wp.float64:
    """Return -(zxx zy^2 - 2 zxy zx zy + zyy zx^2) run^3, 1/m, positive on a ridge.

    q: jet (z, zx, zy, zxx, zxy, zyy), metres. run: 1 / sqrt(zx^2 + zy^2), 0 on level ground.
    """
    sum = q[3] * q[2] * q[2] - wp.float64(2.0) * q[4] * q[1] * q[2] + q[5] * q[1] * q[1]
    return -sum * (run * run) * run


@wp.kernel
def from_jets(
    offset: int,
    ground: Pyramid,
    finer: wp.array(dtype=FinerHeights),
    positions: wp.array(dtype=wp.vec3f),
    levels: wp.array(dtype=wp.float32),
    values: Values,
):
    """Compute the requested values (height, slope, curvatures ..) at point `offset + tid` from the ground's jet there.

    A jet is the height with its first and second derivatives. Slopes are radians, curvatures 1/m; the aspect is the
    unit vector downhill, (0, 0) on level ground. finer: the heights of finer tiles, one or none. levels: log2 of the
    samples that a pixel covers at each point; below 0 only finer tiles count. values: the output arrays, and bits for
    those that are requested.
    """
    v = offset + wp.tid()
    p = positions[v]
    level = levels[v]
    q = Jet()
    if level < 0.0 and finer.shape[0] > 0:
        q = finer_jet_at(finer[0], ground, wp.float64(p[0]), wp.float64(p[1]), level)
    else:
        q = jet_at(ground, wp.float64(p[0]), wp.float64(p[1]), level)
    if (values.wanted & HEIGHT) != 0:
        values.height[v] = to_single(q[0])
    squared = q[1] * q[1] + q[2] * q[2]
    rise = wp.float64(0.0)
    run = wp.float64(0.0)
    normal_z = wp.float64(0.0)
    if (values.wanted & OF_GRADIENT) != 0:
        rise = wp.sqrt(squared)
        if rise > LEVEL_GROUND:
            run = wp.float64(1.0) / rise  # 1 / slope; 0 on level ground
    if (values.wanted & OF_SURFACE) != 0:
        normal_z = wp.float64(1.0) / wp.sqrt(wp.float64(1.0) + squared)
    if (values.wanted & SLOPE) != 0:
        values.slope[v] = wp.float32(arc_tangent(rise))
    if (values.wanted & ASPECT) != 0:
        values.aspect[v] = wp.vec2f(wp.float32(-q[1] * run), wp.float32(-q[2] * run))
    if (values.wanted & MEAN_CURVATURE) != 0:
        values.mean_curvature[v] = to_single(mean_curvature_of(q, normal_z))
    if (values.wanted & PROFILE_CURVATURE) != 0:
        values.profile_curvature[v] = to_single(profile_curvature_of(q, normal_z, run))
    if (values.wanted & PLAN_CURVATURE) != 0:
        # A contour with a radius below the level's spacing, 2^level samples, is not resolved.
        limit = wp.max(ground.per_x, ground.per_y) * inverse_power(wp.int32(wp.floor(level)))
        values.plan_curvature[v] = wp.float32(wp.clamp(plan_curvature_of(q, run), -limit, limit))
    if (values.wanted & NORMAL) != 0:
        values.normal[v] = wp.vec3f(wp.float32(-q[1] * normal_z), wp.float32(-q[2] * normal_z), wp.float32(normal_z))
