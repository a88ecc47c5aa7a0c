# SPDX-License-Identifier: GPL-3.0-or-later
"""`adaptive-terrain query`: heights, slopes and normals of a store at the points of a CSV file, or along their line."""

import csv
import math
import sys
from pathlib import Path

import numpy as np

from ...cbt_terrain.errors import shown, unwritable
from ...cbt_terrain.field.known_ground import is_in_gap
from ...cbt_terrain.field.store import open_store
from ...cbt_terrain.importing.placing import placing_of
from ...cbt_terrain.query.ground import ground_at, profile
from ...cbt_terrain.run.named_file import read_named
from ...cbt_terrain.run.partial_files import written_beside
from ..export.exporting import check_target
from ..text.console import print_line
from .point_table import parse_points

MAX_BYTES = 1 << 30  # of the file of points
# Columns that are added to the points, and those of a profile.
FOUND = ("height_m", "slope_deg", "normal_x", "normal_y", "normal_z")
ALONG = ("along_m", "x", "y", FOUND[0])
LONGEST_UNIT = 10_000.0  # metres; a coordinate system with a longer one counts angles


def run(store: Path, points: Path, out: Path | None, as_line: bool) -> None:
    """Write heights, slopes and normals at the points of a CSV file as CSV, into `out` or on stdout (None).

    `as_line`: write a profile along the line through the points instead. A summary is printed; on stderr if the
    table is on stdout.
    """
    if out is not None:
        check_target(out)
    # descriptors: the file may be /dev/stdin.
    content = read_named(points, "The points file", "a table as CSV", MAX_BYTES, descriptors=True)
    field, placing = open_store(store), placing_of(store)
    is_degrees = placing.metres_y > LONGEST_UNIT  # no unit of length is so long
    forbidden = () if as_line else FOUND  # names that columns of the file may not have
    names, rows, coordinates = parse_points(content, str(points), forbidden, placing.crs, is_degrees)
    positions = placing.to_terrain(coordinates)  # metres from the terrain's middle
    if as_line:
        found = profile(field, positions)
        positions = found.places
        table = np.column_stack([found.along, placing.from_terrain(found.places), found.heights])
        names, lines, inside = list(ALONG), [number_texts(row) for row in table], ~np.isnan(found.heights)
    else:
        ground = ground_at(field, positions)
        table = np.column_stack([ground.heights, np.degrees(ground.slopes), ground.normals])
        lines, inside = [row + number_texts(values) for row, values in zip(rows, table, strict=True)], ground.inside
        names = [*names, *FOUND]
    write_csv(names, lines, out)
    where = f"in {placing.crs}" if placing.crs else "in metres from the terrain's middle"
    missing = int((~inside).sum())
    line = f"{len(lines):,} place{'s' * (len(lines) != 1)}, x and y {shown(where)}; "
    line += f"{missing:,} {'has' if missing == 1 else 'have'} no ground"
    in_gap = int((inside & is_in_gap(field, positions)).sum())
    line += f", {in_gap:,} {'is' if in_gap == 1 else 'are'} in a gap between files, with filled heights" * (in_gap > 0)
    print_line(line, file=sys.stderr if out is None else sys.stdout)


def number_texts(values: np.ndarray) -> list[str]:
    """Return each number as the shortest text that parses to the same float64; "" for NaN."""
    return ["" if math.isnan(value) else repr(value) for value in values.tolist()]


def write_csv(names: list[str], lines: list[list[str]], out: Path | None) -> None:
    """Write a table as CSV into a file, or to stdout if `out` is None. Raises TerrainError if the file fails.

    names: the columns' names, for the first line. lines: the cells.
    """
    if out is None:
        csv.writer(sys.stdout, lineterminator="\n").writerows([names, *lines])
        return
    try:
        with written_beside(out) as partial, partial.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([names, *lines])
    except OSError as reason:
        raise unwritable(str(out), reason) from None
