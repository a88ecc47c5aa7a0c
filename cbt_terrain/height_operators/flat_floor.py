# SPDX-License-Identifier: GPL-3.0-or-later
"""Water over level ground: many height maps store the surface of a sea or lake instead of its floor.

The floor is unknown there. Its depth is assumed to grow with the distance from the shore, by 1 m every 1 / SLOPE
metres, up to MAX_ASSUMED. Heights do not change: only materials read this depth. Since it is assumed, few triangles
are enough for it: they are the leaves of a longest-edge bisection of blocks of BLOCK x BLOCK cells, whose error in
depth is at most TOLERANCE of it.
"""

import math

import numpy as np

# Depth of the assumed floor over the distance from the shore, and its largest depth in metres.
SLOPE, MAX_ASSUMED = 1 / 10, 20.0
# Largest depth in metres of water above its surface in the height map, as of a river that leaves a large lake.
SHALLOW = 3.0
# Smallest fraction of the water of one level that is above level ground: a file with a real floor has less, also where
# its heights are whole metres, so that the floor has steps.
MIN_LEVEL = 0.5
# Levels of water that differ by less, in metres, are the same.
SAME_WATER = 0.01
# Largest difference in metres between heights of level ground.
LEVEL = 1e-3
BLOCK = 64  # cells along a side, a power of 2
# Largest error of a merged triangle's depth, as a fraction of it, and in metres.
TOLERANCE, MIN_ERROR = 0.1, 0.05


def level_floor(heights: np.ndarray, depth: np.ndarray, wet: np.ndarray) -> np.ndarray:
    """Return the samples under shallow water that belong to a level square of 3 x 3 wet samples, bool [rows, columns].

    At least the fraction MIN_LEVEL of the water of their level is above such samples. heights, depth: metres, [rows,
    columns]. wet: samples under water, bool of that shape. Ground beyond the border is assumed to be like that at the
    border.
    """
    can_be = wet & (depth <= SHALLOW)
    lowest, highest = (_of_squares(heights, reduce) for reduce in (np.minimum, np.maximum))
    middles = _of_squares(can_be, np.logical_and) & (highest - lowest <= LEVEL)
    floor = _of_squares(middles, np.logical_or) & can_be
    if floor.any():
        levels = np.rint((heights[wet].astype(np.float64) + depth[wet]) / SAME_WATER)
        _, number, count = np.unique(levels, return_inverse=True, return_counts=True)
        floor[wet] &= (np.bincount(number[floor[wet]], minlength=len(count)) >= MIN_LEVEL * count)[number]
    return floor


def assumed_depth(floor: np.ndarray, missing: np.ndarray | None, step_x: float, step_y: float) -> np.ndarray:
    """Return the assumed depth of a level floor below its samples, float32 [rows, columns] metres; 0 at its border.

    floor: samples of the floor, bool [rows, columns]. missing: holes, beside which the floor has no border, or None.
    step_x, step_y: metres between samples.
    """
    beside = _of_squares(~floor if missing is None else ~(floor | missing), np.logical_or)
    distance = _distance(floor & beside, step_x, step_y, MAX_ASSUMED / SLOPE)
    return np.where(floor, distance * np.float32(SLOPE), np.float32(0.0))


def merge_cells(floor: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles that cover cells of a level floor, and the cells that they leave out.

    Corners of the triangles are numbers of samples, int64 [n, 3], counter-clockwise. Together with two triangles for
    each other cell, cut along any diagonal, they fit without a gap. The cells: bool [rows - 1, columns - 1]. floor:
    bool [rows, columns]. depth: of the water for materials, metres, of the same shape.
    """
    rows, columns = floor.shape
    inner = _of_squares(floor, np.logical_and)  # cells beside other samples are not merged
    padded = [-(-(n - 1) // BLOCK) * BLOCK + 1 for n in (rows, columns)]
    needed, padded_depth = np.ones(padded, bool), np.zeros(padded, np.float32)
    needed[: rows - 1, : columns - 1] = ~inner[:-1, :-1]
    padded_depth[:rows, :columns] = depth
    blocks = np.zeros([(n - 1) // BLOCK for n in padded], bool)
    row, column = inner.nonzero()
    blocks[np.minimum(row // BLOCK, len(blocks) - 1), np.minimum(column // BLOCK, blocks.shape[1] - 1)] = True
    _require_ancestors(needed, padded_depth)
    leaves = _bisect(needed, np.argwhere(blocks)[:, ::-1] * BLOCK)
    # Not merged: cells with two leaves of half a cell, and the cells of blocks without a level floor.
    is_half = np.ptp(leaves[:, :, 0], axis=1) + np.ptp(leaves[:, :, 1], axis=1) == 2
    is_half &= np.ptp(leaves, axis=1).max(axis=1) == 1
    cell_of_leaf = leaves.min(axis=1)
    halves = np.zeros([n - 1 for n in padded], np.int8)
    np.add.at(halves, (cell_of_leaf[is_half, 1], cell_of_leaf[is_half, 0]), 1)
    alone = np.repeat(np.repeat(~blocks, BLOCK, axis=0), BLOCK, axis=1) | (halves == 2)
    merged = ~(is_half & alone[cell_of_leaf[:, 1], cell_of_leaf[:, 0]])
    corners = leaves[merged].astype(np.int64)
    is_inside = (corners[:, :, 0] < columns).all(axis=1) & (corners[:, :, 1] < rows).all(axis=1)
    return (corners[:, :, 1] * columns + corners[:, :, 0])[is_inside], alone[: rows - 1, : columns - 1]


def _of_squares(samples: np.ndarray, reduce: np.ufunc) -> np.ndarray:
    """Return for each sample the reduction over the 3 x 3 samples around it; the border is repeated beyond itself."""
    padded = np.pad(samples, 1, mode="edge")
    across = reduce(reduce(padded[:, :-2], padded[:, 1:-1]), padded[:, 2:])
    return reduce(reduce(across[:-2], across[1:-1]), across[2:])


def _distance(marked: np.ndarray, step_x: float, step_y: float, limit: float) -> np.ndarray:
    """Return the distance of each sample to the nearest marked one, float32 [rows, columns] metres, at most `limit`.

    It is exact: first along columns, then of their squares along rows. marked: bool. step_x, step_y: metres.
    """
    far, row = np.float32(limit), np.arange(len(marked), dtype=np.float32)[:, None] * np.float32(step_y)
    below = np.maximum.accumulate(np.where(marked, row, -np.float32(np.inf)), axis=0)
    above = np.minimum.accumulate(np.where(marked, row, np.float32(np.inf))[::-1], axis=0)[::-1]
    along = np.minimum(np.minimum(row - below, above - row), far) ** 2
    nearest, columns = along.copy(), marked.shape[1]
    for away in range(1, min(columns, math.ceil(limit / step_x))):
        aside = np.float32((away * step_x) ** 2)
        np.minimum(nearest[:, away:], along[:, : columns - away] + aside, out=nearest[:, away:])
        np.minimum(nearest[:, : columns - away], along[:, away:] + aside, out=nearest[:, : columns - away])
    return np.minimum(np.sqrt(nearest), far)


def _require_ancestors(needed: np.ndarray, depth: np.ndarray) -> None:
    """Mark the samples where longest-edge bisection has to split so that its leaves have all needed samples as corners.

    Samples whose depth is not that between the ends of the edge that they bisect are needed, too. needed: bool, in
    place; depth: metres; both [rows + 1, columns + 1], whose rows and columns of cells are multiples of BLOCK.
    """
    half = 1
    while 2 * half <= BLOCK:
        step = 2 * half
        grid = depth[::step, ::step]
        middles, rows, columns = needed[half::step, half::step], needed[::step, half::step], needed[half::step, ::step]
        # `rows` bisect edges along rows, `columns` along columns; `middles` bisect diagonals of squares.
        rows |= _is_off(depth[::step, half::step], grid[:, :-1], grid[:, 1:])
        columns |= _is_off(depth[half::step, ::step], grid[:-1], grid[1:])
        for ends in ((grid[:-1, :-1], grid[1:, 1:]), (grid[:-1, 1:], grid[1:, :-1])):
            middles |= _is_off(depth[half::step, half::step], *ends)
        if half > 1:
            finer = needed[half // 2 :: half, half // 2 :: half]  # middles of the quarters of squares
            pairs = finer[:, ::2] | finer[:, 1::2]
            rows[:-1] |= pairs[::2]
            rows[1:] |= pairs[1::2]
            pairs = finer[::2] | finer[1::2]
            columns[:, :-1] |= pairs[:, ::2]
            columns[:, 1:] |= pairs[:, 1::2]
        middles |= rows[:-1] | rows[1:] | columns[:, :-1] | columns[:, 1:]
        half = step


def _is_off(depth: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return whether depths differ from the mean of those at both ends by more than the tolerance; metres."""
    return abs(depth - (start + end) / 2) > np.maximum(TOLERANCE * depth, MIN_ERROR)


def _bisect(needed: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the leaves of blocks of BLOCK x BLOCK cells, int32 [n, 3 corners, column and row], counter-clockwise.

    needed: samples where the longest edge of a triangle is bisected, bool. corners: column and row of the blocks'
    south-western corners, int [blocks, 2].
    """
    square = np.array([[[BLOCK, 0], [0, BLOCK], [0, 0]], [[0, BLOCK], [BLOCK, 0], [BLOCK, BLOCK]]])
    triangles = (corners[:, None, None] + square).reshape(-1, 3, 2).astype(np.int32)
    leaves = []
    for _ in range(2 * BLOCK.bit_length() - 2):
        start, end, apex = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        middle = (start + end) // 2
        is_split = needed[middle[:, 1], middle[:, 0]]
        leaves.append(triangles[~is_split])
        start, end, apex, middle = (of[is_split] for of in (start, end, apex, middle))
        triangles = np.concatenate([np.stack([apex, start, middle], axis=1), np.stack([end, apex, middle], axis=1)])
    return np.concatenate([*leaves, triangles])
