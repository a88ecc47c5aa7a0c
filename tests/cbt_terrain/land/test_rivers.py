# SPDX-License-Identifier: GPL-3.0-or-later
"""Rivers: against fastscapelib, and what they must leave alone."""

import fastscapelib
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.effects.routing import route
from adaptive_terrain.cbt_terrain.land import fluvial
from adaptive_terrain.cbt_terrain.land.fluvial import step
from adaptive_terrain.cbt_terrain.land.rivers import RIVERS, grow
from river_grounds import aged, bed_of, rough

PLAIN = {"hillslope": 0.0, "creep": 0.0, "variety": 0.0, "deposition": 0.0, "steepest": 89.9, "sea": -9000.0}
LAYERS = ("sediment", "wear", "flow")


@pytest.fixture
def still(monkeypatch):
    """Receivers without noise."""
    monkeypatch.setattr(fluvial, "JITTER", 0.0)


@pytest.mark.parametrize("years", [1e3, 1e5])
def test_heights_are_fastscapelibs_where_there_are_no_pits(still, years):
    """And so float32 gives what its float64 does, to 1e-3 m."""
    rows, columns, step_x, step_y = 97, 121, 32.0, 27.0
    y, x = np.indices((rows, columns))
    cone = 1000 - np.hypot((x - 60) * step_x, (y - 48) * step_y) / 4
    h = (cone + 4 * np.random.default_rng(3).random((rows, columns))).astype(np.float32)
    assert np.array_equal(route(h, step_x, step_y).filled(), h.reshape(-1)), "no pits"
    grid = fastscapelib.RasterGrid([rows, columns], [step_y, step_x], fastscapelib.NodeStatus.FIXED_VALUE)
    graph = fastscapelib.FlowGraph(grid, [fastscapelib.SingleFlowRouter()])
    eroder = fastscapelib.SPLEroder(graph, k_coef=1e-5, area_exp=0.5, slope_exp=1.0, tolerance=1e-6)
    expected, area = h.astype(np.float64), np.empty(h.shape)
    bed = bed_of(h, step_x, step_y)
    for number in range(3):
        graph.update_routes(expected)
        graph.accumulate(area, 1.0)
        expected -= eroder.erode(expected, area, years)
        step(bed, years, RIVERS.defaults() | PLAIN | {"erodibility": 1e-5}, number)
    # Where two ways down are about as steep, rounding decides.
    off = np.abs(bed.heights.reshape(h.shape) - expected)
    assert np.mean(np.abs(expected - h)) > (0.5 if years == 1e3 else 50) and np.quantile(off, 0.995) < 1e-3


def test_rock_worn_and_sediment_make_up_the_change():
    h = rough(90, 130)
    made = aged(h, 20.0, years=2e5, rise=1e-4)
    lift = np.where(h > 0, 1e-4 * 2e5, 0)
    lift[[0, -1]] = lift[:, [0, -1]] = 0
    expected = lift - made.layers["wear"] + made.layers["sediment"]
    assert np.allclose(made.heights, expected, atol=0.01) or np.abs(made.heights - expected).max() < 0.01
    assert all((made.layers[name] >= 0).all() and made.layers[name].dtype == np.float32 for name in LAYERS)


def test_the_sea_holes_and_what_is_masked_stay():
    h = rough(131, 97)
    missing, mask = np.zeros(h.shape, bool), np.ones(h.shape, np.float32)
    missing[60:70, 50:66] = True
    mask[:, :20], mask[:, 20:30] = 0.0, 0.5
    made = aged(h, 20.0, mask=mask, missing=missing, rise=1e-4)
    still = (h <= 0) | missing | (mask == 0)
    assert not made.heights[still].any() and np.abs(made.heights[~still]).mean() > 5
    assert not made.layers["wear"][still].any() and (h + made.heights)[h > 0].min() >= 0
    assert not any(a.any() for a in (aged(h, 20.0, years=0.0).heights, aged(h, 20.0, years=0.0).layers["wear"]))


def test_rims_are_no_dams():
    """A valley that leaves the raster is cut through its rim, as deep as beside it, if not below the lowest; a rim
    never rises."""
    y, x = np.indices((80, 120))
    h = (50 + 1.0 * np.abs(x - 60) + 0.5 * y + 3 * np.random.default_rng(0).random((80, 120))).astype(np.float32)
    h[-1, 5] = 20.0
    made = aged(h, 30.0)
    assert made.heights[0, 55:66].mean() < -5
    after = np.maximum(h[0] + np.minimum(made.heights[1], 0), 20.0)
    assert np.allclose((h + made.heights)[0, 1:-1], after[1:-1], atol=1e-3) and not made.heights[-1, 5]
    assert (aged(h, 30.0, rise=5e-4).heights[[0, -1]] <= 0).all()


def test_a_steady_range_falls_as_the_uplift_asks(still):
    """K (A + A0)^(1/2) S is the uplift wherever water runs."""
    rng = np.random.default_rng(5)
    start, spacing = (1 + rng.random((70, 90))).astype(np.float32), 100.0
    uplift = np.full(start.shape, 5e-4, np.float32)
    kept = {"hillslope": 5e3, "creep": 0.0, "variety": 0.0, "deposition": 0.0, "steepest": 89.0}
    h = start + grow(start, uplift, spacing, years=30e6, **kept).heights
    drainage = route(h, spacing, spacing)
    area, to = drainage.catchments * spacing**2, drainage.to.astype(int)
    at = np.flatnonzero(to != 4)
    other = at + (to[at] // 3 - 1) * 90 + to[at] % 3 - 1
    away = spacing * np.where(to[at] % 2, 1.0, 2**0.5)
    slope = (h.reshape(-1)[at].astype(np.float64) - h.reshape(-1)[other]) / away
    rate = 1e-5 * np.sqrt(area[at] + 5e3) * slope
    assert np.quantile(np.abs(rate / 5e-4 - 1), 0.98) < 0.01
