# SPDX-License-Identifier: GPL-3.0-or-later
"""The plot of time against triangles, both logarithmic, as an SVG."""

from ..operators.text.log_plot import Curve, draw
from .measure import Row

COLOURS = {"refine": "#2f6f73", "surface": "#7a9a1f", "ingest": "#c08a1e", "frame": "#b4431e"}
GREY = "#888888"


def write_plot(rows: list[Row]) -> str:
    """Our times at each size of the `scale_` rows, the baselines' wherever they were measured."""
    curves = []
    for row in rows:
        name = row.name.removeprefix("scale_")
        if name != row.name:
            points = [(int(size.removesuffix("_ms")), ms) for size, ms in row.figures.items()]
            curves.append(Curve(f"{name}, slope {row.ratio:.2f}", COLOURS[name], points))
    for baseline, dash in (("roam_rebuild", "7 4"), ("plain_ingest", "2 4")):
        # Rows of one size met the baseline at different moments; the last one stands for them.
        points = {row.size: row.baseline_ms for row in rows if row.baseline == baseline and row.baseline_ms}
        if len(points) > 1:
            curves.append(Curve(baseline, GREY, sorted(points.items()), dash))
    return draw(curves, "triangles", "ms")
