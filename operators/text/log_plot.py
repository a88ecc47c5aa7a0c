# SPDX-License-Identifier: GPL-3.0-or-later
"""Curves over two logarithmic axes, as a self-contained SVG."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from .svg import LINE, dot, path, picture, text

WIDTH, HEIGHT = 860, 520  # of the drawing, pixels
LEFT, RIGHT, TOP, BOTTOM = 64, 226, 32, 48  # margins of the axes, pixels; the legend is in the right one
NEGLIGIBLE = 1e-9  # points below this fraction of the largest value are left out
DOT, RING, CROSS = "dot", "ring", "cross"


@dataclass(frozen=True)
class Curve:
    """A curve of a plot.

    Attributes:
        points: (x, y) in the order of the line, without those at or near 0, which have no position on the axes.
        dash: SVG dash pattern of the line, "" for a solid one.
        joined: whether to draw a line.
        marker: DOT, RING or CROSS.
        spans: (min, max) of the measured x at each point.
    """

    label: str
    colour: str
    points: Sequence[tuple[float, float]]
    dash: str = ""
    joined: bool = True
    marker: str = DOT
    spans: Sequence[tuple[float, float]] = ()


def draw(curves: Sequence[Curve], x_label: str, y_label: str) -> str:
    """Return the curves as an SVG with a legend; without curves if none has a point.

    x_label, y_label: names of the axes with their units.
    """
    curves = _drawable(curves)
    label = f"{y_label} against {x_label}, both logarithmic"
    if not curves:
        return picture(WIDTH, HEIGHT, label, [])
    xs = [x for curve in curves for x, _ in (*curve.points, *curve.spans)]  # of points, and minima of spans
    xs += [max_x for curve in curves for _, max_x in curve.spans]
    ys = [y for curve in curves for _, y in curve.points]
    x_axis, y_axis = _Axis(xs, LEFT, WIDTH - RIGHT), _Axis(ys, HEIGHT - BOTTOM, TOP)
    parts = []
    for decade in x_axis.decades():
        x = x_axis(10.0**decade)
        parts.append(path([(x, TOP), (x, HEIGHT - BOTTOM)], LINE, 1))
        parts.append(text(x, HEIGHT - BOTTOM + 20, _decade_label(decade), "middle"))
    for decade in y_axis.decades():
        y = y_axis(10.0**decade)
        parts.append(path([(LEFT, y), (WIDTH - RIGHT, y)], LINE, 1))
        parts.append(text(LEFT - 8, y + 4, _decade_label(decade), "end"))
    parts.append(text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 8, x_label, "middle"))
    parts.append(text(LEFT - 8, TOP - 14, y_label, "end" if len(y_label) < 8 else "start"))
    for i, curve in enumerate(curves):
        parts += _draw_curve(curve, x_axis, y_axis, TOP + 16 + 24 * i)
    return picture(WIDTH, HEIGHT, label, parts)


def _draw_curve(curve: Curve, x_axis: "_Axis", y_axis: "_Axis", legend_y: float) -> list[str]:
    """Return the SVG parts of a curve and of its line in the legend at height `legend_y`.

    x_axis, y_axis: map values to pixels.
    """
    places = [(x_axis(x), y_axis(y)) for x, y in curve.points]
    dash = f'stroke-dasharray="{curve.dash}"' if curve.dash else ""
    left = WIDTH - RIGHT
    parts = []
    for (min_x, max_x), (_, y) in zip(curve.spans, places, strict=False):
        ends = x_axis(min_x), x_axis(max_x)  # of the x measured at this point
        parts.append(path([(x, y) for x in ends], curve.colour, 7, more='stroke-opacity="0.3"'))
    if curve.joined:
        parts.append(path(places, curve.colour, 2, more=dash))
        parts.append(path([(left + 16, legend_y), (left + 44, legend_y)], curve.colour, 2, more=dash))
    else:
        parts.append(_draw_marker(left + 30, legend_y, curve))
    parts += [_draw_marker(*place, curve) for place in places]
    return [*parts, text(left + 52, legend_y + 4, curve.label)]


def _drawable(curves: Sequence[Curve]) -> list[Curve]:
    """Return the curves without points that are not positive, infinite or negligible, and without empty curves.

    A point is negligible if its x or its y is below NEGLIGIBLE of the largest of all curves.
    """
    valid = [p for curve in curves for p in curve.points if min(p) > 0 and max(p) < math.inf]
    limits = [NEGLIGIBLE * max(values) for values in zip(*valid, strict=True)]  # of x and of y
    found = []
    for curve in curves:
        flags = [p in valid and p[0] > limits[0] and p[1] > limits[1] for p in curve.points]
        points, spans = (
            [value for value, keep in zip(values, flags, strict=False) if keep]  # spans may be empty
            for values in (curve.points, curve.spans)
        )
        if points:
            found.append(replace(curve, points=points, spans=spans))
    return found


class _Axis:
    """Map values to pixels by their logarithm, over whole decades."""

    def __init__(self, values: Sequence[float], start: float, end: float):
        self.low, self.high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
        self.high = max(self.high, self.low + 1)
        self.start, self.end = start, end

    def __call__(self, value: float) -> float:
        return self.start + (math.log10(value) - self.low) / (self.high - self.low) * (self.end - self.start)

    def decades(self) -> range:
        """Return the exponents of the powers of ten that the axis spans, for its grid lines."""
        return range(self.low, self.high + 1)


def _decade_label(decade: int) -> str:
    """Return ten to the power of `decade` as the label of a grid line."""
    return f"{10**decade:,}" if decade >= 0 else f"{10.0**decade:g}"


def _draw_marker(x: float, y: float, curve: Curve) -> str:
    """Return the SVG of a curve's marker at a point in pixels."""
    if curve.marker == CROSS:
        look = f'stroke="{curve.colour}" stroke-width="2"'
        return f'<path d="M{x - 9:.1f} {y:.1f}h18M{x:.1f} {y - 9:.1f}v18" {look}/>'
    if curve.marker == RING:
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="8" fill="none" stroke="{curve.colour}"/>'
    return dot((x, y), curve.colour, 3.5)
