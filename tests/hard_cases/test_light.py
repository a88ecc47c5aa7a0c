# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 59: rays over the ground in every position relative to the raster."""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.attribute import SamplePoints
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.field.build import from_array
from horizons import coded, directions, engines, every_sample, from_cell_to_cell, places_on
from padded import raster

# Samples from west to east and from south to north, and metres between them.
RASTERS = [((33, 33), (10.0, 10.0)), ((97, 41), (2.0, 7.5)), ((2, 2), (1.0, 1.0)), ((2, 70), (3.0, 1.0))]


def sun(places: SamplePoints, *suns, **angle) -> np.ndarray:
    return ATTRIBUTES["sun"].make(places, {"sun": {"suns": suns}}, {})["sun"]


@pytest.mark.parametrize(
    ("size", "steps", "scale"),
    [
        pytest.param(*raster, scale, marks=() if (number % 2 == 0) == (scale == 1.0) else pytest.mark.thorough)
        for number, raster in enumerate(RASTERS)
        for scale in (1.0, -2.5)
    ],
)
def test_case_59_skipping_blocks_finds_the_same_hits(size, steps, scale):
    """Rays that skip blocks find the same bits as a walk from cell to cell, from every position in any direction."""
    field = from_array(raster(*size), *steps)
    places, along = places_on(field, 240, scale=scale), directions(240)
    found = engines(places, along)
    assert np.array_equal(found, engines(places, along, blocks=False))
    walked = [from_cell_to_cell(field, scale, p, a) for p, a in zip(places.positions, along, strict=True)]
    assert np.array_equal(found, walked)
    near = engines(places, along, far=9.0, least=-1e300)
    walked = [from_cell_to_cell(field, scale, p, a, 9.0, -1e300) for p, a in zip(places.positions, along, strict=True)]
    assert np.array_equal(near, walked), "within a radius, and of ground that falls away"


def test_case_59_rays_through_the_corners_of_cells():
    """Rays exactly through thousands of corners of cells find the same spikes with and without blocks."""
    heights = np.zeros((300, 300), np.float32)
    heights[::7, ::7] = np.arange(43 * 43).reshape(43, 43) % 11 + 1.0
    field = from_array(heights, 1.0)
    places, along = every_sample(field), directions(300 * 300, seed=2)
    pick = np.arange(0, 90_000, 31)
    places, along = places.only(pick), along[pick]
    along[::2] = np.array([(3.0, 4.0), (-4.0, 3.0), (0.6, -0.8)])[np.arange(len(along[::2])) % 3]
    along[::2] /= np.linalg.norm(along[::2], axis=1, keepdims=True)
    assert np.array_equal(engines(places, along), engines(places, along, blocks=False))


def test_case_59_grazing_rays_are_not_hidden_by_their_plane():
    """A point on a plane has that plane as its horizon in every direction, to 1e-6."""
    y, x = np.mgrid[0:65, 0:65].astype(np.float32)
    field = from_array(0.5 * x - 0.25 * y, 1.0)
    places, along = places_on(field, 600, seed=3), directions(600, seed=3)
    inside = abs(places.positions[:, :2]).max(axis=1) < 31.0
    off = engines(places, along, least=-1e300) - along @ (0.5, -0.25)
    assert abs(off[inside]).max() < 1e-6


def test_case_59_places_beyond_the_rim_take_the_light_of_the_rim():
    """Points outside the raster, far away or at NaN take the light of its border."""
    field = from_array(raster(50, 40), 5.0)
    west, south, east, north = field.lattice.rectangle()
    inside = np.array([(east, 3.0, 0.0), (west, south, 0.0), (-7.0, north, 0.0), (west, south, 0.0)], np.float32)
    outside = np.array([(1e30, 3.0, 9.0), (-1e9, -1e9, 0.0), (-7.0, north + 1, 0.0), (np.nan, np.nan, 0.0)], np.float32)
    towards = np.array([(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.6, 0.8)])
    places = (SamplePoints(field, where, np.zeros(4, np.float32)) for where in (inside, outside))
    a, b = (engines(p, towards) for p in places)
    assert np.array_equal(a, b) and (a > 0).any()


def test_case_59_the_sun_upright_level_and_below():
    """The sun at the zenith casts no shadow, a level sun shows at most half of its disc, and a lower one shows none."""
    field = from_array(raster(64, 48), 5.0)
    places = every_sample(field)
    assert (sun(places, (0.0, 0.0, 1.0, 0.00918)) == 1.0).all()
    level = sun(places, (1.0, 0.0, 0.0, 0.00918))
    assert level.max() == pytest.approx(0.5, abs=1e-3) and level.min() == 0.0
    assert (sun(places, (1.0, 0.3, -0.01, 0.00918)) == 0.0).all()
    assert (sun(places, (0.0, 0.0, -1.0, math.pi)) == 0.0).all()
    assert np.isfinite(sun(places, (1e-30, 1e-30, 1e-30, 0.0))).all()


def test_case_59_16_bit_and_float_heights_cast_equal_shadows():
    """Encoded 16-bit heights of a store cast the same shadows as the equal floats."""
    floats, numbers = coded(from_array(raster(60, 45), 4.0, 3.0))
    along = directions(400)
    assert np.array_equal(engines(places_on(floats, 400), along), engines(places_on(numbers, 400), along))
