# SPDX-License-Identifier: GPL-3.0-or-later
"""The asset library in the real program: written once, listed in the Asset Browser, and gone with the extension."""

import shutil

import pytest
from window_report import run_in_window

pytestmark = pytest.mark.thorough


def test_the_asset_browser_lists_the_library(program, tmp_path):
    shutil.rmtree(program.user / "extensions/.user/user_default/adaptive_terrain/assets")
    report = run_in_window(program, "asset_library.py", tmp_path, ("browser", "dropped"))
    assert report["wheels"], "the process that writes the library leaves the extension's wheels in place"
    assert report["files"] == ["adaptive_terrain.blend", "blender_assets.cats.txt", "version.txt"]
    assert report["assets"] == {"materials": 6, "node_groups": 3, "collections": 5}
    assert report["dragged"] == ["Terrain Material"]
    assert report["after_disable"] == [[["Mine", str(tmp_path)]], []]
