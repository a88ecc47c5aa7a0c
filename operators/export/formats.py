# SPDX-License-Identifier: GPL-3.0-or-later
"""Formats of exported meshes, and requests for formats and frames as text, without Blender and the engine."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name

from ...cbt_terrain.errors import TerrainError


@dataclass(frozen=True)
class ExportFormat:
    """A format of exported meshes.

    A function is named "module:function" of this package, to be imported when it is first called.

    Attributes:
        write: write(pieces, path) writes one Piece, or all Pieces of a frame if `is_whole_scene`.
        export: export(obj, name) writes the selected object by Blender's own exporter to the path `name`.
        count: count(file) returns the number of triangles in what `export` wrote; file: open for reading, binary.
        finish: finish(piece, path) completes what `export` wrote, "" if nothing is left to do.
        needs_blender: whether Blender is needed to write it.
        is_whole_scene: whether one file holds all terrains of a frame.
    """

    write: str = "exporting:write_with_blender"
    export: str = ""
    count: str = ""
    finish: str = ""
    needs_blender: bool = True
    is_whole_scene: bool = False

    def call(self, name: str, *arguments):
        """Call the function that an attribute such as "write" names, which is imported at the first call."""
        return resolve_name(f"{__package__}.{getattr(self, name)}")(*arguments)


FORMATS = {
    "npz": ExportFormat("exporting:write_arrays", needs_blender=False),
    "ply": ExportFormat(
        export="blender_exporters:export_ply", count="read_back:count_in_ply", finish="blender_exporters:face_outwards"
    ),
    "obj": ExportFormat(export="blender_exporters:export_obj", count="read_back:count_in_obj"),
    "glb": ExportFormat(export="blender_exporters:export_glb", count="read_back:count_in_glb"),
    "stl": ExportFormat(export="blender_exporters:export_stl", count="read_back:count_in_stl"),
    "usda": ExportFormat(export="blender_exporters:export_usda", count="read_back:count_in_usda"),
    "blend": ExportFormat("exporting:write_blend", is_whole_scene=True),
}
MAX_FRAMES = 1_000_000
MAX_FRAME = 1_048_574  # what Blender holds


def parse_frames(text: str) -> tuple[int, ...]:
    """Parse `7`, `1-24`, `1-24:2` or several of them, such as `1,3,7-20:2`. Raises TerrainError.

    Ends are included. A frame comes once, where it is first named, so `1-240:24,1-240` begins with every 24th frame.
    """
    parts = [_frame_range(part.strip()) for part in text.split(",")]
    if sum(map(len, parts)) > MAX_FRAMES:
        raise TerrainError(f"The frames {_quote(text)} are too many", expected=f"{MAX_FRAMES:,} at most")
    return tuple(dict.fromkeys(frame for part in parts for frame in part))


def range_text(frames: Sequence[int]) -> str:
    """Return frames, in any order, as a range of Open Job Description, sorted and each once: `1-24,30-60:2`."""
    numbers, parts, start = sorted(set(frames)), [], 0
    while start < len(numbers):  # from `start` on, take as many frames as have the same step
        step = numbers[start + 1] - numbers[start] if start + 1 < len(numbers) else 1
        count = 1
        while start + count < len(numbers) and numbers[start + count] - numbers[start + count - 1] == step:
            count += 1
        if count == 2 and step > 1:  # two frames are shorter without a step
            count = 1
        first, last = numbers[start], numbers[start + count - 1]
        parts.append(f"{first}" if count == 1 else f"{first}-{last}" + (f":{step}" if step > 1 else ""))
        start += count
    return ",".join(parts)


def _frame_range(part: str) -> range:
    """Parse one part of a list of frames: A, A-B or A-B:S, both ends included. Raises TerrainError."""
    match = re.fullmatch(r"(-?\d{1,9})(?:-(-?\d{1,9})(?::(\d{1,9}))?)?", part)
    if not match:
        raise TerrainError(f"The frames {_quote(part)} cannot be read", expected="A, A-B or A-B:S")
    first, last, step = int(match[1]), int(match[2] or match[1]), int(match[3] or 1)
    if last < first or step < 1:
        raise TerrainError(
            f"The frames {_quote(part)} go backwards or stand still", expected="A-B:S with A up to B, and S from 1"
        )
    if max(abs(first), abs(last)) > MAX_FRAME:
        raise TerrainError(
            f"The frames {_quote(part)} are not within Blender's range", expected=f"-{MAX_FRAME:,} .. {MAX_FRAME:,}"
        )
    return range(first, last + 1, step)


def _quote(text: str) -> str:
    """Return a text in quotes, cut to 60 characters, for an error."""
    return repr(text if len(text) <= 60 else f"{text[:60]}...")


def parse_formats(text: str) -> tuple[str, ...]:
    """Parse `npz,ply` into a tuple without repetition, in the given order. Raises TerrainError."""
    formats = tuple(dict.fromkeys(part.strip().lower() for part in text.split(",")))
    unknown = [part for part in formats if part not in FORMATS]
    if unknown:
        raise TerrainError(f"The format {unknown[0]!r} is unknown", expected=f"one of {', '.join(FORMATS)}")
    return formats


def format_of(path: Path) -> ExportFormat:
    """Return the format that a file's suffix names, in upper or lower case. Raises TerrainError for another one."""
    found = FORMATS.get(path.suffix[1:].lower())
    if found is None:
        raise TerrainError(f"{path.name!r} has no known format", expected=f"one of {', '.join(FORMATS)}")
    return found


def needs_blender(formats: Sequence[str]) -> bool:
    """Return whether one of the formats needs Blender."""
    return any(FORMATS[name].needs_blender for name in formats)
