# SPDX-License-Identifier: GPL-3.0-or-later
"""Warnings about undeclared no-data and about heights in another unit than metres."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.importing.plausibility import ValueCheck
from rasterio.transform import Affine
from rasters import hills, imported, jacksboro, write_raster

SIZE = {"extent": (3900.0, 2900.0)}


def warnings_of(values, blocks=3):
    check = ValueCheck(values.dtype)
    for rows in np.array_split(values, blocks):
        check.add(rows)
    return check.warnings()


@pytest.mark.parametrize(
    ("mark", "kind"),
    [(32767, "i2"), (-32768, "i2"), (-32767, "i2"), (65535, "u2"), (55537, "u2"), (9999, "f4"), (-9999, "f4"),
     (-99999, "f4"), (99999, "f8"), (1e20, "f4"), (-3.4028234663852886e38, "f4"), (3.4e38, "f4"), (1e38, "f8"),
     (-2147483648, "i4"), (2147483647, "i4"), (4294967295, "u4"), (0, "f4"), (65504, "f2"), (-999999, "f4")],
)  # fmt: skip
def test_marks_that_stand_apart_warn(mark, kind):
    values = hills().astype(kind)
    values[:3, 5:9] = mark
    (warning,) = warnings_of(values)
    value = float(np.array(mark).astype(kind))
    assert warning.startswith(f"12 samples hold {value:.9g}, which stands apart from all others (")
    assert f"(--no-data {value:.9g})" in warning


def test_marks_at_both_ends_and_several_at_one_warn():
    values = hills().astype(np.int32)
    values[0, :4] = -32768, -9999, 32767, 99999
    assert [warning.split(",")[0].split()[-1] for warning in warnings_of(values)] == ["-32768", "-9999", "99999"]


def ordinary():
    """Yield rasters without missing samples, some of which reach the limits of their type."""
    rng, y = np.random.default_rng(3), np.linspace(0.0, 1.0, 64)
    yield "all 16-bit values", np.arange(65536, dtype=np.uint16).reshape(256, 256)
    ramp = np.round(65535.0 * np.clip(1.4 * np.outer(y, y) - 0.2, 0.0, 1.0)).astype(np.uint16)
    yield "clipped at both ends", ramp
    yield "noise", rng.integers(0, 65536, (64, 64), np.uint16)
    yield "signed", rng.integers(-32768, 32768, (64, 64)).astype(np.int16)
    yield "8 bits", rng.integers(0, 2, (64, 64)).astype(np.uint8) * 255
    yield "sea and land", np.maximum(hills(64, 64) - 500.0, 0.0)
    yield "sea and land in metres", np.maximum(hills(64, 64) - 500.0, 0.0).astype(np.int16)
    yield "below the sea", hills(64, 64) - 9999.0
    yield "around 9999", hills(64, 64) + 9500.0
    yield "millimetres", (hills(64, 64) * 1000.0).astype(np.int32)
    yield "flat", np.zeros((64, 64), np.float32)
    yield "two levels", np.repeat([[0.0, 100.0]], 64, axis=0).astype(np.float32)
    yield "missing", np.full((64, 64), np.nan, np.float32)
    yield "jacksboro", jacksboro()


@pytest.mark.parametrize("values", [pytest.param(values, id=name) for name, values in ordinary()])
def test_ordinary_rasters_do_not_warn(values):
    assert warnings_of(values) == []


@pytest.mark.parametrize("land", ["island", "mountains"])
def test_built_in_lands_do_not_warn(tmp_path, land):
    heights = imported(tmp_path, land, size=65)[0].heights()
    np.save(tmp_path / "a.npy", heights)
    assert imported(tmp_path, tmp_path / "a.npy", extent=(8192.0, 8192.0))[1]["warnings"] == []


def test_the_no_data_option_ends_the_warning(tmp_path):
    values = hills().astype(np.int16)
    values[:3, 5:9] = 32767
    source = write_raster(tmp_path / "a.tif", values)
    assert "(--no-data 32767)" in imported(tmp_path, source, **SIZE)[1]["warnings"][0]
    field, report = imported(tmp_path, source, no_data=32767.0, **SIZE)
    assert (report["filled"], report["warnings"]) == (12, []) and field.max_height < 1000.0
    assert imported(tmp_path, source, no_data=float("nan"), **SIZE)[1]["warnings"] == []


def test_marks_are_sought_in_the_files_own_unit(tmp_path):
    values = hills().astype(np.int16)
    values[:3, 5:9] = 9999
    source = write_raster(tmp_path / "a.tif", values)
    report = imported(tmp_path, source, height_scale=0.3048, height_offset=17.0, **SIZE)[1]
    assert "(--no-data 9999)" in report["warnings"][0]


def test_a_relief_beyond_the_extent_warns(tmp_path):
    heights = np.round(hills() * 80.0).astype(np.uint16)
    source = write_raster(tmp_path / "a.png", heights)
    (warning,) = imported(tmp_path, source, height_scale=1.0)[1]["warnings"]
    assert "times the longer side, 39 m. The file names no size" in warning and "--extent" in warning
    (warning,) = imported(tmp_path, source, extent=(390.0, 290.0), height_scale=1.0)[1]["warnings"]
    assert "If heights are not in metres" in warning and "--height-scale" in warning
    assert imported(tmp_path, source, extent=(39_000.0, 29_000.0), height_scale=1.0)[1]["warnings"] == []
    assert imported(tmp_path, source, height_scale=0.001)[1]["warnings"] == []


@pytest.mark.parametrize("way", ["projected", "sheared"])
@pytest.mark.parametrize(
    ("mark", "kind"),
    [
        (9999, "f4"),
        (-32768, "i2"),
        *(pytest.param(*case, marks=pytest.mark.thorough) for case in ((32767, "i2"), (65535, "u2"), (0, "i2"))),
    ],
)
def test_marks_are_sought_before_a_raster_is_resampled(tmp_path, mark, kind, way):
    values = (hills(100, 80) + 500.0).astype(kind)
    values[20:30, 30:40] = mark
    shear = 0.0 if way == "projected" else 3.0
    place = {"crs": "EPSG:32632", "transform": Affine(10.0, shear, 5e5, 0.0, -10.0, 5e6)}
    source = write_raster(tmp_path / "a.tif", values, **place)
    settings = {"project": "EPSG:3035"} if way == "projected" else {}
    warnings = [text for text in imported(tmp_path, source, **settings)[1]["warnings"] if "no data" in text]
    assert len(warnings) == 1 and warnings[0].startswith(f"100 samples hold {mark}, ")
    for no_data in (float(mark), float("nan")):
        report = imported(tmp_path, source, no_data=no_data, **settings)[1]
        assert not any("no data" in text for text in report["warnings"])
    declared = write_raster(tmp_path / "a.tif", values, nodata=mark, **place)
    assert not any("no data" in text for text in imported(tmp_path, declared, **settings)[1]["warnings"])
