# SPDX-License-Identifier: GPL-3.0-or-later
"""Land in the real program: rivers, a preview that never blocks, shaping, Undo and hiding."""

import pytest
from window_report import run_in_window

pytestmark = pytest.mark.thorough


def test_esc_cancels_the_land_of_a_render(program, tmp_path):
    report = run_in_window(program, "cancel_render.py", tmp_path)
    assert not report["rendering_while_shaping"] and not report["rendered_after_esc"], "F12 shapes before it renders"
    assert report["job_ends_s"] < 10.0 and report["wait_ends_s"] < 10.0
    [[message]] = report["said"]
    assert message == "The render was cancelled while land was shaped: render again: finished tiles are reused."
    print({name: report[name] for name in ("job_ends_s", "wait_ends_s")})
    assert report["ended"][-1] == "render_complete" and report["shaped"] == "Shaped"


def test_land_is_shaped_in_the_background(program, tmp_path):
    report = run_in_window(program, "click_land.py", tmp_path, ("preview", "shaping", "shaped", "finer"))
    assert report["preview"] < report["source"] - 1.0, "rivers cut: the mean of the mesh sinks"
    assert abs(report["shaped"] - report["preview"]) < 0.5 * abs(report["preview"] - report["source"]) + 20.0
    assert report["previews_a_step"] == 1 and report["tiles"] is None
    assert report["progress"] and report["after_cancel"] == "Preview"
    assert report["tiles_shaped"][0] == report["tiles_shaped"][1] > 1, "without views all tiles are built"
    assert "press Shape Now" in report["not_baked"], "it would block the window"
    assert report["baked"] == [True, 0] and report["baked_differs_m"] == 0.0
    assert report["stores_for_undo"] == 0, "what was shaped before is found again"
    assert report["hidden_cost"] == [0, 0] and report["shown_cost"] == [1, 0]
    assert report["slider_ends_it"], "and the whole island then costs less than the tiles of this view"
    assert report["tiles_of_views"][0] == report["tiles_of_views"][1] > 1
    times = ("slider_s", "longest_turn_s", "longest_turn_shaping_s", "shaped_s", "longest_turn_resting_s", "finer_s")
    print({name: report[name] for name in times})
