# SPDX-License-Identifier: GPL-3.0-or-later
"""Measurements that need a process of their own: its start, its memory, a renderer that keeps nothing."""

import json
import os
import subprocess
import sys

from ...cbt_terrain.errors import TerrainError

PACKAGE = __name__.rsplit(".", 2)[0]


def run_child(module: str, *arguments, **environment: str) -> dict:
    """Run a module of this folder as a program; returns the JSON object that it prints as its last line."""
    command = [sys.executable, "-P", "-m", f"{PACKAGE}.{module}", *map(str, arguments)]
    ended = subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True)
    lines = ended.stdout.splitlines()
    if ended.returncode != 0 or not lines:
        said = (ended.stderr.strip().splitlines() or ["no message"])[-1]
        raise TerrainError(f"The benchmark's process {module} ended with code {ended.returncode} ({said}).")
    return json.loads(lines[-1])


def resident_mb() -> dict[str, float] | None:
    """This process's resident memory in MB: `own` (anonymous) and `mapped` (files); None where nobody tells."""
    status = _status()
    return {"own": status["RssAnon"], "mapped": status["RssFile"]} if status else None


def peak_mb() -> float | None:
    """The most memory that this process ever held, in MB; None where nobody tells.

    Not `getrusage`: on Linux it begins with what the parent held when it started this process.
    """
    status = _status()
    return status["VmHWM"] if status else None


def _status() -> dict[str, float]:
    try:
        with open("/proc/self/status", encoding="ascii") as file:
            fields = dict(line.split(":", 1) for line in file)
    except OSError:
        return {}
    return {name: int(text.split()[0]) * 1024 / 1e6 for name, text in fields.items() if text.endswith("kB\n")}
