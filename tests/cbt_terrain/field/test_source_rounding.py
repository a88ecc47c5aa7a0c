# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounds hold for the heights that a file was made of, before it rounded them."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.bicubic import LEVERAGE, interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.fit.fit import fit
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import mesh_heights, random_view, reference_heights, rough, scattered, screen_error
from rasters import imported, write_exr, write_raster

STEP = 10.0
SHAPES = {"fits": (33, 65), "padded": (40, 51)}


def unrounded(shape) -> np.ndarray:
    """float64 heights of 520 to 880 m, row 0 north."""
    y, x = np.indices(shape) / 15.0
    return 700.0 + 170.0 * np.sin(x) * np.cos(y) + 0.2 * np.random.default_rng(1).standard_normal(shape)


def as_int16(path, heights):
    return write_raster(path / "a.tif", np.round(heights).astype(np.int16)), {}


def as_scaled_int16(path, heights):
    import rasterio

    source = write_raster(path / "a.tif", np.round((heights - 650.0) / 0.3).astype(np.int16))
    with rasterio.open(source, "r+") as file:
        file.scales, file.offsets = (0.3,), (650.0,)
    return source, {}


def as_png(path, heights):
    codes = np.round((heights - 100.0) / 0.125).astype(np.uint16)
    return write_raster(path / "a.png", codes), {"height_scale": 0.125, "height_offset": 100.0}


def as_exr(path, heights):
    return write_exr(path / "a.exr", Y=heights.astype(np.float16)), {}


def as_npy(dtype, path, heights):
    np.save(path / "a.npy", heights.astype(dtype))
    return path / "a.npy", {}


# Functions that write a file, and half a step of its values near 900 m.
FILES = {
    "int16 GeoTIFF": (as_int16, 0.5),
    "scaled int16 GeoTIFF": (as_scaled_int16, 0.15),
    "uint16 PNG": (as_png, 0.0625),
    "float16 EXR": (as_exr, 0.25),
    "float32": (lambda path, heights: as_npy(np.float32, path, heights), 2.0**-15),
    "float64": (lambda path, heights: as_npy(np.float64, path, heights), 2.0**-15),
}


def most_for(field, asked: float) -> float:
    """Return the largest bound that an update may have for a criterion of `asked` metres.

    It is the criterion, or a quarter more than the source's rounding if that is larger than half of it.
    """
    left = asked - field.source_max if field.source_max <= 0.5 * asked else 0.8 * asked
    return max(left + field.source_max, 1.25 * field.source_max) * (1 + 1e-4)


def imported_from(tmp_path, kind, shape):
    """Return heights (row 0 south), their positions [n, 2], and the field of the file with them rounded."""
    heights = unrounded(SHAPES[shape])
    source, settings = FILES[kind][0](tmp_path, heights)
    rows, columns = heights.shape
    field, report = imported(tmp_path, source, extent=((columns - 1) * STEP, (rows - 1) * STEP), **settings)
    assert report["source_step_m"] == field.source_max and field.lattice.is_padded == (shape == "padded")
    places = [STEP * (np.arange(n) - (n - 1) / 2) for n in (columns, rows)]
    return heights[::-1], np.stack(np.meshgrid(*places), -1).reshape(-1, 2), field


@pytest.mark.parametrize("shape", ["padded", pytest.param("fits", marks=pytest.mark.thorough)])
@pytest.mark.parametrize("kind", FILES)
def test_a_bound_holds_for_the_heights_before_rounding(tmp_path, kind, shape):
    heights, plane, field = imported_from(tmp_path, kind, shape)
    off = FILES[kind][1]
    assert 0.9 * off <= field.source_max <= off * (1 + 1e-3)
    needed = []
    for times in (1.5, 6.0, 40.0):
        asked = times * max(off, 0.05)
        update = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=asked))
        worst = np.abs(mesh_heights(update.surface, plane) - heights.ravel()).max()
        assert worst <= update.bound_m <= most_for(field, asked) and update.terms_m.source == pytest.approx(
            field.source_max
        )
        assert update.bound_m <= asked or times == 1.5
        needed.append(worst > update.bound_m - update.terms_m.source)
    assert any(needed) or off < 0.01, "without the term it would not hold"


@pytest.mark.parametrize("kind", ["int16 GeoTIFF", "float16 EXR"])
def test_a_bound_holds_between_samples_and_in_pixels(tmp_path, kind):
    heights, _, field = imported_from(tmp_path, kind, "fits")
    truth, plane = field.with_raster(samples=heights, steps=None), scattered(field, 20_000)
    view = View.look((-300.0, -200.0, 900.0), (0.0, 0.0, 700.0), resolution=(640, 480))
    update = Terrain(field, 1).update(Criterion(error_px=3.0, error_m=2.0 * field.source_max), [view])
    worst = np.abs(mesh_heights(update.surface, plane) - reference_heights(truth, plane)).max()
    assert update.bound_m - update.terms_m.source < worst <= update.bound_m
    assert 0 < screen_error(view, truth, update.surface, plane) <= update.bound_px
    assert 0 < update.terms_px.source < update.bound_px


@pytest.mark.parametrize("shape", SHAPES)
def test_a_fit_holds_for_the_heights_before_rounding(tmp_path, shape):
    heights, plane, field = imported_from(tmp_path, "int16 GeoTIFF", shape)
    needed = []
    for times in (1.3, 5.0, 8.0):
        asked = times * field.source_max
        fitted = fit(field, asked)
        plain = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=asked))
        worst = np.abs(mesh_heights(fitted.surface, plane) - heights.ravel()).max()
        assert worst <= fitted.bound_m <= most_for(field, asked)
        assert (fitted.bound_m <= asked) == (fitted.limited == "") == (times > 1.3)
        assert fitted.triangles < plain.triangles or times == 1.3
        assert fitted.terms_m.source == pytest.approx(field.source_max, rel=1e-6)
        needed.append(worst > fitted.bound_m - field.source_max)
    assert any(needed), "without the term it would not hold"


def test_a_fit_limited_by_rounding_still_saves_triangles():
    heights = 30.0 * np.sin(np.indices((129, 129)) / 9.0).sum(axis=0)
    field = from_array(heights, 10.0, source_max=0.5)
    fitted, plain = fit(field, 0.9), Terrain(field).update(Criterion(error_px=0.0, error_m=0.9))
    assert fitted.limited == plain.limited == "source" and fitted.rounds > 0
    assert fitted.triangles < plain.triangles and 0.9 < fitted.bound_m <= 1.22 * (1 + 1e-6)


def test_an_error_of_twice_the_rounding_and_more_holds_in_full():
    heights = 30.0 * np.sin(np.indices((129, 129)) / 9.0).sum(axis=0)
    field = from_array(heights, 10.0, source_max=0.5)
    for asked in (1.0, 1.7, 2.6, 8.0):
        for update in (fit(field, asked), Terrain(field).update(Criterion(error_px=0.0, error_m=asked))):
            assert update.limited == "" and 0.6 * asked < update.bound_m <= asked


@pytest.mark.parametrize(
    ("high", "source", "limited"),
    [(0.0, 0.5, "source"), (1e7, 0.0, "precision"), (1e7, 0.5, "precision"), (0.0, 0.0, "max_depth")],
)
def test_a_depth_limit_is_not_blamed_for_rounding(high, source, limited):
    asked = 0.1
    field = from_array(high + 30.0 * np.sin(np.indices((65, 65)) / 3.0).sum(axis=0), 10.0, source_max=source)
    update = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=asked, max_depth=6))
    assert update.bound_m > asked and update.terms_m.geometric > asked
    assert update.limited == limited


def test_rounded_samples_move_bicubic_surfaces_further():
    signs = np.outer([-1.0, 1.0, 1.0, -1.0], [-1.0, 1.0, 1.0, -1.0])
    for origin in (0, 3, 13):  # beside the border, and in the middle
        heights = np.zeros((17, 17))
        heights[origin : origin + 4, origin : origin + 4] = 0.5 * signs
        field = interpolated(from_array(np.zeros((17, 17), np.float32), STEP, source_max=0.5), "bicubic")
        plane = STEP * (np.stack(np.meshgrid(*2 * [np.linspace(origin, origin + 3, 61)]), -1).reshape(-1, 2) - 8)
        worst = np.abs(reference_heights(field.with_raster(samples=heights), plane)).max()
        update = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=2.0))
        assert update.bound_m == pytest.approx(LEVERAGE * 0.5) and worst <= update.bound_m
        assert worst == pytest.approx(LEVERAGE * 0.5), "and by no less"


def test_flats_state_the_rounding_and_what_leaves_miss():
    heights = np.zeros((65, 65), np.float32)
    heights[20:40, 20:40] = 1.0
    # Twists of 1 m at the corners: leaves miss a quarter of a quarter.
    for missed, samples in ((0.0, np.zeros_like(heights)), (0.0625, heights)):
        update = Terrain(from_array(samples, 10.0, source_max=0.5), 1).update(Criterion(error_px=0.0, error_m=0.25))
        assert 0.5 + missed <= update.bound_m <= (0.5 + missed) * 1.002 and update.limited == "source"


@pytest.mark.thorough
def test_bounds_limited_by_rounding_hold_in_random_views():
    rng, tight = np.random.default_rng(4), 0
    for seed in range(25):
        field = from_array(np.round(rough(33, 49, seed, relief=20.0).samples), 10.0, source_max=0.5)
        moved = field.samples + 0.5 * rng.choice([-1.0, 1.0], field.samples.shape)
        view, plane = random_view(rng, field), scattered(field, 4000, seed)
        error_px, morph = float(10 ** rng.uniform(-2, 0)), float(rng.choice([1.0, 1.5]))
        criterion = Criterion(error_px=error_px, meshlet=int(rng.integers(3)), morph=morph)
        update = Terrain(field, 1).update(criterion, [view])
        assert (
            screen_error(view, field.with_raster(samples=moved, steps=None), update.surface, plane) <= update.bound_px
        )
        tight += update.limited == "source" and update.terms_px.geometric < 0.2 * update.terms_px.source
    assert tight > 3


def test_the_term_follows_the_vertical_scale_and_not_the_place():
    field = from_array(np.round(rough(33, 33).samples), 10.0, source_max=0.5)
    view = View.look((0, -500, 300), (0, 0, 0))
    plain = Terrain(field, 1).update(Criterion(error_px=2.0, error_m=4.0), [view])
    for scale, offset in ((3.0, 0.0), (-0.5, 100.0), (0.0, 5.0)):
        update = Terrain(field, 1).update(Criterion(error_px=2.0, error_m=4.0), [view], None, scale, offset)
        assert update.terms_m.source == pytest.approx(0.5 * abs(scale), rel=1e-9)
    assert plain.terms_m.source == pytest.approx(0.5, rel=1e-9) and plain.terms_px.source > 0
    exact = Terrain(from_array(field.samples, 10.0), 1).update(Criterion(error_px=2.0, error_m=4.0), [view])
    assert exact.terms_m.source == exact.terms_px.source == 0.0 and exact.triangles < plain.triangles


def test_what_is_too_much_on_top_of_what_holds_back():
    """Of float32 and the source the first that is too much on top of those before it."""
    far = from_array(8000 + 0.001 * np.random.default_rng(0).standard_normal((9, 9)), 10.0)
    lost = Terrain(far, 1).update(Criterion(error_px=0, error_m=10.0)).terms_m.precision
    for times, reason in ((0.8, "precision"), (2.0, "source"), (6.0, "")):
        asked = times * lost
        update = Terrain(replace(far, source_max=lost), 1).update(Criterion(error_px=0, error_m=asked))
        assert update.limited == reason and (update.bound_m <= asked) == (reason == "")


def test_no_triangles_are_spent_below_the_rounding():
    field = from_array(np.round(rough(65, 65).samples), 10.0, source_max=0.5)
    exact = from_array(field.samples, 10.0)
    for asked, bound, reason in (
        (2.5, 2.5, ""),
        (0.5, 0.9, "source"),
        (0.25, 0.7, "source"),
        (1e-3, 0.62502, "source"),
    ):
        update = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=asked))
        assert update.limited == reason and 0.5 < update.bound_m <= bound * (1 + 1e-6)
        plain = Terrain(exact, 1).update(Criterion(error_px=0.0, error_m=max(0.8 * asked, 0.1251)))
        assert update.triangles == plain.triangles
