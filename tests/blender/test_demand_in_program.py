# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene reads, found by the real program; a click there takes an effect away."""

from pathlib import Path

SUPPORT = Path(__file__).resolve().parents[1] / "support"


def test_the_cases_of_demand_hold(program):
    said = program.script("demand_cases.py", SUPPORT)
    assert said["failed"] == []
    assert said["held"] >= 58
