# SPDX-License-Identifier: GPL-3.0-or-later
"""`adaptive-terrain query`: heights, slopes and normals of a store at the points of a CSV file, or along their line."""

import csv
import io
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.field.store import open_store
from ...cbt_terrain.importing.placing import placing_of
from ...cbt_terrain.query.ground import ground_at, profile
from ...cbt_terrain.run.named_file import cause, read_named
from ...cbt_terrain.run.partial_files import written_beside
from ..output.exporting import check_target
from ..text.console import print_line

MAX_BYTES = 1 << 30
X, Y = "x", "y"
FOUND = ("height_m", "slope_deg", "normal_x", "normal_y", "normal_z")
ALONG = ("along_m", X, Y, FOUND[0])


def run(store: Path, points: Path, out: Path | None, as_line: bool) -> None:
    """Write what there is at the points as CSV, into `out` or on stdout; a line about it goes where that does not."""
    if out is not None:
        check_target(out)
    names, rows, coordinates = read_points(points, () if as_line else FOUND)
    field, placing = open_store(store), placing_of(store)
    places = placing.to_terrain(coordinates)
    if as_line:
        found = profile(field, places)
        table = np.column_stack([found.along, placing.from_terrain(found.places), found.heights])
        names, lines, inside = list(ALONG), [numbers(row) for row in table], ~np.isnan(found.heights)
    else:
        ground = ground_at(field, places)
        table = np.column_stack([ground.heights, np.degrees(ground.slopes), ground.normals])
        lines, inside = [row + numbers(values) for row, values in zip(rows, table, strict=True)], ground.inside
        names = [*names, *FOUND]
    write(names, lines, out)
    where = f"in {placing.crs}" if placing.crs else "in metres from the terrain's middle"
    line = f"{len(lines):,} places, x and y {shown(where)}; {int((~inside).sum()):,} have no ground"
    print_line(line, file=sys.stderr if out is None else sys.stdout)


def numbers(values: np.ndarray) -> list[str]:
    """As CSV holds them: the shortest text of each float64; nothing where there is none."""
    return ["" if math.isnan(value) else repr(value) for value in values.tolist()]


def read_points(path: Path, added: Sequence[str]) -> tuple[list[str], list[list[str]], np.ndarray]:
    """Column names, none of which is to be `added`, rows as they are, and float64 [n, 2] of the columns x and y. Raises
    TerrainError."""
    content = read_named(path, "The points file", "CSV in UTF-8", MAX_BYTES, own=True)
    try:
        text = content.decode("utf-8-sig")
        rows = [row for row in csv.reader(io.StringIO(text, newline=""), strict=True) if row]
    except (UnicodeDecodeError, csv.Error) as reason:
        raise TerrainError(f"{path} cannot be read ({cause(reason)}): expected CSV in UTF-8.") from None
    names = [name.strip() for name in rows[0]] if rows else []
    if names.count(X) != 1 or names.count(Y) != 1:
        said = shown(", ".join(names)) or "nothing"
        raise TerrainError(f"The first line of {path} is {said}; expected the names of columns, x and y among them.")
    taken = [name for name in added if name in names]
    if taken:
        raise TerrainError(
            f"{path} has a column {taken[0]} already; expected none of what is added ({', '.join(added)}): rename or "
            "remove it."
        )
    coordinates = np.empty((len(rows) - 1, 2))
    for n, row in enumerate(rows[1:]):
        try:
            if len(row) != len(names):
                raise ValueError
            coordinates[n] = [float(row[names.index(name)]) for name in (X, Y)]
            if not np.isfinite(coordinates[n]).all():
                raise ValueError
        except ValueError:
            raise TerrainError(
                f"Point {n + 1} of {path} is {shown(', '.join(row))}; expected {len(names)} values, numbers under x "
                "and y."
            ) from None
    return names, rows[1:], coordinates


def write(names: list[str], lines: list[list[str]], out: Path | None) -> None:
    """CSV into a file, or on stdout."""
    if out is None:
        csv.writer(sys.stdout, lineterminator="\n").writerows([names, *lines])
        return
    try:
        with written_beside(out) as partial, partial.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([names, *lines])
    except OSError as reason:
        raise TerrainError(
            f"{out} cannot be written ({reason.strerror or reason}): make room or choose another folder."
        ) from None
