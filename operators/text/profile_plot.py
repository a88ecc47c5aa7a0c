# SPDX-License-Identifier: GPL-3.0-or-later
"""A profile of the ground as a self-contained SVG: height over distance, metres on both axes."""

import math

import numpy as np

from .numbers import length_text, plain
from .svg import LINE, TEAL, WASH, path, picture, text

WIDTH, HEIGHT = 860, 360  # of the drawing, pixels
LEFT, RIGHT, TOP, BOTTOM = 72, 24, 40, 44  # margins of the axes, pixels
LINES = 5  # approximate number of grid lines per axis
MAX_POINTS = 4000  # a few per pixel


def draw(along: np.ndarray, heights: np.ndarray, title: str) -> str:
    """Return the SVG of a profile, with grid lines and a heading; NaN breaks the line where there is no ground.

    along, heights: distances from the start and heights, float64 [n] metres each. Of more than MAX_POINTS points an
    even selection is drawn, so short gaps may be bridged.
    """
    known = np.isfinite(heights)
    if not known.any():
        return picture(WIDTH, HEIGHT, title, [text(LEFT, TOP, "No ground below the line")])
    drawn = np.unique(np.linspace(0, len(along) - 1, min(len(along), MAX_POINTS)).astype(int))  # numbers of points
    low, high = float(heights[known].min()), float(heights[known].max())
    margin = 0.05 * (high - low) or 1.0
    x = _linear_axis(0.0, float(along[-1]) or 1.0, LEFT, WIDTH - RIGHT)
    y = _linear_axis(low - margin, high + margin, HEIGHT - BOTTOM, TOP)
    parts = [text(LEFT, 22, title, look="bold")]
    for metres in _round_values(0.0, float(along[-1]) or 1.0):
        parts.append(path([(x(metres), TOP), (x(metres), HEIGHT - BOTTOM)], LINE, 1))
        parts.append(text(x(metres), HEIGHT - BOTTOM + 20, length_text(metres), "middle"))
    for metres in _round_values(low - margin, high + margin):
        parts.append(path([(LEFT, y(metres)), (WIDTH - RIGHT, y(metres))], LINE, 1))
        parts.append(text(LEFT - 8, y(metres) + 4, f"{plain(metres, 6)} m", "end"))
    points = np.stack([along, heights], axis=1)[drawn]
    for begin, end in runs_of(known[drawn]):
        pixels = [(x(a), y(h)) for a, h in points[begin:end].tolist()]
        floor = HEIGHT - BOTTOM
        parts.append(path([(pixels[0][0], floor), *pixels, (pixels[-1][0], floor)], "none", 0, WASH))
        parts.append(path(pixels, TEAL, 2))
    return picture(WIDTH, HEIGHT, f"{title}: height over distance", parts)


def _linear_axis(low: float, high: float, start: float, end: float):
    """Return a function that maps values low .. high to pixels start .. end."""
    return lambda value: start + (value - low) / (high - low) * (end - start)


def _round_values(low: float, high: float) -> list[float]:
    """Return up to LINES + 1 multiples of 1, 2 or 5 times a power of ten in low .. high, which must differ."""
    rough = (high - low) / LINES
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(n * power for n in (1, 2, 5, 10) if n * power >= rough * (1 - 1e-9))
    return [n * step for n in range(math.ceil(low / step), math.floor(high / step) + 1)]


def runs_of(flags: np.ndarray) -> np.ndarray:
    """Return where runs of True begin and end in `flags`, bool [n]: int [k, 2]."""
    return np.flatnonzero(np.diff(np.r_[False, flags, False].astype(np.int8))).reshape(-1, 2)
