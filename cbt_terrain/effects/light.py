# SPDX-License-Identifier: GPL-3.0-or-later
"""The directions that light is looked for in: azimuths of the sky, strips of the sun's disc."""

import math

import numpy as np
import warp as wp

from ...kernels.effects.light import Strip
from ..errors import TerrainError
from ..run import launch

AZIMUTHS = 16
STRIPS = 3
# Radians, of half the sun's disc: what a hard shadow is made with.
LEAST_RADIUS = 1e-5
# Radians that are looked for beyond the disc, so that what rounding takes is not of the disc.
AROUND = 1e-6
# The part of an upright disc's edge that can be seen: beyond it slopes have no number.
HIGHEST = math.pi / 2 - 1e-6


def azimuths() -> np.ndarray:
    """float64 [16, 2]: unit directions in the middle of 16 equal sectors, by halves, quarters and so on of the circle.

    Any first 4, 8 or 16 of them are spread evenly (bits of their numbers reversed). Made by square roots alone, so that
    every machine has the same.
    """
    root = math.sqrt(2.0)
    cosines = [math.sqrt(2.0 + math.sqrt(2.0 + root)) / 2.0, math.sqrt(2.0 + math.sqrt(2.0 - root)) / 2.0]
    sines = [math.sqrt(2.0 - math.sqrt(2.0 + root)) / 2.0, math.sqrt(2.0 - math.sqrt(2.0 - root)) / 2.0]
    east = [cosines[0], cosines[1], sines[1], sines[0]]
    north = [sines[0], sines[1], cosines[1], cosines[0]]
    quarter = np.stack([east, north], axis=-1)
    circle = [quarter]
    for _ in range(3):
        circle.append(np.stack([-circle[-1][:, 1], circle[-1][:, 0]], axis=-1))
    order = [int(f"{k:04b}"[::-1], 2) for k in range(AZIMUTHS)]
    return np.concatenate(circle)[order]


def strongest(suns) -> tuple[float, float, float, float] | None:
    """The sun that counts of rows (x, y, z, angle) or (x, y, z, angle, strength): the strongest, of equals the first.

    Raises TerrainError for a row that is no direction with an angle.
    """
    rows = [tuple(float(number) for number in sun) for sun in suns]
    for row in rows:
        if len(row) not in (4, 5) or not np.isfinite(row).all() or not any(row[:3]) or not 0.0 <= row[3] <= math.pi:
            raise TerrainError(
                f"A sun of the effect 'sun' is {row}; expected the direction towards it (x, y, z), not all 0, the "
                "angle of its disc in radians (0 to pi), and its strength."
            )
    lit = [row for row in rows if len(row) == 4 or row[4] > 0.0]
    best = max(lit, key=lambda row: row[4] if len(row) == 5 else 1.0, default=None)
    return None if best is None else best[:4]


def strips_of(sun: tuple[float, float, float, float]) -> dict[str, object] | None:
    """What the kernel `sun_seen` takes of a sun: None if its whole disc is below the horizontal.

    Sines are of the C library: single precision hides their last bits.
    """
    x, y, z, angle = sun
    level = math.sqrt(x * x + y * y)
    radius = max(angle / 2.0, LEAST_RADIUS)
    elevation = math.atan2(z, level)
    if elevation <= -radius:
        return None
    azimuth = math.atan2(y, x)
    strips = np.zeros(STRIPS, Strip.numpy_dtype())
    for k in range(STRIPS):
        across = (2 * k + 1) / STRIPS - 1.0
        # Near the zenith a disc covers every azimuth; there the ground stands in the way of none.
        turned = azimuth + across * radius / max(math.cos(elevation), radius)
        strips["azimuth"][k] = _single(math.cos(turned)), _single(math.sin(turned))
        strips["half"][k] = _single(math.sqrt(1.0 - across * across))
    elevation = _single(elevation)
    low, high = (min(elevation + side * (radius + AROUND), HIGHEST) for side in (-1.0, 1.0))
    return {
        "elevation": elevation,
        "radius": radius,
        "low": max(_single(math.tan(low)), 0.0),
        "high": _single(math.tan(high)),
        "strips": wp.array(strips, dtype=Strip, device=launch.DEVICE),
    }


def _single(number: float) -> float:
    return float(np.float32(number))
