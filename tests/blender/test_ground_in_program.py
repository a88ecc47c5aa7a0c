# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground in the real program: a click picks it, and kept objects follow when it moves."""

import pytest
from program_window import WHOLE
from window_report import run_in_window

pytestmark = pytest.mark.thorough


def test_a_click_picks_and_kept_objects_follow(program, tmp_path):
    report = run_in_window(program, "click_ground.py", tmp_path, ("ground",), place=WHOLE)
    assert report["picked"] == pytest.approx(report["clicked"], abs=1.5), "the cursor is under the mouse"
    for x, y, z, ground in report["kept"]:
        assert z == pytest.approx(ground, abs=1e-3), (x, y)
