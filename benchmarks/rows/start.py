# SPDX-License-Identifier: GPL-3.0-or-later
"""Time from the start of Python to the first mesh of a store, with compiled kernels in the cache."""

import statistics
import time
from pathlib import Path

from ...cbt_terrain.field.heightfield import HeightField
from ..rig.child import run_child
from ..rig.measure import BenchmarkRow
from . import engine

SIZE = 50_000
RUNS = 9
LIMIT_MS = 1000.0


def cold_start_row(rough: HeightField, store: Path) -> BenchmarkRow:
    """Measure processes that make one mesh, against a fixed limit."""
    px = engine.error_px(rough, SIZE)
    runs = [run_child("rig.first_mesh", store, px, time.time()) for _ in range(RUNS)]
    row = BenchmarkRow("cold_start", SIZE, statistics.median(run["elapsed_ms"] for run in runs), "1 s", LIMIT_MS)
    row.figures = {"first_update_ms": statistics.median(run["update_ms"] for run in runs)}
    return row
