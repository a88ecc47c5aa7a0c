# SPDX-License-Identifier: GPL-3.0-or-later
"""Demand in the real program, where a click removes an effect."""

import pytest
from window_report import run_in_window


def test_the_cases_of_demand_hold(program):
    report = program.script("demand_cases.py")
    assert report["failed"] == []
    assert report["held"] >= 58


@pytest.mark.thorough
def test_a_click_that_unlinks_a_node_skips_its_effect(program, tmp_path):
    """A stroke cuts a link in the Shader Editor, and no triangle changes."""
    report = run_in_window(program, "click_unlink.py", tmp_path, ("linked", "unlinked"))
    assert report["bare"]["made"] == [] and report["bare"]["runs"] == {}, "no reader, no run"
    assert report["worn"]["made"] == ["height", "slope"] and set(report["worn"]["runs"]) == {"height", "slope"}
    assert report["worn"]["said"]["slope"] == [["material Rock, node Attribute"], ""]
    assert report["removed"]["made"] == ["slope"] and report["links"] == 1
    assert report["cut"]["made"] == [] and report["cut"]["said"]["slope"] == [[], "nothing reads it"]
    assert report["cut"]["runs"]["slope"] == report["removed"]["runs"]["slope"]
    assert len({report[moment]["triangles"] for moment in ("bare", "worn", "removed", "cut")}) == 1
