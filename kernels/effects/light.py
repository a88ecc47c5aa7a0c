# SPDX-License-Identifier: GPL-3.0-or-later
"""Light at a point: the fraction of the sky, or of the sun's disc, above its horizons.

Only + - * / and square roots, so that bits do not depend on a machine's library of functions. `occluder`: the ground,
which is the raster with the maxima of its blocks.
"""

import warp as wp

from .horizon import Occluder, cells_of, gradient, horizon, surface
from .jet import arc_tangent

HALF_PI = wp.constant(wp.float64(1.5707963267948966))


@wp.func
def elevation_of(slope: wp.float64) -> wp.float64:
    """Return the elevation angle of a slope (metres a metre) in radians."""
    return wp.where(slope < wp.float64(0.0), -arc_tangent(-slope), arc_tangent(slope))


@wp.func
def open_fraction(slope: wp.float64, g: wp.vec2d, azimuth: wp.vec2d):
    """Return the cosine-weighted visible part of the sky over one azimuth; the mean over all azimuths is 0 .. 1.

    slope: the horizon's slope, metres a metre, at least dot(g, azimuth). g: gradient of the ground (east, north).
    azimuth: unit vector. The cosine is relative to the ground's normal n. With w = (cos e azimuth, sin e) the part is
    2 * integral of max(n . w, 0) cos e de from the horizon's elevation to the zenith, in closed form (Timonen and
    Westerholm 2010, section 3).
    """
    one = wp.float64(1.0)
    up = one / wp.sqrt(one + wp.dot(g, g))
    ahead = -wp.dot(g, azimuth) * up
    cosine2 = one / (one + slope * slope)
    return ahead * (HALF_PI - elevation_of(slope) - slope * cosine2) + up * cosine2


@wp.kernel
def sky_seen(
    offset: int,
    occluder: Occluder,
    far: wp.float64,
    lowest: wp.float64,
    azimuths: wp.array(dtype=wp.vec2d),
    first: int,
    end: int,
    positions: wp.array(dtype=wp.vec3f),
    out: wp.array(dtype=wp.float32),
):
    """Add the visible part of the sky in azimuths first .. end - 1 to out[i], for point i = offset + tid.

    Each part is divided by the number of azimuths. The call with the last azimuth clamps the sum to 0 .. 1. positions:
    metres. far: metres of ground that can hide sky. lowest: slope below which everything counts as hidden, like
    everything below the tangent plane.
    """
    i = offset + wp.tid()
    count = azimuths.shape[0]
    x = cells_of(wp.float64(positions[i][0]), occluder.west, occluder.step_x, occluder.samples.columns - 1)
    y = cells_of(wp.float64(positions[i][1]), occluder.south, occluder.step_y, occluder.samples.rows - 1)
    z = surface(occluder, x, y)
    g = gradient(occluder, x, y)
    total = out[i]
    for k in range(first, end):
        azimuth = azimuths[k]
        min_slope = wp.max(wp.dot(g, azimuth), lowest)
        slope = horizon(occluder, x, y, z, azimuth, far, min_slope, wp.float64(1.0e300))  # no upper limit of the slope
        total += wp.float32(open_fraction(slope, g, azimuth)) / wp.float32(count)
    if end == count:
        total = wp.clamp(total, wp.float32(0.0), wp.float32(1.0))
    out[i] = total


@wp.struct
class SunStrip:
    """An upright strip of the sun's disc: its azimuth, and half its height in radii of the disc."""

    azimuth: wp.vec2d
    half_height: wp.float64


@wp.kernel
def sun_seen(
    offset: int,
    occluder: Occluder,
    elevation: wp.float64,
    radius: wp.float64,
    low: wp.float64,
    high: wp.float64,
    strips: wp.array(dtype=SunStrip),
    positions: wp.array(dtype=wp.vec3f),
    out: wp.array(dtype=wp.float32),
):
    """Write to out[offset + tid] the part of the sun's disc, 0 .. 1, above the horizon at a point.

    elevation: angle of the disc's centre above the horizon; radius: its angular radius; radians. low, high: slopes just
    below and above the disc; only a horizon between them needs precision. strips: upright strips that make up the disc.
    positions: metres.
    """
    i = offset + wp.tid()
    x = cells_of(wp.float64(positions[i][0]), occluder.west, occluder.step_x, occluder.samples.columns - 1)
    y = cells_of(wp.float64(positions[i][1]), occluder.south, occluder.step_y, occluder.samples.rows - 1)
    z = surface(occluder, x, y)
    zero = wp.float64(0.0)
    visible = zero
    disc = zero  # area of the whole disc, like `visible` in heights of strips
    for k in range(strips.shape[0]):
        half_height = strips[k].half_height
        slope = horizon(occluder, x, y, z, strips[k].azimuth, wp.float64(1.0e300), low, high)  # at any distance
        # In radii above the disc's centre.
        hidden_up_to = (elevation_of(slope) - elevation) / radius
        visible += wp.clamp(half_height - hidden_up_to, zero, wp.float64(2.0) * half_height)
        disc += wp.float64(2.0) * half_height
    out[i] = wp.float32(visible / disc)
