# SPDX-License-Identifier: GPL-3.0-or-later
"""The chart of docs/performance.md: the steps of a frame."""

from ...operators.text.svg import GOLD, GREEN, LINE, PURPLE, RED, SOFT, TEAL, box, path, picture, text
from ..rig.measure import BenchmarkRow

# Steps of a frame in their order; the last is the remainder.
STEPS = {
    "refine": ("refine", TEAL),
    "weld": ("weld", GREEN),
    "displace": ("displace", GOLD),
    "mesh": ("mesh written", RED),
    "blender": ("Blender", PURPLE),
    "rest": ("the rest", SOFT),
}


def write_bars(rows: list[BenchmarkRow]) -> str:
    """Return an SVG with a bar for each size of the row `frame`, divided into its steps."""
    frames = [row for row in rows if row.name == "frame" and row.ms]
    width, left, right, top, pitch = 860, 96, 84, 56, 46
    scale = (width - left - right) / max((row.ms for row in frames), default=1.0)
    parts, x = [], float(left)
    for name, colour in STEPS.values():
        parts += [box(x, 18, 12, 12, colour), text(x + 18, 29, name, look="soft small")]
        x += 40 + 7.2 * len(name)
    for i, row in enumerate(frames):
        y, x = top + pitch * i, float(left)
        parts.append(text(left - 10, y + 20, f"{row.size:,}", "end"))
        steps = {step: row.steps.get(step, 0.0) for step in STEPS if step != "rest"}
        for step, ms in (steps | {"rest": max(0.0, row.ms - sum(steps.values()))}).items():
            parts.append(box(x, y, ms * scale, 30, STEPS[step][1]))
            x += ms * scale
        parts.append(text(x + 8, y + 20, f"{row.ms:.3g} ms"))
    bottom = top + pitch * len(frames)
    parts.append(path([(left, top - 8), (left, bottom)], LINE, 1))
    parts.append(
        text(
            left,
            bottom + 20,
            "triangles, and the milliseconds from a moved camera to the evaluated mesh",
            look="soft small",
        )
    )
    return picture(width, bottom + 36, "Milliseconds of each step of a frame", parts)
