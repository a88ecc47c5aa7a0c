# SPDX-License-Identifier: GPL-3.0-or-later
"""What a folder of maps holds: images, and one JSON file that says what they are.

maps.json                where the tiles are, and of each map its unit, coding and tiles
NAME.1001.png ...        the tiles of a map; NAME.png of a small terrain, which is one tile
"""

import json
import os
import re
from pathlib import Path

from ..errors import TerrainError
from ..run.named_file import cause, read_regular

JSON_NAME = "maps.json"
VERSION = 1
UDIM = "<UDIM>"
MOST_BYTES = 1 << 24
_FILE = re.compile(r"[a-z0-9_]+(\.<UDIM>|\.\d{4})?\.(png|exr)")


def file_name(name: str, form: str, number: int | None) -> str:
    """Of the tile with a number, or of the only one."""
    return f"{name}.{form}" if number is None else f"{name}.{number}.{form}"


def read_index(folder: str | os.PathLike) -> dict | None:
    """The content of a folder's maps.json; None where there is none. Raises TerrainError if it is damaged."""
    file = Path(folder) / JSON_NAME
    try:
        content = json.loads(read_regular(file, MOST_BYTES).decode("utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError) as reason:
        raise TerrainError(
            f"The maps {file} cannot be read ({cause(reason)}): remove the file and bake them again."
        ) from None
    if not _is_index(content):
        raise TerrainError(
            f"The maps {file} are damaged, or of another version than {VERSION}: remove the file and bake them again."
        )
    return content


def files_of(index: dict) -> set[str]:
    """Every image that an index names."""
    return {tile["file"] for entry in index["maps"].values() for tile in entry["tiles"]}


def _is_index(content) -> bool:
    """Whether a JSON value has what a reader relies on; names of files stay inside the folder."""
    try:
        numbers = [content[name] for name in ("columns", "rows", "margin", "vertical_scale", "vertical_offset")]
        maps = content["maps"].values()
        files = [entry["file"] for entry in maps] + list(files_of(content))
        return (
            content["version"] == VERSION
            and isinstance(content["height_field"], str)
            and all(isinstance(number, int | float) for number in numbers)
            and all(isinstance(file, str) and _FILE.fullmatch(file) for file in files)
            and all(isinstance(tile["resolution"], int) for entry in maps for tile in entry["tiles"])
        )
    except (TypeError, KeyError, AttributeError):
        return False
