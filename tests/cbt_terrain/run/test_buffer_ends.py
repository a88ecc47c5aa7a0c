# SPDX-License-Identifier: GPL-3.0-or-later
"""No kernel reads or writes beyond the end of an array."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[2] / "support"


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="pages are protected by mprotect")
def test_no_kernel_reaches_beyond_its_arrays():
    """Flights over rough and level ground, in several squares, slices and sizes of arrays."""
    path = os.pathsep.join([str(TESTS), *filter(None, sys.path)])
    script = [sys.executable, str(TESTS / "guarded_flights.py")]
    done = subprocess.run(script, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "no page behind an array was touched" in done.stdout
