# SPDX-License-Identifier: GPL-3.0-or-later
"""Scree in plain numpy: the same sweeps as kernels/land/thermal.py, pass by pass over the whole, to the same bits."""

import numpy as np

from ...kernels.land.thermal import Slope

HALF, ONE, ZERO = np.float32(0.5), np.float32(1.0), np.float32(0.0)


def sweep(slope: Slope, number: int, base: np.ndarray, left: np.ndarray, scree: np.ndarray) -> None:
    """Sweep `number` of float32 [rows, columns] m, in place, see the kernels."""
    facing, odd = _facing(slope, base + left + scree), number & 1
    rows, columns = base.shape
    dip_y = np.float32(slope.dip_y) * (slope.first_row + np.arange(rows)).astype(np.float32)[:, None]
    dip = np.float32(slope.dip_x) * (slope.first_column + np.arange(columns)).astype(np.float32) + dip_y
    step_x, step_y = np.float32(slope.step_x), np.float32(slope.step_y)
    diagonal = np.sqrt(step_x * step_x + step_y * step_y)
    arrays = base, left, scree, facing, dip

    def pairs(south, west, run, of=slice(None), by=(0, 0)):
        """Those of `south` and `west` with those `by` rows and columns on."""
        rest = [array[south.start + by[0] :, :][:: south.step] for array in arrays]
        first = [array[south][: len(rest[0])][:, west] for array in arrays]
        count = len(first[0])
        _settle(slope, run, first, [array[:count, of] for array in rest])

    every = slice(0, None, 1)
    for parity in (odd, 1 - odd):  # of columns
        start = (parity ^ slope.first_column) & 1
        a, b = slice(start, columns - 1, 2), slice(start + 1, columns, 2)
        pairs(every, a, step_x, b)
    for parity in (odd, 1 - odd):  # of slabs
        south = slice((parity ^ slope.first_row) & 1, rows - 1, 2)
        if rows < 2:
            continue
        pairs(south, slice(None), step_y, slice(None), (1, 0))
        pairs(south, slice(0, columns - 1), diagonal, slice(1, columns), (1, 0))
        pairs(south, slice(1, columns), diagonal, slice(0, columns - 1), (1, 0))


def _facing(slope: Slope, surface: np.ndarray) -> np.ndarray:
    def difference(step: float, axis: int) -> np.ndarray:
        z = np.pad(surface, [(1, 1) if i == axis else (0, 0) for i in (0, 1)], mode="edge")
        z = np.moveaxis(z, axis, 0)
        by = np.full(len(z) - 2, HALF / np.float32(step))
        by[[0, -1]] = ONE / np.float32(step)
        return np.moveaxis((z[2:] - z[:-2]) * by[:, None], 0, axis)

    u, v = difference(slope.step_x, 1), difference(slope.step_y, 0)
    p, q = np.abs(u), np.abs(v)
    most = np.maximum(np.maximum(p, q), (p + q) * np.float32(0.70710678))
    with np.errstate(invalid="ignore"):
        cosine = most / np.sqrt(u * u + v * v)
    return np.where(cosine >= np.float32(0.92), cosine, ONE)


def _settle(slope: Slope, run: np.float32, one: list[np.ndarray], other: list[np.ndarray]) -> None:
    """Pairs of views of base, left, scree, facing and the beds' fall."""
    zi, zj, si, sj = one[0] + one[1], other[0] + other[1], one[2], other[2]
    drop = (zi + si) - (zj + sj)
    down = drop >= ZERO
    high, low = np.where(down, zi, zj), np.where(down, zj, zi)
    on_high, on_low = np.where(down, si, sj), np.where(down, sj, si)
    left = np.where(down, one[1], other[1])
    run = run * np.where(down, one[3], other[3])
    move = np.float32(slope.share) * (np.abs(drop) - np.float32(slope.repose) * run)
    kept = on_high - np.fmax(np.minimum(move, np.float32(slope.part) * on_high), ZERO)
    on_low, on_high = on_low + (on_high - kept), kept
    bare = high - (low + on_low)
    limit = np.float32(slope.soft) + np.float32(np.float32(slope.hard) - np.float32(slope.soft)) * _hardness(
        slope, high, bare, one[4]
    )
    over, cover = np.fmax(bare - limit * run, ZERO), np.fmax(ONE - on_high, ZERO)
    kept = left - np.fmin(np.float32(slope.weather) * cover * over, left)
    on_low, left = on_low + (left - kept), kept
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
