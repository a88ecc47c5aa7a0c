# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights in the cell between the outer samples of two tiles that have no common lattice.

A tile's border counts beyond its outer samples, with a weight that falls from 1 to 0 within one cell. The mean of all
such tiles is linear between two borders one cell apart, so tiles without a shared row have no gap.
"""

import numpy as np

from .positions import BLOCK, SNAPPED, BlockNodes
from .windows import UNCOVERED, GridPiece, LatticeWindow

# Sum of weights from which on a sample has a height: the outer cells of a single tile are half a cell wide.
MIN_WEIGHT = 0.5 - 1e-9


def bridge(
    piece: GridPiece,
    found: list[tuple[BlockNodes, LatticeWindow]],
    out: np.ndarray,
    ranks: np.ndarray,
    moved: np.ndarray,
) -> None:
    """Fill samples of a piece that no tile covers from the borders of tiles within one cell, by their ranks.

    found: nodes and samples of each lattice that the piece meets. out, ranks, moved: heights, ranks and errors of the
    positions of the piece's samples, [rows, columns], which are changed in place.
    """
    rows, columns = np.nonzero(ranks == UNCOVERED)
    weights, sums = np.zeros(len(rows)), np.zeros(len(rows))
    low, high = np.full(len(rows), np.inf), np.full(len(rows), -np.inf)
    errors, off = np.zeros(len(rows)), np.zeros(len(rows))
    parts = []
    for number, (nodes, window) in enumerate(found):
        u = _at(nodes.u, nodes.spacing, piece, rows, columns)
        v = _at(nodes.v, nodes.spacing, piece, rows, columns)
        for n in range(len(window.tile_ranks)):
            parts.append((int(window.tile_ranks[n]), number, n, u, v))
    for _, number, n, u, v in sorted(parts, key=lambda part: part[:3]):
        nodes, window = found[number]
        first_u, first_v, last_u, last_v = window.rectangles[n]
        beyond_u = np.maximum(np.maximum(first_u - u, u - last_u), 0.0)
        beyond_v = np.maximum(np.maximum(first_v - v, v - last_v), 0.0)
        with np.errstate(invalid="ignore"):
            near = np.flatnonzero((beyond_u < 1.0 - SNAPPED) & (beyond_v < 1.0 - SNAPPED))
        if not len(near):
            continue
        heights, step = _border(window, np.clip(u[near], first_u, last_u), np.clip(v[near], first_v, last_v))
        near, heights, step = (values[np.isfinite(heights)] for values in (near, heights, step))
        weight = (1.0 - beyond_u[near]) * (1.0 - beyond_v[near])
        weights[near] += weight
        sums[near] += weight * heights
        low[near], high[near] = np.minimum(low[near], heights), np.maximum(high[near], heights)
        error = nodes.error_u + nodes.error_v
        off[near] = np.maximum(off[near], error)
        errors[near] = np.maximum(errors[near], error * step)
    good = weights >= MIN_WEIGHT
    at = rows[good], columns[good]
    out[at] = sums[good] / weights[good]
    # A weight changes by the error of its position, and a sum of weights is at least a half.
    moved[at] = errors[good] + 2.0 * off[good] * (high[good] - low[good])


def _at(nodes: np.ndarray, spacing: int, piece: GridPiece, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return interpolated values of nodes at samples of a piece."""
    x, y = piece.column % BLOCK + columns, piece.row % BLOCK + rows
    i, j, s, t = x // spacing, y // spacing, (x % spacing) / spacing, (y % spacing) / spacing
    low = nodes[j, i] * (1 - s) + nodes[j, i + 1] * s
    high = nodes[j + 1, i] * (1 - s) + nodes[j + 1, i + 1] * s
    return low * (1 - t) + high * t


def _border(window: LatticeWindow, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return heights of a lattice's samples at positions, NaN where one is missing, and the steps between them."""
    height, width = window.values.shape
    p, q = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    s, t = u - p, v - q
    p, q = p - window.left, q - window.top
    inside = (p >= 0) & (q >= 0) & (p + 1 < width) & (q + 1 < height)
    p, q = np.clip(p, 0, width - 2), np.clip(q, 0, height - 2)
    corners = window.values[q, p], window.values[q, p + 1], window.values[q + 1, p], window.values[q + 1, p + 1]
    a, b, c, d = (
        np.where(needed, z, 0.0) for z, needed in zip(corners, (s < 1, s > 0, t > 0, (s > 0) & (t > 0)), strict=True)
    )
    heights = (a * (1 - s) + b * s) * (1 - t) + (c * (1 - s) + d * s) * t
    step = np.fmax.reduce([np.abs(corners[0] - z) for z in corners[1:]] + [np.zeros_like(s)])
    return np.where(inside, heights, np.nan), 2.0 * step
