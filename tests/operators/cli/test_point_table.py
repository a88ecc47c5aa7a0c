# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of points as spreadsheets and GIS write them."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.cli.point_table import parse_points

POINTS = np.array([[600100.25, 5199950.5], [-7.125, 0.0], [1e-3, 12.0]])
ROWS = [f"{x!r},{y!r}" for x, y in POINTS.tolist()]


def parsed(content, added=(), crs="EPSG:32632", is_degrees=False):
    return parse_points(content if isinstance(content, bytes) else content.encode(), "p.csv", added, crs, is_degrees)


def table(delimiter=",", comma=False, head="x,y", end="\n"):
    rows = [row.replace(".", ";") if comma else row for row in ROWS]  # ; stands for the decimal comma until the end
    lines = [line.replace(",", "\0") for line in (head, *rows)]
    return end.join(line.replace(";", ",").replace("\0", delimiter) for line in lines) + end


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_encodings_delimiters_and_line_ends(encoding, delimiter, end):
    head = "X,Y" if encoding == "utf-16-le" else "X,Y,Größe"
    text = table(delimiter, head="X,Y", end=end)
    if head != "X,Y":
        text = text.replace(end, f"{delimiter}Größe{end}")
    found = parsed(text.encode(encoding))
    assert np.array_equal(found.coordinates, POINTS)
    assert found.names == head.split(",") and all(row[2:] == found.names[2:] for row in found.rows)


@pytest.mark.parametrize("delimiter", [";", "\t", "|"])
def test_decimal_commas(delimiter):
    found = parsed(table(delimiter, comma=True))
    assert np.array_equal(found.coordinates, POINTS)
    assert found.rows[0] == ["600100.25", "5199950.5"], "numbers that go out have points"


@pytest.mark.parametrize(
    ("content", "first"),
    [
        ('x,y\n"1.5","2"\n', (1.5, 2.0)),
        ("sep=;\nx;y\n1,5;2\n", (1.5, 2.0)),
        ("\n x , y \n 1.5 , 2 \n\n  \n\n", (1.5, 2.0)),
        ('name,x,y\n"Rock, big\nand old",1.5,2\n', (1.5, 2.0)),
        ("Northing,id,EASTING\n2,7,1.5\n", (1.5, 2.0)),
        ("POINT_X,POINT_Y\n1.5,2\n", (1.5, 2.0)),
        ("lon,lat,x,y\n7,46,1.5,2\n", (1.5, 2.0)),
        ("x,y,\n1.5,2,\n", (1.5, 2.0)),
        ('x;y;note\n1.5;2;"a;b"\n', (1.5, 2.0)),
        ("n;e;x;y\n0;0;1,5;+2e0\n", (1.5, 2.0)),
    ],
)
def test_headers_and_cells(content, first):
    assert tuple(parsed(content).coordinates[0]) == first


def test_a_header_alone_is_a_table_without_points():
    assert parsed("x,y\n").coordinates.shape == (0, 2)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("x,y\n1,2\n3,\n", "Line 3 of p.csv is 3,; expected 2 values, numbers under x and y"),
        ("x,y\n\n1,2\n\n3\n", "Line 5 of p.csv is 3; expected 2 values"),
        ("sep=,\nx,y\n1,2,3\n", "Line 3 of p.csv is 1, 2, 3; expected 2 values"),
        ("X;Y\n1;2,5,7\n", "Line 2 of p.csv is 1, 2,5,7; expected 2 values, numbers under X and Y"),
        ("x,y\n1_0,2\n", "Line 2 of p.csv"),
        ('x,y\n"1,5",2\n', "Line 2 of p.csv"),
        ("x,y\n1,inf\n", "Line 2 of p.csv"),
        ("x,X,y\n1,2,3\n", "has the columns x, X, y; expected one for each coordinate"),
        ("a;b\n1;2\n", "The first line of p.csv is a;b; expected the names of columns"),
        ("x\n1\n", "The first line of p.csv is x; expected"),
        ('x,y\n1,"2\n', "of p.csv cannot be read"),
        (b"\0\0\0\0\0", "The first line of p.csv"),
        (b"\xff\xfe", "The first line of p.csv is empty"),
    ],
)
def test_errors_name_the_line(content, message):
    with pytest.raises(TerrainError) as error:
        parsed(content)
    assert message in str(error.value)
