# SPDX-License-Identifier: GPL-3.0-or-later
"""Edges of a mosaic: how far the heights of two files are apart that meet without an overlap.

They are compared in the middle of the open cell between both files, to which the two outermost samples of each are
extrapolated, so that a slope is no step. The same comparison inside the two files tells how much of that is their land,
which is subtracted. The median along an edge counts: a cliff is on a part of it, but a wrong unit or vertical datum is
on all of it.

A lattice is a grid that the samples of several files share. A Composite has all lattices of a mosaic, and its files
(tiles) in the order of their priority.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from .composite import Composite
from .lattices import TileLattice
from .seams import StepReport
from .systems import projected

MAX_EDGES = 400  # that are compared; of more, some are chosen evenly
MIN_LINE = 2  # samples along an edge


class TileEdge(NamedTuple):
    """Two files of a lattice that meet: the second begins one sample east of the first, or one below it.

    Attributes:
        lattice: their lattice.
        first, second: indices in its tiles.
        axis: 0 if the second file is in the east, 1 if it is below.
    """

    lattice: TileLattice
    first: int
    second: int
    axis: int

    def line(self) -> tuple[int, int]:
        """Return the first and the last row (axis 0) or column (axis 1) of the lattice along the edge."""
        one, other = (self.lattice.rectangles[number] for number in (self.first, self.second))
        across = 1 - self.axis
        return int(max(one[across], other[across])), int(min(one[across + 2], other[across + 2]))


def find_edges(composite: Composite) -> StepReport:
    """Compare the heights of files that are neighbours on one lattice, where one ends and the other begins.

    Each edge with heights has one step, the median, at its middle: metres, the second file's height less the first's.
    """
    edges = [edge for lattice in composite.lattices for edge in neighbours(lattice)]
    chosen = [edges[len(edges) * n // MAX_EDGES] for n in range(MAX_EDGES)] if len(edges) > MAX_EDGES else edges
    steps, places = [], []
    names: list[tuple[str, str]] = []
    for edge in chosen:
        composite.on_piece()
        # The heights of each file on the edge, and their change over the next sample inside it: so much of the step
        # between the files is a slope of the land.
        first, step_in_first = _border(composite, edge, is_second=False)
        second, step_in_second = _border(composite, edge, is_second=True)
        step = second - first
        of_land = 0.5 * (step_in_first + step_in_second)
        step -= np.where(np.isfinite(of_land), of_land, 0.0)
        known = step[np.isfinite(step)]
        if len(known):
            steps.append(float(np.median(known)) * abs(composite.scale))
            places.append(_middle(composite, edge))
            ranks = (edge.lattice.tiles[number] for number in (edge.first, edge.second))
            one, other = (composite.tiles[rank].path for rank in ranks)
            names.append((one, other))
    positions = np.array(places).reshape(-1, 2)
    return StepReport(
        pairs=len(edges),
        compared=len(chosen),
        steps=np.array(steps),
        places=positions,
        numbers=np.arange(len(names)),
        names=names,
    )


def neighbours(lattice: TileLattice) -> Iterator[TileEdge]:
    """Yield the edges between a lattice's files that share at least MIN_LINE rows or columns.

    Around the globe, a file at the first column may be the eastern neighbour of one at the last column.
    """
    for axis in (0, 1):
        # first, last: of each file across its edges; low, high: along them.
        first, last = lattice.rectangles[:, axis], lattice.rectangles[:, axis + 2]
        low, high = lattice.rectangles[:, 1 - axis], lattice.rectangles[:, 3 - axis]
        turn = lattice.period if axis == 0 else 0  # columns around the globe, 0 for none
        # `after`: where a neighbour of each tile has to begin.
        starts, after = (first % turn, (last + 1) % turn) if turn else (first, last + 1)
        # In the order of their starts, the neighbours of a tile follow each other: entries begin .. end - 1.
        order = np.argsort(starts, kind="stable")
        ends = np.searchsorted(starts[order], after), np.searchsorted(starts[order], after, side="right")
        for number, (begin, end) in enumerate(zip(*ends, strict=True)):
            others = order[begin:end]
            shared = np.minimum(high[others], high[number]) - np.maximum(low[others], low[number]) + 1
            for other in others[shared >= MIN_LINE].tolist():
                yield TileEdge(lattice, number, other, axis)


def _border(composite: Composite, edge: TileEdge, is_second: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of one file half a sample beyond an edge, and the steps inside that file: both float64 [n].

    The values are extrapolated, and NaN where one of the two outermost samples is missing. A step is the difference
    between two extrapolations to the middle of the second and third sample from the edge, one from either side; 0 in a
    file of fewer than 4 samples across. Both are in the composite's unit, before its scale. is_second: take the edge's
    second file, which is in the east or south, else the first.
    """
    number = edge.second if is_second else edge.first
    rectangle, axis = edge.lattice.rectangles[number], edge.axis
    low, high = edge.line()  # first and last sample along the edge
    # samples of the file across the edge, and where the edge begins in it
    size, offset = int(rectangle[axis + 2] - rectangle[axis]) + 1, low - int(rectangle[1 - axis])
    depth = min(size, 4)
    # First sample and count of the outermost samples, across the edge and along it.
    across, along = (0 if is_second else size - depth, depth), (offset, high - low + 1)
    rows, columns = (along, across) if axis == 0 else (across, along)
    window = composite.tile_window(int(edge.lattice.tiles[number]), *rows, *columns)
    # Lines of samples along the edge, from the border inwards. `_half_beyond` extrapolates from two lines.
    lines = window.T if axis == 0 else window
    lines = lines if is_second else lines[::-1]
    step = np.zeros(len(lines[0]))
    if depth == 4:
        step = _half_beyond(lines[2], lines[3]) - _half_beyond(lines[1], lines[0])  # inner side less outer side
    # A step is east less west, or south less north; the first file's inner side is in the west or north.
    return _half_beyond(lines[0], lines[min(1, depth - 1)]), step if is_second else -step


def _half_beyond(near: np.ndarray, far: np.ndarray) -> np.ndarray:
    """Return values extrapolated from two neighbouring samples by half a sample beyond the near one."""
    return near + 0.5 * (near - far)


def _middle(composite: Composite, edge: TileEdge) -> tuple[float, float]:
    """Return x and y of the middle of an edge in the grid's system.

    It is half a sample beyond the first file, which is west of the second (axis 0) or above it (axis 1).
    """
    low, high = edge.line()
    across, along = edge.lattice.rectangles[edge.first][edge.axis + 2] + 0.5, (low + high) / 2
    u, v = (across, along) if edge.axis == 0 else (along, across)
    x, y = edge.lattice.positions(np.array([u]), np.array([v]))
    x, y = projected(edge.lattice.crs, composite.grid.crs, x, y)
    return float(x[0]), float(y[0])
