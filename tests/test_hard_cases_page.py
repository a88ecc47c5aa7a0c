# SPDX-License-Identifier: GPL-3.0-or-later
"""Every hard case has a test, and the page of the site lists all tests."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("hard_cases_page", ROOT / "tools" / "hard_cases_page.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_case_has_a_test_and_every_test_a_row(tool):
    tests = tool.find_tests()
    assert {case for case, *_ in tests} == set(tool.CASES) == {*range(1, 66), 67, 68, 69, 71, 72, 73, *range(75, 91)}
    page = tool.page(tests)
    assert page.count("::test_case_") == len(tests) and all(name in page for name in tool.CASES.values())


def test_a_case_without_number_or_docstring_is_refused(tool, tmp_path):
    file = tmp_path / "test_new.py"
    file.write_text('def test_case_07_new():\n    """It is so.\n\n    More."""\n')
    row = f"| 7 | {tool.CASES[7]} | It is so. | `test_new.py::test_case_07_new` |"
    assert tool.page(tool.find_tests(tmp_path)).splitlines()[-1] == row
    for wrong, message in (
        ("def test_new():\n    '''a'''\n", "no case number"),
        ("def test_case_66_x():\n    '''a'''\n", "no case number"),
        ("def test_case_07_x(): pass", "docstring"),
    ):
        file.write_text(wrong)
        with pytest.raises(ValueError, match=message):
            tool.find_tests(tmp_path)
