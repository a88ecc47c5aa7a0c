# SPDX-License-Identifier: GPL-3.0-or-later
"""Set Up Scene in the window of the real program, after a file was dropped into its viewport."""

import pytest
from rasters import hills, write_raster
from window_report import run_in_window

pytestmark = pytest.mark.thorough


def test_a_dropped_file_and_a_click_make_a_scene(program, tmp_path):
    write_raster(tmp_path / "dem.png", (hills(129, 97) * 60).astype("uint16"))
    report = run_in_window(program, "set_up_scene.py", tmp_path, ("set_up",))
    assert report["before"] == ["Camera", "Cube", "Light", "dem"]
    assert report["triangles"] > 1000, "the viewport shows the land in detail although the camera is inside the ground"
    assert report["followed"] == [True, False, True], "after the import, Set Up Scene and its undo"
    assert report["unturned"], "the import moves the viewport without turning it"
    assert report["after"] == ["Camera", "Terrain Sun", "dem"]
    assert report["camera_off"] < 1e-4, "the camera looks from where the viewport looks"
    assert report["undone"] == report["before"], "one step for Undo"
