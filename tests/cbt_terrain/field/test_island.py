# SPDX-License-Identifier: GPL-3.0-or-later
"""The built-in island."""

import hashlib

import numpy as np
from adaptive_terrain.cbt_terrain.field.island import island
from adaptive_terrain.cbt_terrain.field.lands import LANDS


def test_resolutions_agree_where_their_samples_coincide():
    fine, coarse = island(257), island(65)
    assert np.array_equal(fine[::4, ::4], coarse)


def test_rows_and_threads_do_not_matter():
    whole = island(129)
    for threads in (1, 2):
        rows = np.empty((50, 129), np.float32)
        LANDS["island"].rows(129, 40, rows, 7, threads)
        assert np.array_equal(rows, whole[40:90])


def test_equal_seeds_give_equal_islands():
    assert hashlib.sha256(island(65).tobytes()).hexdigest() == (
        "a61b5dd0ceefda7287ca94ea6ba06bb532f93df33a63d9bc0a0f28a096e9e6dd"
    )
    assert not np.array_equal(island(65, seed=1), island(65, seed=2))


def test_it_is_an_island():
    for seed in (7, 1, 2, 3):
        heights = island(257, seed)
        assert np.isfinite(heights).all()
        border = np.concatenate([heights[0], heights[-1], heights[:, 0], heights[:, -1]])
        assert border.max() < 0.0
        assert 1000.0 < heights.max() < 2200.0 and heights.min() > -400.0
        assert 0.25 < (heights > 0.0).mean() < 0.65
        # A beach: much more land just above the sea than in a band of the same width higher up.
        assert ((heights > 0.0) & (heights < 5.0)).mean() > 1.5 * ((heights > 30.0) & (heights < 35.0)).mean()
