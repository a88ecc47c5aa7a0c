# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounds of the distance between a triangle and a detail, from the triangle's size and the maximum of the mask.

Split a height into a smooth part, whose second derivative is at most N in any direction, and a remainder. Let a circle
of radius r contain a triangle. Then the distance between the plane through its corners and the height is at most the
sum of

* N r^2 / 2 for the smooth part (S. Waldron, "The error in linear interpolation at the vertices of a simplex", SIAM J.
  Numer. Anal. 35, 1998; kernels use the same bound for bicubic patches);
* the range of the remainder, which contains both the remainder and its plane.

A height can be split in several ways; the smallest of their bounds holds. It never grows with the depth, so adding it
to a nested hierarchy leaves that nested.

With a mask m, bilinear in a raster cell between values of 0 .. M, the height is m f. Along an axis m changes by at most
M in a cell, and its twist is at most 2 M. So its slope is at most M g, g = |(1 / step_x, 1 / step_y)|, and its second
derivative at most M w, w = 2 / (step_x step_y). Inside a cell the product's second derivative is then at most
m |f''| + 2 |m'| |f'| + |m''| |f| <= M (N + 2 g S + w A), with the slope S and the magnitude A of the smooth part. The
range of m times the remainder, with 0, is M times that of the remainder. So the bound is M times a number that depends
on the size alone. For a triangle in more than one cell the bound is M times the whole range of f. For waves much longer
than cells this is ten times too large: masks are made for fine detail.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ..view.linear import add_up, length

OUTWARD = 1 + 1e-9  # exceeds the rounding of these sums


class Split(NamedTuple):
    """Limits of a height that is split into a smooth part and a remainder.

    Attributes:
        far: range of the remainder, 0 included, metres.
        curvature: largest second derivative of the smooth part, 1 / m.
        steep: largest slope of the smooth part.
        highest: largest magnitude of the smooth part, metres.
    """

    far: float
    curvature: float
    steep: float
    highest: float


class DetailTerm(NamedTuple):
    """Limits of a summand of a detail.

    Attributes:
        highest: largest magnitude, metres.
        steep: largest slope.
        shortest: shortest wavelength, metres.
        splits: ways to split it; the last one has no smooth part.
    """

    highest: float
    steep: float
    shortest: float
    splits: tuple[Split, ...]


def masked_terms(parts: Iterable[DetailTerm], steps: tuple[float, float]) -> list[DetailTerm]:
    """Return bounds of the summands `parts` times a mask of 0 to 1, inside a raster cell, where the mask is bilinear.

    steps: metres of the cell's sides.
    """
    g, w = length((1 / steps[0], 1 / steps[1])), 2 / (steps[0] * steps[1])  # the mask's slope and second derivative
    terms = []
    for part in parts:
        # By the product rule. f: range of the remainder; n, s, a: curvature, slope and magnitude of the smooth part.
        splits = (Split(f, n + 2 * g * s + w * a, s + g * a, a) for f, n, s, a in part.splits)
        terms.append(DetailTerm(part.highest, part.steep + g * part.highest, part.shortest, tuple(splits)))
    return terms


def highest(parts: Iterable[DetailTerm]) -> float:
    """Return the largest magnitude of a sum of summands, metres, rounded up."""
    return add_up(part.highest for part in parts) * (1 + 1e-12)


def steepest(parts: Iterable[DetailTerm]) -> float:
    """Return the largest slope of the sum in any direction, metres a metre."""
    return add_up(part.steep for part in parts)


def max_distance(parts: Iterable[DetailTerm], radius: float) -> float:
    """Return how far, in metres, the sum can be from a triangle that fits in a circle of `radius` metres."""
    return add_up(min(s.far + 0.5 * s.curvature * (radius * radius) for s in part.splits) for part in parts)


def max_climb(parts: Iterable[DetailTerm], radius: float) -> float:
    """Return how much, metres, the sum of `parts` can differ between two corners of a triangle.

    Each is split into a remainder, limited by its range, and a smooth part, limited by its slope times the distance.
    radius: of a circle that contains the triangle, metres.
    """
    return add_up(min(s.far + 2 * radius * s.steep for s in part.splits) for part in parts)


def radius_at(steps: tuple[float, float], levels: int, depth: int) -> float:
    """Return the radius, metres, of the smallest circle around a triangle at a depth (1 ..) of a root square.

    steps: metres of a raster cell's sides; a square has 2**levels of them. Every two depths halve a square's sides. At
    odd depths a triangle is half of such a part. At even depths its base is a side of the part and its apex the part's
    middle; this returns the larger of both orientations.
    """
    x, y = (step * 2.0 ** (levels - (depth - 1) // 2) for step in steps)  # sides of the part, metres
    if depth % 2:
        return 0.5 * length((x, y))
    return max(_over(x, 0.5 * y), _over(y, 0.5 * x))  # radius for a base and a height


def _over(base: float, height: float) -> float:
    """Return the radius of the smallest circle around a triangle with its apex over the middle of its base, metres."""
    return 0.5 * base if height <= 0.5 * base else (0.25 * base * base + height * height) / (2 * height)


def tables(
    parts: list[DetailTerm], steps: tuple[float, float], levels: int, meshlet: int, smooth_from: int = 1
) -> np.ndarray:
    """Return two bounds for each depth of a leaf, float32 [64, 2] metres, rounded up.

    The first is the distance of the displacement from the 4**meshlet triangles as which a leaf is drawn
    (`max_distance`), the second its difference between the leaf's corners (`max_climb`). parts: summands of the
    displacement. steps: metres between samples. levels: a root square has 2**levels cells a side. smooth_from: first
    depth for which the bounds by curvature and slope hold; with a mask that of half a cell, so that a triangle is
    inside one cell. Coarser triangles have the displacement's whole range, which is entry 0 and holds at all depths.
    """
    limit = 2 * highest(parts)
    bounds = [(limit, limit)]
    for depth in range(1, 64):
        drawn_depth = depth + 2 * meshlet
        drawn_radius, leaf_radius = (radius_at(steps, levels, d) for d in (drawn_depth, depth))
        distance = max_distance(parts, drawn_radius) if drawn_depth >= smooth_from else limit
        bounds.append((distance, max_climb(parts, leaf_radius) if depth >= smooth_from else limit))
    # Rounding must not let a bound grow with the depth, so that a nested hierarchy stays nested.
    above = np.minimum.accumulate(np.array(bounds), axis=0) * OUTWARD
    return np.nextafter(above.astype(np.float32), np.float32(np.inf))
