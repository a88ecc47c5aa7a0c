# SPDX-License-Identifier: GPL-3.0-or-later
"""Structural similarity of pictures, against its formula written out."""

import math

import numpy as np
import pytest
from adaptive_terrain.benchmarks.rows import same_picture
from adaptive_terrain.benchmarks.rows.cycles import similarity


def plain(x, y) -> float:
    """Return the similarity of two grey pictures of 11 x 11 pixels, a single window."""
    weights = [[math.exp(-((r - 5) ** 2 + (c - 5) ** 2) / (2 * 1.5**2)) for c in range(11)] for r in range(11)]
    weights = np.array(weights) / np.sum(weights)
    mean_x, mean_y = (weights * x).sum(), (weights * y).sum()
    var_x, var_y = (weights * (x - mean_x) ** 2).sum(), (weights * (y - mean_y) ** 2).sum()
    both = (weights * (x - mean_x) * (y - mean_y)).sum()
    c1, c2 = 2.55**2, 7.65**2
    light, structure = (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1), (2 * both + c2) / (var_x + var_y + c2)
    return light * structure


def test_similarity_is_the_mean_of_the_formula_over_windows():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, 255, (2, 13, 12))
    windows = [(slice(r, r + 11), slice(c, c + 11)) for r in range(3) for c in range(2)]
    expected = np.mean([plain(x[window], y[window]) for window in windows])
    found = similarity(*(np.repeat(picture[..., None], 3, axis=2) for picture in (x, y)))
    assert found == pytest.approx(expected, rel=1e-9) and abs(expected) < 0.5


def test_a_shift_makes_a_picture_less_similar():
    y, x = np.mgrid[0:64, 0:64]
    picture = np.repeat((128 + 90 * np.sin(x / 3) * np.cos(y / 4))[..., None], 3, axis=2).astype(np.float32)
    assert similarity(picture, picture) == 1.0
    assert 0.0 < similarity(picture, np.roll(picture, 2, axis=1)) < similarity(picture, np.roll(picture, 1, axis=1)) < 1


@pytest.mark.parametrize(("coarsest_px", "step"), [(0.06, 29), (8.0, 0), (1.0, 12), (1e-3, 36)])
def test_the_coarsest_similar_picture_counts(monkeypatch, coarsest_px, step):
    """Pictures are numbers here: their likeness to the grid's."""
    rendered = []

    def render(mode, px):
        rendered.append((mode, px))
        alike = {"grid": 1.0, "adaptive": {1.0: 0.993, 2.0: 0.97, 4.0: 0.95}.get(px), "bare": 0.5}
        likeness = alike.get(mode, 0.9911 if px <= coarsest_px else 0.9485 if px <= 5.0 else 0.9)
        costs = {"ms": 9.0, "cpu_s": 2.0 if mode == "mapped" else 8.0, "triangles": int(1000 / px), "bake_cpu_s": 3.0}
        return costs | {"peak_mb": {"mapped": 900.0, "adaptive": 1300.0, "bare": 500.0}.get(mode)}, likeness

    monkeypatch.setattr(same_picture, "_island", lambda folder: render)
    monkeypatch.setattr(same_picture, "similarity", lambda one, other: one)
    time, memory = same_picture.same_picture_rows(None)
    assert time.figures["error_px"] == pytest.approx(8.0 * 2 ** (-step / 4)) and time.ratio == 0.25
    assert time.figures["ssim"] == (0.9911 if step < 36 else 0.9485), "a miss shows"
    assert time.figures["bake_cpu_s"] == 3.0
    assert memory.ratio == 0.5 and time.size == memory.size == int(1000 / time.figures["error_px"])
    assert time.figures["ratio_at_2px"] == time.figures["ratio_at_4px"] == 0.25
    assert memory.figures["ratio_at_2px"] == memory.figures["ratio_at_4px"] == 0.5
    assert ("mapped", 8.0 if coarsest_px >= 8.0 else pytest.approx(8.0 * 2**-0.75)) in rendered, "found for 4 px"
    assert len(rendered) == len(set(rendered)) <= 23, "each picture once"
