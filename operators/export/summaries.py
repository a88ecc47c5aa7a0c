# SPDX-License-Identifier: GPL-3.0-or-later
"""Summaries of frames: `frame_FRAME.json`, written last, closes a frame.

files     sizes of the frame's files in bytes by name, as seen from the folder of the summary
digests   of their contents, by the same names
settings  digest of the settings that all frames share: the .blend file, versions, command line
inputs    digests of the files that the frame was made of, by name; null for a missing file
terrains  figures of each terrain
checksum  of all the above
"""

import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.store import JSON_NAME, read_json
from ...cbt_terrain.run import stopping
from ...cbt_terrain.run.named_file import BLOCK_BYTES, open_regular, read_regular
from ...cbt_terrain.view.settings import BOUNDS
from ..text.shown_bounds import LIMITS

MAX_SUMMARY_BYTES = 1 << 24
MAX_COUNT = 1 << 62
# What reading damaged JSON and values of wrong types raises.
DAMAGE = (ArithmeticError, ValueError, LookupError, TypeError, AttributeError, RecursionError)


def summary_name(frame: int) -> str:
    """Return the file name of a frame's summary."""
    return f"frame_{frame:04d}.json"


def settings_digest(settings: dict) -> str:
    """Return the digest of settings that JSON can hold."""
    return hashlib.blake2b(json.dumps(settings, sort_keys=True).encode(), digest_size=12).hexdigest()


def content_digest(path: str | Path) -> str | None:
    """Return the digest of a file's content, or the key of a store; None for anything else. Raises Stopped."""
    try:
        if (Path(path) / JSON_NAME).is_file():
            return read_json(Path(path))["key"]
        digest = hashlib.blake2b(digest_size=16)
        with open_regular(path, links=True) as file:
            while chunk := file.read(BLOCK_BYTES):
                digest.update(chunk)
                stopping.check()
        return digest.hexdigest()
    except (OSError, ValueError, TerrainError):
        return None


def input_name(path: Path, out: Path) -> str:
    """Return the name of a file in a summary in `out`: its relative path, so that both may move together."""
    try:
        return os.path.relpath(path, os.path.abspath(out)).replace(os.sep, "/")
    except ValueError:  # another drive of Windows
        return str(path)


def file_named(name: str, out: Path) -> str:
    """Return the absolute path of a file that a summary in `out` names."""
    return os.path.normpath(os.path.join(os.path.abspath(out), name))


def file_sizes(files: Iterable[Path], out: Path) -> dict[str, int]:
    """Return the sizes of a frame's files in bytes, by their names in the summary."""
    return {input_name(file, out): file.stat().st_size for file in files}


def close_summary(summary: dict, out: Path) -> dict:
    """Return a summary completed with the digests of its files and its own checksum."""
    digests = {name: content_digest(file_named(name, out)) for name in summary["files"]}
    summary = summary | {"digests": digests}
    return summary | {"checksum": summary_checksum(summary)}


def read_summary(out: Path, frame: int) -> dict:
    """Read the summary of a frame in the folder `out`.

    Raises FileNotFoundError where there is none, ValueError where something else stands there or it is damaged.
    """
    try:
        summary = json.loads(read_regular(out / summary_name(frame), MAX_SUMMARY_BYTES, links=False).decode("utf-8"))
        if _is_valid(summary, frame):
            return summary
    except FileNotFoundError:
        raise
    except (OSError, *DAMAGE):
        pass
    raise ValueError(f"{summary_name(frame)} is damaged")


def find_complete_summary(
    out: Path, frame: int, settings: str, inputs: dict[str, str | None], formats: Sequence[str]
) -> dict | None:
    """Return the summary of a frame that need not be made again, None for any other frame.

    Such a frame was made with `settings` (a digest), from `inputs` (digests by name), in all `formats` (suffixes
    without dots), and its files are unchanged.
    """
    try:
        summary = read_summary(out, frame)
    except (FileNotFoundError, ValueError):
        return None
    # The same files may be in another folder here, or on another machine.
    if summary["settings"] != settings or _without_folders(summary["inputs"]) != _without_folders(inputs):
        return None
    if not {Path(name).suffix[1:] for name in summary["files"]} >= set(formats):
        return None
    return None if any(file_fault(summary, name, out) for name in summary["files"]) else summary


def file_fault(summary: dict, name: str, out: Path) -> str | None:
    """Return the fault of a file of a summary, such as "is missing" or "has another content"; None for none."""
    path = file_named(name, out)
    try:
        size = os.stat(path).st_size
    except (OSError, ValueError):
        return "is missing"
    if size != summary["files"][name]:
        return "is cut short" if size < summary["files"][name] else "is too long"
    return None if content_digest(path) == summary["digests"][name] else "has another content"


def _without_folders(inputs: dict[str, str | None]) -> list[tuple]:
    """Return inputs as (file name, digest): in another folder, or on another machine, they are the same."""
    return [(name.rsplit("/", 1)[-1], digest) for name, digest in inputs.items()]


def summary_checksum(summary: dict) -> str:
    """Return the digest of a summary without its "checksum"."""
    return settings_digest({name: value for name, value in summary.items() if name != "checksum"})


def _is_valid(summary, frame: int) -> bool:
    """Return whether a summary belongs to the frame and has values of the right types. Damaged ones may also raise."""
    files, digests, inputs = summary["files"], summary["digests"], summary["inputs"]
    return (
        summary["checksum"] == summary_checksum(summary)
        and type(summary["frame"]) is int
        and summary["frame"] == frame
        and isinstance(summary["settings"], str)
        and len(files) > 0
        and all(map(_is_count, files.values()))
        and files.keys() == digests.keys()
        and all(isinstance(digest, str) for digest in digests.values())
        and all(digest is None or isinstance(digest, str) for digest in inputs.values())
        and _is_number(summary["elapsed_ms"])
        and isinstance(summary["terrains"], list)
        and all(map(_is_figures, summary["terrains"]))
    )


def _is_figures(terrain) -> bool:
    """Return whether a value is valid as the figures of a terrain."""
    return (
        isinstance(terrain["name"], str)
        and _is_count(terrain["triangles"])
        and terrain["limited"] in ("", *LIMITS)
        and all(terrain[name] is None or _is_number(terrain[name]) for name in BOUNDS)
        and all(map(_is_number, terrain["ms"].values()))
    )


def _is_count(value) -> bool:
    """Return whether a value is a whole number, 0 or more."""
    return type(value) is int and 0 <= value < MAX_COUNT


def _is_number(value) -> bool:
    """Return whether a value is a number; a whole one may have 62 bits at most."""
    return type(value) is float or (type(value) is int and abs(value) < MAX_COUNT)
