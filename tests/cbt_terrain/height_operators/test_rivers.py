# SPDX-License-Identifier: GPL-3.0-or-later
"""Rivers: comparison with fastscapelib, boundaries, levels and artefacts of the grid."""

import fastscapelib
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.routing import route
from adaptive_terrain.cbt_terrain.height_operators import fluvial
from adaptive_terrain.cbt_terrain.height_operators.fluvial import step
from adaptive_terrain.cbt_terrain.height_operators.height_operator import OperatorGround
from adaptive_terrain.cbt_terrain.height_operators.levels import apply_by_levels
from adaptive_terrain.cbt_terrain.height_operators.rivers import RIVERS
from river_grounds import aged, bed_of, grow, rough

PLAIN = {"hillslope": 0.0, "creep": 0.0, "variety": 0.0, "deposition": 0.0, "steepest": 89.9, "sea": -9000.0}
LAYERS = ("sediment", "wear", "flow")


@pytest.fixture
def still(monkeypatch):
    """Select receivers without noise."""
    monkeypatch.setattr(fluvial, "JITTER", 0.0)


@pytest.mark.parametrize("years", [1e3, 1e5])
def test_heights_are_fastscapelibs_where_there_are_no_pits(still, years):
    """float32 agrees with its float64 to 1e-3 m."""
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


def test_the_change_is_uplift_less_wear_plus_sediment():
    h = rough(90, 130)
    made = aged(h, 20.0, years=2e5, rise=1e-4)
    y, x = np.indices(h.shape)
    far = [np.clip(np.minimum(at, n - 1 - at) / (0.15 * 89), 0, 1) for at, n in ((y, 90), (x, 130))]
    lift = np.where(h > 0, 1e-4 * 2e5, 0) * np.prod([3 * a**2 - 2 * a**3 for a in far], axis=0)
    expected = lift - made.layers["wear"] + made.layers["sediment"]
    assert np.allclose(made.heights, expected, atol=0.01) or np.abs(made.heights - expected).max() < 0.01
    assert all((made.layers[name] >= 0).all() and made.layers[name].dtype == np.float32 for name in LAYERS)


def test_sea_holes_and_masked_ground_do_not_change():
    h = rough(131, 97)
    missing, mask = np.zeros(h.shape, bool), np.ones(h.shape, np.float32)
    missing[60:70, 50:66] = True
    mask[:, :20], mask[:, 20:30] = 0.0, 0.5
    made = aged(h, 20.0, mask=mask, missing=missing, rise=1e-4)
    still = (h <= 0) | missing | (mask == 0)
    assert not made.heights[still].any() and np.abs(made.heights[~still]).mean() > 5
    assert not made.layers["wear"][still].any() and (h + made.heights)[h > 0].min() >= 0
    assert not any(a.any() for a in (aged(h, 20.0, years=0.0).heights, aged(h, 20.0, years=0.0).layers["wear"]))


def test_borders_are_no_dams():
    """A valley is cut through the border as deep as inside, but not below the border's lowest sample, and a border
    never rises."""
    y, x = np.indices((80, 120))
    h = (50 + 1.0 * np.abs(x - 60) + 0.5 * y + 3 * np.random.default_rng(0).random((80, 120))).astype(np.float32)
    h[-1, 5] = 20.0
    made = aged(h, 30.0)
    assert made.heights[0, 55:66].mean() < -5
    after = np.maximum(h[0] + np.minimum(made.heights[1], 0), 20.0)
    assert np.allclose((h + made.heights)[0, 1:-1], after[1:-1], atol=1e-3) and not made.heights[-1, 5]
    assert (aged(h, 30.0, rise=5e-4).heights[[0, -1]] <= 0).all()


@pytest.mark.parametrize("shape", [(60, 84), (61, 85), (61, 84)])
def test_land_rises_alike_at_every_level(shape):
    """Uplift of level ground without erosion is the same at a coarser level, whose last samples may be outside."""
    values = RIVERS.defaults() | {"rise": 1e-3, "erodibility": 0.0, "creep": 0.0, "variety": 0.0, "steepest": 89.0}
    size = (shape[0] - 1) * 35.0, (shape[1] - 1) * 20.0
    fine, coarse = (
        RIVERS.apply(
            OperatorGround(np.full(some, 5.0, np.float32), step * 20.0, step * 35.0, whole=some, size=size),
            values,
            None,
        )
        for some, step in ((shape, 1), ((shape[0] // 2 + 1, shape[1] // 2 + 1), 2))
    )
    inner = fine.heights[2:-2:2, 2:-2:2]
    off = abs(inner - coarse.heights[1 : 1 + inner.shape[0], 1 : 1 + inner.shape[1]])
    assert fine.heights.max() > 290.0 and off.max() < 1e-3


def test_uplift_leaves_no_cliff_at_the_border():
    """After an uplift of 500 m the outer tenth of a plain is as even as the inside."""
    h = (100 + np.random.default_rng(7).random((200, 260))).astype(np.float32)
    after = h + aged(h, 50.0, years=1e6, rise=5e-4, erodibility=1e-6).heights
    profile = after[:, 60:-60].mean(axis=1)
    assert profile.max() - profile[0] > 250 and abs(after[0] - h[0]).max() < 5
    assert np.diff(profile)[:4].max() < 0.25 * 50 and np.diff(profile[:20]).max() > 2 * np.diff(profile)[:2].max()


def test_valleys_do_not_follow_the_grid():
    """On a round island, chords of 8 samples along valleys are within 5.6 degrees of the eight directions, a quarter of
    all, about as often as elsewhere. Without noise and diffusion the fraction is 0.40."""
    size = 601
    y, x = np.indices((size, size)) - size // 2
    h = np.where(np.hypot(y, x) < 282, 5 + np.random.default_rng(1).random((size, size)), -5).astype(np.float32)
    made = grow(h, np.full(h.shape, 5e-4, np.float32), 20.0, years=2e6, hillslope=4e4, creep=1e-3)
    after = (h + made.heights).astype(np.float64)
    ways = [(j, i) for j in (-1, 0, 1) for i in (-1, 0, 1) if j or i]
    fall = np.stack([(after - np.roll(after, (-j, -i), (0, 1))) / np.hypot(j, i) for j, i in ways])
    steepest = np.array([j * size + i for j, i in ways])[fall.argmax(axis=0)]
    down = np.where(fall.max(axis=0) > 0, steepest, 0).reshape(-1)
    start = end = np.flatnonzero(made.layers["flow"].reshape(-1) > 2.5e5)
    for _ in range(8):
        end = end + down[end]
    (north, east), whole = np.divmod(end, size) - np.array(np.divmod(start, size)), down[end] != 0
    turn = np.degrees(np.arctan2(north, east))[whole] % 45
    assert len(turn) > 3000 and np.mean(np.minimum(turn, 45 - turn) < 5.625) < 0.3


def test_rills_run_down_their_slope():
    """On twelve rough planes rills turn to the nearest diagonal of the grid by 1.4 degrees in the mean; 4.6 if
    diagonals counted fully in the choice of receivers."""
    turns = []
    y, x = np.indices((220, 220)) * 8.0
    for seed, degrees in enumerate((10, 15, 20, 25, 30, 35, 55, 60, 65, 70, 75, 80)):
        turn = np.radians(degrees)
        noise = 2 * np.random.default_rng(seed).random(x.shape)
        h = (2000 - x * np.cos(turn) - y * np.sin(turn) + noise).astype(np.float32)
        after = h + aged(h, 8.0, seed=seed, years=1e5, creep=1e-3, steepest=40.0).heights
        v, u = (a[50:-50, 50:-50].astype(np.float64) for a in np.gradient(after))
        fall = np.degrees(np.arctan2(-v.mean(), -u.mean()))
        u, v = u - u.mean(), v - v.mean()
        across = 0.5 * np.degrees(np.arctan2(2 * (u * v).mean(), (u * u - v * v).mean()))  # of the rills
        off = (across + 90 - fall + 90) % 180 - 90
        turns.append(off if degrees < 45 else -off)
    assert abs(np.mean(turns)) < 2.5


def test_valleys_run_down_their_slope_with_uneven_steps():
    """On planes with samples 15 m and 5 m apart, the direction of 200 m downstream is 8 degrees rms off the fall;
    15 if slopes along both axes counted alike."""
    step_x, step_y, n = 15.0, 5.0, 117
    y, x = np.indices((351, n)) * np.array([step_y, step_x])[:, None, None]
    inside = (np.minimum(x, 1740 - x) > 400) & (np.minimum(y, 1750 - y) > 400)
    off = []
    for degrees in range(6, 360, 58):
        turn, noise = np.radians(degrees), 2 * np.random.default_rng(degrees).random(x.shape)
        h = (3000 - x * np.cos(turn) - y * np.sin(turn) + noise).astype(np.float32)
        values = RIVERS.defaults() | {"years": 1e5, "creep": 1e-3, "steepest": 40.0}
        made = apply_by_levels(RIVERS, OperatorGround(h, step_x, step_y, seed=degrees), values)
        to = route(h + made.heights.astype(np.float32), step_x, step_y).to.astype(int)
        start = end = np.flatnonzero((made.layers["flow"] > 3e3) & inside)
        gone = np.zeros(len(start))
        while (gone < 200).any():
            north, east = to[end] // 3 - 1, to[end] % 3 - 1
            end = np.where(gone < 200, end + north * n + east, end)
            gone = np.where(gone < 200, gone + np.hypot(north * step_y, east * step_x), gone)
        north, east = np.divmod(end, n) - np.array(np.divmod(start, n))
        off.append(np.degrees(np.arctan2(north.mean() * step_y, east.mean() * step_x)) - degrees)
    off = (np.array(off) + 180) % 360 - 180
    assert np.sqrt(np.mean(off**2)) < 11.0, off


def test_incision_of_a_steady_range_equals_the_uplift(still):
    """K (A + A0)^(1/2) S is the uplift wherever water runs."""
    rng = np.random.default_rng(5)
    start, spacing = (1 + rng.random((70, 90))).astype(np.float32), 100.0
    uplift = np.full(start.shape, 5e-4, np.float32)
    kept = {"hillslope": 5e3, "creep": 0.0, "variety": 0.0, "deposition": 0.0, "steepest": 89.0}
    h = start + grow(start, uplift, spacing, years=30e6, **kept).heights
    drainage = route(h, spacing, spacing, cell_weight=np.ones(h.shape))
    area, to = drainage.catchments * spacing**2, drainage.to.astype(int)
    at = np.flatnonzero(to != 4)
    other = at + (to[at] // 3 - 1) * 90 + to[at] % 3 - 1
    away = spacing * np.where(to[at] % 2, 1.0, 2**0.5)
    slope = (h.reshape(-1)[at].astype(np.float64) - h.reshape(-1)[other]) / away
    rate = 1e-5 * np.sqrt(area[at] + 5e3) * slope
    assert np.quantile(np.abs(rate / 5e-4 - 1), 0.98) < 0.01


def test_the_floors_of_lakes_are_smooth():
    """Metres of sediment in a bowl deviate by 1 cm rms from the mean of their neighbours; 18 cm without settling."""
    y, x = np.indices((170, 190))
    noise = np.random.default_rng(0).random(x.shape)
    h = (100 + 0.8 * np.hypot(x - 95, y - 85) + 2 * noise).astype(np.float32)
    made = aged(h, 4.0, years=1e5, variety=0.0)
    after = (h + made.heights).astype(np.float64)
    bend = after[1:-1, 1:-1] - 0.25 * (after[:-2, 1:-1] + after[2:, 1:-1] + after[1:-1, :-2] + after[1:-1, 2:])
    deep = made.layers["sediment"][1:-1, 1:-1] > 3
    assert deep.sum() > 2000 and np.sqrt(np.mean(bend[deep] ** 2)) < 0.03


def test_the_knobs_of_a_steep_slope_do_not_melt():
    """0.58 of the curvature of a rough slope of 45 degrees is left after 100,000 years; 0.30 if it were diffused as
    the noise of receivers is."""
    y, x = np.indices((160, 301))
    knobs = 20 * np.cos(2 * np.pi * x / 7) * np.cos(2 * np.pi * y / 7)
    h = (100 + 20 * y + knobs + np.random.default_rng(0).random(x.shape)).astype(np.float32)
    after = h + aged(h, 20.0, years=1e5).heights

    def bends(z):
        z = z.astype(np.float64)
        return (z[2:, 1:-1] + z[:-2, 1:-1] + z[1:-1, 2:] + z[1:-1, :-2] - 4 * z[1:-1, 1:-1])[20:-20, 20:-20]

    assert np.sum(bends(h) * bends(after)) > 0.5 * np.sum(bends(h) ** 2)
