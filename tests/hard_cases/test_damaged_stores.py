# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 64: damaged stores. `make fuzz` tries 2,000; tests/blender runs the same script in the program."""

import json
import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1] / "support"
ROUNDS = 2000 if int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) >= 10_000 else 40


def test_case_64_a_damaged_store_is_a_mesh_or_one_error(tmp_path):
    """Each damaged store gives a mesh that keeps the invariants or one sentence, in flights and in `export`.

    Most have valid checksums. No kernel touches a page behind its arrays.
    """
    path = os.pathsep.join([str(TESTS), *filter(None, sys.path)])
    script = [sys.executable, str(TESTS / "damaged_stores.py"), str(tmp_path), "0", str(ROUNDS)]
    done = subprocess.run(script, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    outcomes = json.loads(done.stdout)
    assert outcomes["mesh"] + outcomes["sentence"] == 2 * ROUNDS and outcomes["sentence"] > ROUNDS / 3
