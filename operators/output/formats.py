# SPDX-License-Identifier: GPL-3.0-or-later
"""Which files an export writes, and of which frames, as they are asked for in words. Imports none of the engine."""

import re
from collections.abc import Sequence

FORMATS = ("npz", "ply", "obj", "glb", "stl", "blend")
MAX_FRAMES = 1_000_000
MAX_FRAME = 1_048_574  # what Blender holds


def parse_frames(text: str) -> tuple[int, ...]:
    """`7`, `1-24`, `1-24:2` or several of them, as `1,3,7-20:2`: ends included, in the order given, each frame once.

    So `1-240:24,1-240` begins with a first look at the whole and then fills it in, as render farms have it.
    """
    parts = [_frame_range(part.strip()) for part in text.split(",")]
    if sum(map(len, parts)) > MAX_FRAMES:
        raise ValueError(f"frames {_short(text)} are more than {MAX_FRAMES:,}")
    return tuple(dict.fromkeys(frame for part in parts for frame in part))


def _frame_range(part: str) -> range:
    """One part of a list of frames."""
    match = re.fullmatch(r"(-?\d{1,9})(?:-(-?\d{1,9})(?::(\d{1,9}))?)?", part)
    if not match:
        raise ValueError(f"frames {_short(part)} are not A, A-B or A-B:S")
    first, last, step = int(match[1]), int(match[2] or match[1]), int(match[3] or 1)
    if last < first or step < 1:
        raise ValueError(f"frames {_short(part)} go backwards or stand still")
    if max(abs(first), abs(last)) > MAX_FRAME:
        raise ValueError(f"frames {_short(part)} are not within -{MAX_FRAME:,} and {MAX_FRAME:,}")
    return range(first, last + 1, step)


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else f"{text[:60]}...")


def parse_formats(text: str) -> tuple[str, ...]:
    """`npz,ply` as a tuple without repetition, in the order given."""
    formats = tuple(dict.fromkeys(part.strip().lower() for part in text.split(",")))
    unknown = [part for part in formats if part not in FORMATS]
    if unknown:
        raise ValueError(f"format {unknown[0]!r} is not one of {', '.join(FORMATS)}")
    return formats


def needs_blender(formats: Sequence[str]) -> bool:
    return any(part != "npz" for part in formats)
