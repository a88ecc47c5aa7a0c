# SPDX-License-Identifier: GPL-3.0-or-later
"""Geomorphing: vertices move to their final heights as the view comes nearer. docs/method/morph.md has the proof.

A vertex is in the mesh if its diamond's ratio (how many times too coarse the diamond is) is above 1, and at its final
height from the ratio k on. Between them its height follows the smoothstep of (1 - 1 / ratio) / (1 - 1 / k). So the
surface is a mean of the meshes for 1 .. k times an error. For a bound B the walk uses B over the mean of the ramp.
"""

from functools import lru_cache

# The default takes a quarter to a half more triangles; jumps shrink with the step of the camera.
SMOOTH = 1.5
MAX_MORPH = 4.0  # takes over three quarters more triangles than without, and is little smoother


@lru_cache(maxsize=64)
def mean_ramp(k: float) -> float:
    """Return m(k), the mean of the ratio of error to criterion over the ramp from 1 to k: 1.21 at k = 1.5.

    Geomorphing raises errors by this factor, 1 <= k <= MAX_MORPH. It is the integral of 6 u (1 - u) / (1 - c u) over u
    from 0 to 1, c = 1 - 1 / k. As a power series in c it has no logarithm, whose last bits differ by machine.
    """
    c, power, mean, n = 1.0 - 1.0 / k, 1.0, 0.0, 0
    while power > 1e-18:
        mean += 6.0 * power / ((n + 2) * (n + 3))
        power, n = power * c, n + 1
    return mean
