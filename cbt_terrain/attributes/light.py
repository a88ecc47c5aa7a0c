# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions of light: azimuths of the sky, strips of the sun's disc."""

import math
from collections.abc import Iterable

import numpy as np

from ..errors import TerrainError
from ..run import launch

AZIMUTHS = 16  # in which the horizon of a point is found
STRIPS = 3  # upright ones, into which the sun's disc is cut
# Radius of the sun's disc in radians that hard shadows are computed with.
MIN_RADIUS = 1e-5
# Radians beyond the disc that absorb rounding.
AROUND = 1e-6
# Largest elevation in radians whose slope is finite.
HIGHEST = math.pi / 2 - 1e-6


def azimuths() -> np.ndarray:
    """Return unit vectors in the middle of 16 equal sectors, float64 [16, 2], in bit-reversed order.

    The first 4, 8 or 16 of them are spread evenly. Square roots alone give the same bits on every machine.
    """
    root = math.sqrt(2.0)
    # Of 11.25 and 33.75 degrees; the other two directions of a quarter exchange sine and cosine.
    cosines = [math.sqrt(2.0 + math.sqrt(2.0 + root)) / 2.0, math.sqrt(2.0 + math.sqrt(2.0 - root)) / 2.0]
    sines = [math.sqrt(2.0 - math.sqrt(2.0 + root)) / 2.0, math.sqrt(2.0 - math.sqrt(2.0 - root)) / 2.0]
    east = [cosines[0], cosines[1], sines[1], sines[0]]
    north = [sines[0], sines[1], cosines[1], cosines[0]]
    quarter = np.stack([east, north], axis=-1)
    circle = [quarter]
    for _ in range(3):
        circle.append(np.stack([-circle[-1][:, 1], circle[-1][:, 0]], axis=-1))  # a quarter turn further
    order = [int(f"{k:04b}"[::-1], 2) for k in range(AZIMUTHS)]
    return np.concatenate(circle)[order]


def strongest(suns: Iterable[Iterable[float]]) -> tuple[float, float, float, float] | None:
    """Return x, y, z and angle of the strongest sun, the first of equals; None if none has a strength above 0.

    (x, y, z): direction towards the sun. suns: (x, y, z, angle), of strength 1, or (x, y, z, angle, strength), as the
    parameter in sun.py. Raises TerrainError for rows of other lengths, numbers that are not finite, no direction, and
    angles beyond 0 .. pi.
    """
    rows = [tuple(float(number) for number in sun) for sun in suns]
    for row in rows:
        if len(row) not in (4, 5) or not np.isfinite(row).all() or not any(row[:3]) or not 0.0 <= row[3] <= math.pi:
            raise TerrainError(
                f"A sun of the effect 'sun' is {row}",
                expected="the direction towards it (x, y, z), not all 0, the angle of its disc in radians (0 to pi), "
                "and its strength",
            )
    lit = [row for row in rows if len(row) == 4 or row[4] > 0.0]
    if not lit:
        return None
    x, y, z, angle = max(lit, key=lambda row: row[4] if len(row) == 5 else 1.0)[:4]
    return x, y, z, angle


def strips_of(sun: tuple[float, float, float, float]) -> dict[str, object] | None:
    """Return a sun as inputs of `sun_seen`, the kernel that finds the visible fraction of its disc.

    They are the elevation and radius in radians, the slopes `low` and `high` to its lower and upper edge, and upright
    strips of the disc: azimuth (cosine, sine), and half the height in radii. None if the whole disc is below the
    horizontal. Single precision hides the last bits of the C library's sines. AROUND widens the range of slopes against
    rounding, and HIGHEST keeps them finite. sun: x, y, z towards it and the angle of its disc in radians.
    """
    from ...kernels import wp
    from ...kernels.effects.light import SunStrip

    x, y, z, angle = sun
    horizontal = math.sqrt(x * x + y * y)
    radius = max(angle / 2.0, MIN_RADIUS)
    elevation = math.atan2(z, horizontal)
    if elevation <= -radius:
        return None
    azimuth = math.atan2(y, x)
    strips = np.zeros(STRIPS, SunStrip.numpy_dtype())
    for k in range(STRIPS):
        across = (2 * k + 1) / STRIPS - 1.0  # from the disc's centre to the strip's middle, in radii
        # Near the zenith a disc covers every azimuth, but no ground hides it there.
        strip_azimuth = azimuth + across * radius / max(math.cos(elevation), radius)
        strips["azimuth"][k] = _rounded_to_single(math.cos(strip_azimuth)), _rounded_to_single(math.sin(strip_azimuth))
        strips["half_height"][k] = _rounded_to_single(math.sqrt(1.0 - across * across))
    elevation = _rounded_to_single(elevation)
    low, high = (min(elevation + side * (radius + AROUND), HIGHEST) for side in (-1.0, 1.0))
    return {
        "elevation": elevation,
        "radius": radius,
        "low": max(_rounded_to_single(math.tan(low)), 0.0),
        "high": _rounded_to_single(math.tan(high)),
        "strips": wp.array(strips, dtype=SunStrip, device=launch.DEVICE),
    }


def _rounded_to_single(number: float) -> float:
    """Return the number rounded to float32, which hides the last bits of the C library."""
    return float(np.float32(number))
