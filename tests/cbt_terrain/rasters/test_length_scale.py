# SPDX-License-Identifier: GPL-3.0-or-later
"""Warnings about lengths that differ from those on the ground, against independent formulas."""

import math
import re

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.formats.sources import open_source
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from rasterio.transform import Affine
from rasterio.warp import transform
from rasters import hills, imported, write_raster
from transverse_mercator import utm_to_degrees

A, F = 6378137.0, 1.0 / 298.257223563
E2 = F * (2.0 - F)
NUMBER = r"([\d.]+)"
WARNING = re.compile(
    rf"Lengths in .*: in the middle of the raster they are {NUMBER} times the true ones along x and {NUMBER} times "
    rf"along y, and {NUMBER} to {NUMBER} times up to its border"
)


def radii(latitude):
    """Return the metres in a radian of longitude and of latitude on WGS 84."""
    sine = math.sin(math.radians(latitude))
    prime = A / math.sqrt(1.0 - E2 * sine**2)
    return prime * math.cos(math.radians(latitude)), prime * (1.0 - E2) / (1.0 - E2 * sine**2)


def web_mercator(latitude):
    """y of Web Mercator, and its scale factors along x and y."""
    along_x, along_y = radii(latitude)
    y = A * math.asinh(math.tan(math.radians(latitude)))
    return y, A / along_x, A / math.cos(math.radians(latitude)) / along_y


def warnings_of(tmp_path, placed, crs, width=11, height=21, **settings):
    source = write_raster(tmp_path / "a.tif", hills(width, height), crs=crs, transform=placed)
    raster = open_source(ImportSettings(str(source), **settings))
    raster.close()
    return list(raster.georeference.size_warnings)


def factors_of(warnings):
    [warning] = warnings
    return [float(number) for number in WARNING.search(warning).groups()]


@pytest.mark.parametrize("latitude", [60.0, -45.0, 8.5])
def test_web_mercator_is_warned_about_with_its_factor(tmp_path, latitude):
    y, along_x, along_y = web_mercator(latitude)
    north, south = web_mercator(latitude + 0.001), web_mercator(latitude - 0.001)
    step = (north[0] - south[0]) / 21
    warnings = warnings_of(tmp_path, Affine(step, 0.0, 1e6, 0.0, -step, north[0]), "EPSG:3857")
    middle_x, middle_y, low, high = factors_of(warnings)
    assert (middle_x, middle_y) == pytest.approx((along_x, along_y), rel=1e-3)
    assert low == pytest.approx(min(north[1], south[1], along_y), rel=1e-3) and high == pytest.approx(
        max(north[2], south[2], along_x), rel=1e-3
    )
    assert "--project utm" in warnings[0]


def test_web_mercator_at_the_equator_is_true(tmp_path):
    assert warnings_of(tmp_path, Affine(30.0, 0.0, 1e6, 0.0, -30.0, 3e5), "EPSG:3857") == []


def test_a_factor_at_the_border_alone_is_warned_about(tmp_path):
    """At the equator Web Mercator is true, at 30 degrees 1.15 times too large."""
    y = web_mercator(30.0)[0]
    _, _, low, high = factors_of(warnings_of(tmp_path, Affine(1e4, 0.0, 0.0, 0.0, -y / 10.5, y), "EPSG:3857"))
    assert low == pytest.approx(1.0, abs=0.01) and high == pytest.approx(1 / math.cos(math.radians(30.0)), rel=5e-3)


def test_world_mercator_has_one_factor(tmp_path):
    """Conformal on the ellipsoid: the same along x and y."""
    warnings = warnings_of(tmp_path, Affine(20.0, 0.0, 1e6, 0.0, -20.0, 8362698.5 + 210.0), "EPSG:3395")
    along_x, along_y, _, _ = factors_of(warnings)
    assert along_x == along_y == pytest.approx(A / radii(60.0)[0], rel=1e-3)  # y of 60 N is 8,362,698.5 m


def test_plate_carree_is_wrong_along_x_alone(tmp_path):
    """EPSG:4087 has degrees times 111,319.49 m along both axes."""
    y = 60.0 * 111319.49
    along_x, along_y, _, _ = factors_of(warnings_of(tmp_path, Affine(20.0, 0.0, 1e6, 0.0, -20.0, y), "EPSG:4087"))
    assert along_x == pytest.approx(A / radii(60.0)[0], rel=2e-3)
    assert along_y == pytest.approx(A / radii(60.0)[1], rel=2e-3)


TURNED = Affine(0.0, 20.0, 1e6, 20.0, 0.0, 6.67e6), Affine(16.0, 12.0, 1e6, 12.0, -16.0, 6.67e6)


@pytest.mark.parametrize("turned", TURNED, ids=["by 90", "by 37"])
def test_turned_rasters_have_the_factors_of_their_own_axes(tmp_path, turned):
    """At 60 N: x is twice too long, y is right, and a diagonal is in between."""
    along_x, along_y, _, _ = factors_of(warnings_of(tmp_path, turned, "EPSG:4087"))
    per_x, per_y = radii(6.67e6 / 111319.49)
    x, y = (turned.b, 0.0) if turned.a == 0.0 else (turned.a, turned.d)
    assert along_x == pytest.approx(20.0 / math.hypot(x / A * per_x, y / A * per_y), rel=2e-3)
    x, y = (0.0, turned.d) if turned.a == 0.0 else (turned.b, turned.e)
    assert along_y == pytest.approx(20.0 / math.hypot(x / A * per_x, y / A * per_y), rel=2e-3)


def test_utm_far_from_its_zone_is_warned_about(tmp_path):
    """1 + x^2 / 2 R^2 of a transverse Mercator: 1,500 km from its meridian 1.028."""
    far = Affine(30.0, 0.0, 2_000_000.0, 0.0, -30.0, 5_200_000.0)
    along_x, along_y, _, _ = factors_of(warnings_of(tmp_path, far, "EPSG:32632"))
    assert along_x == pytest.approx(0.9996 * (1.0 + (1.5e6 / 0.9996 / 6.378e6) ** 2 / 2), abs=1e-3) == along_y
    near = Affine(30.0, 0.0, 750_000.0, 0.0, -30.0, 5_200_000.0)
    assert warnings_of(tmp_path, near, "EPSG:32632") == []


def test_state_planes_in_feet_are_true_in_their_state_alone(tmp_path):
    assert warnings_of(tmp_path, Affine(10.0, 0.0, 1e6, 0.0, -10.0, 2e5), "EPSG:2263") == []  # New York
    assert factors_of(warnings_of(tmp_path, Affine(10.0, 0.0, 1e6, 0.0, -10.0, 4e6), "EPSG:2263"))[0] > 1.01


def test_compound_systems_are_measured_as_well(tmp_path):
    y = web_mercator(60.0)[0]
    compound = "EPSG:3857+5773"
    assert factors_of(warnings_of(tmp_path, Affine(20.0, 0.0, 1e6, 0.0, -20.0, y), compound))[0] > 1.9
    assert warnings_of(tmp_path, Affine(20.0, 0.0, 5e5, 0.0, -20.0, 5e6), "EPSG:25832+7837") == []


def test_cells_of_any_size_are_measured_or_silent(tmp_path):
    for step in (1e-20, 1e-9, 1e-3, 0.01, 100.0):
        assert warnings_of(tmp_path, Affine(step, 0.0, 5e5, 0.0, -step, 5e6), "EPSG:32632") == []


def test_systems_without_degrees_are_silent(tmp_path):
    local = 'LOCAL_CS["site grid",UNIT["metre",1]]'
    assert warnings_of(tmp_path, Affine(10.0, 0.0, 5e6, 0.0, -10.0, 9e6), local) == []


def test_another_planet_is_measured_on_its_own_ellipsoid(tmp_path):
    """A sphere of 1,737.4 km; plate carree at 60 N: twice too long along x."""
    moon = 'PROJCS["Moon",GEOGCS["Moon",DATUM["Moon",SPHEROID["Moon",1737400,0]],PRIMEM["Reference_Meridian",0],'
    moon += 'UNIT["degree",0.0174532925199433]],PROJECTION["Equirectangular"],PARAMETER["standard_parallel_1",0],'
    moon += 'PARAMETER["central_meridian",0],UNIT["metre",1]]'
    y = 1737400.0 * math.radians(60.0)
    along_x, along_y, _, _ = factors_of(warnings_of(tmp_path, Affine(20.0, 0.0, 0.0, 0.0, -20.0, y + 210.0), moon))
    assert (along_x, along_y) == pytest.approx((2.0, 1.0), rel=1e-3)


def test_projecting_or_an_extent_makes_the_warning_needless(tmp_path):
    y = web_mercator(60.0)[0]
    placed = Affine(20.0, 0.0, 1e6, 0.0, -20.0, y)
    assert warnings_of(tmp_path, placed, "EPSG:3857", project="utm") == []
    assert imported(tmp_path, tmp_path / "a.tif", extent=(100.0, 200.0))[1]["warnings"] == []
    assert len(imported(tmp_path, tmp_path / "a.tif")[1]["warnings"]) == 1


def test_beyond_utm_a_polar_system_is_suggested(tmp_path):
    y = web_mercator(84.9)[0]
    [warning] = warnings_of(tmp_path, Affine(20.0, 0.0, 1e6, 0.0, -20.0, y), "EPSG:3857")
    assert "--project EPSG:32661" in warning
    assert warnings_of(tmp_path, Affine(20.0, 0.0, 1e6, 0.0, -20.0, y), "EPSG:3857", project="EPSG:32661") == []


SOUTH_WEST, EAST_NORTH = (1.05e6, 6.5e5), (-6.5e5, -1.05e6)  # the same place in Bohemia


def slope_to_the_east(tmp_path, code, place):
    """Write heights that are the longitude, in parts of a degree that are about 1 m long."""
    columns, rows = np.meshgrid(np.arange(40) + 0.5, np.arange(40) + 0.5)
    x, y = place[0] + 100.0 * columns, place[1] - 100.0 * rows
    longitudes = np.array(transform(f"EPSG:{code}", "EPSG:4326", x.ravel(), y.ravel())[0]).reshape(40, 40)
    heights = ((longitudes - 15.7) * 7e4).astype(np.float32)
    place = {"crs": f"EPSG:{code}", "transform": Affine(100.0, 0.0, place[0], 0.0, -100.0, place[1])}
    return write_raster(tmp_path / "a.tif", heights, **place)


@pytest.mark.parametrize(
    ("code", "place", "is_mirrored"), [(5513, SOUTH_WEST, True), (2065, SOUTH_WEST, True), (5514, EAST_NORTH, False)]
)
def test_systems_that_mirror_the_ground_are_warned_about(tmp_path, code, place, is_mirrored):
    source = slope_to_the_east(tmp_path, code, place)
    for settings in ({}, {"extent": (3900.0, 3900.0)}):
        warnings = imported(tmp_path, source, **settings)[1]["warnings"]
        assert [f"x and y of EPSG:{code} run south and west" in text for text in warnings] == [True] * is_mirrored
        assert all("mirrored" in text and "--project utm" in text for text in warnings)
    raster = open_source(ImportSettings(str(source), project="utm"))
    placed, rows = raster.georeference, raster.read(0, raster.height)
    x = placed.middle[0] + (np.arange(raster.width) - (raster.width - 1) / 2) * placed.step_x
    y = placed.middle[1] - (np.arange(raster.height) - (raster.height - 1) / 2) * placed.step_y
    longitudes, _ = utm_to_degrees(*np.meshgrid(x, y), 15.0)
    inner = np.isfinite(rows)
    inner[:, :4] = inner[:, -4:] = inner[:4] = inner[-4:] = False
    off = np.abs(rows - (longitudes - 15.7) * 7e4)
    assert inner.mean() > 0.5 and np.median(off[inner]) < 5.0 < 100.0 < np.ptp(rows[inner])
    assert raster.warnings == [] and placed.warnings == ()
    raster.close()


@pytest.mark.parametrize(
    ("code", "x", "y"),
    [(32632, 5e5, 5e6), (2053, 1e5, 3e6), (3031, 0.0, 0.0), (3031, 1e6, 1e6), (3413, 0.0, 0.0),
     (32661, 2e6, 2e6), (32761, 2.5e6, 1.5e6), (3857, 20037508.0, 6e6)],
)  # fmt: skip
def test_systems_that_keep_the_ground_are_silent(tmp_path, code, x, y):
    """One of them runs west and south, which turns the ground by 180 degrees; some lie around a pole."""
    for step in (30.0, -30.0):
        source = write_raster(
            tmp_path / "a.tif", hills(9, 9), crs=f"EPSG:{code}", transform=Affine(30, 0, x, 0, step, y)
        )
        assert not any("mirrored" in text for text in imported(tmp_path, source)[1]["warnings"])


def test_across_180_degrees_an_extent_is_suggested(tmp_path):
    """--project refuses a raster of Web Mercator that passes the edge of that system."""
    across = Affine(30.0, 0.0, 20037508.0 - 150.0, 0.0, -30.0, web_mercator(-40.0)[0])
    [warning] = warnings_of(tmp_path, across, "EPSG:3857")
    assert "--project" not in warning and "--extent" in warning
    beside = Affine(30.0, 0.0, 20037508.0 - 330.0, 0.0, -30.0, web_mercator(-40.0)[0])
    [warning] = warnings_of(tmp_path, beside, "EPSG:3857")
    assert "--project utm" in warning and warnings_of(tmp_path, beside, "EPSG:3857", project="utm") == []
