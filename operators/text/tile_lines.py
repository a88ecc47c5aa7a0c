# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines about written tiles."""

from .shown_bounds import bound_text


def height_tiles_line(name: str, index: dict) -> str:
    """Describe height tiles by the content of their JSON file."""
    across, down = index["num_tiles"]
    masks = f", {len(index['masks'])} masks" if index["masks"] else ""
    error = bound_text(index["heights"]["max_error"], "m")
    return f"{name}.json: {across * down:,} tiles ({across} x {down}){masks}, heights at most {error} off"


def tileset_line(name: str, report) -> str:
    """Describe a tileset by its TilesetReport."""
    bounds = " to ".join(bound_text(bound, "m") for bound in dict.fromkeys((report.bounds[-1], report.bounds[0])))
    place = "on the globe" if report.is_on_globe else "in metres from the terrain's middle"
    levels = f"{len(report.bounds)} level{'s' if len(report.bounds) > 1 else ''}"
    counts = f"{report.num_tiles:,} tiles in {levels}, {report.num_triangles:,} triangles"
    return f"{name}: {counts}, {place}, bounds {bounds}"
