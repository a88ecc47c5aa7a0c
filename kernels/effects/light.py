# SPDX-License-Identifier: GPL-3.0-or-later
"""What light reaches a place: the part of the sky, or of the sun's disc, that stands above its horizons.

Only + - * / and square roots, so that no machine's library of functions is in the bits.
"""

import warp as wp

from .horizon import Occluder, cells_of, gradient, horizon, surface
from .jet import arc_tangent

HALF_PI = wp.constant(wp.float64(1.5707963267948966))


@wp.func
def elevation_of(slope: wp.float64) -> wp.float64:
    """Radians above the horizontal."""
    return wp.where(slope < wp.float64(0.0), -arc_tangent(-slope), arc_tangent(slope))


@wp.func
def open_part(slope: wp.float64, g: wp.vec2d, azimuth: wp.vec2d):
    """Cosine-weighted share of the half plane over an azimuth above the horizon `slope`; 1 if nothing is in the way.

    `g`: gradient of the ground, about whose normal n the cosine is. With w = (cos e azimuth, sin e) the share is twice
    the integral of max(n . w, 0) cos e from the horizon's elevation to the zenith, in closed form (Timonen and
    Westerholm 2010, section 3). The mean over all azimuths is the visible part of the sky.
    """
    one = wp.float64(1.0)
    up = one / wp.sqrt(one + wp.dot(g, g))
    ahead = -wp.dot(g, azimuth) * up
    q = one / (one + slope * slope)
    return ahead * (HALF_PI - elevation_of(slope) - slope * q) + up * q


@wp.kernel
def sky_seen(
    offset: int,
    occluder: Occluder,
    far: wp.float64,
    lowest: wp.float64,
    azimuths: wp.array(dtype=wp.vec2d),
    first: int,
    end: int,
    places: wp.array(dtype=wp.vec3f),
    out: wp.array(dtype=wp.float32),
):
    """Add to `out` what the azimuths `first` .. `end` show of the sky above ground up to `far` metres off; the last one
    puts it into 0 .. 1. What is below the slope `lowest`, or below the place's own plane, counts as hidden."""
    i = offset + wp.tid()
    count = azimuths.shape[0]
    x = cells_of(wp.float64(places[i][0]), occluder.west, occluder.step_x, occluder.samples.columns - 1)
    y = cells_of(wp.float64(places[i][1]), occluder.south, occluder.step_y, occluder.samples.rows - 1)
    z = surface(occluder, x, y)
    g = gradient(occluder, x, y)
    total = out[i]
    for k in range(first, end):
        azimuth = azimuths[k]
        least = wp.max(wp.dot(g, azimuth), lowest)
        slope = horizon(occluder, x, y, z, azimuth, far, least, wp.float64(1.0e300))
        total += wp.float32(open_part(slope, g, azimuth)) / wp.float32(count)
    if end == count:
        total = wp.clamp(total, wp.float32(0.0), wp.float32(1.0))
    out[i] = total


@wp.struct
class Strip:
    """An upright strip of the sun's disc: where it stands, and half its height in radii of the disc."""

    azimuth: wp.vec2d
    half: wp.float64


@wp.kernel
def sun_seen(
    offset: int,
    occluder: Occluder,
    elevation: wp.float64,
    radius: wp.float64,
    low: wp.float64,
    high: wp.float64,
    strips: wp.array(dtype=Strip),
    places: wp.array(dtype=wp.vec3f),
    out: wp.array(dtype=wp.float32),
):
    """Part of the sun's disc above the horizon. `elevation`, `radius`: radians; `low`, `high`: slopes to just below and
    just above the disc, between which a horizon hides a part of it."""
    i = offset + wp.tid()
    x = cells_of(wp.float64(places[i][0]), occluder.west, occluder.step_x, occluder.samples.columns - 1)
    y = cells_of(wp.float64(places[i][1]), occluder.south, occluder.step_y, occluder.samples.rows - 1)
    z = surface(occluder, x, y)
    zero = wp.float64(0.0)
    seen = zero
    whole = zero
    for k in range(strips.shape[0]):
        half = strips[k].half
        slope = horizon(occluder, x, y, z, strips[k].azimuth, wp.float64(1.0e300), low, high)
        hidden = (elevation_of(slope) - elevation) / radius
        seen += wp.clamp(half - hidden, zero, wp.float64(2.0) * half)
        whole += wp.float64(2.0) * half
    out[i] = wp.float32(seen / whole)
