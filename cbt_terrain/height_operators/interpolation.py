# SPDX-License-Identifier: GPL-3.0-or-later
"""Changes of a coarse level, interpolated and added to the heights of a finer raster."""

import numpy as np


def add_change(
    source: np.ndarray, before: np.ndarray, change: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> np.ndarray:
    """Return the source's heights with the change of a coarse level, float32 [rows, columns] m.

    The top of a cliff sinks while its foot rises. Added to the source, the change interpolated between them would make
    a spike and a trench. So a height above the coarse ground gets the smallest change around it, one below it the
    largest, but neither passes the changed coarse ground.

    source: heights at the positions. before, change: heights and their change of the coarse level. rows, columns:
    positions of the source's samples in that level, float64.
    """
    ground, mean, detail, clipped = _parts(source, before, change, rows, columns)
    return ground + mean + (detail - clipped)


def finer_change(
    source: np.ndarray, before: np.ndarray, change: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> np.ndarray:
    """Return the change that `add_change` makes, exactly 0 where the change around it is 0.

    source: heights at the positions. before, change: heights and their change of the coarse level. rows, columns:
    positions of the source's samples in that level, float64.
    """
    _, mean, _, clipped = _parts(source, before, change, rows, columns)
    return mean - clipped


def _parts(
    source: np.ndarray, before: np.ndarray, change: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the interpolated coarse ground and change, and the source's detail above that ground, float32 m.

    The last array is the detail that the change removes: all of it, within the extremes of the change around it.
    source: heights at the positions. before, change: heights and their change of the coarse level. rows, columns:
    positions of the source's samples in that level, float64.
    """
    ground, mean = interpolate(before, rows, columns), interpolate(change, rows, columns)
    # Smallest and largest change around: `of` combines the values of a coarse sample and its neighbours.
    low, high = (interpolate(_extreme(of, change), rows, columns) for of in (np.minimum, np.maximum))
    detail = source - ground
    return ground, mean, detail, np.clip(detail, mean - high, mean - low)


def _extreme(extreme: np.ufunc, samples: np.ndarray) -> np.ndarray:
    """Return the minimum or maximum of each sample and its eight neighbours. extreme: np.minimum or np.maximum."""
    wide = np.pad(samples, 1, mode="edge")
    wide = extreme(extreme(wide[:-2], wide[1:-1]), wide[2:])
    return extreme(extreme(wide[:, :-2], wide[:, 1:-1]), wide[:, 2:])


def interpolate(samples: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return a grid, interpolated bilinearly at each of `rows` and `columns`, float32 [rows, columns].

    These are positions in samples, float64 [n] each.
    """
    low = np.minimum(rows.astype(np.int64), max(len(samples) - 2, 0))
    fraction = (rows - low)[:, None].astype(np.float32)
    lines = interpolate_columns(samples, columns)
    return lines[low] + fraction * (lines[np.minimum(low + 1, len(samples) - 1)] - lines[low])


def interpolate_columns(samples: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Interpolate each row of a grid linearly at `columns`, float64 positions in samples."""
    last = samples.shape[1] - 1
    low = np.minimum(columns.astype(np.int64), max(last - 1, 0))
    fraction = (columns - low).astype(np.float32)
    left = samples[:, low]
    return left + fraction * (samples[:, np.minimum(low + 1, last)] - left)
