# SPDX-License-Identifier: GPL-3.0-or-later
"""The figures of docs/method that show a mesh. The meshes are those that `reference.refine` makes."""

import itertools
import math

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
from figure_shapes import WIDTH, SquareFrame, lines, tint


def diamond() -> str:
    """Draw the bisection of a triangle, a crack, and the diamond that has none."""
    size, top, parts = 160, 34, []
    places = [SquareFrame(44 + 204 * i, top, size) for i in range(4)]
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
    """Return a mesh that is fine along a ridge."""

    def wanted(at: Point, longest: float) -> bool:
        ridge = abs(at[1] - 0.30 - 0.35 * math.sin(2.4 * at[0]))
        return longest > finest + 0.9 * ridge + 0.2 * abs(at[0] - 0.55)

    roots = square(0, 0, 1)
    return refine(roots, depth, nested(roots, depth, wanted))


def inner(triangle: Triangle) -> Point:
    """Return the centroid of a triangle."""
    return sum(p[0] for p in triangle) / 3, sum(p[1] for p in triangle) / 3


def curve() -> str:
    """Draw the leaves in the order of the curve, and the curve cut into slices."""
    leaves, size, top = example(11, 0.06), 340, 44
    left, right = SquareFrame(36, top, size), SquareFrame(WIDTH - 36 - size, top, size)
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
    """Return each leaf's edge that the curve does not cross, and whether it is left of the curve."""
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
    """Draw the finished part of the mesh, a leaf that opens an edge and one that closes one."""
    leaves, size, top = example(9, 0.10), 330, 44
    third = sides(leaves)
    closes = [any(edge == other for other, _ in third[:i]) for i, (edge, _) in enumerate(third)]
    outer = {e for leaf in leaves for e in edges(leaf) if sum(e in edges(other) for other in leaves) == 1}

    def still_open(now: int) -> list[tuple[frozenset[Point], bool]]:
        """Return the edges of the leaves before `now` that a later leaf shares."""
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
        at = SquareFrame(x, top, size)
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


def border() -> str:
    """Draw a raster that does not fill its squares: padded, refined, and cut at its border."""
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
    parts, inside, outside = [f'<defs><clipPath id="border">{shape}</clipPath></defs>'], [], []
    roots = [root for i in range(across) for root in square(i * side, 0, side)]
    for leaf in refine(roots, 8, nested(roots, 8, wanted)):
        points = [at(*p) for p in leaf]
        if any(x > columns or y > rows for x, y in leaf):
            outside.append(path(points, LINE, 1, PAPER, 'stroke-dasharray="2 3"'))
        inside.append(path(points, TEAL, 1.1, tint(TEAL, 14)))
    parts += outside + ['<g clip-path="url(#border)">', *inside, "</g>"]
    for i in range(across):
        corners = [at(i * side, 0), at(i * side + side, 0), at(i * side + side, side), at(i * side, side)]
        parts.append(path([*corners, corners[0]], SOFT, 1.2, more='stroke-dasharray="6 4"'))
    parts.append(path([at(0, 0), at(columns, 0), at(columns, rows), at(0, rows), at(0, 0)], RED, 2.6))
    parts.append(text(x0, top - 22, "a raster of 27 x 12 samples, on two squares of 16 cells", look="bold"))
    x = at(across * side, 0)[0] + 28
    parts += lines(
        x, top + 22, ("Red: the raster's border.", "The mesh is cut there:", "one new vertex an edge."), "small"
    )
    parts += lines(
        x, top + 96, ("Beyond it nothing is", "stored, and no error", "counts: the mesh stays", "as coarse as it may.")
    )
    parts += lines(x, top + 188, ("The samples stay where", "the file has them."))
    return picture(WIDTH, at(0, 0)[1] + 26, "A padded raster, cut at its border", parts)
