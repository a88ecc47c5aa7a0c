# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums and small products, written out in one order: the same bits on every machine and in every Python.

BLAS and LAPACK, which stand behind `@`, `np.linalg` and `np.einsum`, choose their order of sums by the processor.
Python's `sum` compensates rounding from 3.12 on. `math.hypot` and `**` are the C library's.
"""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

SWEEPS = 60  # of Jacobi rotations; three columns are at right angles after six or so


def add_up(terms: Iterable) -> Any:
    """Return the sum of floats or arrays, added from left to right, so that its bits are the same on every machine."""
    total = 0.0
    for term in terms:
        total = total + term
    return total


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Multiply float64 matrices: a [n, k] by b [k, m] gives [n, m], by b [k] gives [n]."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    return add_up(np.multiply.outer(a[:, k], b[k]) for k in range(a.shape[1]))


def length(vector: ArrayLike) -> float:
    """Return the Euclidean length of numbers, of any shape."""
    return math.sqrt(add_up(x * x for x in np.asarray(vector, np.float64).reshape(-1).tolist()))


def lengths(matrix: np.ndarray) -> np.ndarray:
    """Return the Euclidean lengths of the columns of a matrix [k, n], float64 [n]."""
    return np.sqrt(add_up(row * row for row in np.asarray(matrix, np.float64)))


def determinant(m: np.ndarray) -> float:
    """Return the determinant of a matrix [3, 3]."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(m, np.float64).tolist()
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return x of matrix [n, n] times x = right [n, m], by elimination with row pivots.

    Raises numpy's LinAlgError where there is none.
    """
    # each row of the matrix, followed by that of `right`
    rows = [a + b for a, b in zip(np.asarray(matrix, np.float64).tolist(), np.asarray(right).tolist(), strict=True)]
    n = len(rows)
    for k in range(n):
        pivot_row = max(range(k, n), key=lambda i: abs(rows[i][k]))
        rows[k], rows[pivot_row] = rows[pivot_row], rows[k]
        pivot = rows[k][k]
        if pivot == 0 or not math.isfinite(pivot):
            raise np.linalg.LinAlgError("the matrix is singular")
        rows[k] = [x / pivot for x in rows[k]]
        for i in range(n):
            if i != k:
                factor = rows[i][k]
                rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    return np.array(rows)[:, n:]


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse of a float64 [n, n] matrix. Raises numpy's LinAlgError if it is singular."""
    return solve(matrix, np.eye(len(matrix)))


def min_stretch(matrix: np.ndarray) -> float:
    """Return the smallest length of a unit vector after multiplication by a matrix [3, 3]: its smallest singular value.

    Columns are rotated in pairs until all are at right angles (one-sided Jacobi).
    """
    columns = np.asarray(matrix, np.float64).T.tolist()
    for _ in range(SWEEPS):
        at_right_angles = True
        for p, q in ((0, 1), (0, 2), (1, 2)):
            a, b = columns[p], columns[q]
            # dot products
            aa, bb, ab = (add_up(x * y for x, y in zip(u, v, strict=True)) for u, v in ((a, a), (b, b), (a, b)))
            if abs(ab) > 1e-16 * math.sqrt(aa * bb):
                at_right_angles = False
                # The rotation of both columns that makes `ab` 0, by the smaller of two angles.
                cotangent_of_double = (bb - aa) / (2 * ab)
                root = math.sqrt(1 + cotangent_of_double * cotangent_of_double)
                tangent = math.copysign(1 / (abs(cotangent_of_double) + root), cotangent_of_double)
                cosine = 1 / math.sqrt(1 + tangent * tangent)
                columns[p] = [cosine * x - cosine * tangent * y for x, y in zip(a, b, strict=True)]
                columns[q] = [cosine * tangent * x + cosine * y for x, y in zip(a, b, strict=True)]
        if at_right_angles:
            break
    return min(length(column) for column in columns)


def round_last_bits(value: float) -> float:
    """Round to 12 digits, because the last bits of sines, exponentials and the like depend on the processor."""
    return float(f"{value:.12g}")
