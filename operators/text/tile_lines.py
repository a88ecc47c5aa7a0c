# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines about written tiles."""

from .shown_bounds import bound_text


def height_tiles_line(name: str, index: dict) -> str:
    """Describe height tiles by the content of their JSON file."""
    across, down = index["num_tiles"]
    masks = f", {len(index['masks'])} masks" if index["masks"] else ""
    error = bound_text(index["heights"]["max_error"], "m")
    return f"{name}.json: {across * down:,} tiles ({across} x {down}){masks}, heights at most {error} off"
