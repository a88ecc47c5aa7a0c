# SPDX-License-Identifier: GPL-3.0-or-later
"""Results as lines and as JSON, and the writing of files; performance_page.py makes the pages."""

import json
import os
import tempfile
from pathlib import Path

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run.owned_files import remove_file
from ...operators.text.numbers import number
from ..rig.measure import BenchmarkRow
from .goals import excess, goal_of


def line(row: BenchmarkRow) -> str:
    """Return the line of a row in the terminal."""
    parts = [f"{row.name:20} {row.size:>11,}", f"{number(row.ms):>9} ms" if row.ms is not None else " " * 12]
    if row.ratio is not None:
        base = "" if row.baseline_ms is None else f"{number(row.baseline_ms)} ms"
        parts.append(f"{row.baseline:>14} {base:>11}  ratio {row.ratio:7.4f}")
    goal, missed = goal_of(row.name, row.size), excess(row)
    if goal is not None and row.ratio is not None:
        parts.append(f"goal {goal:g}: {'met' if missed is None else f'missed by {missed:.0%}'}")
    parts += [f"{name} {number(value)}" for name, value in row.figures.items()]
    if row.attempts > 1:
        parts.append(f"attempt {row.attempts}")
    return "  ".join(parts).rstrip()


def as_json(row: BenchmarkRow) -> dict:
    """Return the six keys of every result, the goal, and other measurements."""
    content = {name: getattr(row, name) for name in ("name", "size", "ms", "baseline", "baseline_ms", "ratio")}
    content["goal"] = goal_of(row.name, row.size)
    extras = {"first_ms": row.first_ms, "steps": row.steps, "figures": row.figures}
    if row.attempts > 1:
        extras["attempts"] = row.attempts
    return content | {name: value for name, value in extras.items() if value}


def write_json(rows: list[BenchmarkRow], path: Path) -> None:
    """Write rows as JSON."""
    text = json.dumps([as_json(row) for row in rows], indent=1, allow_nan=False)
    write_text(path, text + "\n")


def check_writable(path: Path) -> None:
    """Raise TerrainError unless the file and the folders above it can be written; leave nothing behind."""
    existing = next(folder for folder in path.absolute().parents if folder.exists())
    try:
        if path.is_dir():
            raise IsADirectoryError(None, "it is a folder")
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as reason:
        raise _unwritable(path, reason) from reason


def write_text(path: Path, text: str) -> None:
    """Write a whole file or none; write into anything that is no plain file, such as a pipe."""
    whole = path.is_file() or not path.exists()
    target = path.resolve() if whole else path
    part = target.with_name(f".{target.name}.{os.getpid()}") if whole else path
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.write_text(text, encoding="utf-8")
            if whole:
                part.replace(target)
        finally:
            if whole:
                remove_file(part, may_be_link=True)
    except OSError as reason:
        raise _unwritable(path, reason) from reason


def _unwritable(path: Path, reason: OSError) -> TerrainError:
    return TerrainError(f"{path} cannot be written ({reason.strerror})", fix="choose another name")
