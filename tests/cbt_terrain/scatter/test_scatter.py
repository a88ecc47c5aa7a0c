# SPDX-License-Identifier: GPL-3.0-or-later
"""Scatter: caches, squares and threads do not change the points of any place."""

import math
from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.splat_rules import Layer, Rule, image_rule
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.heightfield import with_detail
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.scatter.points import scatter_points
from adaptive_terrain.cbt_terrain.scatter.scatter import Scatter
from adaptive_terrain.cbt_terrain.scatter.tile import POINTS, UNITS, tile
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, View
from fields import rough
from scatter_by_hand import grown_by_hand, heights_by_hand, places_by_hand, wanted_by_hand
from scattered_frames import ScatteredFrames

SHAPE = 70, 101  # of a raster that fits no lattice
SCATTER = Scatter(spacing=8.0, full_until=150.0, variation=0.0, margin_deg=0.0, seed=3)
NEAR = View.look((-420.0, -300.0, 160.0), (0, 0, 0), resolution=(640, 360), clip=(1.0, 700.0))
VIEWS = {
    "perspective": [NEAR],
    "two": [NEAR, View.look((300.0, 350.0, 90.0), (-50, 0, 20), fov_deg=20)],
    "orthographic": [View.look((0, 0, 900.0), (50, 20, 0), kind=ORTHOGRAPHIC, ortho_width=400.0, clip=(1, 2000))],
    "panorama": [View.look((30.0, -40.0, 120.0), (100, 0, 0), kind=PANORAMIC, fov_deg=360, resolution=(800, 400))],
    "none": [],
}


def turned_and_scaled():
    c, s = math.cos(0.7), math.sin(0.7)
    turn = np.array([[c, -s, 0, 40.0], [s, c, 0, -25.0], [0, 0, 1, 12.0], [0, 0, 0, 1]])
    return turn @ np.diag([1.2, 0.8, 1.5, 1.0])


@pytest.fixture(scope="module")
def field():
    return rough(*SHAPE)


@pytest.fixture(scope="module")
def by_hand(field):
    return places_by_hand(field, SCATTER)


def arrays(points):
    parts = points.positions, points.normals, points.size, points.id, points.variant, points.rotation
    return [part.tobytes() for part in parts]


@pytest.mark.parametrize(
    "placement",
    [pytest.param(np.eye(4), marks=pytest.mark.thorough, id="plain"), pytest.param(turned_and_scaled(), id="turned")],
)
@pytest.mark.parametrize("views", VIEWS.values(), ids=VIEWS)
def test_the_points_equal_those_of_a_test_by_hand(field, by_hand, views, placement):
    """Compare ids, positions and sizes; only points within a centimetre of a frame's border or at their first size may
    differ."""
    points = scatter_points(
        field, SCATTER, views, placement=placement, vertical_scale=0.7, vertical_offset=5.0, threads=2
    )
    ids, rank, plan = by_hand
    there = np.column_stack([plan, heights_by_hand(field, plan, 0.7, 5.0)])
    want, clearance = wanted_by_hand(SCATTER, there, views, placement)
    sure = (clearance > 1e-2) & (np.abs(1.25 * want - rank) > 1e-6)
    assert np.array_equal(np.setdiff1d(points.id, ids[~sure]), np.sort(ids[sure & (1.25 * want > rank)]))
    number = np.searchsorted(ids, points.id)
    assert np.abs(points.positions - there[number]).max() < 0.02  # lattice units are 2.4 mm
    whole = sure[number]
    assert np.abs(points.size - grown_by_hand(want, rank)[number])[whole].max() < 2e-3
    assert len(points) > 100 and len(np.unique(points.id)) == len(points)


def test_a_frame_alone_is_a_frame_of_a_sequence_on_any_threads(field, eager_threads):
    """A flight there and back with a jump, and the same frames each by itself, on one, two and five threads."""
    scatter = replace(SCATTER, where=Layer("Steep", (Rule("slope", low=0.2, edge=0.2),)))
    rows = [ScatteredFrames(field, scatter, threads=threads) for threads in (1, 2, 5)]
    for k in (0, 1, 2, 30, 2, 1):
        view = View.look((-420.0 + 9 * k, -300.0 + 5 * k, 160.0), (2 * k, 0, 0))
        alone = arrays(scatter_points(field, scatter, [view], threads=1))
        assert all(arrays(row.points([view])) == alone for row in rows)


def test_cached_candidates_are_used_again(field):
    scatterer, moved = ScatteredFrames(field, SCATTER), View.look((-419.9, -300.0, 160.0), (0, 0, 0), clip=(1.0, 700.0))
    scatterer.points([NEAR])
    with launch.stopwatch() as ms:
        scatterer.points([moved])
    assert "choose" in ms and "place" not in ms


def test_points_keep_within_a_margin_of_the_frame(field):
    plain = scatter_points(field, SCATTER, [NEAR])
    for wider in (replace(SCATTER, margin_deg=10.0), replace(SCATTER, margin_m=30.0)):
        more = scatter_points(field, wider, [NEAR])
        assert len(more) > 1.1 * len(plain) and np.isin(plain.id, more.id).all()


def test_no_point_is_in_a_hole_or_outside_of_the_border():
    rng = np.random.default_rng(5)
    raster = (20 * rng.random((33, 47))).astype(np.float32)
    raster[8:14, 20:31] = np.nan
    field = from_array(raster, 10.0, holes=True)
    points = scatter_points(field, Scatter(spacing=2.0), threads=2)
    x, y = points.positions[:, 0] / 10 + 23, points.positions[:, 1] / 10 + 16
    assert x.min() >= 0 and x.max() <= 46 and y.min() >= 0 and y.max() <= 32
    i, j = np.minimum(x.astype(int), 45), np.minimum(y.astype(int), 31)
    bad = np.isnan(raster)
    holes = bad[:-1, :-1] | bad[:-1, 1:] | bad[1:, :-1] | bad[1:, 1:]
    assert not holes[j, i].any()
    assert len(points) == pytest.approx((~holes).sum() * 100 / 4, rel=0.02)


def test_points_stand_on_the_surface_that_the_terrain_has(field):
    """Bicubic and with detail: at the corners of its cells the raster's own heights; normals as the heights differ."""
    smooth = interpolated(field, "bicubic")
    for ground in (smooth, with_detail(field, Detail(3.0, 20.0))):
        points = scatter_points(ground, Scatter(spacing=3.0))
        plain = heights_by_hand(field, points.positions[:, :2].astype(float))
        most = 3.0 if ground.detail else field.lattice.step_x
        off = np.abs(points.positions[:, 2] - plain)
        assert 0.2 < off.max() <= most
        assert np.abs(np.linalg.norm(points.normals, axis=1) - 1).max() < 1e-6


def test_density_follows_rules_layers_and_paint(field):
    """As many whole points as the mean of the density says, a quarter more that grow; none where it is 0."""
    image = np.zeros((8, 8), np.float32)
    image[:, 4:] = 1.0
    base = Scatter(spacing=2.0, variation=0.0)
    everywhere = len(scatter_points(field, base))
    half = scatter_points(field, replace(base, where=Layer("East", (image_rule(image),))))
    assert half.positions[:, 0].min() > -0.07 * 1000
    assert len(half) == pytest.approx(everywhere / 2, rel=0.03)
    thin = scatter_points(field, replace(base, where=Layer("Thin", strength=0.3)))
    assert len(thin) == pytest.approx(0.375 * everywhere, rel=0.01)
    assert (thin.size == 1.0).sum() == pytest.approx(0.3 * everywhere, rel=0.05)
    assert thin.tested < 0.5 * half.tested  # what no rule can add is not looked at
    grass = Layer("Grass"), Layer("Rock", (Rule("slope", low=0.35),), on_top=True)
    on = [scatter_points(field, replace(base, layers=grass, on=k)) for k in (0, 1)]
    assert len(np.intersect1d(on[0].id, on[1].id)) < 0.02 * everywhere
    assert sum(map(len, on)) == pytest.approx(everywhere, rel=0.02)
    steepness = [np.arccos(points.normals[:, 2]).mean() for points in on]
    assert steepness[1] > steepness[0] + 0.1


def test_rotations_align_points_with_the_normal(field):
    points = scatter_points(field, Scatter(spacing=5.0, align=0.6))
    w, x, y, z = points.rotation.astype(float).T
    up = np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z])
    mix = 0.6 * points.normals.astype(float) + (0, 0, 0.4)
    assert np.abs(up - mix / np.linalg.norm(mix, axis=1)[:, None]).max() < 1e-5
    turn = np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z)
    assert np.histogram(turn, 8, (-math.pi, math.pi))[0].min() > 0.1 * len(turn)


def test_seeds_and_variants_differ(field):
    one, other = (scatter_points(field, Scatter(spacing=8.0, variation=0.5, seed=seed)) for seed in (1, 2))
    assert 0.5 < one.size.min() < 0.52 and 1.48 < one.size.max() < 1.5
    assert np.unique(one.variant).size > 0.99 * len(one) and one.variant.min() >= 0
    share = np.bincount(one.variant % 3) / len(one)
    assert np.abs(share - 1 / 3).max() < 0.03
    distance = np.abs(one.positions[:, None, :2] - other.positions[None, ::40, :2]).max(axis=2).min(axis=0)
    assert np.median(distance) > 0.3


@pytest.mark.parametrize("count", [64, 400, POINTS])
def test_every_prefix_of_the_tile_keeps_apart_and_is_no_lattice(count):
    """Measure distances to the nearest point of nine tiles in units of the densest packing."""
    place = tile().place[:count].astype(np.float64) / UNITS
    some = place[:: max(1, count // 200)]
    apart = np.abs(some[:, None] - place)
    squared = (np.minimum(apart, 1 - apart) ** 2).sum(axis=2)
    squared[squared == 0] = 2
    distance = np.sqrt(squared.min(axis=1)) / math.sqrt(2 / (math.sqrt(3) * count))
    assert distance.min() > 0.55 and 0.75 < distance.mean() < 0.88
    assert distance.std() > 0.05  # all equal in a lattice


def test_windows_have_the_ranks_of_their_parts_of_the_tile():
    """Yield the squares of each halving that begin at a multiple of an eighth or of their side."""
    own = tile()
    for halvings, starts in enumerate((1, 8, 8, 8, 16)):
        order, ends = own.order[halvings], own.first[halvings]
        for window in range(starts**2):
            row, column = divmod(window, starts)
            within = ((own.place / UNITS - np.array([column, row]) / starts) % 1 < 0.5**halvings).all(axis=1)
            assert np.array_equal(order[ends[window] : ends[window + 1]], np.flatnonzero(within))
    square, shift = np.array([[3, 0], [1, 1]]), np.array([[1, 7], [5, 2]])
    assert own.windows(np.array([4, 1]), square, shift).tolist() == [2 * 16 + 1, 2 * 8 + 7]


@pytest.mark.parametrize("few, tiles", [(1, 24), pytest.param(4, 16, marks=pytest.mark.thorough), (64, 4)])
def test_a_thin_scatter_neither_repeats_nor_has_close_points(few, tiles):
    """In tiles seen from far above, hardly any points coincide with those moved by a tile, by half a tile or by both.
    They keep the distance of points inside a tile, and few are missing."""
    field, above = from_array(np.zeros((9, 9), np.float32), 16.0 * tiles), View.look((0, 0, 1e6), (0, 0, 0), fov_deg=1)
    scatter = Scatter(spacing=1.0, variation=0.0, seed=few, full_until=1e6 * math.sqrt(few / POINTS))
    points = scatter_points(field, scatter, [above])
    place = points.positions[points.size == 1.0, :2].astype(np.float64)
    moves = 128 * np.array([(0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (0, 3), (0.5, 0), (0.5, 1)])
    apart2 = np.full((len(moves), len(place)), np.inf)
    for first in range(0, len(place), 500):
        away = place[first : first + 500, None] - place
        for move, nearest in zip(moves, apart2, strict=True):
            squared = ((away - move) ** 2).sum(axis=2)
            squared[squared == 0.0] = np.inf if not move.any() else 0.0
            nearest[first : first + 500] = squared.min(axis=1)
    same = (apart2[1:] < 0.05**2).mean(axis=1)
    assert same.max() < 0.05
    distance = np.sqrt(apart2[0]) / (128 * math.sqrt(2 / (math.sqrt(3) * few)))
    assert distance.min() > 0.55 and distance.mean() > 0.75
    assert len(place) == pytest.approx(few * tiles**2, rel=0.1 if few == 64 else 0.5)


@pytest.mark.parametrize(
    "wrong, said",
    [
        ({"spacing": 0.0}, "spacing is 0.0; expected 0.0001"),
        ({"spacing": math.nan}, "spacing is nan"),
        ({"full_until": -1.0}, "full_until is -1.0"),
        ({"variation": 2.0}, "variation is 2.0; expected 0 .. 1"),
        ({"seed": -1}, "seed is -1"),
        ({"on": 0}, "stands on splat layer 0, and there are 0"),
        ({"where": Layer("A", (Rule("colour"),))}, "rule about 'colour'"),
    ],
)
def test_invalid_scatters_are_refused(wrong, said):
    with pytest.raises(TerrainError, match=said):
        Scatter(**wrong)


def test_too_many_points_are_refused(field):
    with pytest.raises(TerrainError, match="more than 67,108,864 points in view"):
        scatter_points(field, Scatter(spacing=0.05))
    with pytest.raises(TerrainError, match="finer than a mesh can hold"):
        scatter_points(from_array(np.zeros((5, 5), np.float32), 1e6), Scatter(spacing=1e-4))


def test_damaged_heights_are_refused(field):
    samples = field.samples.copy()
    samples[30, 40] = np.inf
    with pytest.raises(TerrainError, match="not finite"):
        scatter_points(field.with_raster(samples=samples), SCATTER)
