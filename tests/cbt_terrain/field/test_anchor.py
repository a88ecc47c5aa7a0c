# SPDX-License-Identifier: GPL-3.0-or-later
"""An anchor: float32 positions relative to a point near the camera, on the same surface with the same results."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.measure import measure
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest, SamplePoints
from adaptive_terrain.cbt_terrain.attributes.evaluate import values_at
from adaptive_terrain.cbt_terrain.attributes.layered_detail import LayeredDetail, displaced
from adaptive_terrain.cbt_terrain.attributes.splat_rules import NOISE, SLOPE, Layer, Rule
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.heightfield import anchored, with_detail
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.query.rays import pick
from adaptive_terrain.cbt_terrain.scatter.points import scatter_points
from adaptive_terrain.cbt_terrain.scatter.scatter import Scatter
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from rasters import hills

STEP = 123.4  # metres; 8,193 samples are 1,011 km
ANCHOR = 499_712.0, 0.0


def country():
    """Return a strip of land 1,011 km long, whose coordinates are no multiples of a power of two."""
    return from_array(hills(8193, 5), STEP, STEP)


def seen_from(field, x: float, height: float = 900.0):
    """Return a view from above a point, in the space of `field`."""
    x -= field.lattice.anchor_x
    return View.look((x, -900.0, height), (x + 300.0, 0.0, 400.0), resolution=(640, 360), clip=(1.0, 1e6))


def errors_of_x(field, surface, within: float) -> np.ndarray:
    """Return how far x of vertices within `within` metres of the anchor is from its exact value, metres.

    Exact values are multiples of the finest edge from the raster's western border, computed in float64.
    """
    finest = STEP * 2.0 ** -(int(surface.level.max()) // 2 + 1)
    east = surface.positions[:, 0].astype(np.float64) + field.lattice.anchor_x
    border = 8192 / 2 * STEP
    exact = np.round((east + border) / finest) * finest - border
    near = np.abs(east - ANCHOR[0]) < within
    assert near.sum() > 100
    return np.abs(east - exact)[near]


def test_positions_near_the_anchor_are_exact_to_micrometres():
    plain = country()
    moved = anchored(plain, *ANCHOR)
    criterion = Criterion(error_px=1.0)
    found = [Terrain(field, 1).update(criterion, [seen_from(field, ANCHOR[0])]) for field in (plain, moved)]
    before, after = (
        errors_of_x(field, update.surface, 500.0) for field, update in zip((plain, moved), found, strict=True)
    )
    assert 0.01 < before.max() < 0.0157, "half a step of float32 is 15.6 mm at 500 km"
    assert after.max() < 2e-5
    assert found[1].bound_px <= found[0].bound_px


def test_leaves_and_heights_do_not_depend_on_the_anchor():
    plain = from_array(hills(40, 50), 100.0, 100.0)
    criterion = Criterion(error_px=2.0, error_m=6.0)
    for field in (plain, interpolated(plain, "bicubic"), with_detail(plain, Detail(5.0, 80.0, 0.5, 3))):
        base = interpolated(anchored(plain, 1024.0, -2048.0), field.interpolation)
        moved = with_detail(base, field.detail)
        a, b = (Terrain(f, 2).update(criterion, [View.look((-x, 900.0 - y, 1500.0), (-x, -y, 500.0))])
                for f, x, y in ((field, 0.0, 0.0), (moved, 1024.0, -2048.0)))  # fmt: skip
        assert np.array_equal(a.surface.triangles, b.surface.triangles)
        there = b.surface.positions.astype(np.float64) + (1024.0, -2048.0, 0.0)
        assert np.abs(there - a.surface.positions).max() < 2e-3
        assert np.abs(a.surface.normals - b.surface.normals).max() < 1e-4 and np.array_equal(a.surface.uv, b.surface.uv)


@pytest.mark.thorough
@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
@pytest.mark.parametrize("shape", [(9, 65), (27, 40)])
def test_bounds_hold_with_an_anchor(interpolation, shape):
    """Rounding by float32 is a large part: cells of 300 km, whose coordinates are up to 20,000 km from the anchor."""
    rng = np.random.default_rng(5)
    raster = (1e4 * rng.standard_normal(shape)).astype(np.float32)
    steps = 3.01e5, 2.73e5
    for x, y in ((0.44, 0.0), (-0.48, 0.3), (0.1, -0.43)):
        place = x * shape[1] * steps[0], y * shape[0] * steps[1]
        field = interpolated(anchored(from_array(raster, *steps), *place), interpolation)
        for error_m in (0.02, 900.0):
            update = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=error_m, max_triangles=40_000))
            found = measure(field, update.surface, random_points=20_000, threads=1)
            assert found.vertical_max_m <= update.bound_m


def test_an_anchor_is_inside_the_raster():
    field = from_array(hills(20, 20), 10.0, 10.0)
    for x, y in ((96.0, 0.0), (0.0, -1e9), (float("nan"), 0.0), (float("inf"), 0.0)):
        with pytest.raises(TerrainError, match="outside"):
            anchored(field, x, y)


def test_rounding_counts_by_the_distance_to_the_anchor():
    """The bound in a frame near the anchor is far below that of coordinates at the other end of the raster."""
    raster = np.tile(np.float32([0.0, 60.0]), (5, 4097))[:, :8193]
    plain = from_array(np.ascontiguousarray(raster), STEP, STEP)
    bounds = []
    for field in (plain, anchored(plain, *ANCHOR)):
        x = ANCHOR[0] - field.lattice.anchor_x
        view = View.look((x, 0.0, 40.0), (x + 1.0, 0.0, 0.0), fov_deg=20.0, resolution=(640, 360), clip=(1.0, 100.0))
        bounds.append(Terrain(field, 1).update(Criterion(error_px=0.2), [view]).terms_px.precision)
    assert bounds[1] < 0.02 * bounds[0]


def test_queries_attributes_and_scatters_follow_the_anchor():
    plain = with_detail(from_array(hills(60, 50), 100.0, 100.0), Detail(4.0, 60.0, 0.5, 7))
    raster = from_array(hills(60, 50), 100.0, 100.0)
    moved = with_detail(anchored(raster, 2048.0, -1024.0), plain.detail)
    away = np.array([2048.0, -1024.0])
    places = np.random.default_rng(1).uniform(-2400.0, 2400.0, (200, 2))
    heights, there = ground_at(plain, places).heights, ground_at(moved, places - away).heights
    assert np.abs(heights - there).max() < 1e-9
    rays = np.c_[places[:9], np.full(9, 5e3)], np.tile([0.1, 0.2, -1.0], (9, 1))
    hits = pick(plain, *rays).points, pick(moved, rays[0] - (*away, 0.0), rays[1]).points + (*away, 0.0)
    assert np.nanmax(np.abs(hits[0] - hits[1])) < 1e-6
    requests = [AttributeRequest(name, ("test",)) for name in ("slope", "flow", "sky")]
    values = [
        values_at(SamplePoints(field, np.c_[at, heights].astype(np.float32), np.zeros(200, np.float32)), requests)
        for field, at in ((plain, places), (moved, places - away))
    ]
    for name in ("slope", "flow", "sky"):
        assert values[0][name] == pytest.approx(values[1][name], rel=1e-4, abs=1e-4)
    a, b = (scatter_points(field, Scatter(spacing=60.0)) for field in (plain, moved))
    assert len(a) == len(b) > 1000
    assert np.abs(a.positions - (b.positions + np.float32([*away, 0.0]))).max() < 2e-2


def test_masks_of_displacement_do_not_depend_on_the_anchor():
    """Masks are kept beside the raster, so they have to be the same for all anchors, with noise in their rules, too."""
    plain, away = from_array(hills(60, 50), 100.0, 100.0), np.array([2048.0, -1024.0])
    rules = (Rule(NOISE, low=0.0, edge=0.3),), (Rule(SLOPE, low=0.3, edge=0.2),)
    layers = Layer("Grass"), *(Layer(f"{n}", rule, noise_size=300.0, ragged=1.0) for n, rule in enumerate(rules))
    ground = LayeredDetail(None, layers, ((1, Detail(4.0, 60.0, 0.5, 7)), (2, Detail(2.0, 30.0))))
    before, after = (displaced(field, ground, 1.0, 0.0, 1) for field in (plain, anchored(plain, *away)))
    for one, other in zip(before.detail.layers, after.detail.layers, strict=True):
        assert np.array_equal(one.mask.values, other.mask.values) and 0 < one.mask.values.mean() < 255
    places = np.random.default_rng(1).uniform(-2400.0, 2400.0, (500, 2))
    heights, there = ground_at(before, places).heights, ground_at(after, places - away).heights
    assert np.abs(heights - there).max() < 1e-9 and np.abs(heights - ground_at(plain, places).heights).max() > 0.1


def test_an_anchor_moves_the_origin_of_files():
    field = from_array(hills(40, 40), 10.0, 10.0).with_raster(
        crs="EPSG:2263", place=(3.28, 0.0, 9.8e5, 0.0, 3.28, 2e5), origin=np.array([9.8e5, 2e5, 0.0])
    )
    moved = anchored(field, 100.0, -50.0)
    assert moved.origin.tolist() == [9.8e5 + 328.0, 2e5 - 164.0, 0.0]
    assert moved.raster.place == (3.28, 0.0, 9.8e5 + 328.0, 0.0, 3.28, 2e5 - 164.0)
    assert moved.key != field.key and str(anchored(field, 0.0, 0.0).key) == str(field.key) == field.raster.digest
    assert anchored(field, 100.0, -50.0) is moved, "the last one is kept"
    with pytest.raises(TerrainError, match="import it again"):
        anchored(replace(field, raster=replace(field.raster, place=None)), 1.0, 0.0)
