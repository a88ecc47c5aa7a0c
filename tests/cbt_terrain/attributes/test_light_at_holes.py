# SPDX-License-Identifier: GPL-3.0-or-later
"""A hole hides neither sun nor sky, whatever fills it; the ground around it still does."""

import hashlib
import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import sky_layer
from adaptive_terrain.cbt_terrain.attributes.attribute import SamplePoints
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.attributes.occlusion import visible_sky
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from horizons import engines, every_sample, places_on
from rasters import hills

STEP_X, STEP_Y = 3.0, 4.0


def land(width: int = 61, height: int = 47) -> np.ndarray:
    """Return hills with a hole inside, two at the border, single missing samples and a line of known ones in a hole."""
    heights = (3.0 * hills(width, height)).astype(np.float32)
    y, x = np.mgrid[:height, :width]
    heights[(x - 25) ** 2 + (y - 20) ** 2 < 70] = np.nan
    heights[18, 20:30] = 500.0  # known, but of no cell that is left
    heights[:9, 40:] = heights[30:, :7] = np.nan
    heights[40, 50] = heights[41, 51] = np.nan
    return heights


def made(name: str, places: SamplePoints, **parameters) -> np.ndarray:
    effect = ATTRIBUTES[name]
    return effect.make(places, {name: effect.defaults() | parameters}, {})[name]


def ground_cells(heights: np.ndarray) -> np.ndarray:
    """bool [rows - 1, columns - 1]: cells with four known samples."""
    known = np.isfinite(heights)
    return known[1:, 1:] & known[1:, :-1] & known[:-1, 1:] & known[:-1, :-1]


def plain_horizon(field: HeightField, heights: np.ndarray, place, azimuth) -> float:
    """Return the largest slope to the sides of ground cells along a ray, at least 0, cell side by cell side."""
    west, south, _, _ = field.lattice.rectangle()
    filled, ground = field.heights().astype(float), np.pad(ground_cells(heights), 1)
    x0, y0 = (float(place[0]) - west) / STEP_X, (float(place[1]) - south) / STEP_Y
    i, j = (min(int(at), count - 2) for at, count in ((x0, heights.shape[1]), (y0, heights.shape[0])))
    corners, u, v = filled[j : j + 2, i : i + 2], x0 - i, y0 - j
    z0 = (1 - v) * (corners[0, 0] * (1 - u) + corners[0, 1] * u) + v * (corners[1, 0] * (1 - u) + corners[1, 1] * u)
    best = 0.0
    for axis, (start, other, step) in enumerate(((x0, y0, STEP_X), (y0, x0, STEP_Y))):
        per_metre, across = azimuth[axis] / step, azimuth[1 - axis] / (STEP_Y, STEP_X)[axis]
        rows = filled.T if axis == 0 else filled
        cells = ground.T if axis == 0 else ground
        for line in range(rows.shape[0]) if abs(per_metre) > 1e-12 else ():
            way = (line - start) / per_metre
            at = other + way * across
            cell = int(at)
            if way <= min(STEP_X, STEP_Y) / 1024 or not 0 <= at <= rows.shape[1] - 1 or cell == rows.shape[1] - 1:
                continue
            if cells[line, cell + 1] or cells[line + 1, cell + 1]:  # a cell before or after the line
                height = rows[line, cell] + (rows[line, cell + 1] - rows[line, cell]) * (at - cell)
                best = max(best, (height - z0) / way)
    return best


@pytest.mark.parametrize("blocks", [True, False])
def test_horizons_are_those_of_the_ground_that_is_left(blocks):
    heights = land()
    field = from_array(heights, STEP_X, STEP_Y, holes=True)
    places = places_on(field, 600, seed=3).only(np.arange(2, 600, 3))  # between samples
    angles = np.random.default_rng(5).uniform(0, 2 * math.pi, len(places))
    towards = np.stack([np.cos(angles), np.sin(angles)], -1)
    expected = [plain_horizon(field, heights, *ray) for ray in zip(places.positions, towards, strict=True)]
    found = engines(places, towards, blocks=blocks)
    assert found == pytest.approx(expected, abs=1e-9)
    filled = SamplePoints(from_array(heights, STEP_X, STEP_Y), places.positions, places.level)
    assert (engines(filled, towards) > found + 0.01).sum() > 20, "the fill hides something"


def beside_a_cliff(holes: bool) -> tuple[HeightField, np.ndarray]:
    """Return a plain, a hole in its east and a plateau of two columns behind it, and which samples are the plain's.

    The nearest sample fills the eastern half of the hole with the plateau's height.
    """
    heights = np.zeros((60, 90), np.float32)
    heights[:, 48:88] = np.nan
    heights[:, 88:] = 300.0
    return from_array(heights, STEP_X, STEP_Y, holes=holes), np.tile(np.arange(90) < 48, (60, 1))


def test_a_hole_casts_no_shadow():
    """The sun is 70 degrees high in the east: the plateau's shadow is 109 m long and ends in the hole of 123 m."""
    suns = ((math.cos(math.radians(70.0)), 0.0, math.sin(math.radians(70.0)), 0.00918),)
    lit = {}
    for holes in (False, True):
        field, plain = beside_a_cliff(holes)
        lit[holes] = made("sun", every_sample(field), suns=suns).reshape(plain.shape)[plain]
    assert (lit[True] == 1.0).all() and (lit[False] == 0.0).mean() > 0.3


def test_known_ground_behind_a_hole_casts_its_shadow():
    """At 60 degrees the shadow is 173 m long: it covers the eastern 50 m of the plain."""
    suns = ((math.cos(math.radians(60.0)), 0.0, math.sin(math.radians(60.0)), 0.00918),)
    field, plain = beside_a_cliff(holes=True)
    lit = made("sun", every_sample(field), suns=suns).reshape(plain.shape)[20]
    assert (lit[32:48] == 0.0).all() and (lit[:30] == 1.0).all()


@pytest.mark.parametrize(("quality", "tolerance"), [("FULL", 0.03), ("PREVIEW", 0.12)])
def test_a_hole_hides_no_sky(quality, tolerance):
    """The plain sees as much as if it went on to the plateau; the preview's coarse samples make that less steep."""
    field, plain = beside_a_cliff(holes=True)
    heights = np.where(np.arange(90) < 88, np.float32(0.0), np.float32(300.0))
    level, filled = from_array(np.tile(heights, (60, 1)), STEP_X, STEP_Y), beside_a_cliff(holes=False)[0]
    found, expected, hidden = (
        made("sky", every_sample(each), quality=quality).reshape(plain.shape)[plain] for each in (field, level, filled)
    )
    assert (expected - found).max() < 0.03 and (found - expected).max() < tolerance
    assert (found - hidden).max() > 0.1


def test_holes_of_any_shape_hide_no_sky():
    """Sweeps find the horizons that rays find, as on land without holes."""
    y, x = np.mgrid[:47, :61]
    smooth = 60.0 * np.sin(0.13 * x + 0.05 * y) + 45.0 * np.cos(0.11 * y - 0.06 * x)
    heights = np.where(np.isnan(land()), np.float32(np.nan), smooth.astype(np.float32))
    heights[18, 20:30] = np.nan
    known, places = np.isfinite(heights), every_sample(from_array(heights, STEP_X, STEP_Y, holes=True))
    sky, rays = made("sky", places), visible_sky(places, far=1e300, lowest=0.0)
    differences = abs(sky - rays).reshape(known.shape)[known]
    assert differences.mean() < 0.005 and differences.max() < 0.07
    filled = made("sky", every_sample(from_array(heights, STEP_X, STEP_Y)))
    assert abs(filled - sky).reshape(known.shape)[known].max() > 0.1


def test_a_hole_occludes_nothing_within_a_radius():
    field, plain = beside_a_cliff(holes=True)
    found = made("ambient_occlusion", every_sample(field), radius=100.0).reshape(plain.shape)[plain]
    filled = made("ambient_occlusion", every_sample(beside_a_cliff(holes=False)[0]), radius=100.0)
    assert (found == 1.0).all() and filled.reshape(plain.shape)[plain].min() < 0.8


def test_missing_samples_have_the_sky_of_the_nearest_ground(monkeypatch):
    """On a coarser level, too, whose cells at the border of a hole have points of ground and missing corners."""
    heights = land()
    for limit in (heights.size, heights.size // 4):
        monkeypatch.setattr(sky_layer, "MAX_SAMPLES", limit)
        field = from_array(heights, STEP_X, STEP_Y, holes=True)
        layer = sky_layer.sky_layer(field, 1.0, 2)
        values = layer.values.numpy().reshape(layer.rows, layer.columns)
        stride = -(-heights.shape[0] // layer.rows)
        known = np.isfinite(np.pad(heights, ((0, 1), (0, 1)), mode="edge")[::stride, ::stride])
        known = known[: layer.rows, : layer.columns]
        rows, columns = np.nonzero(known)
        for row, column in np.argwhere(~known)[::5]:
            far = (rows - row) ** 2 + (columns - column) ** 2
            nearest = far == far.min()
            assert values[row, column] in values[rows[nearest], columns[nearest]]


def test_a_sky_of_an_older_version_is_computed_again(tmp_path):
    """It has the name that stores without holes use, whose skies have not changed."""
    heights = land()
    np.save(tmp_path / "a.npy", heights)
    names = {}
    for holes in (True, False):
        import_source(ImportSettings(source=str(tmp_path / "a.npy"), holes=holes), tmp_path / str(holes))
        field = open_store(tmp_path / str(holes))
        sky_layer.sky_layer(field, 1.0, 1)
        names[holes] = [file.name for file in (tmp_path / str(holes)).glob("data-*/effect_sky_*.npy")]
    assert len(names[True]) == len(names[False]) == 1 and names[True] != names[False]
    assert names[False] == ["effect_sky_" + hashlib.blake2b(b"(1, (1.0,))", digest_size=8).hexdigest() + ".npy"]
    assert sky_layer.is_known(open_store(tmp_path / "True"), 1.0)
