# SPDX-License-Identifier: GPL-3.0-or-later
"""Other versions of kernel modules, to compare with."""

import importlib.util
import sys
from pathlib import Path

import warp as wp
from adaptive_terrain import kernels


def load(name: str, path: Path):
    """Load a file as module `name` of the package's kernels."""
    spec = importlib.util.spec_from_file_location(f"{kernels.__name__}.{name}", path)
    wp.set_module_options({"enable_backward": False}, spec.name)
    sys.modules[spec.name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
