# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of rows as lines, as JSON and as pages; the alternation of runs."""

import json
import xml.etree.ElementTree as ElementTree

import pytest
from adaptive_terrain.benchmarks.pages import goals, performance_page, plot, report
from adaptive_terrain.benchmarks.rig.measure import BenchmarkRow, Timed, alternate, median_by_step
from adaptive_terrain.cbt_terrain.errors import TerrainError

SPACE = "{http://www.w3.org/2000/svg}"
MACHINE = {"Processor": "Abacus 3", "Threads": "2"}


@pytest.fixture
def rows(monkeypatch):
    made_up = {
        "refine_1t": goals.RowGoal("One.", {50_000: 0.4, 1_000_000: 0.15}, {1_000_000: 0.25}),
        "refine_2t": goals.RowGoal("Two.", {500_000: 0.2}),
        "surface": goals.RowGoal("Three.", {1_000_000: 0.4}),
        "cold_start": goals.RowGoal("Four.", {goals.ANY_SIZE: 1.0}),
        "large_memory": goals.RowGoal("Five.", {goals.ANY_SIZE: 2.0}),
    }
    monkeypatch.setattr(goals, "ROWS", made_up)
    monkeypatch.setattr(performance_page, "ROWS", made_up)
    return [
        BenchmarkRow("refine_1t", 50_000, 1.0, "roam_rebuild", 4.0, first_ms=2.0, steps={"refine": 0.8, "weld": 0.2}),
        BenchmarkRow("refine_1t", 1_000_000, 20.0, "roam_rebuild", 80.0),
        BenchmarkRow("refine_2t", 500_000, 3.0, "roam_rebuild", None),
        BenchmarkRow("surface", 1_000_000, 50.0, "roam_rebuild", 80.0),
        BenchmarkRow("cold_start", 50_000, 500.0, figures={"first_update_ms": 40.0}),
        BenchmarkRow("large_memory", 1_000_000, None, "4097 x 4097", ratio=1.5),
    ]


def test_the_six_keys_of_every_row(rows, tmp_path):
    report.write_json(rows, tmp_path / "rows.json")
    content = json.loads((tmp_path / "rows.json").read_text())
    assert len(content) == len(rows)
    for row in content:
        assert list(row)[:6] == ["name", "size", "ms", "baseline", "baseline_ms", "ratio"]
        assert isinstance(row["name"], str) and isinstance(row["size"], int)
    first, _, unbuilt, _, cold, memory = content
    assert (first["ms"], first["baseline_ms"], first["ratio"], first["goal"]) == (1.0, 4.0, 0.25, 0.4)
    assert first["steps"] == {"refine": 0.8, "weld": 0.2} and first["first_ms"] == 2.0
    assert unbuilt["baseline"] == "roam_rebuild" and unbuilt["baseline_ms"] is None and unbuilt["ratio"] is None
    assert cold["baseline"] is None and cold["figures"] == {"first_update_ms": 40.0}
    assert memory["ms"] is None and memory["ratio"] == 1.5


def test_a_line_reports_how_far_a_goal_is_missed(rows):
    lines = [report.line(row) for row in rows]
    assert "ratio  0.2500" in lines[0] and lines[0].endswith("goal 0.4: met")
    assert "goal 0.15: missed by 67%" in lines[1]
    assert "ratio" not in lines[2]
    assert lines[4].endswith("first_update_ms 40")


def test_the_page_explains_missed_rows(rows):
    page = performance_page.page(rows, MACHINE, ["There is no C compiler here."])
    table, _, sentences = page.partition("## Missed goals")[2].partition("## Method")[0].strip().partition("\n\n")
    assert table.splitlines()[2:] == [
        "| refine_1t | 1,000,000 | 0.25 | 0.15 | 0.25 |",
        "| surface | 1,000,000 | 0.625 | 0.4 |  |",
    ]
    assert sentences == "* `refine_1t`: One.\n* `surface`: Three."
    assert "Processor Abacus 3, Threads 2." in page and f"measured {len(rows)} rows" in page
    assert page.endswith("* There is no C compiler here.\n")
    tables = [paragraph.splitlines() for paragraph in page.split("\n\n") if paragraph.startswith("|")]
    assert len(tables) == 2 and all(len({line.count("|") for line in lines}) == 1 for lines in tables)


def test_the_page_has_the_six_rows_that_were_measured(rows, monkeypatch):
    for name, goal in (("frame", 0.35), ("same_picture", 0.3)):
        monkeypatch.setitem(goals.ROWS, name, goals.RowGoal("A row.", {goals.ANY_SIZE: goal}))
    measured = [BenchmarkRow(name, 1_000_000, 10.0, "base", 40.0) for name in ("import", "frame", "still", "surface")]
    measured += [BenchmarkRow("refine_error", 1_000_000, 10.0, "base", 40.0), BenchmarkRow("frame", 50_000, 7.0)]
    measured.append(BenchmarkRow("same_picture", 1_632_029, 1363.0, "cycles dicing", 5087.0))
    table = performance_page.headlines([*rows, *measured]).splitlines()[2:]
    assert len(table) == len(performance_page.HEADLINES) == 6
    assert table[0].endswith("| 1,000,000 | 10 | base | 40 | 0.25 | 0.35 |")
    assert table[4].endswith("| 1,632,029 | 1,363 | cycles dicing | 5,087 | 0.268 | 0.3 |")
    assert len(performance_page.headlines(measured[:3]).splitlines()) == 5


def test_the_bars_of_a_frame_are_its_steps_and_end_at_its_time():
    steps = {"refine": 3.0, "weld": 1.0, "displace": 3.0, "mesh": 5.0, "blender": 3.0}
    frames = [
        BenchmarkRow("frame", 50_000, 10.0, steps={"refine": 10.0}),
        BenchmarkRow("frame", 1_000_000, 20.0, steps=steps),
    ]
    chart = ElementTree.fromstring(plot.write_bars(frames))
    wide = [float(box.get("width")) for box in chart.iter(f"{SPACE}rect") if box.get("height") == "30.0"]
    short, long = wide[: len(plot.STEPS)], wide[len(plot.STEPS) :]
    assert sum(short) == pytest.approx(sum(long) / 2, abs=0.5)
    assert [w / sum(long) for w in long] == pytest.approx([0.15, 0.05, 0.15, 0.25, 0.15, 0.25], abs=0.01)
    assert {"50,000", "1,000,000", "20 ms"} <= {text.text for text in chart.iter(f"{SPACE}text")}


def test_a_page_that_cannot_be_written_is_one_sentence(rows, tmp_path):
    (tmp_path / "docs").write_text("a file")
    with pytest.raises(TerrainError, match="cannot be written"):
        report.write_text(tmp_path / "docs" / "performance.md", "a page")
    with pytest.raises(TerrainError, match="cannot be written"):
        report.write_json(rows, tmp_path)


def test_our_runs_and_the_baselines_alternate():
    turns = []

    def ours():
        turns.append("a")
        return {"refine": 10.0 + len(turns), **({"weld": 1.0} if len(turns) > 30 else {})}

    def theirs():
        turns.append("b")
        return float(len(turns))

    timed = alternate(ours, theirs)
    assert "".join(turns) == "abab" + 3 * (5 * "b" + 5 * "a")
    assert timed == Timed({"refine": 32.0, "weld": 0.0}, {"refine": 11.0}, 17.0)
    assert alternate(ours).baseline_ms is None
    short = []
    alternate(lambda: short.append(1) or {"total": 0.1})
    assert len(short) == 2 + 15 * 5


@pytest.mark.parametrize(
    ("ms", "other_ms", "expected"),
    [
        (0.1, 0.1, "abab" + 15 * (5 * "b" + 5 * "a")),
        (0.1, 20.0, "abab" + 3 * (5 * "b" + 25 * "a")),  # more blocks of a short measurement, not of the baseline
        (30.0, 240.0, "abab" + 3 * (2 * "b" + 5 * "a")),
        (900.0, 170.0, "abab" + 3 * (2 * "b" + "a")),
    ],
)
def test_blocks_have_fewer_long_runs(ms, other_ms, expected):
    turns = []
    alternate(lambda: turns.append("a") or {"total": ms}, lambda: turns.append("b") or other_ms)
    assert "".join(turns) == expected
    assert median_by_step([{"a": 1.0}, {"a": 3.0, "b": 2.0}, {"b": 2.0}]) == {"a": 1.0, "b": 2.0}
