# SPDX-License-Identifier: GPL-3.0-or-later
"""Pushes of a triangle of a fit, against the same in numpy, point by point."""

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.kernels.field.domain import Domain
from adaptive_terrain.kernels.fitting.push import pushes_of

APEX_Z, RISE_LEFT, RISE_RIGHT, AIM = 501.0, 1.0, -2.0, 2.5


@wp.kernel
def run(d: Domain, apex: wp.vec2i, left: wp.vec2i, right: wp.vec2i, out: wp.array(dtype=wp.float32)):
    q = pushes_of(d, apex + left, apex, apex + right, wp.float64(APEX_Z), wp.vec2f(RISE_LEFT, RISE_RIGHT), AIM)
    for k in range(7):
        out[k] = q[k]


def pushes(heights: np.ndarray, apex: tuple, left: tuple, right: tuple) -> np.ndarray:
    out = wp.zeros(7, dtype=wp.float32, device="cpu")
    d = Domain()  # a lattice unit is a cell
    d.samples.floats = wp.array(heights.ravel(), dtype=wp.float32, device="cpu")
    d.samples.rows, d.samples.columns = heights.shape
    inputs = [d, wp.vec2i(*apex), wp.vec2i(*left), wp.vec2i(*right), out]
    wp.launch(run, 1, inputs=inputs, device="cpu")
    return out.numpy()


def expected(heights: np.ndarray, apex: tuple, left: tuple, right: tuple) -> np.ndarray:
    """Sum over every sample and every extremum along a diagonal, one after the other."""
    legs = np.array([left, right])
    n2 = legs[0] @ legs[0]

    def above(x: float, y: float) -> tuple:
        i, j = int(np.floor(apex[0] + x)), int(np.floor(apex[1] + y))
        i, j = min(i, heights.shape[1] - 2), min(j, heights.shape[0] - 2)
        s, t = apex[0] + x - i, apex[1] + y - j
        cell = heights[j : j + 2, i : i + 2].astype(np.float64)
        u, v = legs @ (x, y) / n2
        return u, v, (1 - t, t) @ cell @ (1 - s, s) - (APEX_Z + u * RISE_LEFT + v * RISE_RIGHT)

    n = int(np.abs(legs).max())
    inside = [(x, y) for y in range(-n, n + 1) for x in range(-n, n + 1)]
    points = [above(x, y) for x, y in inside if min(*(legs @ (x, y)), n2 - (legs @ (x, y)).sum()) >= 0]
    ends = [(legs[0], legs[1])] if 0 in left else [(np.zeros(2, int), leg) for leg in legs]
    for start, end in ends:
        step = np.sign(end - start)
        for k in range(np.abs(end - start).max()):
            at = start + k * step
            # A parabola through three points.
            r0, r, r1 = (above(*(at + t * step))[2] for t in (0.0, 0.5, 1.0))
            bend, slope = 2 * (r0 + r1 - 2 * r), 4 * r - 3 * r0 - r1
            if bend and 0 < -slope / (2 * bend) < 1:
                points.append(above(*(at - slope / (2 * bend) * step)))
    u, v, r = np.array(points).T
    beyond = np.abs(r) > AIM
    over = np.where(beyond, np.sign(r) * (np.abs(r) - AIM), 0.0)
    return np.array([np.abs(r).max(), *(f(w) for w in (1 - u - v, u, v) for f in (beyond.dot, over.dot))])


WAYS = [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)]


@pytest.mark.parametrize(
    ("n", "left"),
    [
        *((n, left) for n in (1, 2, 4, 8) for left in WAYS),
        *((16, left) for left in WAYS[::4]),
        *(pytest.param(16, left, marks=pytest.mark.thorough) for left in WAYS if left not in WAYS[::4]),
    ],
)
def test_pushes_are_those_of_every_point(n, left):
    heights = (3.0 * np.random.default_rng(n).standard_normal((33, 35)) + 500.0).astype(np.float32)
    left, right = (n * left[0], n * left[1]), (-n * left[1], n * left[0])
    for mirrored in (left, right), (right, left):
        found, wanted = pushes(heights, (17, 16), *mirrored), expected(heights, (17, 16), *mirrored)
        assert wanted[1:].any() and found == pytest.approx(wanted, rel=1e-5, abs=1e-4)


@pytest.mark.parametrize(("apex", "left", "right"), [((0, 0), (1, 0), (0, 1)), ((1, 1), (-1, 0), (0, -1))])
def test_a_raster_of_four_samples_is_not_read_beyond(apex, left, right):
    heights = np.array([[500.0, 509.0], [495.0, 501.0]], np.float32)
    assert pushes(heights, apex, left, right) == pytest.approx(expected(heights, apex, left, right), rel=1e-5, abs=1e-4)
