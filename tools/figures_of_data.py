# SPDX-License-Identifier: GPL-3.0-or-later
"""The figures of docs/method that show bounds, errors, times and the data of a frame."""

import math

from adaptive_terrain.operators.text.svg import (
    GOLD,
    INK,
    LINE,
    PAPER,
    RED,
    SOFT,
    TEAL,
    WASH,
    Point,
    dot,
    path,
    picture,
    text,
)
from figure_shapes import WIDTH, arrow, lines, tint

# Processor time of one thread in a flight over rough ground, milliseconds: the walk with its tree, a pass of the
# classic update, most passes and time until nothing changes in the next frame, the same after a cut. The last number is
# libcbt's split pass and decoding at depth 27, see docs/method.md.
PASSES = {
    "50,000": (2.14, 9.1, 5, 35.0, 13, 112.0, 26.1),
    "500,000": (10.4, 93.8, 8, 572.0, 13, 1_231.0, 283.0),
    "1,000,000": (16.6, 279.0, 8, 1_890.0, 12, 2_915.0, 590.0),
}


def band() -> str:
    """Draw how the bounds of a box decide about everything in it, for a camera over a line of ground."""
    eye, height, ground, size = 1_800.0, 200.0, 7_100.0, 10_000.0  # metres; the path leads to the place `ground`
    pixel = 1 / 900  # radians
    errors = (30.0, 18.0, 10.0, 5.4, 3.9)  # of the diamonds on the path, metres
    parts, top, row = [], 96, 44
    left, right, low, high = 110, WIDTH - 200, math.log10(0.15), math.log10(45)

    def x(metres: float) -> float:
        return left + (math.log10(metres) - low) / (high - low) * (right - left)

    parts.append(text(28, 30, "one pixel at a box, in metres: from its nearest to its furthest point", look="bold"))
    for metres in (0.2, 0.5, 1, 2, 5, 10, 20):
        parts.append(path([(x(metres), top - 22), (x(metres), top + row * len(errors) - 14)], LINE, 1))
        parts.append(text(x(metres), top - 30, f"{metres:g} m", "middle", look="soft small"))
    known, start, width = (math.inf, -math.inf), 0.0, size
    for depth, error in enumerate(errors):
        y = top + row * depth
        near = max(start - eye, eye - start - width, 0.0)
        far = max(eye - start, start + width - eye)
        measured = known[0] > known[1] or known[0] < error <= known[1]
        if measured:
            known = math.hypot(near, height) * pixel, math.hypot(far, height) * pixel
        verdict = "splits" if error > known[0 if measured else 1] else "a leaf"
        look = f'fill="{TEAL}"' if measured else f'fill="{SOFT}" fill-opacity="0.3"'
        wide = x(known[1]) - x(known[0])
        parts.append(f'<rect x="{x(known[0]):.1f}" y="{y - 7}" width="{wide:.1f}" height="14" rx="7" {look}/>')
        parts.append(path([(x(error), y - 13), (x(error), y + 13)], RED, 3.5, more='stroke-linecap="round"'))
        parts.append(text(28, y + 5, f"depth {depth}", look="small"))
        parts.append(text(right + 20, y + 5, f"{verdict}: {'measured' if measured else 'known before'}", look="small"))
        width /= 2
        start += width * (ground >= start + width)
    y = top + row * len(errors) + 14
    parts.append(f'<rect x="28" y="{y - 10}" width="28" height="12" rx="6" fill="{TEAL}"/>')
    parts.append(text(64, y, "the band of a box that was measured", look="soft small"))
    parts.append(f'<rect x="322" y="{y - 10}" width="28" height="12" rx="6" fill="{SOFT}" fill-opacity="0.3"/>')
    parts.append(text(358, y, "it holds for all that lies inside", look="soft small"))
    parts.append(path([(600, y - 11), (600, y + 3)], RED, 3.5))
    parts.append(text(612, y, "the diamond's error, in metres", look="soft small"))
    return picture(WIDTH, int(y + 24), "Bands: what is certain inside a box", parts)


def error() -> str:
    """Draw the error of a whole triangle and the error at its split vertex alone."""
    top, base, count = 24, 250, 33
    heights = [0.42 + 0.16 * math.sin(i / 5.2) + 0.035 * math.sin(i * 1.9) for i in range(count)]
    heights[9] += 0.33
    left, right = 60, WIDTH - 240

    def at(i: float, h: float) -> Point:
        return left + i / (count - 1) * (right - left), base - h * 220

    surface = [at(i, h) for i, h in enumerate(heights)]
    ends = heights[0], heights[-1]
    chord = [at(0, ends[0]), at(count - 1, ends[1])]
    parts = [
        path([*surface, at(count - 1, 0), at(0, 0)], "none", 0, WASH),
        path(surface, INK, 1.8),
        path(chord, TEAL, 2.6),
    ]
    parts += [dot(p, INK, 2.2) for p in surface]

    def on_chord(i: int) -> float:
        return ends[0] + (ends[1] - ends[0]) * i / (count - 1)

    worst = max(range(count), key=lambda i: abs(heights[i] - on_chord(i)))
    for i, colour, words, dy in (
        (worst, RED, "the error", -8),
        ((count - 1) // 2, SOFT, "at the split vertex alone", 58),
    ):
        a, b = at(i, on_chord(i)), at(i, heights[i])
        parts += [path([a, b], colour, 3), dot(a, colour, 3.5), dot(b, colour, 3.5)]
        parts.append(text(b[0] + 10, b[1] + dy, words, look="bold small", colour=colour))
    a = at((count - 1) // 2, on_chord((count - 1) // 2))
    parts.append(path([(a[0] + 4, a[1] + 8), (a[0] + 22, a[1] + 42)], SOFT, 1))
    x = right + 30
    parts += lines(
        x,
        70,
        ("The largest distance between", "triangle and surface,", "over all that the triangle", "covers."),
        "small",
    )
    parts += lines(
        x,
        160,
        (
            "A spike of one sample is found",
            "at every depth.",
        ),
    )
    return picture(WIDTH, base + top, "The error of a triangle", parts)


def frame() -> str:
    """Draw a frame as data: its inputs, the result of each step, and what Blender receives."""
    parts, wide, tall = [], 188, 74

    def box(x: float, y: float, title: str, rows: tuple[str, ...], colour: str, filled: bool = False) -> None:
        fill = tint(colour, 14) if filled else PAPER
        parts.append(
            f'<rect x="{x}" y="{y}" width="{wide}" height="{tall}" rx="7" fill="{fill}" stroke="{colour}" '
            'stroke-width="1.6"/>'
        )
        parts.append(text(x + 14, y + 24, title, look="bold"))
        parts.extend(lines(x + 14, y + 44, rows))

    columns = [18 + 212 * i for i in range(4)]
    first, second, third = 30, 160, 290
    box(columns[0], first, "View", ("camera matrices, float64;", "resolution, clip range"), SOFT)
    box(columns[1], first, "Criterion", ("an error in pixels or", "metres; limits"), SOFT)
    box(columns[2], first, "Errors and ranges", ("what each triangle leaves", "out; boxes of heights"), GOLD)
    box(columns[3], first, "Samples", ("heights as in the file,", "mapped from disk"), GOLD)
    box(columns[0], second, "Refine", ("a walk along the curve;", "each diamond judged"), TEAL, True)
    box(columns[1], second, "Leaves", ("codes and corners, int32;", "marked in the tree"), SOFT)
    box(columns[2], second, "Weld", ("two stacks number the", "points and the edges"), TEAL, True)
    box(columns[3], second, "Displace", ("heights and normals,", "float64, then float32"), TEAL, True)
    box(columns[0], third, "Blender mesh", ("written into its own", "arrays, no conversion"), RED, True)
    box(columns[1], third, "Surface", ("positions, corners,", "edges, attributes"), SOFT)
    box(columns[2], third, "Cut", ("triangles that cross the", "rim, where there are any"), TEAL, True)
    down, half = tall, wide / 2
    for i in (0, 1):
        parts.append(arrow((columns[i] + half, first + down), (columns[0] + half + 40 * i, second)))
    parts.append(arrow((columns[2] + half, first + down), (columns[0] + wide - 12, second)))
    parts.append(arrow((columns[3] + half, first + down), (columns[3] + half, second)))
    for i in (0, 1, 2):
        parts.append(arrow((columns[i] + wide, second + down / 2), (columns[i + 1], second + down / 2)))
    parts.append(path([(columns[3] + half, second + down), (columns[3] + half, third + down / 2)], SOFT, 1.6))
    parts.append(arrow((columns[3] + half, third + down / 2), (columns[2] + wide, third + down / 2)))
    for i in (2, 1):
        parts.append(arrow((columns[i], third + down / 2), (columns[i - 1] + wide, third + down / 2)))
    x, y = columns[3] + 2, third + 54
    for dy, colour, words in ((0, GOLD, "the store"), (20, TEAL, "a step, in kernels")):
        parts.append(f'<rect x="{x + 108 - 74}" y="{y + dy - 11}" width="12" height="12" rx="3" fill="{colour}"/>')
        parts.append(text(x + 108 - 54, y + dy, words, look="soft small"))
    return picture(WIDTH, third + tall + 30, "A frame as data", parts)


def passes() -> str:
    """Draw the measured times of the walk and of the classic update on a logarithmic scale."""
    left, right, top, tall, low, high = 150, WIDTH - 40, 66, 118, 0.0, 4.0

    def x(ms: float) -> float:
        return left + (math.log10(ms) - low) / (high - low) * (right - left)

    parts = [text(28, 30, "milliseconds until the mesh of a frame is there", look="bold")]
    for decade in range(5):
        at = x(10.0**decade)
        parts.append(path([(at, top - 12), (at, top + tall * len(PASSES) - 30)], LINE, 1))
        parts.append(text(at, top - 18, f"{10**decade:,} ms", "middle", look="soft small"))
    for row, (leaves, (walk, one, flight, flight_ms, cut, cut_ms, other)) in enumerate(PASSES.items()):
        y = top + tall * row
        parts.append(text(28, y + 36, leaves, look="bold"))
        parts.append(text(28, y + 54, "leaves", look="soft small"))
        bars = (
            (walk, TEAL, f"the walk: one call, {walk:.3g} ms"),
            (one, GOLD, f"a pass of splits and merges: {one:.3g} ms"),
            (flight_ms, GOLD, f"the next frame of a flight, up to {flight} passes: {flight_ms:,.0f} ms"),
            (cut_ms, GOLD, f"after a cut, {cut} passes: {cut_ms:,.0f} ms"),
            (other, SOFT, f"libcbt, one split pass and decoding: {other:.3g} ms"),
        )
        for k, (ms, colour, words) in enumerate(bars):
            at = y + 18 * k
            parts.append(f'<rect x="{left}" y="{at}" width="{x(ms) - left:.1f}" height="12" rx="3" fill="{colour}"/>')
            if x(ms) < 0.5 * (left + right):
                parts.append(text(x(ms) + 8, at + 11, words, look="soft small"))
            else:
                parts.append(text(x(ms) - 8, at + 11, words, "end", look="small", colour=PAPER))
    return picture(WIDTH, top + tall * len(PASSES) - 8, "The walk and the classic update of the tree: times", parts)
