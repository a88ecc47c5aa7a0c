# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `query`: points of a CSV file in, heights out, in the coordinates of the raster itself."""

import csv
import math

import numpy as np
import pytest
import rasterio
import store_exports
from rasterio.transform import Affine, from_origin
from rasters import hills, imported, write_raster

PLACED = {
    "metres": {"crs": "EPSG:32616", "transform": from_origin(500_000, 4_000_000, 10, 20)},
    "feet": {"crs": "EPSG:2263", "transform": from_origin(900_000, 200_000, 50, 50)},
    "degrees": {"crs": "EPSG:4326", "transform": from_origin(7.5, 46.5, 1 / 1200, 1 / 1200)},
    "south first": {"crs": "EPSG:32616", "transform": Affine(10, 0, 500_000, 0, 10, 4_000_000)},
}


@pytest.fixture
def query(tmp_path, capsys):
    """Run `query` on lines of CSV; returns the exit code, rows as dicts and the output."""

    def run(lines, *more, store="store"):
        (tmp_path / "points.csv").write_text("\n".join(lines), encoding="utf-8")
        code = store_exports.run("query", "--store", tmp_path / store, "--points", tmp_path / "points.csv", *more)
        printed = capsys.readouterr()
        out = tmp_path / "out.csv"
        text = out.read_text(encoding="utf-8") if out.exists() else printed.out
        return code, list(csv.DictReader(text.splitlines())), printed

    return run


@pytest.mark.parametrize("name", ["feet", "degrees", "south first"])
def test_coordinates_are_those_of_the_raster(name, query, tmp_path):
    heights = hills(31, 22)
    imported(tmp_path, write_raster(tmp_path / "a.tif", heights, **PLACED[name]))
    with rasterio.open(tmp_path / "a.tif") as file:
        cells = [(row, column) for row in (0, 9, 21) for column in (0, 17, 30)]
        points = [file.xy(row, column) for row, column in cells]
    code, rows, printed = query(["name,x,y", *(f"p{n},{x!r},{y!r}" for n, (x, y) in enumerate(points)), "far,0,0"])
    assert code == 0 and f"10 places, x and y in {PLACED[name]['crs']}; 1 has no ground" in printed.err
    assert [row["name"] for row in rows] == [*(f"p{n}" for n in range(9)), "far"]
    found = [float(row["height_m"]) for row in rows[:-1]]
    assert np.abs(np.array(found) - [heights[cell] for cell in cells]).max() < 1e-3
    assert rows[-1]["height_m"] == rows[-1]["slope_deg"] == rows[-1]["normal_z"] == ""


def test_slopes_and_normals_of_a_plane(query, tmp_path):
    plane = np.tile(np.arange(12, dtype=np.float32) * np.float32(10 / math.sqrt(3)), (9, 1))
    imported(tmp_path, write_raster(tmp_path / "a.tif", plane), extent=(110.0, 80.0))
    code, (row,), printed = query(["\ufeff x , y", "", "3.5,-1e1"])
    assert code == 0 and "1 place, x and y in metres from the terrain's middle; 0 have no ground" in printed.err
    assert float(row["slope_deg"]) == pytest.approx(30, abs=1e-5)
    assert float(row["normal_x"]) == pytest.approx(-0.5, abs=1e-6) and float(row["normal_y"]) == 0


def test_a_rotated_raster_is_queried_from_its_middle(query, tmp_path):
    source = write_raster(tmp_path / "a.tif", hills(31, 22), **PLACED["degrees"])
    imported(tmp_path, source, extent=(300.0, 210.0))
    assert "in metres from the terrain's middle" in query(["x,y", "0,0"])[2].err
    turned = PLACED["metres"] | {"transform": Affine(8, 12, 1000, 6, -16, 2000)}
    imported(tmp_path, write_raster(tmp_path / "a.tif", hills(31, 22), **turned))
    assert "in metres from the terrain's middle; 0 have" in query(["x,y", "0,0"])[2].err


def test_a_profile_into_a_file(query, tmp_path):
    heights = hills(31, 22)
    imported(tmp_path, write_raster(tmp_path / "a.tif", heights, **PLACED["metres"]))
    y = 4_000_000 - 20 * 4.5  # the middle of row 4
    lines = ["x,y,height_m", f"500005,{y},7", f"500305,{y},8"]  # those of the points themselves are not written
    code, rows, printed = query(lines, "--profile", "--out", tmp_path / "out.csv")
    assert (code, printed.err) == (0, "") and printed.out.startswith("31 places, x and y in EPSG:32616; 0 have")
    assert [float(row["along_m"]) for row in rows] == pytest.approx(10.0 * np.arange(31))
    assert [float(row["height_m"]) for row in rows] == pytest.approx(heights[4], abs=1e-3)
    assert float(rows[-1]["x"]) == 500305 and list(rows[0]) == ["along_m", "x", "y", "height_m"]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "is empty; expected the names of columns, x and y (or easting and northing, lon and lat) among them"),
        (["lon,lat", "1,2"], "has the columns lon and lat, but the terrain has no coordinate system"),
        (["x,y", "1,2", "3,north"], "Line 3 of"),
        (["x,y", "1,nan"], "is 1, nan; expected 2 values"),
        (["x,y", "1,2,3"], "expected 2 values"),
        (["x,y", '1,"2'], "cannot be read (unexpected end of data)"),
        (["x,y,height_m", "1,2,3"], "has a column height_m already; expected none of the columns that are added"),
    ],
)
def test_bad_points_are_refused(query, tmp_path, lines, message):
    imported(tmp_path, write_raster(tmp_path / "a.tif", hills(9, 8)))
    code, _, found = query(lines)
    assert code == 1 and message in found.err and found.out == "" and found.err.count("\n") == 1


def test_other_bad_input_is_refused(query, tmp_path):
    imported(tmp_path, write_raster(tmp_path / "a.tif", hills(9, 8)))
    assert "There is no terrain store at" in query(["x,y", "0,0"], store="none")[2].err
    assert "The line has 1 points" in query(["x,y", "0,0"], "--profile")[2].err
    for out, message in (
        (tmp_path / "none" / "out.csv", "There is no folder"),
        (tmp_path, "is a folder; expected a file"),
    ):
        assert message in query(["x,y", "0,0"], "--out", out)[2].err
    assert "cannot be read" in query([], "--points", tmp_path / "none.csv")[2].err


def test_a_table_of_a_spreadsheet_is_read(query, tmp_path):
    heights = hills(31, 22)
    imported(tmp_path, write_raster(tmp_path / "a.tif", heights, **PLACED["metres"]))
    lines = ["Name;Easting;Northing", "Zürich;500175,0;3999790"]
    (tmp_path / "other.csv").write_bytes("\r\n".join(lines).encode("cp1252"))
    code, (row,), printed = query([], "--points", tmp_path / "other.csv")
    assert (code, row["Name"], float(row["Easting"])) == (0, "Zürich", 500175.0), printed
    assert float(row["height_m"]) == pytest.approx(heights[10, 17], abs=1e-3)


def test_degrees_are_for_systems_in_degrees(query, tmp_path):
    heights = hills(31, 22)
    imported(tmp_path, write_raster(tmp_path / "a.tif", heights, **PLACED["degrees"]))
    x, y = 7.5 + 17.5 / 1200, 46.5 - 10.5 / 1200
    code, (row,), _ = query(["Latitude,Longitude", f"{y!r},{x!r}"])
    assert code == 0 and float(row["height_m"]) == pytest.approx(heights[10, 17], abs=1e-3)
    assert "the terrain's coordinates are degrees, in EPSG:4326" in query(["easting,northing", "1,2"])[2].err
    imported(tmp_path, write_raster(tmp_path / "a.tif", heights, **PLACED["metres"]))
    assert "are lengths, not degrees, in EPSG:32616" in query(["lon,lat", "1,2"])[2].err
