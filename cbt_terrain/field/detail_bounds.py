# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a triangle can be from a detail, by its size alone; with a mask, by its size and the mask's most.

Let a height be `far` metres at most from a smooth one whose second derivative is at most N in any direction, and let a
circle of radius r hold a triangle. Its plane through the corners misses

* at most N r^2 / 2 of the smooth one (S. Waldron, "The error in linear interpolation at the vertices of a simplex",
  SIAM J. Numer. Anal. 35, 1998; kernels say the same of bicubic patches);
* at most the range of the rest, since the rest and its plane both lie in that.

There are several ways to divide a height so: the least of what they say holds. It never grows with the depth: added to
a nested hierarchy it leaves it nested.

With a mask m, bilinear in a raster cell between values of 0 .. M, the height is m f. Along an axis m changes by at most
M in a cell, and its twist is at most 2 M: so its slope is at most M g, g = |(1 / step_x, 1 / step_y)|, and its second
derivative at most M w, w = 2 / (step_x step_y). Inside a cell the product's is then at most
m |f''| + 2 |m'| |f'| + |m''| |f| <= M (N + 2 g S + w A), with S the slope and A the most of the smooth part; and m
times the rest spans M times the range of the rest and 0. So it is M times a number of the size alone. A triangle that
is in more than one cell misses at most M times all of f's range. Of waves much longer than cells that is ten times too
much: masks are for detail.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ..ask.linear import add_up, length

OUTWARD = 1 + 1e-9  # above what these sums round


class Way(NamedTuple):
    """A height is so many metres at most from a smooth one: `far` is the range of the rest, 0 included. The smooth one
    has the second derivative `bend` (1 / m) and the slope `steep` at most, and is `most` metres from 0 at most."""

    far: float
    bend: float
    steep: float
    most: float


class Part(NamedTuple):
    """A summand of a detail: at most `most` metres from 0, with a slope of `steep` at most and waves of `shortest`
    metres or more, and the ways to divide it. Its last way is that nothing of it is smooth."""

    most: float
    steep: float
    shortest: float
    ways: tuple[Way, ...]


def masked(parts: Iterable[Part], steps: tuple[float, float]) -> list[Part]:
    """The parts times a mask of 0 .. 1, inside the cells of a raster; steps: metres of their sides."""
    g, w = length((1 / steps[0], 1 / steps[1])), 2 / (steps[0] * steps[1])
    found = []
    for part in parts:
        ways = (Way(f, n + 2 * g * s + w * a, s + g * a, a) for f, n, s, a in part.ways)
        found.append(Part(part.most, part.steep + g * part.most, part.shortest, tuple(ways)))
    return found


def highest(parts: Iterable[Part]) -> float:
    """Metres that their sum rises above the surface or falls below it, at most."""
    return add_up(part.most for part in parts) * (1 + 1e-12)


def steepest(parts: Iterable[Part]) -> float:
    """Metres a metre that it climbs in any direction, at most."""
    return add_up(part.steep for part in parts)


def missed(parts: Iterable[Part], radius: float) -> float:
    """Metres between it and a triangle that a circle of `radius` metres holds, at most."""
    return add_up(min(way.far + 0.5 * way.bend * (radius * radius) for way in part.ways) for part in parts)


def climbed(parts: Iterable[Part], radius: float) -> float:
    """Metres by which two corners of such a triangle differ in it, at most."""
    return add_up(min(way.far + 2 * radius * way.steep for way in part.ways) for part in parts)


def radius_at(steps: tuple[float, float], levels: int, depth: int) -> float:
    """Metres of the radius of the least circle that holds a triangle at a depth (1 ..) of a root square.

    steps: metres of a raster cell's sides; a square has 2**levels of them. At odd depths a triangle is half a cell, at
    even ones it stands on a cell's side with its apex in the middle; of the two ways to stand, the larger.
    """
    x, y = (step * 2.0 ** (levels - (depth - 1) // 2) for step in steps)
    if depth % 2:
        return 0.5 * length((x, y))
    return max(_over(x, 0.5 * y), _over(y, 0.5 * x))


def _over(base: float, height: float) -> float:
    """Of the triangle with its apex over the middle of its base."""
    return 0.5 * base if height <= 0.5 * base else (0.25 * base * base + height * height) / (2 * height)


def tables(
    parts: list[Part], steps: tuple[float, float], levels: int, meshlet: int, smooth_from: int = 1
) -> np.ndarray:
    """float32 [64, 2] metres for each depth, rounded up: `missed` by triangles of leaves that are drawn as 4**meshlet,
    and `climbed` by the leaf's edges. Entry 0 is what no triangle exceeds, nor do those above the depth `smooth_from`:
    with a mask that of half a raster cell."""
    most = 2 * highest(parts)
    found = [(most, most)]
    for depth in range(1, 64):
        drawn, own = (radius_at(steps, levels, d) for d in (depth + 2 * meshlet, depth))
        smooth = depth + 2 * meshlet >= smooth_from, depth >= smooth_from
        found.append((missed(parts, drawn) if smooth[0] else most, climbed(parts, own) if smooth[1] else most))
    above = np.minimum.accumulate(np.array(found), axis=0) * OUTWARD
    return np.nextafter(above.astype(np.float32), np.float32(np.inf))
