# SPDX-License-Identifier: GPL-3.0-or-later
"""Folders of maps: images and one JSON file.

maps.json                positions of the tiles; unit, coding and tiles of each map
NAME.1001.png ...        tiles of a map; NAME.png for a small terrain with one tile
"""

import json
import os
import re
from pathlib import Path
from typing import Any

from ..errors import TerrainError
from ..run.named_file import cause, read_regular

JSON_NAME = "maps.json"
VERSION = 1
UDIM = "<UDIM>"
MAX_BYTES = 1 << 24
BAKE_AGAIN = "remove the file and bake them again"
_FILE = re.compile(r"[a-z0-9_]+(\.<UDIM>|\.\d{4})?\.(png|exr)")


def file_name(name: str, form: str, number: int | None) -> str:
    """Return the file name of the tile with a number, None for the only one."""
    return f"{name}.{form}" if number is None else f"{name}.{number}.{form}"


def read_index(folder: str | os.PathLike) -> dict | None:
    """Return the content of a folder's maps.json, None without one. Raises TerrainError if it is damaged."""
    file = Path(folder) / JSON_NAME
    try:
        content = json.loads(read_regular(file, MAX_BYTES).decode("utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError) as reason:
        raise TerrainError(f"The maps {file} cannot be read ({cause(reason)})", fix=BAKE_AGAIN) from None
    if not _is_index(content):
        raise TerrainError(f"The maps {file} are damaged, or of another version than {VERSION}", fix=BAKE_AGAIN)
    return content


def image_files(index: dict) -> set[str]:
    """Return the names of the images that an index (the content of maps.json) lists."""
    return {tile["file"] for entry in index["maps"].values() for tile in entry["tiles"]}


def _is_index(content: Any) -> bool:
    """Return whether a JSON value is a valid index; file names stay inside the folder."""
    try:
        numbers = [content[name] for name in ("columns", "rows", "margin", "vertical_scale", "vertical_offset")]
        maps = content["maps"].values()
        files = [entry["file"] for entry in maps] + list(image_files(content))
        return (
            content["version"] == VERSION
            and isinstance(content["height_field"], str)
            and all(isinstance(number, int | float) for number in numbers)
            and all(isinstance(file, str) and _FILE.fullmatch(file) for file in files)
            and all(isinstance(tile["resolution"], int) for entry in maps for tile in entry["tiles"])
        )
    except (TypeError, KeyError, AttributeError):
        return False
