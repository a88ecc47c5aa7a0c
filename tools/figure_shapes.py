# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes that several figures of docs/method draw."""

import math
from collections.abc import Iterable

from adaptive_terrain.operators.text.svg import PAPER, SOFT, Point, path, text

WIDTH = 860


def tint(colour: str, percent: int) -> str:
    """Mix a colour with the paper."""
    return f"color-mix(in srgb, {colour} {percent}%, {PAPER})"


def lines(x: float, y: float, rows: Iterable[str], look: str = "soft small", anchor: str = "start") -> list[str]:
    """Set rows of text below each other."""
    return [text(x, y + 18 * i, row, anchor, look) for i, row in enumerate(rows)]


def arrow(start: Point, end: Point) -> str:
    """Draw a straight arrow."""
    length = math.dist(start, end)
    x, y = (end[0] - start[0]) / length, (end[1] - start[1]) / length
    back = end[0] - 9 * x, end[1] - 9 * y
    head = [(back[0] - 4.5 * y, back[1] + 4.5 * x), end, (back[0] + 4.5 * y, back[1] - 4.5 * x)]
    return path([start, back], SOFT, 1.6) + path(head, SOFT, 0, SOFT)


class SquareFrame:
    """A square of `side` units on the page: (x, y) is its top left corner in pixels, `size` its width in pixels."""

    def __init__(self, x: float, y: float, size: float, side: float = 1.0):
        self.x, self.y, self.scale, self.size = x, y, size / side, size

    def __call__(self, *points: Point) -> list[Point]:
        """Return points of the square in pixels."""
        return [(self.x + px * self.scale, self.y + self.size - py * self.scale) for px, py in points]
