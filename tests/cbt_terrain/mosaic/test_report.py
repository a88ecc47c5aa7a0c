# SPDX-License-Identifier: GPL-3.0-or-later
"""The report on a mosaic: by `info` and before an import, as text and as JSON."""

import json

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.importing.covered import covered_points
from adaptive_terrain.cbt_terrain.mosaic import report
from adaptive_terrain.cbt_terrain.mosaic.composite import Composite
from adaptive_terrain.cbt_terrain.mosaic.edges import find_edges
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.mosaic.mosaic_source import open_composite
from adaptive_terrain.cbt_terrain.mosaic.report import (
    _expected_seconds,
    coverage,
    covered_entry,
    datum_warnings,
    describe_mosaic,
)
from adaptive_terrain.cbt_terrain.mosaic.seams import find_seams
from adaptive_terrain.operators.cli import command_line
from mosaic_files import EAST, NORTH, UTM32, UTM33, moved, settings_of, sheet
from rasterio.transform import Affine


def opened(*files, **more):
    return open_composite(settings_of(*files, **more), None)


@pytest.fixture
def pair(tmp_path):
    """Write two tiles that share one row of samples, the second 2 m higher."""
    first = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 40, 30)
    second = sheet(UTM32, EAST, NORTH - 290, 10.0, 10.0, 40, 30, shift=2.0)
    return first.write(tmp_path / "tiles" / "a.tif"), second.write(tmp_path / "tiles" / "b.tif")


def test_a_shared_row_is_a_seam(pair):
    seams = find_seams(opened(*pair))
    assert (seams.pairs, len(seams.steps)) == (1, 42)  # the row, and its ends as samples of two more sides
    assert np.abs(seams.steps - 2.0).max() < 1e-3
    assert np.abs(seams.places[:, 1] - (NORTH - 295)).max() < 1e-6


def test_seams_inside_of_missing_borders_are_found(tmp_path):
    """A file with a rim without data has its seam inside."""
    first = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 40, 40)
    second = sheet(UTM32, EAST + 50, NORTH - 50, 10.0, 10.0, 30, 30, shift=-1.5)
    second.heights[:3] = second.heights[-3:] = second.heights[:, :3] = second.heights[:, -3:] = np.nan
    seams = find_seams(opened(first.write(tmp_path / "a.tif"), second.write(tmp_path / "b.tif")))
    assert len(seams.steps) == 24 * 24 and np.abs(seams.steps + 1.5).max() < 1e-3


@pytest.mark.parametrize("turned", [False, True])
def test_a_step_between_files_that_only_meet_is_an_edge(tmp_path, turned):
    """Tiles of cells share no row. One is 7 m too high; another has a cliff and missing samples at its border."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 90, 60)
    whole.heights[20:, 30:60] += 7.0
    whole.heights[:8, 60:] += 300.0
    whole.heights[10:13, 60] = np.nan
    for row, rows in ((0, 20), (20, 40)):
        for column in (0, 30, 60):
            file = whole.write(tmp_path / "tiles" / f"{row}_{column}.tif", row, rows, column, 30)
            if turned:
                with rasterio.open(file, "r+") as opened_file:
                    opened_file.transform = Affine.rotation(20.0) @ opened_file.transform
    report = describe_mosaic(opened(tmp_path / "tiles"), settings_of(tmp_path / "tiles"))
    assert (report["seam_samples"], report["edges"], report["edges_compared"]) == (0, 7, 7)
    assert report["edge_max_m"] == pytest.approx(7.0, abs=0.5) and report["edge_median_m"] < 1.0
    assert "20_30.tif" in report["edge_max_between"]
    if not turned:
        x, y = report["edge_max_at"]
        middles = {(EAST + 450, NORTH - 200), (EAST + 300, NORTH - 400), (EAST + 600, NORTH - 400)}
        assert (x, y) in middles


@pytest.mark.parametrize("axis", [0, 1])
def test_rough_land_is_no_step_between_files(tmp_path, axis):
    """Extrapolation from the two outermost samples alone would find a step of 4.5 m in these waves."""
    waves = 500.0 * np.sin(np.pi / 12 * (np.arange(40) - 19.5))
    for offset in (0.0, 5.0):
        whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 40, 40)
        whole.heights[:] = waves[None, :] if axis == 0 else waves[:, None]
        files = []
        for part in range(2):
            rows, columns = ((0, 40), (20 * part, 20)) if axis == 0 else ((20 * part, 20), (0, 40))
            whole.heights += offset * part
            files.append(whole.write(tmp_path / f"{offset}_{part}.tif", *rows, *columns))
        [step] = find_edges(opened(*files)).steps
        assert step == pytest.approx(offset, abs=0.8)


def test_edges_pass_the_date_line(tmp_path):
    west, east = (sheet("EPSG:4326", x, 0.01, 1e-3, 1e-3, 20, 20) for x in (180 - 0.02, -180.0))
    west.heights[:], east.heights[:] = 5.0, 9.0
    found = find_edges(opened(west.write(tmp_path / "w.tif"), east.write(tmp_path / "e.tif")))
    assert found.pairs == 1 and found.steps.tolist() == [4.0]
    assert find_edges(opened(west.write(tmp_path / "a.tif"), west.write(tmp_path / "b.tif"))).pairs == 0


def test_coverage_counts_cells(tmp_path, pair):
    assert coverage(opened(*pair)) == (pytest.approx(10 / 580, abs=0.01), 0.0)
    far = sheet(UTM32, EAST + 800, NORTH, 10.0, 10.0, 40, 59).write(tmp_path / "far.tif")
    assert coverage(opened(*pair, far))[1] == pytest.approx(400 / 1190, abs=0.01)


def test_the_points_of_files_are_reported_with_large_gaps(tmp_path, pair):
    """The second file is in the south-east of the first one."""
    assert covered_entry(opened(*pair)) == {}
    files = [
        sheet(UTM32, EAST + x, NORTH - y, 10.0, 10.0, columns, rows).write(tmp_path / f"{x}.tif")
        for x, y, columns, rows in ((0, 0, 40, 30), (900, 1400, 30, 20))
    ]
    points = covered_points(covered_entry(opened(*files))["covered"])
    x, y = np.linspace(5.0, 1195.0, 256), np.linspace(1595.0, 5.0, 256)[:, None]  # metres east and south, row 0 south
    expected = (x < 400) & (y < 300) | (x > 900) & (y > 1400)
    assert (points != expected).mean() < 0.002 and points.shape == expected.shape


@pytest.mark.parametrize("quick", [0, 1_000_000])
def test_a_step_between_files_is_a_warning_of_the_import(tmp_path, quick):
    """Also of a quick import that reads all samples, which is the first one in Blender's window."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 60, 30)
    for shift, expected in ((1.5, 0), (5.0, 1)):
        files = []
        for column in (0, 30):
            whole.heights[:, 30:] += shift if column else 0.0
            files.append(whole.write(tmp_path / f"{shift}_{column}.tif", 0, 30, column, 30))
        report = run_mosaic_import(settings_of(*files, quick=quick), tmp_path / f"store_{shift}_{quick}")
        warnings = [text for text in report["warnings"] if "meet with a step" in text]
        assert len(warnings) == expected and report["edge_max_m"] > 0.0
        whole.heights[:, 30:] -= shift
    assert "5.0_0.tif and 5.0_30.tif" in warnings[0]
    assert f"near {EAST + 300:.10g}, {NORTH - 150:.10g}." in warnings[0]


def test_differing_vertical_datums_are_warned_about(tmp_path):
    files = []
    for name, crs in (("a", "EPSG:32632+5773"), ("b", "EPSG:32632+3855"), ("c", "EPSG:32632")):
        one = sheet(UTM32, EAST + 100 * len(files), NORTH, 10.0, 10.0, 10, 10)
        files.append(one.write(tmp_path / f"{name}.tif", crs=crs))
    [warning] = datum_warnings(opened(*files))
    assert "EGM96 in 1, EGM2008 in 1, and 1 name none" in warning
    assert datum_warnings(opened(files[0], files[2])) == []
    assert opened(*files).grid.crs == UTM32


def test_the_time_is_measured_on_one_large_window(tmp_path, monkeypatch):
    file = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 700, 600).write(tmp_path / "a.tif")
    composite, windows = opened(file), []
    read = composite.read
    monkeypatch.setattr(composite, "read", lambda *window: windows.append(window) or read(*window))
    assert _expected_seconds(composite) > 0.0
    assert windows[-1] == (43, 513, 93, 513) and composite.grid.width == 700 and composite.grid.height == 600
    assert sum(rows * columns for _, rows, _, columns in windows[:-1]) < 0.1 * 513**2


@pytest.mark.parametrize(("column", "row"), [(140, 140), pytest.param(20, 230, marks=pytest.mark.thorough)])
def test_the_time_of_a_blended_inset_counts_by_its_area(tmp_path, monkeypatch, column, row):
    """A blended sample takes ten times as long; the inset of 6 % lies in the middle, or near a corner."""
    country = sheet(UTM32, EAST, NORTH, 25.0, 25.0, 320, 320).write(tmp_path / "country.tif")
    city = sheet(UTM32, EAST + 25 * column, NORTH - 25 * row, 5.0, 5.0, 400, 400).write(tmp_path / "city.tif")
    composite, clock, read = opened(country, city), [0.0], Composite.read

    def timed_read(self, top, rows, left, columns):
        """Read, and let the clock say 1 us a sample, or 10 us in the window of an inset."""
        city_columns = 5 * column < left + columns / 2 < 5 * column + 400
        is_blended = city_columns and 5 * row < top + rows / 2 < 5 * row + 400
        clock[0] += rows * columns * (1e-5 if is_blended else 1e-6)
        return read(self, top, rows, left, columns)

    monkeypatch.setattr(Composite, "read", timed_read)
    monkeypatch.setattr(report.time, "perf_counter", lambda: clock[0])
    number = composite.grid.width * composite.grid.height
    inset = (400 / 1596) ** 2
    assert _expected_seconds(composite) == pytest.approx(number * 1e-6 * (1.0 + 9.0 * inset), rel=0.1)


def test_info_describes_several_files_as_one_terrain(pair, tmp_path, capsys):
    folder = str(pair[0].parent)
    assert command_line.main(["info", folder, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (
        report["files"] == 2 and report["raster"] == [40, 59] and report["seam_max_m"] == pytest.approx(2.0, abs=1e-3)
    )
    west, south, east, north = report["west_south_east_north"]
    assert (west, east) == (EAST + 5, EAST + 395) and (south, north) == (NORTH - 585, NORTH - 5)
    x, y = moved(UTM32, UTM33, EAST, NORTH)
    other = sheet(UTM33, float(x), float(y), 10.0, 10.0, 10, 10).write(tmp_path / "other.tif")
    assert command_line.main(["info", folder, str(other), "--project", "EPSG:32633", "--step", "20"]) == 0
    lines = capsys.readouterr().out
    assert "files: 3\n" in lines and "crs: EPSG:32633\n" in lines and "step_m: 20.0, 20.0\n" in lines


def test_an_import_prints_the_report_before_it_works(pair, tmp_path, capsys):
    store = str(tmp_path / "store")
    assert command_line.main(["import", *map(str, pair), "--store", store]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = [line.partition(":")[0] for line in lines]
    assert names.index("seam_median_m") < names.index("expected_disk_mb") < names.index("lowest_m")
    assert names.count("files") == 1 and lines[-1].startswith(store) and "ready after" in lines[-1]
    assert "seconds" not in names  # a second time, of the work without its start
    assert command_line.main(["info", store]) == 0
    assert "seam_max_m: " in capsys.readouterr().out


def test_options_of_several_files_are_refused_for_one(pair, tmp_path, capsys):
    arguments = ["import", str(pair[0]), "--step", "5", "--store", str(tmp_path / "store")]
    assert command_line.main(arguments) == 1
    assert "A step and a priority are of several files" in capsys.readouterr().err
    assert command_line.main(["import", "island", str(pair[0]), "--store", str(tmp_path / "store")]) == 1
    assert "The built-in terrain island cannot be one of several sources" in capsys.readouterr().err
