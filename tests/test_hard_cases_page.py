# SPDX-License-Identifier: GPL-3.0-or-later
"""Every hard case has a test, and docs/hard_cases.md lists all tests."""

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("hard_cases_page", ROOT / "tools" / "hard_cases_page.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def text(tool):
    return tool.PAGE.read_text(encoding="utf-8")


def test_every_case_has_a_test(tool):
    expected = {*range(1, 66), 67, 68, 69, 71, 72, 73}
    assert {test.case for test in tool.find_tests()} == set(tool.CASES) == expected


def test_the_page_lists_the_tests_and_what_they_assert(tool, text):
    assert tool.listed(text) == tool.rows(tool.find_tests()), "run `make hard-cases`"


def test_every_listed_test_passed_or_gives_a_reason(tool, text):
    results = tool.results_of(text)
    assert len(results) == len(tool.find_tests())
    assert all(result.startswith(("passed", "skipped: ")) for result in results)
    assert f"{sum(r.startswith('passed') for r in results)} of {len(results)} tests passed" in text


def test_a_case_without_number_or_docstring_is_refused(tool, tmp_path, monkeypatch):
    monkeypatch.setattr(tool, "TESTS", tmp_path)
    file = tmp_path / "test_new.py"
    file.write_text('def test_case_07_new():\n    """It is so.\n\n    More."""\n')
    assert tool.rows(tool.find_tests()) == [("7", tool.CASES[7], "It is so.", "`test_new.py::test_case_07_new`")]
    for wrong, message in (
        ("def test_new():\n    '''a'''\n", "no case number"),
        ("def test_case_07_x(): pass", "docstring"),
    ):
        file.write_text(wrong)
        with pytest.raises(ValueError, match=message):
            tool.find_tests()
    file.write_text("def test_case_66_x():\n    '''a'''\n")
    with pytest.raises(ValueError, match="no case number"):
        tool.find_tests()


def test_results_of_many_parameters_are_counted(tool):
    assert tool._summary(["passed"]) == "passed" and tool._summary(["passed"] * 3) == "passed (3)"
    assert tool._summary(["passed", "failed", "passed"]) == "failed (1), passed (2)"
    assert tool._summary(["passed", "skipped: no bpy"]) == "passed (1), skipped: no bpy (1)"


def test_a_module_without_bpy_says_so(tool):
    whole = tool.ElementTree.fromstring(
        '<testcase classname="" name="tests.hard_cases.test_a"><skipped message="collection skipped">'
        "('/a.py', 2, &quot;Skipped: could not import 'bpy': No module named 'bpy'&quot;)</skipped></testcase>"
    )
    assert tool._outcome(whole) == "skipped: could not import 'bpy': No module named 'bpy'"
    one = tool.ElementTree.fromstring('<testcase><skipped message="resident memory is read from /proc"/></testcase>')
    assert tool._outcome(one) == "skipped: resident memory is read from /proc"
