# SPDX-License-Identifier: GPL-3.0-or-later
"""Lakes at a finer level leave where they left at the coarser one."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.land_effects import rivers
from adaptive_terrain.cbt_terrain.land_effects.land_effect import Ground
from adaptive_terrain.cbt_terrain.land_effects.levels import coarser, finer
from adaptive_terrain.cbt_terrain.land_effects.rivers import RIVERS

VALUES = RIVERS.defaults() | {"years": 1e5, "variety": 0.0}


def bowl():
    """201 x 301 samples: a lake on a plateau that falls to both sides. The pass in the west is 11 m higher than that
    in the east, which lies between every second sample."""
    y, x = np.indices((201, 301))
    h = 260.0 - 0.3 * np.abs(x - 150) + 0.05 * np.random.default_rng(2).random(x.shape)
    away = np.hypot(x - 150, y - 100)
    h += np.where(away < 60, 0.02 * (away**2 - 60**2), 30 * np.exp(-(((away - 60) / 8) ** 2)))
    h[98:103, 70:98] = np.minimum(h[98:103, 70:98], 248.0 + 0.1 * (np.arange(70, 98) - 98))
    h[101, 202:230] = np.minimum(h[101, 202:230], 237.0 - 0.1 * (np.arange(202, 230) - 202))
    return h.astype(np.float32)


def flows(h, coarse):
    """Samples that drain over the western and over the eastern pass at the finer level."""
    ground = Ground(h, 10.0, 9.0, whole=(601, 601))
    flow = RIVERS.apply(ground, VALUES, coarse).layers["flow"] / 90.0
    return flow[90:112, 80].max(), flow[90:112, 220].max()


@pytest.fixture(scope="module")
def coarse():
    below = RIVERS.apply(Ground(coarser(bowl()), 20.0, 18.0, whole=(301, 301), level=1), VALUES, None)
    parts = ({name: finer(a, (201, 301)) for name, a in of.items()} for of in (below.layers, below.kept))
    return type(below)(finer(below.heights, (201, 301)), *parts)


def test_a_lake_leaves_as_at_the_coarser_level(coarse):
    west, east = flows(bowl(), coarse)
    assert west > 8000 and east < 2000


def test_without_that_it_would_leave_over_the_lower_pass(coarse, monkeypatch):
    monkeypatch.setattr(rivers, "keep_outlets", lambda *_: None)
    west, east = flows(bowl(), coarse)
    assert west < 2000 and east > 8000


def test_water_that_has_another_way_far_below_is_not_held_back(coarse):
    """A gorge between every second sample, deeper than the lake: it is no lake any more."""
    h = bowl()
    h[101, 150:] = np.minimum(h[101, 150:], 180.0 - 0.1 * (np.arange(150, 301) - 150))
    assert flows(h, coarse)[1] > 8000


def test_a_dam_between_two_coarser_samples_holds_no_lake(coarse):
    """Of one sample's width across the western pass, 12 m high, where rivers work for a year only."""
    h = bowl()
    h[94:107, 81] += 12.0
    made = RIVERS.apply(Ground(h, 10.0, 9.0, whole=(601, 601)), VALUES | {"years": 1.0}, coarse)
    after = h + made.heights
    assert after[98:103, 81].min() < after[98:103, 80].min() + 1.0
