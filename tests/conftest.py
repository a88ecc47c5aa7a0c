# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of hypothesis, and a clean end of the test run in spite of the bpy module."""

import gc
import os
import sys

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # numpy's threads would compete with ours; read when numpy is imported

import pytest
from hypothesis import settings
from real_program import bare_program, dem, extension_zip, program, release, scene  # noqa: F401

# Every run has the same examples; `make fuzz` has fifty times as many.
EXAMPLES = max(20, int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) // 10)
settings.register_profile("project", max_examples=EXAMPLES, derandomize=True, deadline=None, database=None)
settings.load_profile("project")

# The modules that tests import stay: looking through all their objects again and again takes a fifth of the time.
gc.disable()

_exit_status = 0


@pytest.fixture
def eager_threads(monkeypatch):
    """Cut even the smallest job into slices, so that threads share it."""
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.run.launch.SLICE_ITEMS", 2)


def pytest_collection_finish():
    gc.freeze()
    gc.enable()
    gc.set_threshold(50_000, 20, 100)  # looking for garbage more often took a twentieth of the time


def pytest_sessionfinish(exitstatus):
    global _exit_status
    _exit_status = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure():
    """End the process at once if bpy was used.

    The bpy module shuts Blender down when Python frees it. If anything still refers to it, as pytest does, its C++
    destructors run on a live Blender, and the process crashes or hangs after the last test.
    """
    if "bpy" in sys.modules:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(_exit_status)
