# SPDX-License-Identifier: GPL-3.0-or-later
"""Two coordinates are read from texts as maps, tables and the panel write them."""

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.text.coordinates import EAST_FIRST, NO_ORDER, NORTH_FIRST, parse_coordinates
from hypothesis import given
from hypothesis import strategies as st


@pytest.mark.parametrize(
    "text, first, second",
    [
        ("47.42, 10.98", 47.42, 10.98),
        ("47.42,10.98", 47.42, 10.98),
        ("47.42,100.980", 47.42, 100.98),
        (" (47.42 10.98)\n", 47.42, 10.98),
        ("47.420\t10.980", 47.42, 10.98),
        ("-33.9 / 151.2", -33.9, 151.2),
        ("\u221233.9; +151.2", -33.9, 151.2),
        ("47,42 10,98", 47.42, 10.98),
        ("47,42, 10,98", 47.42, 10.98),
        ("2600000 1200000", 2600000.0, 1200000.0),
        ("600,200", 600.0, 200.0),
        ("2'600'000 1'200'000", 2600000.0, 1200000.0),
        ("2\u2019600\u2019000.5/1\u2019200\u2019000", 2600000.5, 1200000.0),
        ("2,600,000 1,200,000", 2600000.0, 1200000.0),
        ("2,600,000.50, 1,200,000.25", 2600000.5, 1200000.25),
        ("2.600.000,5 1.200.000,5", 2600000.5, 1200000.5),
        ("2 600 000, 1 200 000", 2600000.0, 1200000.0),
        ("2\u202f600\u202f000; 1\u00a0200\u00a0000", 2600000.0, 1200000.0),
    ],
)
def test_numbers_are_read_as_people_write_them(text, first, second):
    assert parse_coordinates(text) == (first, second, NO_ORDER, False)


@pytest.mark.parametrize(
    "text, expected",
    [
        ("E 2,600,000.00, N 1,200,000.00", (2600000.0, 1200000.0, EAST_FIRST, False)),
        ("easting=850.00 northing=-1,200.00", (850.0, -1200.0, EAST_FIRST, False)),
        ("y: 3 x: 4", (3.0, 4.0, NORTH_FIRST, False)),
        ("47.420000° N, 10.980000° E", (47.42, 10.98, NORTH_FIRST, True)),
        ("10.98°W 47.42°S", (-10.98, -47.42, EAST_FIRST, True)),
        ("33.9 S, 151.2 E", (-33.9, 151.2, NORTH_FIRST, True)),
        ("N47.5 E10.5", (47.5, 10.5, NORTH_FIRST, False)),
        ("Lat: 47.42, Lon: -10.98", (47.42, -10.98, NORTH_FIRST, True)),
        ("47°30'36\"N 10°45'0.0\"E", (47.51, 10.75, NORTH_FIRST, True)),
        ("47° 30\u2032 36\u2033, -10° 45\u2032", (47.51, -10.75, NO_ORDER, True)),
        ("-0° 30' 0'' / 0° 15' 0''", (-0.5, 0.25, NO_ORDER, True)),
    ],
)
def test_names_and_degree_signs_are_read(text, expected):
    assert parse_coordinates(text) == pytest.approx(expected)


@pytest.mark.parametrize(
    "text",
    ["", " , ", "Zugspitze", "47.42", "1 2 3", "nan nan", "inf 2", "1e5 2e5", "--5 3", "47°75'N 10°E", "47.5°30' 10°",
     "-5 S 3 E", "47 N 48 N", "5 N 3", "47° 16\u2033 O, 10° O", "1" + "0" * 400 + " 1", "47 10\0", "1.2.3 4"],
)  # fmt: skip
def test_other_texts_are_refused(text):
    with pytest.raises(TerrainError, match="coordinates.*expected two numbers, such as"):
        parse_coordinates(text)


@pytest.mark.parametrize("text", ["47,420 10,980", "47,420; 10,980", "600,200, 300,400"])
def test_commas_with_two_meanings_are_refused(text):
    with pytest.raises(TerrainError, match="decimals or thousands.*decimal points"):
        parse_coordinates(text)


@given(st.text(st.sampled_from("0123456789.,;'\" °NESWxy-+\n\u2019e"), max_size=30))
def test_any_text_is_read_or_refused(text):
    try:
        read = parse_coordinates(text)
    except TerrainError:
        return
    assert all(abs(number) < 1e31 for number in read[:2])


@given(*[st.floats(-1e9, 1e9)] * 2)
def test_the_coordinates_of_the_panel_are_read(east, north):
    read = parse_coordinates(f"E {east:,.2f}, N {north:,.2f}")
    assert read[2] == EAST_FIRST and read[:2] == (float(f"{east:.2f}"), float(f"{north:.2f}"))


@given(st.floats(-90, 90), st.floats(-180, 180))
def test_degrees_of_the_panel_are_read(latitude, longitude):
    north, east = "N" if latitude >= 0.0 else "S", "E" if longitude >= 0.0 else "W"
    read = parse_coordinates(f"{abs(latitude):.6f}° {north}, {abs(longitude):.6f}° {east}")
    assert read == (float(f"{latitude:.6f}"), float(f"{longitude:.6f}"), NORTH_FIRST, True)
