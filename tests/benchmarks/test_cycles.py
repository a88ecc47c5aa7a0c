# SPDX-License-Identifier: GPL-3.0-or-later
"""Structural similarity of pictures, against its formula written out."""

import math

import numpy as np
import pytest
from adaptive_terrain.benchmarks.rows import cycles_likeness
from adaptive_terrain.benchmarks.rows.cycles import similarity


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


@pytest.mark.parametrize(("least", "step"), [(0.06, 17), (1.0, 0), (2**-5.75, 23), (1e-3, 24)])
def test_the_same_picture_is_the_coarsest_that_is_as_alike(monkeypatch, least, step):
    """Pictures are numbers here: how alike they are to the grid's."""
    rendered = []

    def render(mode, px):
        rendered.append((mode, px))
        alike = {"grid": 1.0, "adaptive": 0.993, "bare": 0.5}.get(mode, 0.9911 if px <= least else 0.95)
        said = {"ms": 9.0, "cpu_s": 2.0 if mode == "mapped" else 8.0, "triangles": int(1000 / px)}
        return said | {"peak_mb": {"mapped": 900.0, "adaptive": 1300.0, "bare": 500.0}.get(mode)}, alike

    monkeypatch.setattr(cycles_likeness, "_island", lambda folder: render)
    monkeypatch.setattr(cycles_likeness, "similarity", lambda one, other: one)
    time, memory = cycles_likeness.same_picture_rows(None)
    assert time.figures["error_px"] == pytest.approx(2 ** (-step / 4)) and time.ratio == 0.25
    assert time.figures["ssim"] == (0.9911 if step < 24 else 0.95), "a miss is told"
    assert memory.ratio == 0.5 and time.size == memory.size == int(1000 / time.figures["error_px"])
    assert len(rendered) == len(set(rendered)) <= 9, "each error once"
