# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole method in few lines: read this first.

A right triangle is split at the middle of its longest edge. The triangle behind that edge has the same longest edge, so
both are split at this *split vertex* or neither is; one alone would leave a crack. The two form a *diamond*, and a
*criterion* decides for each diamond whether it is too coarse.

A criterion is *nested* if a split diamond always has split parents: the diamonds at the apexes of its two triangles.
Then one walk from the roots that looks at each triangle once gives a mesh without cracks, in the order of the
Sierpinski curve, and the mesh depends on nothing but the criterion. `nested` makes any criterion nested; the product's
criteria are nested by construction (docs/method/pixels.md).

kernels/refine/plain.py is `refine` as a kernel. walk.py produces the same bytes faster.
"""

import math
from collections.abc import Callable, Sequence

Point = tuple[float, float]
Triangle = tuple[Point, Point, Point]  # left, apex, right: the longest edge runs from left to right
Criterion = Callable[[Point, float], bool]  # is the diamond split, by its split vertex and its longest edge


def middle(a: Point, b: Point) -> Point:
    """Return the midpoint of two points."""
    return (a[0] + b[0]) / 2, (a[1] + b[1]) / 2


def length(a: Point, b: Point) -> float:
    """Return the distance of two points."""
    x, y = b[0] - a[0], b[1] - a[1]
    return math.sqrt(x * x + y * y)


def children(triangle: Triangle) -> tuple[Triangle, Triangle]:
    """Return the two halves of a triangle in the order of the curve."""
    left, apex, right = triangle
    vertex = middle(left, right)
    return (left, vertex, apex), (apex, vertex, right)


def square(x: float, y: float, side: float) -> tuple[Triangle, Triangle]:
    """Return the two root triangles of a square with its lower left corner at (x, y)."""
    upper_left, lower_right = (x, y + side), (x + side, y)
    return (upper_left, (x, y), lower_right), (lower_right, (x + side, y + side), upper_left)


def refine(roots: Sequence[Triangle], depth: int, is_split: Criterion) -> list[Triangle]:
    """Return the leaves below some roots in the order of the curve, at most `depth` bisections deep."""
    leaves = []
    for triangle in roots:
        left, _, right = triangle
        if depth and is_split(middle(left, right), length(left, right)):
            leaves += refine(children(triangle), depth - 1, is_split)
        else:
            leaves.append(triangle)
    return leaves


def nested(roots: Sequence[Triangle], depth: int, is_split: Criterion) -> Criterion:
    """Return the criterion that also splits all ancestors of a diamond that `is_split` (a *saturated* criterion).

    Then a plain recursion over triangles gives a mesh without cracks. roots: triangles of the root squares. depth:
    number of bisections down to which it holds.
    """
    decisions: dict[Point, bool] = {}

    def visit(triangles: Sequence[Triangle], depth_left: int, parents_of: dict[Point, set[Point]]) -> None:
        """Evaluate the criterion on the diamonds of these triangles and of all below, and note their parents."""
        for left, apex, right in triangles if depth_left else ():
            parents_of.setdefault(middle(left, right), set()).add(apex)
            decisions[middle(left, right)] = is_split(middle(left, right), length(left, right))
            visit(children((left, apex, right)), depth_left - 1, parents_of)

    def split(vertex: Point) -> None:
        """Mark a diamond, given by its split vertex, and all its ancestors as split."""
        decisions[vertex] = True
        for parent in parents[vertex]:
            if decisions.get(parent) is False:
                split(parent)

    parents: dict[Point, set[Point]] = {}
    visit(roots, depth, parents)
    for vertex in [vertex for vertex, wanted in decisions.items() if wanted]:
        split(vertex)
    return lambda vertex, _longest: decisions[vertex]


def edges(triangle: Triangle) -> list[frozenset[Point]]:
    """Return the three edges of a triangle."""
    left, apex, right = triangle
    return [frozenset(pair) for pair in ((left, apex), (apex, right), (right, left))]
