# SPDX-License-Identifier: GPL-3.0-or-later
"""A height below the raster's cells, and how far a triangle can be from it.

Octave k (0 ..) is quintic value noise n of the amplitude a = a_0 roughness^k and the wavelength l = l_0 2^-k, so metres
of height a n(x / l); amplitudes add up to that of the detail. Against a plane through a triangle's corners it is

* at most 2 a away: both lie between -a and a;
* at most N r^2 / 2 away, N = a c / l^2 its largest second derivative in any direction and r the radius of a circle that
  holds the triangle (S. Waldron, "The error in linear interpolation at the vertices of a simplex", SIAM J. Numer. Anal.
  35, 1998; kernels say the same of bicubic patches). The noise is twice differentiable, also where lattice cells meet.

The constant c. Between lattice values in [-1, 1] n is linear in each of them, so is its second derivative in a given
direction, which is therefore largest where all four are 1 or -1. With the fade f(u) = 6 u^5 - 15 u^4 + 10 u^3 the
largest is that of the checkerboard F(u) F(v), F = 1 - 2 f, in a cell's middle along a diagonal: 4 f'(1/2)^2 =
4 (15/8)^2 = 225/16; and the largest slope in any direction is 2 f'(1/2) = 15/4. tests/cbt_terrain/test_detail.py
proves c <= 14.1 and slopes <= 3.8 for all cells by interval arithmetic.

The bound is the sum over the octaves of the less of both. It depends on the size of the triangle alone, so on the depth
alone, and never grows with it: added to a nested hierarchy it leaves it nested.
"""

import hashlib
import math
from dataclasses import dataclass

import numpy as np

from ...kernels.field import detail as kernels
from ..errors import TerrainError

MOST_OCTAVES = 9
# Largest second derivative and slope of the noise, see above: what the proof shows is a little more than the truth.
BEND, SLOPE = 14.1, 3.8
# The shortest wave has so many of the finest leaf's edges: what remains of it is 0.11 of its amplitude.
EDGES_A_WAVE = 4
LARGEST = 1e6


@dataclass(frozen=True)
class Detail:
    """Octaves of noise, together at most `amplitude` metres above or below the surface. The longest waves have
    `wavelength` metres; each octave half as long has `roughness` (0 .. 1) of the amplitude of the one before. `seed`
    gives another pattern."""

    amplitude: float
    wavelength: float = 4.0
    roughness: float = 0.5
    seed: int = 0

    def __post_init__(self):
        _check("amplitude", self.amplitude, 0.0, LARGEST, "metres")
        _check("wavelength", self.wavelength, 1e-3, LARGEST, "metres")
        _check("roughness", self.roughness, 0.0, 1.0, "parts of the octave before")
        if not (isinstance(self.seed, int) and 0 <= self.seed < 2**32):
            raise TerrainError(f"The detail's seed is {self.seed!r}; expected a whole number, 0 .. {2**32 - 1}.")

    @property
    def key(self) -> str:
        """Equal for equal details."""
        text = repr((float(self.amplitude), float(self.wavelength), float(self.roughness), self.seed))
        return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()

    def waves(self, finest: float) -> list[tuple[float, float]]:
        """Amplitude and wavelength, metres, of the octaves that leaves with edges of `finest` metres can show."""
        lengths = [self.wavelength * 0.5**k for k in range(MOST_OCTAVES)]
        shown = [length for k, length in enumerate(lengths) if k == 0 or length >= EDGES_A_WAVE * finest]
        parts = [self.roughness**k for k in range(len(shown))]
        share = self.amplitude / sum(parts)
        return [(share * part, length) for part, length in zip(parts, shown, strict=True) if share * part > 0.0]

    def packed(self, finest: float) -> kernels.Detail:
        """As the kernels read it."""
        d = kernels.Detail()
        waves = self.waves(finest)
        d.octaves, d.seed = len(waves), self.seed
        d.amplitude = waves[0][0] if waves else 0.0
        d.gain, d.frequency = self.roughness, 1.0 / self.wavelength
        return d


def _check(name: str, value: float, low: float, high: float, unit: str) -> None:
    if not (isinstance(value, int | float) and low <= value <= high):
        raise TerrainError(f"The detail's {name} is {value!r}; expected {low:g} .. {high:g} {unit}.")


def highest(waves: list[tuple[float, float]]) -> float:
    """Metres that the sum of octaves rises above the surface or falls below it, at most."""
    return sum(a for a, _ in waves) * (1 + 1e-12)


def steepest(waves: list[tuple[float, float]]) -> float:
    """Metres a metre that it climbs in any direction, at most."""
    return sum(SLOPE * a / length for a, length in waves)


def missed(waves: list[tuple[float, float]], radius: float) -> float:
    """Metres between the sum of octaves and a triangle that a circle of `radius` metres holds, at most."""
    return sum(min(2 * a, 0.5 * BEND * a * (radius / length) ** 2) for a, length in waves)


def climbed(waves: list[tuple[float, float]], radius: float) -> float:
    """Metres by which two corners of such a triangle differ in it, at most."""
    return sum(min(2 * a, 2 * radius * SLOPE * a / length) for a, length in waves)


def radius_at(steps: tuple[float, float], levels: int, depth: int) -> float:
    """Metres of the radius of the least circle that holds a triangle at a depth (1 ..) of a root square.

    steps: metres of a raster cell's sides; a square has 2**levels of them. At odd depths a triangle is half a cell, at
    even ones it stands on a cell's side with its apex in the middle; of the two ways to stand, the larger.
    """
    x, y = (step * 2.0 ** (levels - (depth - 1) // 2) for step in steps)
    if depth % 2:
        return 0.5 * math.hypot(x, y)
    return max(_over(x, 0.5 * y), _over(y, 0.5 * x))


def _over(base: float, height: float) -> float:
    """Of the triangle with its apex over the middle of its base."""
    return 0.5 * base if height <= 0.5 * base else (0.25 * base * base + height * height) / (2 * height)


def tables(waves: list[tuple[float, float]], steps: tuple[float, float], levels: int, meshlet: int) -> np.ndarray:
    """float32 [64, 2] metres for each depth, rounded up: `missed` by triangles of leaves that are drawn as 4**meshlet,
    and `climbed` by the leaf's edges. Entry 0 is what no triangle exceeds."""
    most = 2 * highest(waves)
    found = [(most, most)]
    for depth in range(1, 64):
        drawn, own = (radius_at(steps, levels, d) for d in (depth + 2 * meshlet, depth))
        found.append((missed(waves, drawn), climbed(waves, own)))
    above = np.minimum.accumulate(np.array(found), axis=0) * (1 + 1e-9)
    return np.nextafter(above.astype(np.float32), np.float32(np.inf))
