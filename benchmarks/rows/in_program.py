# SPDX-License-Identifier: GPL-3.0-or-later
"""Row `frame` inside a Blender program without a window.

Python and numpy are the program's. The package and Warp come from the environment of this process; neither is compiled
for one version of Python.
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
from ..rig.measure import BenchmarkRow
from ..rig.scenes import MILLION
from . import in_blender

MARK = "ROW "  # starts the line of the result, since Blender prints lines as well
NAME_BLENDER = "give --blender the command that starts Blender"


def program_version(command: list[str]) -> str:
    """Return the first line of `blender --version`. Raises TerrainError if the command does not start Blender."""
    lines = _output([*command, "--version"]).splitlines()
    version = next((line.strip() for line in lines if line.startswith("Blender ")), None)
    if version is None:
        raise TerrainError(f"`{' '.join(command)}` is no Blender program", fix=NAME_BLENDER)
    return version


def program_frame_row(command: list[str], store: Path) -> BenchmarkRow:
    """Run `measure_here` inside the program that the command starts."""
    output = _output([*command, *inside(f"in_program.measure_here({str(store)!r})")])
    results = [line.removeprefix(MARK) for line in output.splitlines() if line.startswith(MARK)]
    if len(results) != 1:
        message = (output.strip().splitlines() or ["no message"])[-1]
        raise TerrainError(f"`{' '.join(command)}` has measured nothing ({message})", fix=NAME_BLENDER)
    return BenchmarkRow(**json.loads(results[0]))


def inside(call: str) -> list[str]:
    """Return Blender's arguments for a call in its own Python, where this module is named `in_program`."""
    site = sysconfig.get_paths()["purelib"]
    expression = f"import site; site.addsitedir({site!r}); from {PACKAGE}.rows import in_program; {call}"
    return ["-b", "--factory-startup", "--python-exit-code", "1", "--python-expr", expression]


def measure_here(store: str) -> None:
    """Measure the row in this process, a Blender program, and print it as JSON."""
    need_bpy("The benchmark")
    row = in_blender.frame_row(open_store(store), Path(store), MILLION)
    print(MARK + json.dumps(asdict(row) | {"name": "program_frame"}), flush=True)


def _output(command: list[str]) -> str:
    try:
        result = subprocess.run(command, capture_output=True, text=True, errors="replace")
    except (OSError, ValueError) as reason:
        raise TerrainError(f"{command[0]} cannot be started ({reason})", fix=NAME_BLENDER) from reason
    if result.returncode != 0:
        message = (result.stderr.strip().splitlines() or ["no message"])[-1]
        raise TerrainError(f"The program {command[0]} ended with code {result.returncode} ({message})")
    return result.stdout
