# SPDX-License-Identifier: GPL-3.0-or-later
"""The rows with Blender once more, inside a Blender program as artists run it, without a window.

Its Python and numpy are its own; the package and Warp come from this process's environment, whatever Python that has:
neither is compiled for one.
"""

import json
import subprocess
import sysconfig
from dataclasses import asdict
from pathlib import Path

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.store import open_store
from ...operators.blender import need_bpy
from ..rig.child import PACKAGE
from ..rig.measure import Row
from . import engine, in_blender

PREFIX = "program_"
MARK = "ROWS "  # before the line of the result: Blender prints lines of its own


def program_version(command: list[str]) -> str:
    """What `blender --version` says first. Raises TerrainError unless the command starts Blender."""
    said = _output([*command, "--version"]).splitlines()
    version = next((line.strip() for line in said if line.startswith("Blender ")), None)
    if version is None:
        raise TerrainError(
            f"`{' '.join(command)}` is no Blender program; --blender expects the command that starts one."
        )
    return version


def program_rows(command: list[str], store: Path) -> list[Row]:
    """`measure_here` inside the program that the command starts."""
    output = _output([*command, *inside(f"in_program.measure_here({str(store)!r})")])
    results = [line.removeprefix(MARK) for line in output.splitlines() if line.startswith(MARK)]
    if len(results) != 1:
        said = (output.strip().splitlines() or ["no message"])[-1]
        raise TerrainError(f"`{' '.join(command)}` has measured nothing ({said}); --blender expects a Blender program.")
    return [Row(**row) for row in json.loads(results[0])]


def inside(call: str) -> list[str]:
    """Blender's arguments for a call in its own Python, where this module is `in_program`."""
    site = sysconfig.get_paths()["purelib"]
    expression = f"import site; site.addsitedir({site!r}); from {PACKAGE}.rows import in_program; {call}"
    return ["-b", "--factory-startup", "--python-exit-code", "1", "--python-expr", expression]


def measure_here(store: str) -> None:
    """Measure the rows of a store in this process, a Blender program; print them, their names prefixed, as JSON."""
    need_bpy("The benchmark")
    rough, path = open_store(store), Path(store)
    rows = [in_blender.ingest_row(rough)]
    rows += [in_blender.frame_row(rough, path, size) for size in in_blender.FRAME_SIZES]
    rows += [in_blender.frame_row(rough, path, in_blender.MILLION, engine.MESHLET)]
    rows += [in_blender.still_frame_row(rough, path)]
    print(MARK + json.dumps([asdict(row) | {"name": PREFIX + row.name} for row in rows]), flush=True)


def _output(command: list[str]) -> str:
    try:
        ended = subprocess.run(command, capture_output=True, text=True, errors="replace")
    except (OSError, ValueError) as reason:
        raise TerrainError(
            f"{command[0]} cannot be started ({reason}); --blender expects the command that starts Blender."
        ) from reason
    if ended.returncode != 0:
        said = (ended.stderr.strip().splitlines() or ["no message"])[-1]
        raise TerrainError(f"The program {command[0]} ended with code {ended.returncode} ({said}).")
    return ended.stdout
