# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 64: untrusted project folders. `make fuzz` tries 1,000 mutants of land folders, scenes and summaries."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SUPPORT = Path(__file__).parents[1] / "support"
MANY = max(12, int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) // 10)


@pytest.mark.parametrize("rounds", [8, pytest.param(MANY, marks=pytest.mark.thorough)])
@pytest.mark.skipif(os.name != "posix", reason="links, pipes and forks are those of POSIX")
def test_case_64_a_hostile_project_folder_harms_nothing(tmp_path, rounds):
    """Each hostile folder gives a result or one error in time, and changes nothing outside its output folders."""
    script = [sys.executable, str(SUPPORT / "hostile_folders.py"), str(tmp_path / "mutants"), "0", str(rounds)]
    done = subprocess.run(script, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-4000:]
    ends = json.loads(done.stdout.splitlines()[-1])
    assert sum(ends.values()) == rounds
    assert sum(number for name, number in ends.items() if name.endswith("refused")) > rounds / 6
