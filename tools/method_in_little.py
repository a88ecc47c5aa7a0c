# SPDX-License-Identifier: GPL-3.0-or-later
"""The method in little, for figures: triangles of the plane, halved at their longest edges."""

import math
from collections.abc import Callable, Sequence

from adaptive_terrain.operators.text.svg import Point

# (left, apex, right): the longest edge runs from left to right.
Triangle = tuple[Point, Point, Point]


def middle(a: Point, b: Point) -> Point:
    return (a[0] + b[0]) / 2, (a[1] + b[1]) / 2


def children(triangle: Triangle) -> tuple[Triangle, Triangle]:
    """Its two halves, in the order of the curve."""
    left, apex, right = triangle
    split = middle(left, right)
    return (left, split, apex), (apex, split, right)


def square(x: float, y: float, side: float) -> tuple[Triangle, Triangle]:
    """The two roots of a square with its lower left corner at (x, y)."""
    upper_left, lower_right = (x, y + side), (x + side, y)
    return (upper_left, (x, y), lower_right), (lower_right, (x + side, y + side), upper_left)


def refined(roots: Sequence[Triangle], depth: int, wanted: Callable[[Point, float], bool]) -> list[Triangle]:
    """The leaves below some roots, along the curve. `wanted`: whether a split vertex is asked for, by its place and the
    longest edge that it halves. What one of those needs is split too, which a nested criterion says by itself."""
    parents: dict[Point, set[Point]] = {}

    def gather(triangle: Triangle, left: int) -> None:
        if left:
            parents.setdefault(middle(triangle[0], triangle[2]), set()).add(triangle[1])
            for child in children(triangle):
                gather(child, left - 1)

    split: set[Point] = set()

    def need(vertex: Point) -> None:
        if vertex in parents and vertex not in split:
            split.add(vertex)
            for parent in parents[vertex]:
                need(parent)

    def ask(triangle: Triangle, left: int) -> None:
        if left:
            vertex = middle(triangle[0], triangle[2])
            if wanted(vertex, math.dist(triangle[0], triangle[2])):
                need(vertex)
            for child in children(triangle):
                ask(child, left - 1)

    def leaves(triangle: Triangle) -> list[Triangle]:
        if middle(triangle[0], triangle[2]) not in split:
            return [triangle]
        first, second = children(triangle)
        return leaves(first) + leaves(second)

    for visit in (gather, ask):
        for root in roots:
            visit(root, depth)
    return [leaf for root in roots for leaf in leaves(root)]


def edges(triangle: Triangle) -> list[frozenset[Point]]:
    left, apex, right = triangle
    return [frozenset(pair) for pair in ((left, apex), (apex, right), (right, left))]
