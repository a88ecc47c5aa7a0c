# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights that a finer level starts from beside cliffs: those that coarser samples know, and the ground's own."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.land_effects.cliffs import beside_cliffs
from adaptive_terrain.cbt_terrain.land_effects.levels import coarser, finer

DROP = 10.0


def cliff():
    """A wall of 400 m between columns 9 and 10 of 9 x 21 samples."""
    return np.where(np.arange(21) < 10, 100.0, 500.0).astype(np.float32) * np.ones((9, 1), np.float32)


def slid(before):
    """What the coarser level's change, brought to this one, makes of a ground whose walls go half down: heights."""
    mean = np.float32(0.5) * (before.min() + before.max())
    change = np.where(abs(np.arange(before.shape[1]) - 9.5) < 3, mean - before, np.float32(0.0))
    return before + finer(coarser(change), before.shape)


def test_there_is_neither_a_spike_nor_a_trench():
    before = cliff()
    after = slid(before)
    assert after[:, 9].max() < 150.0 and after[:, 11].max() == 300.0  # the trench: a mean of +200 and -200
    found = beside_cliffs(after, before, after, (0, 0), DROP)
    assert (found[:, 8:12] >= 290.0).all() and (found[:, 8:12] <= 310.0).all()
    assert (found[:, ::2] == after[:, ::2]).all()


@pytest.mark.parametrize("axis", [0, 1])
def test_a_tile_that_begins_anywhere_has_the_same(axis):
    before = np.ascontiguousarray(np.moveaxis(cliff(), 0, axis))
    after = np.ascontiguousarray(np.moveaxis(slid(cliff()), 0, axis))
    whole = beside_cliffs(after, before, after, (0, 0), DROP)
    for south, west in ((1, 0), (0, 1), (3, 3)):
        part = np.s_[south:, west:]
        tile = beside_cliffs(after[part], before[part], after[part], (south, west), DROP)
        inner = np.s_[int(south > 0) :, int(west > 0) :]  # beyond the first is a coarser sample
        assert (tile[inner] == whole[part][inner]).all()


def test_what_stood_out_before_stands_out_as_far():
    before = np.full((9, 9), 100.0, np.float32)
    before[3, 3], before[5, 5] = 180.0, 30.0
    after = before - np.float32(20.0)
    assert (beside_cliffs(after, before, after, (0, 0), DROP) == after).all()
