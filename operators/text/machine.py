# SPDX-License-Identifier: GPL-3.0-or-later
"""The machine on which a result was measured."""

import importlib.metadata
import os
import platform
import sys


def describe_machine() -> dict[str, str]:
    """Return processor, threads, system and versions of packages as texts by name, for measured reports."""
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "Processor": _processor(),
        "Threads": str(threads),
        "System": f"{platform.system()} {platform.machine()}",
        "Python": platform.python_version(),
        "numpy": _version("numpy"),
        "Warp": _version("warp-lang"),
        "Blender": _blender(),
    }


def _processor() -> str:
    """Return the processor's name, or its architecture if the system does not tell."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.processor() or platform.machine()


def _version(package: str) -> str:
    """Return the version of an installed package, "none" without it."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def _blender() -> str:
    """Return Blender's version, or that of the installed bpy package if it is not loaded."""
    bpy = sys.modules.get("bpy")
    return bpy.app.version_string if bpy is not None else _version("bpy")
