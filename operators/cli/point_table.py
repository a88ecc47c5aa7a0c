# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of points as spreadsheets and GIS write them: CSV with commas, semicolons, tabs or bars, in several encodings.

`parse_points` gets the bytes of a file; it opens nothing.
"""

import codecs
import csv
import io
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...cbt_terrain.errors import TerrainError, shown

DELIMITERS = ",;\t|"
# Names of the two columns, in any case: of any coordinates, of lengths, of degrees.
ANY = (("x", "xcoord", "x_coord", "point_x", "coord_x"), ("y", "ycoord", "y_coord", "point_y", "coord_y"))
LENGTHS = (("easting", "eastings", "east", "e"), ("northing", "northings", "north", "n"))
DEGREES = (("lon", "long", "lng", "longitude"), ("lat", "latitude"))
EXPECTED = "the names of columns, x and y (or easting and northing, lon and lat) among them"


class PointTable(NamedTuple):
    """Column names, rows of text, and coordinates, float64 [n, 2].

    Rows are as in the file, except that coordinates with a decimal comma have a point.
    """

    names: list[str]
    rows: list[list[str]]
    coordinates: np.ndarray


def parse_points(content: bytes, name: str, added: Sequence[str], crs: str, is_degrees: bool) -> PointTable:
    """Read a table of points from the content of a CSV file.

    Args:
        content: the file's bytes.
        name: the file's name, for errors.
        added: names that no column may have.
        crs: name of the coordinate system of x and y, "" for metres from the terrain's middle.
        is_degrees: whether that system counts angles.

    Raises:
        TerrainError: the content is no such table; the message names the line, or the columns.
    """
    text = _decode(content)
    first, _, rest = text.partition("\n")
    if first.strip().casefold().startswith("sep=") and len(first.strip()) <= 5:  # a line of Excel's, as sep=;
        text = rest
    lines, delimiter = _split_into_cells(text, name)  # lines: (number of the line, its cells)
    names = [cell.strip() for cell in lines[0][1]] if lines else []
    columns = _find_coordinates(names, name, crs, is_degrees)
    doubled = [column for column in added if column in names]
    if doubled:
        raise TerrainError(
            f"{name} has a column {doubled[0]} already",
            expected=f"none of the columns that are added ({', '.join(added)})",
            fix="rename or remove it",
        )
    shift = text is rest  # a line was cut off: line numbers in errors are those of the file
    rows, coordinates = [], np.empty((max(len(lines) - 1, 0), 2))
    for n, (line, row) in enumerate(lines[1:]):
        values = [_parse_number(row[column], delimiter) if column < len(row) else math.nan for column in columns]
        if len(row) != len(names) or not all(map(math.isfinite, values)):
            numeric = f"{shown(names[columns[0]])} and {shown(names[columns[1]])}"
            raise TerrainError(
                f"Line {line + shift} of {name} is {shown(', '.join(row))}",
                expected=f"{len(names)} values, numbers under {numeric}",
                fix="correct or remove the line",
            )
        coordinates[n] = values
        if delimiter != ",":  # the table that goes out has decimal points
            row = [
                repr(values[columns.index(c)]) if c in columns and "," in cell else cell for c, cell in enumerate(row)
            ]
        rows.append(row)
    return PointTable(names, rows, coordinates)


def _decode(content: bytes) -> str:
    """Decode UTF-8, UTF-16 or Windows-1252, with or without a byte order mark; bytes without a letter are replaced."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16", "replace")
    # UTF-16 without a mark: in Latin text every other byte is 0, from the byte `first` on.
    for first, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        if len(content) >= 4 and not any(content[first : 64 + first : 2]) and any(content[:64]):
            return content.decode(encoding, "replace")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace")


def _split_into_cells(text: str, name: str) -> tuple[list[tuple[int, list[str]]], str]:
    """Split a text into lines of cells; return line numbers with cells, without empty lines, and the delimiter.

    The delimiter is the one with which the header has most names of coordinates, a comma if it has none. A row in
    several lines has the number of its last. Raises TerrainError for broken quotes.
    """
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    known = {column for pair in (ANY, LENGTHS, DEGREES) for axis in pair for column in axis}
    header = next((line for line in text.split("\n") if line.strip()), "")

    def num_found(delimiter: str) -> int:
        """Count the names of coordinates in the header, if it is split at `delimiter`."""
        cells = next(csv.reader([header], delimiter=delimiter, skipinitialspace=True), [])
        return sum(cell.strip().casefold() in known for cell in cells)

    delimiter = max(DELIMITERS, key=num_found)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=True, strict=True)
    try:
        return [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)], delimiter
    except csv.Error as reason:
        raise TerrainError(f"Line {reader.line_num} of {name} cannot be read ({reason})", expected="CSV") from None


def _find_coordinates(names: list[str], name: str, crs: str, is_degrees: bool) -> tuple[int, int]:
    """Return the positions of the x and the y column by their names.

    names: the columns' names. name: the table's name and crs: the store's system, in errors. is_degrees: the store is
    in degrees. Raises TerrainError unless there is one of each. ANY, LENGTHS and DEGREES: the names that x and y may
    have in any system, in one of lengths (as easting), and in one of degrees (as longitude).
    """
    folded = [column.casefold() for column in names]
    for pair in (ANY, LENGTHS, DEGREES):
        # Positions of the columns for x, and of those for y.
        found = [[n for n, column in enumerate(folded) if column in axis] for axis in pair]
        if not all(found):
            continue
        if max(map(len, found)) > 1:
            several = ", ".join(names[n] for axis in found for n in axis)
            raise TerrainError(
                f"{name} has the columns {shown(several)}", expected="one for each coordinate", fix="rename others"
            )
        used = " and ".join(names[axis[0]] for axis in found)
        if pair is not ANY and not crs:
            raise TerrainError(
                f"{name} has the columns {shown(used)}, but the terrain has no coordinate system",
                expected="x and y in metres from its middle",
            )
        if pair is not ANY and (pair is DEGREES) != is_degrees:
            unit = "degrees" if is_degrees else "lengths, not degrees"
            raise TerrainError(
                f"{name} has the columns {shown(used)}, but the terrain's coordinates are {unit}, in {shown(crs)}",
                fix="transform the points into that system, and name the columns x and y",
            )
        return found[0][0], found[1][0]
    raise TerrainError(f"The first line of {name} is {shown(', '.join(names)) or 'empty'}", expected=EXPECTED)


def _parse_number(text: str, delimiter: str) -> float:
    """Return the number in a cell, NaN if there is none.

    A decimal comma is accepted unless commas separate the cells.
    """
    text = text.strip()
    if delimiter != "," and "." not in text:
        text = text.replace(",", ".")
    try:
        return float(text) if "_" not in text else math.nan
    except ValueError:
        return math.nan
