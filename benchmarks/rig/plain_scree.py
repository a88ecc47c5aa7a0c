# SPDX-License-Identifier: GPL-3.0-or-later
"""Scree in numpy: the sweeps of kernels/land/thermal.py in passes over whole arrays, with equal bytes."""

import numpy as np

from ...kernels.land.thermal import Slope

HALF, ONE, ZERO = np.float32(0.5), np.float32(1.0), np.float32(0.0)


def sweep(slope: Slope, number: int, base: np.ndarray, left: np.ndarray, scree: np.ndarray) -> None:
    """Apply sweep `number` in place to float32 [rows, columns] metres, the arrays of the kernels."""
    facing, odd = _facing(slope, base + left + scree), number & 1
    rows, columns = base.shape
    dip_y = np.float32(slope.dip_y) * (slope.first_row + np.arange(rows)).astype(np.float32)[:, None]
    dip = np.float32(slope.dip_x) * (slope.first_column + np.arange(columns)).astype(np.float32) + dip_y
    step_x, step_y = np.float32(slope.step_x), np.float32(slope.step_y)
    diagonal = np.sqrt(step_x * step_x + step_y * step_y)
    arrays = base, left, scree, facing, dip

    def settle_pairs(rows, columns, run, other_columns=slice(None), other_row=0):
        """Settle samples at `rows` and `columns` with those at `other_row` rows further and `other_columns`."""
        others = [array[rows.start + other_row :, :][:: rows.step] for array in arrays]
        ones = [array[rows][: len(others[0])][:, columns] for array in arrays]
        count = len(ones[0])
        _settle(slope, run, ones, [array[:count, other_columns] for array in others])

    all_rows, all_columns = slice(0, None, 1), slice(None)
    for parity in (odd, 1 - odd):  # of columns
        start = (parity ^ slope.first_column) & 1
        settle_pairs(all_rows, slice(start, columns - 1, 2), step_x, slice(start + 1, columns, 2))
    for parity in (odd, 1 - odd):  # of rows
        south = slice((parity ^ slope.first_row) & 1, rows - 1, 2)
        if rows < 2:
            continue
        settle_pairs(south, all_columns, step_y, all_columns, 1)
        settle_pairs(south, slice(0, columns - 1), diagonal, slice(1, columns), 1)
        settle_pairs(south, slice(1, columns), diagonal, slice(0, columns - 1), 1)


def _facing(slope: Slope, surface: np.ndarray) -> np.ndarray:
    def difference(step: float, axis: int) -> np.ndarray:
        z = np.pad(surface, [(1, 1) if i == axis else (0, 0) for i in (0, 1)], mode="edge")
        z = np.moveaxis(z, axis, 0)
        factor = np.full(len(z) - 2, HALF / np.float32(step))
        factor[[0, -1]] = ONE / np.float32(step)
        return np.moveaxis((z[2:] - z[:-2]) * factor[:, None], 0, axis)

    u, v = difference(slope.step_x, 1), difference(slope.step_y, 0)
    p, q = np.abs(u), np.abs(v)
    largest = np.maximum(np.maximum(p, q), (p + q) * np.float32(0.70710678))
    with np.errstate(invalid="ignore"):
        cosine = largest / np.sqrt(u * u + v * v)
    return np.where(cosine >= np.float32(0.92), cosine, ONE)


def _settle(slope: Slope, run: np.float32, one: list[np.ndarray], other: list[np.ndarray]) -> None:
    """Settle pairs, given views of base, rock, scree, facing and the dip of beds of both samples."""
    zi, zj, si, sj = one[0] + one[1], other[0] + other[1], one[2], other[2]
    drop = (zi + si) - (zj + sj)
    down = drop >= ZERO
    high, low = np.where(down, zi, zj), np.where(down, zj, zi)
    on_high, on_low = np.where(down, si, sj), np.where(down, sj, si)
    left = np.where(down, one[1], other[1])
    run = run * np.where(down, one[3], other[3])
    move = np.float32(slope.share) * (np.abs(drop) - np.float32(slope.repose) * run)
    rest = on_high - np.fmax(np.minimum(move, np.float32(slope.max_fraction) * on_high), ZERO)
    on_low, on_high = on_low + (on_high - rest), rest
    bare = high - (low + on_low)
    limit = np.float32(slope.soft) + np.float32(np.float32(slope.hard) - np.float32(slope.soft)) * _hardness(
        slope, high, bare, one[4]
    )
    over, cover = np.fmax(bare - limit * run, ZERO), np.fmax(ONE - on_high, ZERO)
    rest = left - np.fmin(np.float32(slope.weather) * cover * over, left)
    on_low, left = on_low + (left - rest), rest
    one[1][...], other[1][...] = np.where(down, left, one[1]), np.where(down, other[1], left)
    one[2][...], other[2][...] = np.where(down, on_high, on_low), np.where(down, on_low, on_high)


def _hardness(slope: Slope, high: np.ndarray, bare: np.ndarray, dip: np.ndarray) -> np.ndarray:
    thick = np.float32(slope.thick)
    t = (high + dip) * (ONE / thick)
    floor = np.floor(t)
    n = np.nan_to_num(floor).astype(np.int64).astype(np.uint32)
    weight = np.fmax((t - floor) * np.float32(4.0) - np.float32(3.0), ZERO)
    mixed = _hash(slope, n) * (ONE - weight) + _hash(slope, n + np.uint32(1)) * weight
    return HALF + (mixed - HALF) * (thick / np.fmax(bare, thick))


def _hash(slope: Slope, n: np.ndarray) -> np.ndarray:
    n = n * np.uint32(0x9E3779B9) + np.uint32(slope.seed)
    n = (n ^ (n >> np.uint32(15))) * np.uint32(0x7FEB352D)
    n = n ^ (n >> np.uint32(15))
    return (n >> np.uint32(8)).astype(np.float32) * np.float32(5.9604645e-08)
