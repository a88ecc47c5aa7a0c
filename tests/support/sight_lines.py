# SPDX-License-Identifier: GPL-3.0-or-later
"""Straight lines over a height field, cell by cell in numpy: what rays and lines of sight meet, by brute force."""

import numpy as np
from fields import reference_heights

EDGE = 1e-9  # of a piece: where two pieces meet a sign may be that of either


def holes_of(field) -> np.ndarray:
    """bool [rows - 1, columns - 1]: cells that have a missing sample."""
    v = np.ones(field.samples.shape, bool) if field.valid is None else field.valid > 0
    return ~(v[1:, 1:] & v[1:, :-1] & v[:-1, 1:] & v[:-1, :-1])


def pieces(field, origin, direction, end, scale=1.0, offset=0.0, places=3):
    """Return the pieces of a line between two crossings of sample lines, in order.

    t [n, places] evenly over each, metres of the line above the surface there [n, places], and whether it is over
    ground [n].
    """
    lattice = field.lattice
    steps, cells = np.array([lattice.step_x, lattice.step_y]), np.array([lattice.cells_x, lattice.cells_y])
    start, rate = origin[:2] / steps + cells / 2, direction[:2] / steps
    first, last, cuts = 0.0, end, []
    for u, du, n in zip(start, rate, cells, strict=True):
        if du:
            at = np.sort((np.arange(n + 1) - u) / du)
            first, last = max(first, at[0]), min(last, at[-1])
            cuts.append(at)
        elif not 0 <= u <= n:
            last = -1.0
    if not first <= last:
        return np.empty((0, places)), np.empty((0, places)), np.empty(0, bool)
    if not np.isfinite(last):
        last = first + 1e5
    cuts = np.concatenate([*cuts, [first, last]])
    cuts = np.unique(cuts[(cuts >= first) & (cuts <= last)])
    cuts = cuts if len(cuts) > 1 else np.array([first, last])
    t = cuts[:-1, None] + np.linspace(0, 1, places) * np.diff(cuts)[:, None]
    points = origin + t[..., None] * direction
    e = points[..., 2] - reference_heights(field, points[..., :2].reshape(-1, 2)).reshape(t.shape) * scale - offset
    middle = np.clip((start + t.mean(axis=1)[:, None] * rate).astype(int), 0, cells - 1)
    return t, e, ~holes_of(field)[middle[:, 1], middle[:, 0]]


def parabolas(t, e):
    """Return the coefficients a, b, c of e(x), x in 0 .. 1 over each piece, of a bilinear surface."""
    a = 2 * (e[:, 0] + e[:, 2] - 2 * e[:, 1])
    return a, e[:, 2] - e[:, 0] - a, e[:, 0]


def first_contact(field, origin, direction, scale=1.0, offset=0.0) -> float:
    """Return the first t at which a line meets a bilinear surface, by the roots of each piece; infinite without one."""
    t, e, ground = pieces(field, origin, direction, np.inf, scale, offset)
    a, b, c = parabolas(t, e)
    small = 1e-12 * np.maximum(np.abs([a, b, c]).max(axis=0), 1e-3)
    a, b = (np.where(np.abs(v) < small, 0.0, v) for v in (a, b))
    square = b * b - 4 * a * c
    with np.errstate(all="ignore"):
        q = -0.5 * (b + np.copysign(np.sqrt(np.maximum(square, 0.0)), b))
        roots = np.stack([q / a, c / q])
    roots[:, square < -((2e-9 * a) ** 2)] = np.inf  # complex by more than rounding
    roots[~((roots > -EDGE) & (roots < 1 + EDGE))] = np.inf
    first = np.where(c == 0.0, 0.0, roots.min(axis=0))
    met = np.flatnonzero(ground & (first < np.inf))
    return t[met[0], 0] + first[met[0]] * (t[met[0], 2] - t[met[0], 0]) if len(met) else np.inf


def least_clearance(field, start, end, scale=1.0, offset=0.0) -> float:
    """Return the least metres by which the line between two points is above a bilinear surface.

    It is less than 0 where the surface is above the line. From a start on the surface, it is the line's rise in the
    first piece.
    """
    t, e, ground = pieces(field, start, end - start, 1.0, scale, offset)
    a, b, c = parabolas(t, e)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.clip(np.nan_to_num(-b / (2 * a)), 0.0, 1.0)
    least = np.minimum(c + (b + a * turn) * turn, np.minimum(e[:, 0], e[:, 2]))
    if len(e) and abs(e[0, 0]) < 1e-9:
        least[0] = min(b[0], a[0] + b[0])
    return float(least[ground].min(initial=np.inf))
