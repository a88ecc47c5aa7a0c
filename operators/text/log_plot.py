# SPDX-License-Identifier: GPL-3.0-or-later
"""Curves over two logarithmic axes, as an SVG that needs nothing else."""

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

WIDTH, HEIGHT = 860, 520
LEFT, RIGHT, TOP, BOTTOM = 64, 226, 32, 48
INK, GRID = "#333333", "#dddddd"
# What is so many times less than the largest value would make an axis that shows nothing else.
NOTHING = 1e-9
DOT, RING, CROSS = "dot", "ring", "cross"


@dataclass(frozen=True)
class Curve:
    """`points`: (x, y) in the order in which they are joined; left out is what is not above 0 and so has no place, and
    what is so far below the rest that it is as good as 0. `dash`: an SVG pattern of the line, "" for a whole one.
    `joined`: whether there is a line. `marker`: DOT, RING or CROSS."""

    label: str
    colour: str
    points: Sequence[tuple[float, float]]
    dash: str = ""
    joined: bool = True
    marker: str = DOT


def draw(curves: Sequence[Curve], x_label: str, y_label: str) -> str:
    """The plot; an empty picture where no curve has a point."""
    curves = _placed(curves)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}"'
    if not curves:
        return f"{head}/>\n"
    xs, ys = zip(*(point for curve in curves for point in curve.points), strict=True)
    x_axis, y_axis = _Axis(xs, LEFT, WIDTH - RIGHT), _Axis(ys, HEIGHT - BOTTOM, TOP)
    parts = [
        f'{head} font-family="system-ui, sans-serif" font-size="13">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>',
    ]
    for decade in x_axis.decades():
        x = x_axis(10.0**decade)
        parts.append(_line(x, TOP, x, HEIGHT - BOTTOM))
        parts.append(_text(x, HEIGHT - BOTTOM + 20, _power(decade), "middle"))
    for decade in y_axis.decades():
        y = y_axis(10.0**decade)
        parts.append(_line(LEFT, y, WIDTH - RIGHT, y))
        parts.append(_text(LEFT - 8, y + 4, _power(decade), "end"))
    parts.append(_text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 8, x_label, "middle"))
    parts.append(_text(LEFT - 8, TOP - 14, y_label, "end" if len(y_label) < 8 else "start"))
    for i, curve in enumerate(curves):
        places = [(x_axis(x), y_axis(y)) for x, y in curve.points]
        dash = f' stroke-dasharray="{curve.dash}"' if curve.dash else ""
        stroke = f'fill="none" stroke="{curve.colour}" stroke-width="2"{dash}'
        y = TOP + 16 + 24 * i
        if curve.joined:
            parts.append(f'<polyline points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in places)}" {stroke}/>')
            parts.append(f'<path d="M{WIDTH - RIGHT + 16} {y}h28" {stroke}/>')
        else:
            parts.append(_marker(WIDTH - RIGHT + 30, y, curve))
        parts += [_marker(*place, curve) for place in places]
        parts.append(_text(WIDTH - RIGHT + 52, y + 4, curve.label, "start"))
    return "\n".join([*parts, "</svg>"]) + "\n"


def _placed(curves: Sequence[Curve]) -> list[Curve]:
    """The curves with the points that have a place, without those that then have none."""
    places = [p for curve in curves for p in curve.points if min(p) > 0 and max(p) < math.inf]
    least = [NOTHING * max(values) for values in zip(*places, strict=True)]
    kept = [[p for p in curve.points if p in places and p[0] > least[0] and p[1] > least[1]] for curve in curves]
    return [replace(curve, points=points) for curve, points in zip(curves, kept, strict=True) if points]


class _Axis:
    """Values to pixels by their logarithm, whole decades from end to end."""

    def __init__(self, values: Sequence[float], start: float, end: float):
        self.low, self.high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
        self.high = max(self.high, self.low + 1)
        self.start, self.end = start, end

    def __call__(self, value: float) -> float:
        return self.start + (math.log10(value) - self.low) / (self.high - self.low) * (self.end - self.start)

    def decades(self) -> range:
        return range(self.low, self.high + 1)


def _power(decade: int) -> str:
    return f"{10**decade:,}" if decade >= 0 else f"{10.0**decade:g}"


def _marker(x: float, y: float, curve: Curve) -> str:
    if curve.marker == CROSS:
        look = f'stroke="{curve.colour}" stroke-width="2"'
        return f'<path d="M{x - 9:.1f} {y:.1f}h18M{x:.1f} {y - 9:.1f}v18" {look}/>'
    look = f'r="8" fill="none" stroke="{curve.colour}"' if curve.marker == RING else f'r="3.5" fill="{curve.colour}"'
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" {look}/>'


def _line(x1: float, y1: float, x2: float, y2: float) -> str:
    return f'<path d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" stroke="{GRID}"/>'


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{INK}">{html.escape(text)}</text>'
