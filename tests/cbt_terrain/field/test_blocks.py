# SPDX-License-Identifier: GPL-3.0-or-later
"""Pyramids of blocks that are filled some rows at a time."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field import blocks


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (9, 4), (33, 20), (64, 5)])
@pytest.mark.parametrize("reduce", [np.maximum, np.minimum])
def test_rows_at_a_time_give_the_same_levels(shape, reduce, monkeypatch):
    finest = np.random.default_rng(1).standard_normal(shape).astype(np.float32)
    levels = blocks.halvings(finest, reduce)
    assert [level.shape for level in levels] == blocks.level_shapes(*shape)
    assert levels[-1][0, 0] == (finest.max() if reduce is np.maximum else finest.min())
    found, first, wide = blocks.concatenate_levels(levels, 2)
    assert first.tolist()[2:] == np.cumsum([0, *(level.size for level in levels[:-1])]).tolist()
    monkeypatch.setattr(blocks, "ROWS", 4)
    filled = np.zeros(len(found), np.float32)
    blocks.fill_levels(filled, *shape, reduce, lambda rows: finest[rows])
    assert filled.tobytes() == found.tobytes() and wide[2:].tolist() == [level.shape[1] for level in levels]
