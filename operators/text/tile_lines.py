# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines about written tiles."""

from .shown_bounds import bound_text


def height_tiles_line(name: str, index: dict) -> str:
    """Describe height tiles in a line: number of tiles and masks, and error. index: content of their JSON file `name`.

    For example `land.json: 4 tiles (2 x 2), heights at most 0.01 m off`.
    """
    across, down = index["num_tiles"]
    masks = f", {_counted(len(index['masks']), 'mask')}" if index["masks"] else ""
    error = bound_text(index["heights"]["max_error"], "m")
    return f"{name}.json: {_counted(across * down, 'tile')} ({across} x {down}){masks}, heights at most {error} off"


def tileset_line(name: str, report) -> str:
    """Describe the tileset in the file `name` in a line: tiles, levels, triangles, bounds. report: TilesetReport."""
    # Of the finest and the coarsest level, once if both are equal.
    bounds = " to ".join(bound_text(bound, "m") for bound in dict.fromkeys((report.bounds[-1], report.bounds[0])))
    place = "on the globe" if report.is_on_globe else "in metres from the terrain's middle"
    tiles, levels = _counted(report.num_tiles, "tile"), _counted(len(report.bounds), "level")
    counts = f"{tiles} in {levels}, {report.num_triangles:,} triangles"
    return f"{name}: {counts}, {place}, bounds {bounds}"


def _counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless it is 1."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
