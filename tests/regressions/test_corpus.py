# SPDX-License-Identifier: GPL-3.0-or-later
"""Replay every scenario in corpus.json, each of which once failed.

`broke` describes the failure, with the commit that fixed it; the rest is a scenario (see tests/scenarios.py). An entry
with `error` must be refused with a matching sentence; every other one must be sound. `open` marks a known defect; the
test fails once it is fixed, so that `open` is removed. A failing property test prints the entry to add.
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
def test_a_past_failure_does_not_return(entry):
    scenario = {name: value for name, value in entry.items() if name not in ("broke", "error", "open")}
    if "error" not in entry:
        assert_sound(scenario)
        return
    with pytest.raises(TerrainError, match=entry["error"]) as caught:
        field, views, criterion, placed = make(scenario)
        Terrain(field, 1).update(criterion, views, **placed)
    assert str(caught.value).endswith(".") and "\n" not in str(caught.value)


def test_entries_have_a_description_and_are_unique():
    assert all(entry["broke"] and "WHAT" not in entry["broke"] for entry in ENTRIES)
    scenarios = [json.dumps({**entry, "broke": ""}, sort_keys=True) for entry in ENTRIES]
    assert len(set(scenarios)) == len(scenarios)
