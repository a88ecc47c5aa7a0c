# SPDX-License-Identifier: GPL-3.0-or-later
"""Lakes at a finer level have the outlets of the coarser one."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.height_operators.height_operator import OperatorGround
from adaptive_terrain.cbt_terrain.height_operators.levels import coarser, interpolate_change
from adaptive_terrain.cbt_terrain.height_operators.rivers import RIVERS

VALUES = RIVERS.defaults() | {"years": 1e5, "variety": 0.0}


def bowl():
    """Return 201 x 301 samples of a lake on a plateau that falls to both sides. The pass in the west is 11 m higher
    than that in the east, which is between every second sample."""
    y, x = np.indices((201, 301))
    h = 260.0 - 0.3 * np.abs(x - 150) + 0.05 * np.random.default_rng(2).random(x.shape)
    away = np.hypot(x - 150, y - 100)
    h += np.where(away < 60, 0.02 * (away**2 - 60**2), 30 * np.exp(-(((away - 60) / 8) ** 2)))
    h[98:103, 70:98] = np.minimum(h[98:103, 70:98], 248.0 + 0.1 * (np.arange(70, 98) - 98))
    h[101, 202:230] = np.minimum(h[101, 202:230], 237.0 - 0.1 * (np.arange(202, 230) - 202))
    return h.astype(np.float32)


def flows(h, coarse):
    """Return the drainage areas of the western and the eastern pass at the finer level in samples."""
    ground = OperatorGround(h, 10.0, 9.0, whole=(601, 601))
    flow = RIVERS.apply(ground, VALUES, coarse).layers["flow"] / 90.0
    return flow[90:112, 80].max(), flow[90:112, 220].max()


@pytest.fixture(scope="module")
def coarse():
    below = RIVERS.apply(OperatorGround(coarser(bowl()), 20.0, 18.0, whole=(301, 301), level=1), VALUES, None)
    return interpolate_change(below, (201, 301))


def test_a_lake_has_the_outlet_of_the_coarser_level(coarse):
    west, east = flows(bowl(), coarse)
    assert west > 8000 and east < 2000


def test_without_keep_outlets_the_lower_pass_is_the_outlet(coarse, monkeypatch):
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.height_operators.lake_outlets.keep_outlets", lambda *_: None)
    west, east = flows(bowl(), coarse)
    assert west < 2000 and east > 8000


def test_a_gorge_below_the_lake_drains_it(coarse):
    """It is between every second sample and deeper than the lake."""
    h = bowl()
    h[101, 150:] = np.minimum(h[101, 150:], 180.0 - 0.1 * (np.arange(150, 301) - 150))
    assert flows(h, coarse)[1] > 8000


def test_a_dam_between_two_coarser_samples_is_breached(coarse):
    """It is one sample wide and 12 m high, on the western pass, where rivers erode for a year only."""
    h = bowl()
    h[94:107, 81] += 12.0
    made = RIVERS.apply(OperatorGround(h, 10.0, 9.0, whole=(601, 601)), VALUES | {"years": 1.0}, coarse)
    after = h + made.heights
    assert after[98:103, 81].min() < after[98:103, 80].min() + 1.0
