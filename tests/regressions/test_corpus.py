# SPDX-License-Identifier: GPL-3.0-or-later
"""Every scenario that ever broke something, replayed: corpus.json.

`broke` says what it broke, with the commit that mended it where there was one; the rest is a scenario (see
tests/scenarios.py). An entry with `error` must be refused with one sentence that matches it; every other one must be
sound. One with `open` is a defect that is known and not yet mended; the test fails when it is, so that `open` goes. A
property test that fails prints the entry to add.
"""

import json
from pathlib import Path

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.terrain import Terrain
from scenarios import assert_sound, make

ENTRIES = json.loads((Path(__file__).parent / "corpus.json").read_text(encoding="utf-8"))


def parameter(entry):
    marks = pytest.mark.xfail(strict=True, reason=entry["open"]) if "open" in entry else ()
    return pytest.param(entry, id=entry["broke"][:60], marks=marks)


@pytest.mark.parametrize("entry", [parameter(entry) for entry in ENTRIES])
def test_what_broke_once(entry):
    scenario = {name: value for name, value in entry.items() if name not in ("broke", "error", "open")}
    if "error" not in entry:
        assert_sound(scenario)
        return
    with pytest.raises(TerrainError, match=entry["error"]) as caught:
        field, views, criterion, placed = make(scenario)
        Terrain(field, 1).update(criterion, views, **placed)
    assert str(caught.value).endswith(".") and "\n" not in str(caught.value)


def test_entries_say_what_they_broke_and_are_there_once():
    assert all(entry["broke"] and "WHAT" not in entry["broke"] for entry in ENTRIES)
    scenarios = [json.dumps({**entry, "broke": ""}, sort_keys=True) for entry in ENTRIES]
    assert len(set(scenarios)) == len(scenarios)
