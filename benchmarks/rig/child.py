# SPDX-License-Identifier: GPL-3.0-or-later
"""Measurements in a child process: start-up time, memory, a renderer with no cached data."""

import json
import os
import subprocess
import sys

from ...cbt_terrain.errors import TerrainError

PACKAGE = __name__.rsplit(".", 2)[0]


def run_child(module: str, *arguments, **environment: str) -> dict:
    """Run a module of this package as a program and return the JSON object of its last line of output."""
    command = [sys.executable, "-P", "-m", f"{PACKAGE}.{module}", *map(str, arguments)]
    result = subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True)
    lines = result.stdout.splitlines()
    if result.returncode != 0 or not lines:
        message = (result.stderr.strip().splitlines() or ["no message"])[-1]
        raise TerrainError(f"The benchmark's process {module} ended with code {result.returncode} ({message})")
    return json.loads(lines[-1])


def resident_mb() -> dict[str, float] | None:
    """Return the resident memory of this process in MB, `own` (anonymous) and `mapped` (files); None if unknown."""
    status = _status_mb()
    return {"own": status["RssAnon"], "mapped": status["RssFile"]} if status else None


def peak_mb() -> float | None:
    """Return the maximum resident memory of this process in MB; None if unknown.

    `getrusage` is no use: on Linux it starts from the memory of the parent when it started this process.
    """
    status = _status_mb()
    return status["VmHWM"] if status else None


def _status_mb() -> dict[str, float]:
    try:
        with open("/proc/self/status", encoding="ascii") as file:
            fields = dict(line.split(":", 1) for line in file)
    except OSError:
        return {}
    return {name: int(text.split()[0]) * 1024 / 1e6 for name, text in fields.items() if text.endswith("kB\n")}
