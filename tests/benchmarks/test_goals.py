# SPDX-License-Identifier: GPL-3.0-or-later
"""Goals of rows, and the rule by which a quick run fails."""

import pytest
from adaptive_terrain.benchmarks import suite
from adaptive_terrain.benchmarks.pages import goals
from adaptive_terrain.benchmarks.pages.goals import ANY_SIZE, SLACK, RowGoal
from adaptive_terrain.benchmarks.rig.measure import BenchmarkRow


def result(ratio, name="made_up"):
    return BenchmarkRow(name, 1_000_000, 100.0 * ratio, "base", 100.0)


@pytest.fixture
def rows(monkeypatch):
    made_up = {
        "made_up": RowGoal("A row.", {ANY_SIZE: 0.2}),
        "missed": RowGoal("A row.", {ANY_SIZE: 0.2}, {1_000_000: 0.6}),
        "sized": RowGoal("A row.", {500_000: 0.2}),
    }
    monkeypatch.setattr(goals, "ROWS", made_up)


def test_a_row_may_exceed_its_goal_by_half(rows):
    fast, slow = result(0.299), result(0.301)
    assert goals.failures([fast, slow]) == [slow]
    assert goals.excess(fast) == pytest.approx(0.495) and goals.excess(result(0.2)) is None


def test_a_known_miss_may_exceed_its_known_ratio_by_half(rows):
    fast, slow = result(0.899, "missed"), result(0.901, "missed")
    assert goals.failures([fast, slow]) == [slow]
    assert goals.max_ratio("missed", 500_000) == pytest.approx(0.3), "a known ratio counts for its size alone"


def test_rows_without_goal_or_ratio_never_fail(rows):
    assert goals.failures([result(1e9, "sized"), result(1e9, "unknown"), BenchmarkRow("made_up", 1_000_000, 1e9)]) == []
    assert goals.goal_of("sized", 500_000) == 0.2 and goals.goal_of("sized", 1_000_000) is None


class Measurement:
    """A measurement with given ratios, one for each call; the last one repeats."""

    def __init__(self, *ratios, name="made_up"):
        self.ratios, self.name, self.calls = ratios, name, 0

    def __call__(self):
        self.calls += 1
        return BenchmarkRow(self.name, 1_000_000, 1.0, "base", ratio=self.ratios[min(self.calls, len(self.ratios)) - 1])


def test_a_disturbed_measurement_is_repeated(rows):
    disturbed, calm = Measurement(0.9, 0.1), Measurement(0.2, name="missed")
    found = suite.measure_rows([disturbed, calm], goals.ATTEMPTS)
    assert [(row.name, row.ratio, row.attempts) for row in found] == [("made_up", 0.1, 2), ("missed", 0.2, 1)]
    assert (disturbed.calls, calm.calls) == (2, 1) and goals.failures(found) == []


def test_a_row_that_is_slow_in_every_attempt_fails(rows):
    slow = Measurement(0.5, 0.4, 0.45)
    found = suite.measure_rows([slow], goals.ATTEMPTS)
    assert [row.ratio for row in goals.failures(found)] == [0.4] and found[0].attempts == slow.calls == 3


def test_a_miss_within_the_slack_is_measured_once(rows):
    missed = Measurement(0.25, 0.1)
    [row] = suite.measure_rows([missed], goals.ATTEMPTS)
    assert (row.ratio, missed.calls) == (0.25, 1)


def test_only_a_failed_row_is_replaced_by_a_better_one(rows):
    def two():
        return [BenchmarkRow("made_up", 1_000_000, 1.0, "a", ratio=next(ratios)), BenchmarkRow("sized", 7, next(times))]

    ratios, times = iter([0.9, 0.4, 0.25]), iter([1.0, 2.0, 3.0])
    failed, other = suite.measure_rows([two], goals.ATTEMPTS)
    assert (failed.ratio, failed.attempts, other.ms, other.attempts) == (0.25, 3, 1.0, 1)


@pytest.mark.parametrize("name", goals.ROWS)
def test_every_row_has_goals_and_one_sentence(name):
    row = goals.ROWS[name]
    assert row.sentence.endswith(".") and ". " not in row.sentence and "against" in row.sentence
    assert row.ratios and all(goal > 0 for goal in row.ratios.values())
    for size, known in row.known.items():
        assert size in row.ratios and known >= round(SLACK * row.ratios[size], 9), "smaller misses need no entry"
