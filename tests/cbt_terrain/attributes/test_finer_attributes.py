# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes and maps with finer tiles, against known derivatives and a dense grid of the same surface."""

import os

import numpy as np
import OpenEXR
import pytest
from adaptive_terrain.cbt_terrain.attributes import bake as baking
from adaptive_terrain.cbt_terrain.attributes import finer_pyramid, sizing, tiling
from adaptive_terrain.cbt_terrain.attributes.attribute import GEOMETRY, AttributeRequest, SamplePoints
from adaptive_terrain.cbt_terrain.attributes.bake import bake
from adaptive_terrain.cbt_terrain.attributes.evaluate import values_at
from adaptive_terrain.cbt_terrain.attributes.folder import read_index
from adaptive_terrain.cbt_terrain.attributes.jet import OUTPUTS, make
from adaptive_terrain.cbt_terrain.attributes.plan import plan
from adaptive_terrain.cbt_terrain.attributes.scale import fixed_level, footprint_levels, limit_levels
from adaptive_terrain.cbt_terrain.attributes.splat_rules import Layer, Rule
from adaptive_terrain.cbt_terrain.attributes.tiling import tiling_of
from adaptive_terrain.cbt_terrain.field import derived_arrays
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.finer_tiles import SIDE
from adaptive_terrain.cbt_terrain.field.heightfield import anchored
from adaptive_terrain.cbt_terrain.field.store import is_intact, open_store
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from evaluations import Evaluations
from fields import rough
from finer_fields import dense_field, finer_field, finer_store, in_small_squares

ALL = {name: {} for name in OUTPUTS}
WHOLE = "flow", "wetness", "sky", "sun", "ambient_occlusion"  # their heights have the raster's step


def hills(x, y):
    """Return hills of 5 m, 90 m apart, with their derivatives, float64: z, zx, zy, zxx, zxy, zyy."""
    a, b = 2 * np.pi / 90, 2 * np.pi / 110
    s, c, t, d = np.sin(a * x), np.cos(a * x), np.sin(b * y), np.cos(b * y)
    return 5 * s * t, 5 * a * c * t, 5 * b * s * d, -5 * a * a * s * t, 5 * a * b * c * d, -5 * b * b * s * t


def town(heights, rows=65, columns=65, bits=4, known=((1, 1), (2, 1), (1, 2), (2, 2)), step=32.0):
    """Return a field of samples `step` apart and finer ones in some tiles, of a function of x and y in metres."""
    lattice = from_array(np.zeros((rows, columns), np.float32), step).lattice
    west, south, _, _ = lattice.rectangle()

    def at(columns, rows, size):
        return heights(west + np.asarray(columns) * size, south + np.asarray(rows)[:, None] * size).astype(np.float32)

    plain = from_array(at(range(columns), range(rows), step), step)
    finer = step / (1 << bits)
    read = lambda box: at(range(box.x0, box.x1 + 1), range(box.y0, box.y1 + 1), finer)  # noqa: E731
    return in_small_squares(plain, bits, known, read)


@pytest.fixture(scope="module")
def field():
    return finer_field()


@pytest.fixture(scope="module")
def hilly():
    return town(lambda x, y: hills(x, y)[0])


def points(field, count, seed=0, inside=None) -> np.ndarray:
    """float32 [n, 3]: random points of the raster, or of a box (west, south, east, north)."""
    west, south, east, north = inside or field.lattice.rectangle()
    rng = np.random.default_rng(seed)
    return np.c_[rng.uniform(west, east, count), rng.uniform(south, north, count), np.zeros(count)].astype(np.float32)


def at_level(field, positions, level, threads=1) -> dict[str, np.ndarray]:
    return make(SamplePoints(field, positions, np.full(len(positions), level, np.float32), threads=threads), ALL, {})


def finest(field, positions) -> np.ndarray:
    return footprint_levels(field, positions, ())


def test_a_plane_is_exact_at_every_level():
    field = town(lambda x, y: 40 + 0.3 * x - 0.2 * y + 1e-3 * (abs(x) < 1), known=[(1, 1)])
    places = points(field, 3000)
    levels = np.random.default_rng(1).uniform(-4, 3, 3000).astype(np.float32)
    limit_levels(field, places, levels)
    found = make(SamplePoints(field, places, levels), ALL, {})
    assert (levels < -3).sum() > 30
    away = abs(places[:, 0]) > 300.0
    np.testing.assert_allclose(found["slope"][away], np.arctan(np.hypot(0.3, 0.2)), atol=2e-5)
    normal = np.array([-0.3, 0.2, 1]) / np.sqrt(1.13)
    np.testing.assert_allclose(found["detail_normal"][away], np.tile(normal, (away.sum(), 1)), atol=2e-5)


def test_hills_have_their_derivatives_at_the_finer_step(hilly):
    places = points(hilly, 4000, inside=(-380.0, -380.0, -50.0, -50.0))
    assert (finest(hilly, places) == -4).all()
    z, p, q, r, s, t = hills(*places[:, :2].astype(np.float64).T)
    g2, errors = p * p + q * q, {}
    expected = {
        "height": z,
        "slope": np.arctan(np.sqrt(g2)),
        "mean_curvature": -((1 + q * q) * r - 2 * p * q * s + (1 + p * p) * t) / (2 * (1 + g2) ** 1.5),
        "profile_curvature": -(r * p * p + 2 * s * p * q + t * q * q) / (g2 * (1 + g2) ** 1.5),
        "plan_curvature": -(r * q * q - 2 * s * p * q + t * p * p) / g2**1.5,
    }
    for level in (-4.0, 0.0):
        found, steep = at_level(hilly, places, level), g2 > 0.05
        errors[level] = {name: abs(found[name] - wanted)[steep].max() for name, wanted in expected.items()}
        normal = np.stack([-p, -q, np.ones_like(p)], 1) / np.sqrt(1 + g2)[:, None]
        errors[level]["detail_normal"] = abs(found["detail_normal"] - normal).max()
    for name, limit in zip(errors[0.0], (0.05, 2e-3, 2e-4, 2e-4, 2e-3, 2e-3), strict=True):
        assert errors[-4.0][name] < limit and errors[0.0][name] > 10 * limit, (name, errors)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("rows", "columns", "bits", "known"),
    [
        (97, 130, 4, ((2, 3), (3, 3), (3, 2))),
        (258, 261, 1, ((0, 0),)),
        (5, 5, 8, ((1, 1), (3, 2))),
        (36, 41, 4, ((2, 2), (1, 2), (0, 1))),  # at the raster's border
    ],
)
def test_values_equal_those_of_a_dense_grid(rows, columns, bits, known):
    field = finer_field(rows, columns, bits, known)
    dense = dense_field(field)
    places = points(field, 20_000)
    places[:, :2] = np.where(np.arange(20_000)[:, None] % 4, places[:, :2], np.rint(places[:, :2] / 4) * 4)
    lowest = finest(field, places)
    assert (lowest == -bits).mean() > 0.02 and (lowest == 0).any()
    for level in (-bits, 0.25 - bits, 0.75 - bits, -1.5, -1.125, -1.0):  # at 0 is the raster
        there = places[lowest <= level]
        if -bits <= level <= -1 and len(there):
            found, expected = at_level(field, there, level), at_level(dense, there, level + bits)
            assert all(found[name].tobytes() == expected[name].tobytes() for name in ALL), level


def test_values_do_not_jump_where_tiles_end(field):
    """Near level 0, of one point, and near the border of the tiles, along lines with closer and closer points."""
    places = points(field, 3000)
    inner = places[finest(field, places) <= -1]
    for level in (0.0, -1.0):
        a, b = (at_level(field, inner, level + d)["slope"] for d in (-(2**-18), 2**-18))
        assert abs(a - b).max() < 2e-5
    tile, west, south = SIDE * 2.0, *field.lattice.rectangle()[:2]
    for along in (0, 1):
        steps = {}
        for metres in (0.1, 0.05):
            at = np.arange(0.9 * tile, 5.1 * tile, metres)
            line = np.zeros((len(at), 3), np.float32)
            line[:, along], line[:, 1 - along] = at + (west, south)[along], (south, west)[along] + 3.37 * tile
            levels = finest(field, line)
            assert levels.min() == -4 and levels[0] == levels[-1] == 0
            found = make(SamplePoints(field, line, levels), ALL, {})
            steps[metres] = {name: abs(np.diff(found[name], axis=0)).max() for name in ("slope", "detail_normal")}
            assert abs(np.diff(levels)).max() < 4 * metres / 128 * 1.1
        assert all(steps[0.05][name] < 0.7 * steps[0.1][name] for name in steps[0.1]), steps


def test_values_depend_on_no_other_point_and_no_thread(field, eager_threads):
    other = field.with_raster()  # with an empty cache
    places = points(field, 500)
    levels = finest(field, places)
    expected = make(SamplePoints(field, places, levels), ALL, {})
    threaded = make(SamplePoints(other, places, finest(other, places), threads=3), ALL, {})
    order = np.random.default_rng(2).permutation(500)
    shuffled = make(SamplePoints(field, places[order], levels[order], threads=2), ALL, {})
    one = make(SamplePoints(field.with_raster(), places[7:8], levels[7:8]), ALL, {})
    for name, array in expected.items():
        assert threaded[name].tobytes() == array.tobytes()
        assert shuffled[name].tobytes() == array[order].tobytes()
        assert one[name].tobytes() == array[7:8].tobytes()


def test_a_flight_has_the_values_of_each_frame_alone(field):
    flight = Evaluations(2)
    requests = [AttributeRequest("slope", ("a test",)), AttributeRequest("mean_curvature", ("a test",), GEOMETRY)]
    west, south, _, _ = field.lattice.rectangle()
    for frame in range(4):
        eye = west + 1500.0 + 20 * frame, south + 1500.0
        view = View.look((*eye, 150.0), (eye[0] + 200, eye[1] + 300, 40.0))
        surface = Terrain(field).update(Criterion(error_px=2.0), [view]).surface
        found = flight.attributes(plan(requests), field, surface, [view])
        alone = Evaluations().attributes(plan(requests), field, surface, [view])
        assert all(found[name].array.tobytes() == alone[name].array.tobytes() for name in alone)
        levels = footprint_levels(field, surface.positions, [view])
        assert levels.min() < -3 and fixed_level(field, 0.0) == -4
        wanted = make(SamplePoints(field, surface.positions, levels), {"slope": {}}, {})["slope"]
        assert found["slope"].array.tobytes() == wanted.tobytes()


def test_levels_without_finer_tiles_are_those_of_the_raster():
    field = rough(97, 130, 7, relief=80.0, step=32.0)
    places = points(field, 1000)
    view = View.look((0.0, 0.0, 90.0), (50.0, 0.0, 40.0))
    assert footprint_levels(field, places, [view]).min() == 0 and (finest(field, places) == 0).all()
    assert fixed_level(field, 0.0) == 0 and fixed_level(field, 64.0) == 1
    assert len(finer_pyramid.finer_heights(field.raster, 1)) == 0 and not field.cache.results


def test_splat_layers_have_the_finer_slope_and_noise(hilly):
    steep = Layer("Steep", (Rule("slope", low=0.3, edge=0.02),), on_top=True)
    spots = Layer("Spots", (Rule("noise", low=0.0, edge=0.2),), on_top=True, noise_size=24.0)
    layers = AttributeRequest("splat_1", ("a test",), parameters=(("layers", (Layer("Grass"), steep, spots)),))
    places = points(hilly, 4000, inside=(-400.0, -400.0, -50.0, -50.0))
    found = {
        level: values_at(SamplePoints(hilly, places, np.full(4000, level, np.float32)), [layers])["splat_1"]
        for level in (-4.0, -3.5, 0.0)
    }
    _, p, q, *_ = hills(*places[:, :2].astype(np.float64).T)
    bare = found[-4.0][:, 2] < 1e-3
    share = found[-4.0][:, 1] / np.maximum(1 - found[-4.0][:, 2], 1e-6)
    slope = np.arctan(np.hypot(p, q))
    assert (
        bare.sum() > 300 and (share[bare & (slope > 0.32)] > 0.99).all() and (share[bare & (slope < 0.28)] < 0.01).all()
    )
    assert np.ptp(found[0.0][:, 2]) == 0 and found[-4.0][:, 2].std() > 0.3, "noise of 24 m fades at a step of 32 m"
    assert abs(found[-4.0] - found[-3.5]).max() < 0.5


def test_attributes_of_the_whole_raster_keep_its_step(field):
    places = points(field, 300)
    plain = field.with_raster(finer=None)
    for name in WHOLE:
        request = [AttributeRequest(name, ("a test",))]
        levels = np.zeros(300, np.float32) if name == "wetness" else finest(field, places)  # it reads the normal
        found = values_at(SamplePoints(field, places, levels), request)[name]
        expected = values_at(SamplePoints(plain, places, np.zeros(300, np.float32)), request)[name]
        assert found.tobytes() == expected.tobytes(), name
    assert np.isfinite(
        values_at(SamplePoints(field, places, finest(field, places)), request)["ambient_occlusion"]
    ).all()


def test_points_in_an_anchored_space_have_the_same_values(field):
    moved = anchored(field.with_raster(place=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0), crs="EPSG:25832"), 256.0, -128.0)
    places = np.rint(points(field, 500) * 4) / 4
    there = places - np.array([256.0, -128.0, 0.0], np.float32)
    for name, array in at_level(field, places, -3.0).items():
        np.testing.assert_allclose(at_level(moved, there, -3.0)[name], array, atol=1e-6)


@pytest.fixture
def small_tiles(monkeypatch):
    monkeypatch.setattr(tiling, "SINGLE_CELLS", 512)
    monkeypatch.setattr(tiling, "TILE_CELLS", 62)


def test_maps_have_the_finer_step_where_heights_are_finer(field, tmp_path, small_tiles):
    dense, request = dense_field(field), AttributeRequest("slope", ("a test",))
    tiles = tiling_of(field.lattice, -4)
    assert tiles == tiling_of(dense.lattice) and len(tiles) == 80
    shown = sizing.shown_by(tiles, field, [request])
    met = np.array([finer_pyramid.is_finer(field.raster, tiles.box(tile)) for tile in range(len(tiles))])
    assert (shown == np.where(met, 2.0, 32.0)).all() and 9 <= met.sum() < 40
    sides = sizing.resolutions(tiles, shown, shown, 4)
    assert {side for side, there in zip(sides, met, strict=True) if there} == {256} and min(sides) == 64
    bake(field, [request], tmp_path / "finer", sides, form="exr")
    bake(dense, [request], tmp_path / "dense", sides, form="exr")
    exact = 0
    for tile in np.flatnonzero(met):
        x0, y0 = tiles.first_texel(tile, 256)
        step_x, step_y = tiles.texel(256)
        rows = np.arange(tile % 4, 256, 4)
        x, y = np.meshgrid(x0 + np.arange(256) * step_x, y0 - rows * step_y)
        west, south, east, north = field.lattice.rectangle()
        places = np.stack([np.clip(x, west, east), np.clip(y, south, north), 0 * x], -1).astype(np.float32)
        levels = np.full(places[..., 0].size, read_level(tiles, 256, 32.0), np.float32)
        limit_levels(field, places.reshape(-1, 3), levels)
        wanted = make(SamplePoints(field, places.reshape(-1, 3), levels), {"slope": {}}, {})["slope"]
        found, inside = image(tmp_path / "finer", tile)[rows], image(tmp_path / "dense", tile)[rows]
        np.testing.assert_allclose(found, wanted.reshape(found.shape), rtol=1e-3, atol=1e-6)
        inner = (levels == levels.min()).reshape(found.shape) & (levels.min() < -3)
        np.testing.assert_allclose(found[inner], inside[inner], rtol=1e-3)
        exact += inner.sum()
    assert exact > 50_000


def image(folder, tile: int) -> np.ndarray:
    """Return the values of the map slope in a tile's image, float32 [rows, columns], row 0 north."""
    entry = read_index(folder)["maps"]["slope"]["tiles"][tile]
    return next(iter(OpenEXR.File(str(folder / entry["file"])).channels().values())).pixels


def read_level(tiles, side: int, step: float) -> float:
    """Return the level of the texels of an image on ground with samples `step` metres apart."""
    return round((np.log2(max(tiles.texel(side)) / step) - baking.SHARPER) * 8) / 8


def test_only_images_with_finer_texels_get_another_key(field, tmp_path, small_tiles, monkeypatch):
    """Maps that an older version has baked stay where nothing is finer."""
    request = AttributeRequest("slope", ("a test",))
    tiles = tiling_of(field.lattice, -4)
    with monkeypatch.context() as before:
        before.setattr(baking, "is_finer", lambda *_: False)
        bake(field, [request], tmp_path, [64] * len(tiles))
    keys = [tile["key"] for tile in read_index(tmp_path)["maps"]["slope"]["tiles"]]
    assert bake(field, [request], tmp_path, [64] * len(tiles)).written > 0
    changed = np.array(keys) != [tile["key"] for tile in read_index(tmp_path)["maps"]["slope"]["tiles"]]
    met = np.array([finer_pyramid.is_finer(field.raster, tiles.box(tile)) for tile in range(len(tiles))])
    assert changed[met].all() and not changed.all()


def test_a_large_town_has_its_levels_in_the_store(tmp_path, monkeypatch):
    finer_store(tmp_path, 65, 65, 4, [(2, 2)])
    places = points(open_store(tmp_path), 2000)
    expected = at_level(open_store(tmp_path), places, -2.5)
    assert not list(tmp_path.rglob("finer_pyramid.npy"))
    monkeypatch.setattr(derived_arrays, "MIN_CACHED", 0)
    assert at_level(open_store(tmp_path), places, -2.5)["slope"].tobytes() == expected["slope"].tobytes()
    [file] = tmp_path.rglob("finer_pyramid.npy")
    with monkeypatch.context() as nothing:  # is computed again
        nothing.setattr(finer_pyramid, "_fill_levels", None)
        field = open_store(tmp_path)
        assert at_level(field, places, -2.5)["slope"].tobytes() == expected["slope"].tobytes()
    assert verify(tmp_path)["finer_pyramid.npy"] >= 1 and is_intact(field)
    os.truncate(file, 5000)
    assert not is_intact(field)
    assert at_level(open_store(tmp_path), places, -2.5)["slope"].tobytes() == expected["slope"].tobytes()
