# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 64 in the real program: opening a .blend and changing the frame reads its store."""

import os

import pytest
from damaged_stores import whole_stores

FULL = int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) >= 10_000
PARTS, ROUNDS = (10, 200) if FULL else (1, 30)


@pytest.mark.thorough
@pytest.mark.parametrize("part", range(PARTS))
def test_damaged_stores_give_a_mesh_or_one_sentence(program, part):
    """There is no crash, no index out of range and no infinite number; the last mesh stays if a store is refused."""
    folder = program.user / "stores"  # visible to the program
    folder.mkdir(exist_ok=True)
    arguments = folder, str(part * ROUNDS), str(ROUNDS), *whole_stores(folder)
    outcomes = program.script("damaged_stores.py", *arguments, timeout=1800)
    assert outcomes["mesh"] + outcomes["sentence"] == 2 * ROUNDS and outcomes["sentence"] > ROUNDS / 3
