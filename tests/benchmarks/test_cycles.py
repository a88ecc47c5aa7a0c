# SPDX-License-Identifier: GPL-3.0-or-later
"""Structural similarity of pictures, against its formula written out."""

import math

import numpy as np
import pytest
from adaptive_terrain.benchmarks.cycles import similarity


def plain(x, y) -> float:
    """Of two grey pictures of 11 x 11 pixels: one window."""
    weights = [[math.exp(-((r - 5) ** 2 + (c - 5) ** 2) / (2 * 1.5**2)) for c in range(11)] for r in range(11)]
    weights = np.array(weights) / np.sum(weights)
    mean_x, mean_y = (weights * x).sum(), (weights * y).sum()
    var_x, var_y = (weights * (x - mean_x) ** 2).sum(), (weights * (y - mean_y) ** 2).sum()
    both = (weights * (x - mean_x) * (y - mean_y)).sum()
    c1, c2 = 2.55**2, 7.65**2
    light, structure = (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1), (2 * both + c2) / (var_x + var_y + c2)
    return light * structure


def test_one_window_is_the_formula_and_a_picture_the_mean_of_its_windows():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, 255, (2, 13, 12))
    windows = [(slice(r, r + 11), slice(c, c + 11)) for r in range(3) for c in range(2)]
    expected = np.mean([plain(x[window], y[window]) for window in windows])
    found = similarity(*(np.repeat(picture[..., None], 3, axis=2) for picture in (x, y)))
    assert found == pytest.approx(expected, rel=1e-9) and abs(expected) < 0.5


def test_a_picture_is_like_itself_and_less_like_a_shifted_one():
    y, x = np.mgrid[0:64, 0:64]
    picture = np.repeat((128 + 90 * np.sin(x / 3) * np.cos(y / 4))[..., None], 3, axis=2).astype(np.float32)
    assert similarity(picture, picture) == 1.0
    assert 0.0 < similarity(picture, np.roll(picture, 2, axis=1)) < similarity(picture, np.roll(picture, 1, axis=1)) < 1
