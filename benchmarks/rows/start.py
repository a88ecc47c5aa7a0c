# SPDX-License-Identifier: GPL-3.0-or-later
"""cold_start: from the start of Python to the first mesh of a store, with compiled kernels at hand and without."""

import statistics
import tempfile
import time
from pathlib import Path

from ...cbt_terrain.field.heightfield import HeightField
from ..rig.child import run_child
from ..rig.measure import Row
from . import engine

SIZE = 50_000
RUNS = 9


def warm_row(rough: HeightField, store: Path) -> Row:
    """With the kernels of earlier runs in Warp's cache."""
    px = engine.error_px(rough, SIZE, 0)
    return _row("cold_start", [run_child("rig.first_mesh", store, px, time.time()) for _ in range(RUNS)])


def no_cache_row(rough: HeightField, store: Path) -> Row:
    """With an empty kernel cache for each run; `files` is how many each run put into it."""
    px, runs, files = engine.error_px(rough, SIZE, 0), [], 0
    for _ in range(RUNS):
        with tempfile.TemporaryDirectory() as cache:
            runs.append(run_child("rig.first_mesh", store, px, time.time(), WARP_CACHE_PATH=cache))
            files += sum(path.is_file() for path in Path(cache).rglob("*"))
    row = _row("cold_start_no_cache", runs)
    row.figures["files"] = files / RUNS
    return row


def _row(name: str, runs: list[dict]) -> Row:
    row = Row(name, SIZE, statistics.median(run["elapsed_ms"] for run in runs))
    row.figures = {"first_update_ms": statistics.median(run["update_ms"] for run in runs)}
    return row
