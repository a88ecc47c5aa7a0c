# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 64 in the real program: a .blend names its store, so to open one and change the frame is enough."""

import os
from pathlib import Path

TESTS = Path(__file__).parents[1]
ROUNDS = 2000 if int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) >= 10_000 else 30


def test_frame_changes_over_damaged_stores_give_a_mesh_or_one_sentence(program, tmp_path, monkeypatch):
    """No crash, no index out of range, nothing that is not finite; where a store is refused the last mesh stays."""
    monkeypatch.syspath_prepend(TESTS)
    from damaged_stores import whole_stores

    (program.user / "stores").mkdir()  # a folder that the program sees, too
    wholes = whole_stores(program.user / "stores")
    outcomes = program.script("damaged_stores.py", program.user / "stores", "0", str(ROUNDS), *wholes, timeout=3600)
    assert outcomes["mesh"] + outcomes["sentence"] == 2 * ROUNDS and outcomes["sentence"] > ROUNDS / 3
