# SPDX-License-Identifier: GPL-3.0-or-later
"""Sky, occlusion and sun where they are known from geometry, and the same bits however they are made."""

import math

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.attributes import light, occlusion, sky, sky_layer
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.attributes.occluder import occluder_of
from adaptive_terrain.cbt_terrain.attributes.pyramid import level_of
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import blocks, derived_arrays, extremes
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.extremes import find_extremes
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.run import launch, stopping
from adaptive_terrain.cbt_terrain.run.buffers import flat
from adaptive_terrain.kernels.effects.light import sky_seen
from fields import rough
from horizons import every_sample
from own_surface import bilinear
from padded import raster
from rasters import store_heights

DISC = 0.00918


def made(name, places, **parameters) -> np.ndarray:
    effect = ATTRIBUTES[name]
    return effect.make(places, {name: effect.defaults() | parameters}, {})[name]


def grid(field, values) -> np.ndarray:
    return values.reshape(field.lattice.height, field.lattice.width)


def sky_by_rays(places) -> np.ndarray:
    """Return the visible fraction of the sky above the horizontal, by rays without end."""
    return occlusion.visible_sky(places, far=1e300, lowest=0.0)


def both_skies(field, scale=1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the sky by rays and by the sweep, [rows, columns] each."""
    places = every_sample(field, scale)
    return grid(field, sky_by_rays(places)), grid(field, made("sky", places))


def test_azimuths_are_even_and_so_are_the_first_of_them():
    found = light.azimuths()
    assert abs(np.hypot(*found.T) - 1).max() < 1e-15
    for count in (4, 8, 16):
        angles = np.sort(np.degrees(np.arctan2(found[:count, 1], found[:count, 0])) % 360)
        assert np.diff(angles) == pytest.approx(360 / count, abs=1e-9)
    assert np.sort(np.degrees(np.arctan2(found[:, 1], found[:, 0])) % 360)[0] == pytest.approx(11.25)


@pytest.mark.parametrize("steps", [(4.0, 4.0), (2.0, 5.0)])
@pytest.mark.parametrize("rise", [0.3, 1.0, 2.0])
def test_the_bottom_of_a_valley_sees_the_cosine_of_its_sides(steps, rise):
    """Of a V between two planes of the angle a: the mean of 1 / (1 + (tan a cos azimuth)^2) is cos a."""
    x = np.abs(np.arange(-40, 41)) * steps[0] * rise
    field = from_array(np.tile(x, (101, 1)), *steps)
    for found in both_skies(field):
        assert found[50, 40] == pytest.approx(math.cos(math.atan(rise)), abs=0.01 if rise > 1.5 else 0.004)


def test_the_bottom_of_a_round_pit_sees_half():
    """A pit as deep as it is wide from the middle has its rim 45 degrees high: cos^2 45."""
    y, x = np.mgrid[-60:61, -60:61].astype(float)
    field = from_array(-np.sqrt(np.maximum(50.0**2 - x * x - y * y, 0.0)), 1.0)
    for found in both_skies(field):
        assert found[60, 60] == pytest.approx(0.5, abs=0.01)


def test_a_plane_and_a_summit_see_the_whole_upper_half():
    """The summit and a level plane all of it, exactly; a slope of the angle a (1 + cos a) / 2."""
    y, x = np.mgrid[-30:31, -30:31].astype(float)
    for summit in both_skies(from_array(-0.02 * (x * x + y * y), 3.0)):
        assert summit[30, 30] == 1.0
    for level in both_skies(from_array(np.full((40, 33), 1234.5678), 3.0)):
        assert (level == 1.0).all()
    for slope in both_skies(from_array(3.0 * x * math.tan(math.radians(35.0)) + 1e4, 3.0)):
        assert abs(slope - (1 + math.cos(math.radians(35.0))) / 2).max() < 2e-3


def test_a_steep_plane_hides_nothing_of_its_own_half_space():
    y, x = np.mgrid[0:40, 0:50].astype(float)
    field = from_array(2.0 * x - y + 700.0, 2.0, 3.0)
    assert abs(made("ambient_occlusion", every_sample(field), radius=30.0) - 1.0).max() < 1e-4


@pytest.mark.parametrize("elevation", [10.0, 28.0, 50.0])
@pytest.mark.parametrize("towards", [(1, 0), (0, -1)])
def test_the_shadow_of_a_wall_is_as_long_as_geometry_says(elevation, towards):
    """40 m high, the sun straight behind it: 40 / tan(elevation) metres, and sharp on both sides."""
    far = np.arange(300) * 2.0
    wall = np.where(far >= 500.0, 40.0, 0.0)
    heights = np.tile(wall, (300, 1)) if towards[0] else np.tile(wall[::-1, None], (1, 300))
    e = math.radians(elevation)
    suns = ((towards[0] * math.cos(e), towards[1] * math.cos(e), math.sin(e), DISC),)
    field = from_array(heights, 2.0)
    lit = grid(field, made("sun", every_sample(field), suns=suns))
    lit = lit[150] if towards[0] else lit[::-1, 150]
    edge, soft = 500.0 - 40.0 / math.tan(e), 40.0 / math.sin(e) ** 2 * DISC
    ground = far < 498.0
    assert (lit[ground & (far < edge - soft)] == 1.0).all()
    assert (lit[ground & (far > edge + soft)] == 0.0).all()
    assert (lit[far >= 500.0] == 1.0).all()


def test_half_of_a_wide_sun_stands_over_a_wall_of_its_height():
    """The visible part falls smoothly, as the share of the disc above a level edge."""
    far = np.arange(200) * 1.0
    field = from_array(np.tile(np.where(far >= 150.0, 50.0, 0.0), (1001, 1)), 1.0)
    places = every_sample(field).only(500 * 200 + np.arange(200))
    lit = made("sun", places, suns=((1.0, 0.0, 1.0, math.radians(10.0)),))
    assert lit[100] == pytest.approx(0.5, abs=0.01)
    x = np.clip((np.arctan2(50.0, 150.0 - far[:149]) - math.pi / 4) / math.radians(5.0), -1, 1)
    share = (np.arccos(x) - x * np.sqrt(1 - x * x)) / math.pi
    assert abs(lit[:149] - share).max() < 0.04


def test_the_strongest_sun_counts():
    field = rough(40, 50)
    places = every_sample(field)
    low, high = (1.0, 0.2, 0.2, DISC), (-0.3, 0.5, 0.6, DISC)
    alone = made("sun", places, suns=(high,))
    assert not np.array_equal(alone, made("sun", places, suns=(low,)))
    assert np.array_equal(alone, made("sun", places, suns=((*low, 1.0), (*high, 3.0))))
    assert np.array_equal(alone, made("sun", places, suns=((*high, 2.0), (*low, 2.0))))
    assert (made("sun", places, suns=()) == 0.0).all()
    assert (made("sun", places, suns=((*low, 0.0),)) == 0.0).all()


@pytest.mark.parametrize("sun", [(0, 0, 0, 0.1), (1, 0, math.nan, 0.1), (1, 0, 0, -0.1), (1, 0, 0, 4.0), (1, 0, 0)])
def test_invalid_suns_are_refused(sun):
    with pytest.raises(TerrainError, match="expected the direction towards it"):
        made("sun", every_sample(rough(5, 5)), suns=(sun,))


def test_shadows_are_those_of_the_placed_terrain():
    """Turned, sheared and stretched: in the world, rays against the placed triangles of the profile say the same."""
    y, x = np.mgrid[0:60, 0:80]
    h = 10.0 * (np.sin(x / 5.0 + np.cos(y / 9.0)) + np.cos(y / 6.0 - x / 11.0))
    field = from_array(h, 3.0, 2.0)
    twist = abs(h[1:, 1:] - h[1:, :-1] - h[:-1, 1:] + h[:-1, :-1]).max()
    rng = np.random.default_rng(1)
    placement = np.eye(4)
    placement[:3, :3] = np.diag([2.0, 0.7, 1.4]) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    placement[:3, :3] *= np.sign(np.linalg.det(placement[:3, :3]))
    local = np.array([0.5, 0.3, 0.25])
    world = placement[:3, :3] @ local
    places = every_sample(field)
    lit = made("sun", places, suns=((*np.linalg.solve(placement[:3, :3], world), 0.0),))
    samples = places.positions.astype(float)
    decided = {0.0: 0, 1.0: 0}
    for at in rng.integers(0, len(samples), 400):
        # Ways of 2,000 steps through the world, whose points are looked up under the inverse placement.
        way = np.linspace(0.01, 1.0, 2001)[:, None] * world * 400.0 + placement[:3, :3] @ samples[at]
        back = np.linalg.solve(placement[:3, :3], way.T).T
        over = back[:, 2] - _surface(field, back)
        clearest = np.nanmin(over) if np.isfinite(over).any() else math.inf
        if abs(clearest) > twist / 4:  # between two lines a cell may rise that much over the profile
            assert lit[at] == (1.0 if clearest > 0 else 0.0)
            decided[float(lit[at])] += 1
    assert min(decided.values()) > 20


def _surface(field, points) -> np.ndarray:
    """Bilinear heights, not a number beyond the rim."""
    west, south, _, _ = field.lattice.rectangle()
    x, y = (points[:, 0] - west) / field.lattice.step_x, (points[:, 1] - south) / field.lattice.step_y
    h = field.heights()
    out = (x < 0) | (y < 0) | (x > h.shape[1] - 1) | (y > h.shape[0] - 1)
    return np.where(out, np.nan, bilinear(h, x, y))


@pytest.mark.parametrize("size, steps", [((65, 65), (10.0, 10.0)), ((100, 37), (4.0, 9.0)), ((40, 2), (5.0, 5.0))])
@pytest.mark.parametrize("scale", [1.0, -1.5])
def test_the_sweep_sees_what_rays_see(size, steps, scale):
    """Between lines it interpolates: 0.02 rms apart on ground of random heights, more where all of it is rim."""
    rays, swept = both_skies(from_array(raster(*size) * 0.3, *steps), scale)
    assert np.sqrt(((rays - swept) ** 2).mean()) < (0.02 if min(size) > 2 else 0.05)


@pytest.mark.parametrize("azimuth", light.azimuths()[[0, 3, 5, 9, 14]])
def test_a_sweep_along_samples_finds_their_largest_slopes(azimuth):
    """Along a diagonal of samples no interpolation is left: the largest slope to any of them."""
    h = raster(50, 50).astype(np.float64)
    towards = np.sign(azimuth) / math.sqrt(2.0)
    out = np.full(h.shape, np.nan, np.float32)
    sky_layer.sweep(h.astype(np.float32), (3.0, 3.0), towards, 1.0, 1, out)
    i, j = np.sign(azimuth).astype(int)
    around, largest = np.pad(h, 49, constant_values=-np.inf), np.zeros(h.shape)
    for k in range(1, 50):
        ahead = around[49 + k * j : 99 + k * j, 49 + k * i : 99 + k * i]
        largest = np.maximum(largest, (ahead - h) / (k * 3.0 * math.sqrt(2.0)))
    assert largest.max() > 0.0 and (np.abs(out - largest) <= np.maximum(1e-6 * largest, 1e-7)).all()


@pytest.mark.thorough
def test_threads_change_no_bit():
    field = from_array(raster(300, 211), 3.0)
    suns = ((1.0, 0.4, 0.5, DISC),)
    found = []
    for threads in (1, 2, 5):
        fresh = field.with_raster()
        places = every_sample(fresh, threads=threads)
        values = [made("sky", places), made("sky", places, quality=sky.PREVIEW), sky_by_rays(places)]
        found.append([*values, made("sun", places, suns=suns), made("ambient_occlusion", places)])
    for others in found[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(found[0], others, strict=True))


def test_four_passes_of_four_azimuths_are_one_of_sixteen():
    places = every_sample(rough(60, 70))
    directions = wp.array(light.azimuths(), dtype=wp.vec2d, device="cpu")
    where = wp.array(places.positions, dtype=wp.vec3f, device="cpu")
    out = np.zeros(len(places), np.float32)
    for first in range(0, 16, 4):
        numbers = [wp.float64(1e300), wp.float64(0.0), directions, first, first + 4]
        launch.spread(sky_seen, len(places), [occluder_of(places), *numbers, where, flat(out, wp.float32)], step="test")
    assert np.array_equal(out, sky_by_rays(places))


def test_an_interrupted_sweep_continues_with_the_same_bits(monkeypatch):
    field, calls = from_array(raster(120, 90), 2.0), []

    def stop_at_the_sixth():
        calls.append(1)
        if len(calls) == 12:
            raise stopping.Stopped

    whole = made("sky", every_sample(field.with_raster()))
    monkeypatch.setattr(stopping, "check", stop_at_the_sixth)
    with pytest.raises(stopping.Stopped):
        made("sky", every_sample(field))
    assert not sky_layer.is_known(field, 1.0)
    monkeypatch.undo()
    assert np.array_equal(made("sky", every_sample(field)), whole) and sky_layer.is_known(field, 1.0)


def test_a_preview_is_near_and_independent_of_the_layer():
    field = rough(257, 300, relief=80.0)
    places = every_sample(field)
    first = made("sky", places, quality=sky.PREVIEW)
    full = made("sky", places)
    assert np.array_equal(first, made("sky", places, quality=sky.PREVIEW))
    assert np.sqrt(((first - full) ** 2).mean()) < 0.1 and not np.array_equal(first, full)


def test_the_sky_of_a_large_raster_is_that_of_a_coarser_one(monkeypatch):
    """Of heights of 2 x 2 cells, made in sixteen steps that can be stopped after each; near the truth."""
    field = rough(81, 60)
    places = every_sample(field)
    monkeypatch.setattr(sky_layer, "MAX_SAMPLES", 41 * 31)
    assert sky_layer.layer_level(field) == 1 and not sky_layer.is_known(field, 1.0)
    assert [sky_layer.advance(field, 1.0, 2) for _ in range(16)] == [False] * 15 + [True]
    assert sky_layer.is_known(field, 1.0)
    found, truth = made("sky", places), sky_by_rays(places)
    assert np.sqrt(((found - truth) ** 2).mean()) < 0.1
    coarse = from_array(level_of(field.raster, 1), 2 * field.lattice.step_x)
    assert np.array_equal(field.cache.results["sky", 1.0]["sky"], sky_layer_of(coarse))


def sky_layer_of(field):
    sky_layer.sky_layer(field, 1.0, 1)
    return field.cache.results["sky", 1.0]["sky"]


def test_the_sky_is_stored_and_computed_again_if_damaged(tmp_path):
    """The next process has it at once; of three vertical scales the store keeps the last two."""
    folder = store_heights(tmp_path / "store", raster(90, 70), 3.0)
    field = open_store(folder)
    places = every_sample(field)
    whole = made("sky", places)
    again = open_store(folder)
    assert sky_layer.is_known(again, 1.0) and np.array_equal(made("sky", every_sample(again)), whole)
    assert sum(name.startswith("effect_sky_") for name in verify(folder)) == 1
    (file,) = folder.glob("data-*/effect_sky_*.npy")
    damaged = bytearray(file.read_bytes())
    damaged[5000] ^= 1
    file.write_bytes(damaged)
    with pytest.raises(TerrainError, match="differs from its checksum.*delete the file; it is computed again"):
        verify(folder)
    third = open_store(folder)
    assert not sky_layer.is_known(third, 1.0) and np.array_equal(made("sky", every_sample(third)), whole)
    for scale in (2.0, 3.0):
        made("sky", every_sample(third, scale))
    assert len(list(folder.glob("data-*/effect_sky_*.npy"))) == 2
    assert [sky_layer.is_known(open_store(folder), scale) for scale in (1.0, 2.0, 3.0)] == [False, True, True]
    file = next(folder.glob("data-*/effect_sky_*.npy"))
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(TerrainError, match="expected .* delete the file"):
        verify(folder)


@pytest.mark.parametrize("name", ["sky", "ambient_occlusion", "sun"])
def test_light_is_a_function_of_the_point_alone(name):
    """Of the same place among others, on a bicubic surface too, and at any level."""
    field = from_array(raster(70, 50), 4.0)
    places = every_sample(field)
    whole, some = made(name, places), np.arange(5, len(places), 37)
    assert np.array_equal(made(name, places.only(some)), whole[some])
    assert np.array_equal(made(name, every_sample(interpolated(field, "bicubic"))), whole)


def test_holes_and_hostile_heights_give_numbers_from_0_to_1():
    heights = raster(60, 50)
    heights[20:30, 20:35] = np.nan
    spiky = np.zeros((40, 40))
    spiky[20, 20] = 9e29
    for field in (from_array(heights, 3.0, holes=True), from_array(spiky, 1.0), from_array(raster(2, 2), 1e-3)):
        for name in ("sky", "ambient_occlusion", "sun"):
            for quality in ({"quality": sky.FULL}, {"quality": sky.PREVIEW}) if name == "sky" else ({},):
                found = made(name, every_sample(field), **quality)
                assert np.isfinite(found).all() and found.min() >= 0.0 and found.max() <= 1.0


def test_the_sky_of_the_last_two_vertical_scales_is_cached():
    field = from_array(raster(70, 60), 3.0)
    for scale in (1.0, 1.1, 1.2, 1.3):
        places = every_sample(field, scale)
        whole, preview = made("sky", places), made("sky", places, quality=sky.PREVIEW)
    assert [sky_layer.is_known(field, scale) for scale in (1.0, 1.1, 1.2, 1.3)] == [False, False, True, True]
    assert sum(key[0] in (sky_layer.LAYER, sky_layer.PREVIEW) for key in field.cache.results) == 4
    assert np.array_equal(made("sky", places), whole) and len(preview) == len(whole)


def test_a_larger_limit_keeps_as_many_vertical_scales(monkeypatch, tmp_path):
    """Of five scales, the newest four are cached and stored; before the limit none is removed."""
    monkeypatch.setattr(sky_layer, "MAX_SCALES", 4)
    field = open_store(store_heights(tmp_path / "store", raster(30, 20), 3.0))
    for count, scale in enumerate((1.0, 2.0, 3.0, 4.0, 5.0), 1):
        sky_layer.sky_layer(field, scale, 1)
        assert sum(key[0] == sky_layer.LAYER for key in field.cache.results) == min(count, 4)
        assert len(list(tmp_path.glob("store/data-*/effect_sky_*.npy"))) == min(count, 4)
    again = open_store(tmp_path / "store")
    assert [sky_layer.is_known(again, scale) for scale in (1.0, 2.0, 5.0)] == [False, True, True]


def test_extremes_of_a_large_raster_are_in_its_store(tmp_path, monkeypatch):
    store_heights(tmp_path, raster(90, 70), 5.0)
    reductions = np.maximum, np.minimum
    expected = [[array.tobytes() for array in find_extremes(open_store(tmp_path), reduce)] for reduce in reductions]
    monkeypatch.setattr(derived_arrays, "MIN_CACHED", 0)
    monkeypatch.setattr(blocks, "ROWS", 2)
    for _ in range(2):
        found = [[array.tobytes() for array in find_extremes(open_store(tmp_path), reduce)] for reduce in reductions]
        assert found == expected
        monkeypatch.setattr(extremes, "over_cells", None)  # nothing is read again
    assert {"tops.npy", "bottoms.npy"} < verify(tmp_path).keys()
