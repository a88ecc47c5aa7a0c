# SPDX-License-Identifier: GPL-3.0-or-later
"""Warnings about files that later files hide."""

from contextlib import closing

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.mosaic import hidden_files
from adaptive_terrain.cbt_terrain.mosaic.hidden_files import hidden_warnings, thin_warnings
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.mosaic.mosaic_source import open_composite
from adaptive_terrain.operators.cli import command_line
from mosaic_files import DEGREES, EAST, NORTH, UTM32, UTM33, moved, settings_of, sheet


def warnings_of(*files, **more):
    return hidden_warnings(open_composite(settings_of(*files, **more), None))


@pytest.fixture
def country(tmp_path):
    """Write four tiles of a country with 8 m steps, each of 320 m, in a folder."""
    whole = sheet(UTM32, EAST, NORTH, 8.0, 8.0, 80, 80)
    for row in (0, 40):
        for column in (0, 40):
            whole.write(tmp_path / "country" / f"{row}_{column}.tif", row, 40, column, 40)
    return tmp_path / "country"


@pytest.fixture
def city(tmp_path):
    """Write a city with 1 m steps on the corner that the country's tiles share."""
    return sheet(UTM32, EAST + 240, NORTH - 260, 1.0, 1.0, 160, 150).write(tmp_path / "city.tif")


def test_a_city_before_tiles_of_its_country_is_named(city, country, capsys):
    """Each tile covers a part of the city, all of them together cover it whole."""
    [warning] = warnings_of(city, country)
    assert warning.startswith("city.tif lies below coarser files, such as 40_0.tif, which cover 100 % of it")
    assert "Name the finer files last, or set Overlaps to Finest File (--priority resolution)." in warning
    assert command_line.main(["info", str(city), str(country)]) == 0
    assert warning in capsys.readouterr().out
    assert warnings_of(country, city) == warnings_of(city, country, priority="resolution") == []


def test_an_import_warns_once_and_before_its_long_work(city, country, tmp_path, capsys):
    assert command_line.main(["import", str(city), str(country), "--store", str(tmp_path / "store")]) == 0
    lines = capsys.readouterr().out.splitlines()
    [place] = [number for number, line in enumerate(lines) if "city.tif lies below coarser files" in line]
    [lowest] = [number for number, line in enumerate(lines) if line.startswith("lowest_m: ")]
    assert place < lowest


@pytest.mark.parametrize("inside", [0.3, 0.7])
def test_a_city_that_is_mostly_below_is_named(tmp_path, country, inside):
    """A city beyond the eastern border of its country is warned about if more than a half of it is hidden."""
    west = EAST + 640 - inside * 200
    city = sheet(UTM32, west, NORTH - 100, 1.0, 1.0, 200, 100).write(tmp_path / "city.tif")
    found = warnings_of(city, country)
    assert len(found) == (inside > 0.5) and all("cover 7" in text for text in found)


@pytest.mark.parametrize("crs", [UTM33, DEGREES])
def test_files_in_other_systems_are_compared_by_their_places(tmp_path, city, crs):
    x, y = (float(value) for value in moved(UTM32, crs, EAST, NORTH))
    step_x, step_y = (10.0, 10.0) if crs == UTM33 else (1.4e-4, 9e-5)
    around = sheet(crs, x - 20 * step_x, y + 20 * step_y, step_x, step_y, 120, 120).write(tmp_path / "around.tif")
    [warning] = warnings_of(city, around, project=UTM32)
    assert warning.startswith("city.tif lies below coarser files, such as around.tif")
    # Turned by 3 degrees, the corner of a file's box is outside of the file.
    far = sheet(crs, x + 30 * step_x, y - 30 * step_y, step_x, step_y, 120, 120).write(tmp_path / "far.tif")
    assert warnings_of(city, far, project=UTM32) == []


def test_a_file_below_files_of_its_step_has_no_effect(tmp_path, country):
    within = sheet(UTM32, EAST + 82, NORTH - 82, 8.0, 8.0, 40, 40).write(tmp_path / "within.tif")
    [warning] = warnings_of(within, country)
    assert warning.startswith("within.tif has no effect except in gaps of later files, such as ")
    assert "name it last" in warning and warnings_of(country, within) == []


def test_tiles_that_overlap_at_borders_are_not_named(tmp_path):
    """Each tile has a margin of a quarter on its neighbours of two steps."""
    for number, step in enumerate((4.0, 1.0, 4.0, 1.0)):
        side = int(200 / step)
        sheet(UTM32, EAST + 150 * number, NORTH, step, step, side, side).write(tmp_path / "row" / f"{number}.tif")
    assert warnings_of(tmp_path / "row") == []


def test_no_file_is_examined_for_borders_alone(country, city, monkeypatch):
    """A closer look costs 1 ms for each file, which thousands of tiles with common borders do not need."""
    looks = []
    monkeypatch.setattr(hidden_files, "_cover_of", lambda *file: looks.append(file))
    assert warnings_of(country, city) == [] and looks == []


@pytest.mark.parametrize("shape", [(1, 40), (40, 1), (1, 1)])
def test_files_of_one_sample_are_named_if_gaps_are_cut(tmp_path, shape):
    """Nothing is left of them, unless they are beside another file."""
    whole = sheet(UTM32, EAST, NORTH, 8.0, 8.0, 80, 80)
    rows, columns = shape
    large, alone = whole.write(tmp_path / "large.tif", 0, 40, 0, 40), tmp_path / "alone.tif"
    whole.write(alone, 0, rows, 60, columns) if columns == 1 else whole.write(alone, 60, rows, 0, columns)
    beside = tmp_path / "beside.tif"
    whole.write(beside, 0, rows, 40, columns) if columns == 1 else whole.write(beside, 40, rows, 0, columns)
    with closing(open_composite(settings_of(large, alone, beside, holes=True), None)) as composite:
        [warning] = thin_warnings(composite)
    assert warning.startswith("alone.tif is one sample wide and beside no other file, so nothing is left of it where")
    reports = {}
    for holes in (True, False):
        settings = settings_of(large, alone, beside, holes=holes)
        reports[holes] = run_mosaic_import(settings, tmp_path / f"store{holes}")
        assert (warning in reports[holes]["warnings"]) == holes
    field = open_store(tmp_path / "storeTrue")
    shown = np.argwhere(field.valid)  # the samples of all three files are known
    assert len(shown) == 1600 + 2 * rows * columns
    percent = 100.0 * (1.0 - len(shown) / field.samples.size)
    assert [reports[holes]["missing_percent"] for holes in (True, False)] == pytest.approx([percent, percent], abs=0.01)


def test_missing_percent_counts_no_data_inside_files(tmp_path):
    """By its header one file covers everything, so `gap_percent` is 0 beside a second one."""
    left, right = (sheet(UTM32, EAST + east, NORTH, 8.0, 8.0, 40, 40) for east in (0.0, 320.0))
    left.heights[5:25, 10:30] = np.nan
    files = left.write(tmp_path / "left.tif"), right.write(tmp_path / "right.tif")
    report = run_mosaic_import(settings_of(*files, holes=True), tmp_path / "store")
    assert report["gap_percent"] == 0.0 and report["cut_out"] == 400
    assert report["missing_percent"] == pytest.approx(100.0 * 400 / (80 * 40), abs=0.01)
