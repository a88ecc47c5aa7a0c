# SPDX-License-Identifier: GPL-3.0-or-later
"""The rule by which a quick run fails, and that the goals stand beside rows that exist."""

import pytest
from adaptive_terrain.benchmarks import goals
from adaptive_terrain.benchmarks.measure import Row
from adaptive_terrain.benchmarks.report import MEANING


def ingest(ratio):
    return Row("ingest", 1_000_000, 100.0 * ratio, "plain_ingest", 100.0)


@pytest.fixture
def recorded(monkeypatch):
    monkeypatch.setattr(goals, "RECORDED", {})
    return goals.RECORDED


def test_half_as_much_again_as_the_goal_is_allowed(recorded):
    goal = goals.GOALS["ingest", 1_000_000]
    fast, slow = ingest(1.49 * goal), ingest(1.51 * goal)
    assert goals.failures([fast, slow]) == [slow]
    assert goals.missed_by(fast) == pytest.approx(0.49)
    assert goals.missed_by(ingest(goal)) is None


def test_a_row_known_to_fall_short_is_held_to_what_was_recorded(recorded):
    recorded["ingest", 1_000_000] = (0.6, "the writer is slow")
    good, bad = ingest(0.89), ingest(0.91)
    assert goals.failures([good, bad]) == [bad]


def test_rows_without_a_goal_or_a_baseline_never_fail(recorded):
    rows = [Row("frame", 50_000, 1e9, "plain_ingest", 1.0), Row("refine_1t", 50_000, 1e9, "roam_rebuild", None)]
    assert goals.failures(rows) == []
    assert [goals.missed_by(row) for row in rows] == [None, None]


def test_a_goal_for_every_size_of_a_row(recorded):
    assert goals.goal_of("scale_frame", 1_000_000) == goals.goal_of("scale_frame", 4_000_000) == 1.05
    assert goals.goal_of("refine_2t", 50_000) is None


def test_goals_and_records_are_of_rows_that_exist():
    assert {name for name, _ in goals.GOALS} <= set(MEANING)
    for key, (ratio, reason) in goals.RECORDED.items():
        assert goals.goal_of(*key) is not None and ratio > goals.goal_of(*key) and reason
