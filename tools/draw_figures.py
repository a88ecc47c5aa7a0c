# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw every figure of docs/method into docs/images: `make figures`.

The meshes are no sketches: `refined` is the method in little, and what is drawn is what it makes.
"""

import itertools
import math
from collections.abc import Iterable
from pathlib import Path

from adaptive_terrain.cbt_terrain.refine.reference import Triangle, children, edges, middle, nested, refine, square
from adaptive_terrain.operators.text.svg import (
    BLUE,
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

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
WIDTH = 860


def tint(colour: str, percent: int) -> str:
    return f"color-mix(in srgb, {colour} {percent}%, {PAPER})"


def lines(x: float, y: float, rows: Iterable[str], look: str = "soft small", anchor: str = "start") -> list[str]:
    return [text(x, y + 18 * i, row, anchor, look) for i, row in enumerate(rows)]


def arrow(start: Point, end: Point, stroke: str = SOFT, width: float = 1.6) -> str:
    length = math.dist(start, end)
    x, y = (end[0] - start[0]) / length, (end[1] - start[1]) / length
    back = end[0] - 9 * x, end[1] - 9 * y
    head = [(back[0] - 4.5 * y, back[1] + 4.5 * x), end, (back[0] + 4.5 * y, back[1] - 4.5 * x)]
    return path([start, back], stroke, width) + path(head, stroke, 0, stroke)


class Frame:
    """Places of a square of `side` units as pixels: (x, y) of its top left corner on the page, and its size there."""

    def __init__(self, x: float, y: float, size: float, side: float = 1.0):
        self.x, self.y, self.scale, self.size = x, y, size / side, size

    def __call__(self, *points: Point) -> list[Point]:
        return [(self.x + px * self.scale, self.y + self.size - py * self.scale) for px, py in points]


def diamond() -> str:
    """Bisection, a crack, and the diamond that has none."""
    size, top, parts = 160, 34, []
    places = [Frame(44 + 204 * i, top, size) for i in range(4)]
    first_root, second_root = square(0, 0, 1)
    centre = (0.5, 0.5)
    titles = ("two roots", "bisection", "one alone: a crack", "both: a diamond")
    words = (
        ("A square, cut in two.", "Ids 2 and 3."),
        ("The longest edge is halved,", "joined to the corner."),
        ("The new vertex lies inside", "the neighbour's edge."),
        ("Both at the edge are split:", "one new vertex, no crack."),
    )
    for at, title, rows in zip(places, titles, words, strict=True):
        parts.append(text(at.x + size / 2, top - 14, title, "middle", "bold"))
        parts += lines(at.x + size / 2, top + size + 26, rows, anchor="middle")
    first, second, third, fourth = places
    for at, split_first, split_second in ((first, 0, 0), (second, 1, 0), (third, 0, 1), (fourth, 1, 1)):
        for root, split in ((first_root, split_first), (second_root, split_second)):
            if at is second and root is second_root:
                continue
            shade = WASH if at is not fourth else tint(TEAL, 16)
            for triangle in children(root) if split else [root]:
                parts.append(path(at(*triangle), INK, 1.6, shade))
    for at, ids in ((first, (("2", 0.3, 0.3), ("3", 0.7, 0.7))), (second, (("4", 0.2, 0.5), ("5", 0.5, 0.2)))):
        for name, x, y in ids:
            [(px, py)] = at((x, y))
            parts.append(text(px, py + 5, name, "middle", "bold", TEAL))
    for at, colour in ((second, TEAL), (third, RED), (fourth, TEAL)):
        parts.append(dot(at(centre)[0], colour, 6))
    [(x, y)] = third(centre)
    parts.append(f'<circle cx="{x}" cy="{y}" r="14" fill="none" stroke="{RED}" stroke-width="1.6"/>')
    return picture(WIDTH, top + size + 66, "Longest-edge bisection and the diamond", parts)


def example(depth: int, finest: float) -> list[Triangle]:
    """A mesh that is fine along a ridge, as the figures of the curve and of the strip show it."""

    def wanted(at: Point, longest: float) -> bool:
        ridge = abs(at[1] - 0.30 - 0.35 * math.sin(2.4 * at[0]))
        return longest > finest + 0.9 * ridge + 0.2 * abs(at[0] - 0.55)

    roots = square(0, 0, 1)
    return refine(roots, depth, nested(roots, depth, wanted))


def inner(triangle: Triangle) -> Point:
    return sum(p[0] for p in triangle) / 3, sum(p[1] for p in triangle) / 3


def curve() -> str:
    """The leaves in the order of the curve, and its cut into slices."""
    leaves, size, top = example(11, 0.06), 340, 44
    left, right = Frame(36, top, size), Frame(WIDTH - 36 - size, top, size)
    cuts = [0, len(leaves) // 3, 2 * len(leaves) // 3, len(leaves)]
    parts = [
        text(left.x, top - 16, f"{len(leaves)} leaves, one curve", look="bold"),
        text(right.x, top - 16, "three slices, one for each thread", look="bold"),
    ]
    for leaf in leaves:
        parts.append(path(left(*leaf), LINE, 1.2, WASH))
    parts.append(path(left(leaves[0][0], *(inner(leaf) for leaf in leaves)), TEAL, 2.2))
    parts.append(dot(left(leaves[0][0])[0], TEAL, 5))
    for i, colour in enumerate((TEAL, BLUE, GOLD)):
        fill = tint(colour, 26)
        for leaf in leaves[cuts[i] : cuts[i + 1]]:
            parts.append(path(right(*leaf), LINE, 1.2, fill))
        parts.append(path(right(*(inner(leaf) for leaf in leaves[cuts[i] : cuts[i + 1]])), colour, 2.2))
    words = ("Neighbours along the curve share an edge.", "Fine or coarse, it passes each leaf once.")
    parts += lines(left.x, top + size + 26, words)
    parts += lines(
        right.x, top + size + 26, ("Cut anywhere: each thread numbers its own part,", "and the bytes are the same.")
    )
    return picture(WIDTH, top + size + 64, "The Sierpinski curve through an adaptive mesh", parts)


def sides(leaves: list[Triangle]) -> list[tuple[frozenset[Point], bool]]:
    """Of each leaf the edge that the curve does not cross, and whether it lies left of the curve."""
    shared = [set(edges(a)) & set(edges(b)) for a, b in itertools.pairwise(leaves)]
    found = []
    for i, leaf in enumerate(leaves):
        crossed = set().union(*shared[max(i - 1, 0) : i + 1])
        [third] = [edge for edge in edges(leaf) if edge not in crossed][:1]
        enter = leaf[0] if i == 0 else middle(*next(iter(shared[i - 1])))
        leave = leaf[2] if i == len(leaves) - 1 else middle(*next(iter(shared[i])))
        at = middle(*third)
        turn = (leave[0] - enter[0]) * (at[1] - enter[1]) - (leave[1] - enter[1]) * (at[0] - enter[0])
        found.append((third, turn > 0))
    return found


def strip() -> str:
    """The finished part of the mesh with its two borders: a leaf that opens an edge, one that closes one."""
    leaves, size, top = example(9, 0.10), 330, 44
    third = sides(leaves)
    closes = [any(edge == other for other, _ in third[:i]) for i, (edge, _) in enumerate(third)]
    outer = {e for leaf in leaves for e in edges(leaf) if sum(e in edges(other) for other in leaves) == 1}

    def still_open(now: int) -> list[tuple[frozenset[Point], bool]]:
        """Of the edges that leaves before `now` left aside, those that a later one shares."""
        ahead = set().union(*map(edges, leaves[now:]))
        return [(edge, is_left) for edge, is_left in third[:now] if edge in ahead]

    def shows_both(now: int) -> int:
        on_left = sum(is_left for _, is_left in still_open(now))
        return min(on_left, len(still_open(now)) - on_left)

    inside = [i for i, (edge, _) in enumerate(third) if edge not in outer]
    opening, closing = (max((i for i in inside if closes[i] == kind), key=shows_both) for kind in (False, True))
    parts = []
    cases = ((opening, 36, "this leaf opens an edge: push"), (closing, WIDTH - 36 - size, "this leaf closes one: pop"))
    for now, x, title in cases:
        at = Frame(x, top, size)
        parts.append(text(x, top - 16, title, look="bold"))
        for i, leaf in enumerate(leaves):
            fill = tint(TEAL, 20) if i < now else PAPER
            fill = tint(RED, 45) if i == now else fill
            parts.append(path(at(*leaf), LINE, 1.1, fill))
        for edge, is_left in still_open(now):
            parts.append(path(at(*edge), BLUE if is_left else GOLD, 4, more='stroke-linecap="round"'))
        edge, _ = third[now]
        dash = "" if closes[now] else 'stroke-dasharray="3 6"'
        more = f'{dash} stroke-linecap="round"'
        parts.append(path(at(*edge), RED, 4, more=more))
        parts.append(path(at(leaves[0][0], *(inner(leaf) for leaf in leaves[: now + 1])), SOFT, 1.1))
        [new] = [p for p in leaves[now] if p not in set().union(*edges(leaves[now - 1]))]
        if not any(new in leaf for leaf in leaves[:now]):
            parts.append(dot(at(new)[0], RED, 6))
    y = top + size + 28
    for x, colour, words in ((36, BLUE, "open edges on the left"), (226, GOLD, "open edges on the right")):
        parts.append(path([(x, y - 5), (x + 22, y - 5)], colour, 4))
        parts.append(text(x + 30, y, words, look="soft small"))
    parts.append(
        text(
            36,
            y + 22,
            "Each side is a stack. A leaf either pushes one edge and its new vertex, or takes the edge on top.",
            look="soft small",
        )
    )
    return picture(WIDTH, y + 40, "Welding along the curve: two stacks of open edges", parts)


def band() -> str:
    """What bounds on a box decide about all that lies inside of it; computed for a camera over a line of ground."""
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
    """The error over all that a triangle covers, beside the error at its split vertex alone."""
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


def rim() -> str:
    """A raster that does not fit its squares: padded, refined, and cut at its rim."""
    columns, rows, side = 26, 11, 16
    unit, top, x0 = 16, 54, 40
    across = -(-columns // side)

    def at(x: float, y: float) -> Point:
        return x0 + x * unit, top + (side - y) * unit

    def wanted(p: Point, longest: float) -> bool:
        inside = p[0] <= columns and p[1] <= rows
        return inside and longest > 1.3 + 0.8 * abs(p[1] - 3.2 - 2.4 * math.sin(p[0] / 4.5))

    left, high = at(0, rows)
    shape = f'<rect x="{left}" y="{high}" width="{columns * unit}" height="{rows * unit}"/>'
    parts, inside, outside = [f'<defs><clipPath id="rim">{shape}</clipPath></defs>'], [], []
    roots = [root for i in range(across) for root in square(i * side, 0, side)]
    for leaf in refine(roots, 8, nested(roots, 8, wanted)):
        points = [at(*p) for p in leaf]
        if any(x > columns or y > rows for x, y in leaf):
            outside.append(path(points, LINE, 1, PAPER, 'stroke-dasharray="2 3"'))
        inside.append(path(points, TEAL, 1.1, tint(TEAL, 14)))
    parts += outside + ['<g clip-path="url(#rim)">', *inside, "</g>"]
    for i in range(across):
        corners = [at(i * side, 0), at(i * side + side, 0), at(i * side + side, side), at(i * side, side)]
        parts.append(path([*corners, corners[0]], SOFT, 1.2, more='stroke-dasharray="6 4"'))
    parts.append(path([at(0, 0), at(columns, 0), at(columns, rows), at(0, rows), at(0, 0)], RED, 2.6))
    parts.append(text(x0, top - 22, "a raster of 27 x 12 samples, on two squares of 16 cells", look="bold"))
    x = at(across * side, 0)[0] + 28
    parts += lines(
        x, top + 22, ("Red: the raster's rim.", "The mesh is cut there:", "one new vertex an edge."), "small"
    )
    parts += lines(
        x, top + 96, ("Beyond it nothing is", "stored, and no error", "counts: the mesh stays", "as coarse as it may.")
    )
    parts += lines(x, top + 188, ("The samples stay where", "the file has them."))
    return picture(WIDTH, at(0, 0)[1] + 26, "A padded raster, cut at its rim", parts)


def frame() -> str:
    """A frame as data: what goes in, what each step makes of it, what Blender gets."""
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


# Processor time of one thread in a flight over rough ground, milliseconds: the walk with its tree, a pass of the
# classic update, most passes and time until nothing changes in the next frame, the same after a cut. The last number is
# libcbt's split pass and decoding at depth 27, see docs/method.md.
PASSES = {
    "50,000": (3.07, 15.5, 4, 60.6, 12, 174.0, 26.1),
    "500,000": (15.6, 149.0, 7, 1_042.0, 13, 1_863.0, 283.0),
    "1,000,000": (19.2, 380.0, 8, 2_592.0, 12, 4_173.0, 590.0),
}


def passes() -> str:
    """The walk beside the classic update: measured times on a scale of decades."""
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


FIGURES = {draw.__name__: draw for draw in (frame, diamond, curve, strip, band, error, rim, passes)}


def main() -> None:
    for name, draw in FIGURES.items():
        (IMAGES / f"method_{name}.svg").write_text(draw(), encoding="utf-8")


if __name__ == "__main__":
    main()
