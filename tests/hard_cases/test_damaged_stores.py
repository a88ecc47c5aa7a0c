# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 64: a store with anything in it. `make fuzz` tries 2,000; tests/blender has the same in the program."""

import json
import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1] / "support"
ROUNDS = 2000 if int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) >= 10_000 else 40


def test_case_64_a_store_with_any_bytes_gives_a_mesh_or_one_sentence(tmp_path):
    """Damaged stores, most with checksums that fit, through flights and `export`: every mesh holds the invariants, and
    no kernel touches a page behind its arrays."""
    path = os.pathsep.join([str(TESTS), *filter(None, sys.path)])
    script = [sys.executable, str(TESTS / "damaged_stores.py"), str(tmp_path), "0", str(ROUNDS)]
    done = subprocess.run(script, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    outcomes = json.loads(done.stdout)
    assert outcomes["mesh"] + outcomes["sentence"] == 2 * ROUNDS and outcomes["sentence"] > ROUNDS / 3
