# SPDX-License-Identifier: GPL-3.0-or-later
"""The text of the points that files of a mosaic cover."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.importing.covered import POINTS, covered_points, covered_text


def test_covered_points_survive_their_text():
    points = np.random.default_rng(1).random((POINTS, POINTS)) < 0.3
    text = covered_text(points)
    assert len(text) == POINTS * POINTS // 4 and np.array_equal(covered_points(text), points)


@pytest.mark.parametrize("text", [None, 3, "", "xy" * 8192, "f" * 7, "ff" * 8191, "00" * 8192, ["ff"] * 8192])
def test_other_values_are_no_points(text):
    assert covered_points(text) is None
