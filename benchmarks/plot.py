# SPDX-License-Identifier: GPL-3.0-or-later
"""The plot of time against triangles, both logarithmic, as an SVG."""

import math

from .measure import Row

WIDTH, HEIGHT = 860, 520
LEFT, RIGHT, TOP, BOTTOM = 64, 226, 32, 48
COLOURS = {"refine": "#2f6f73", "surface": "#7a9a1f", "ingest": "#c08a1e", "frame": "#b4431e"}
GREY = "#888888"


def write_plot(rows: list[Row]) -> str:
    """Our times at each size of the `scale_` rows, the baselines' wherever they were measured."""
    curves = []
    for row in rows:
        name = row.name.removeprefix("scale_")
        if name != row.name:
            points = {int(size.removesuffix("_ms")): ms for size, ms in row.figures.items()}
            curves.append((f"{name}, slope {row.ratio:.2f}", COLOURS[name], "", points))
    for baseline, dash in (("roam_rebuild", "7 4"), ("plain_ingest", "2 4")):
        # Rows of one size met the baseline at different moments; the last one stands for them.
        points = {row.size: row.baseline_ms for row in rows if row.baseline == baseline and row.baseline_ms}
        if len(points) > 1:
            curves.append((baseline, GREY, dash, dict(sorted(points.items()))))
    if not curves:
        return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}"/>\n'
    return _draw(curves)


def _draw(curves: list[tuple[str, str, str, dict[int, float]]]) -> str:
    sizes = [size for *_, points in curves for size in points]
    times = [ms for *_, points in curves for ms in points.values()]
    x_axis, y_axis = _Axis(sizes, LEFT, WIDTH - RIGHT), _Axis(times, HEIGHT - BOTTOM, TOP)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="system-ui, sans-serif" '
        'font-size="13">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>',
    ]
    for decade in x_axis.decades():
        x = x_axis(10.0**decade)
        parts.append(_line(x, TOP, x, HEIGHT - BOTTOM, "#dddddd"))
        parts.append(_text(x, HEIGHT - BOTTOM + 20, f"{10**decade:,}", "middle"))
    for decade in y_axis.decades():
        y = y_axis(10.0**decade)
        parts.append(_line(LEFT, y, WIDTH - RIGHT, y, "#dddddd"))
        parts.append(_text(LEFT - 8, y + 4, f"{10.0**decade:,g}", "end"))
    parts.append(_text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 8, "triangles", "middle"))
    parts.append(_text(LEFT - 8, TOP - 14, "ms", "end"))
    for i, (label, colour, dash, points) in enumerate(curves):
        places = [(x_axis(size), y_axis(ms)) for size, ms in points.items()]
        stroke = f'fill="none" stroke="{colour}" stroke-width="2"' + (f' stroke-dasharray="{dash}"' if dash else "")
        parts.append(f'<polyline points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in places)}" {stroke}/>')
        parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{colour}"/>' for x, y in places]
        y = TOP + 16 + 24 * i
        parts.append(f'<path d="M{WIDTH - RIGHT + 16} {y}h28" {stroke}/>')
        parts.append(_text(WIDTH - RIGHT + 52, y + 4, label, "start"))
    return "\n".join([*parts, "</svg>"]) + "\n"


class _Axis:
    """Values to pixels by their logarithm, whole decades from end to end."""

    def __init__(self, values: list[float], start: float, end: float):
        self.low, self.high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
        self.high = max(self.high, self.low + 1)
        self.start, self.end = start, end

    def __call__(self, value: float) -> float:
        return self.start + (math.log10(value) - self.low) / (self.high - self.low) * (self.end - self.start)

    def decades(self) -> range:
        return range(self.low, self.high + 1)


def _line(x1: float, y1: float, x2: float, y2: float, colour: str) -> str:
    return f'<path d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" stroke="{colour}"/>'


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="#333333">{text}</text>'
