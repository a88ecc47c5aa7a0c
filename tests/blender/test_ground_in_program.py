# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground in the real program: a click of the mouse picks it, and what is kept on it follows when it is moved."""

import json
import os
from pathlib import Path

import pytest
from program_window import WHOLE, read_screen, wait_for, window
from real_program import SCRIPTS


def test_a_click_picks_and_what_is_kept_follows(program, tmp_path):
    pictures = Path(os.environ.get("ADAPTIVE_TERRAIN_PICTURES", tmp_path))
    pictures.mkdir(parents=True, exist_ok=True)
    arguments = ["--python", str(SCRIPTS / "click_ground.py"), "--", str(tmp_path)]
    with window(program, arguments, tmp_path, place=WHOLE) as blender:
        wait_for(tmp_path / "pictured", blender)
        read_screen(tmp_path).save(pictures / "ground.png")
        (tmp_path / "picture_taken").touch()
        wait_for(tmp_path / "done.json", blender)
    said = json.loads((tmp_path / "done.json").read_text())
    assert "error" not in said, (said, (tmp_path / "blender.log").read_text()[-4000:])
    assert said["picked"] == pytest.approx(said["clicked"], abs=1.5), "the cursor is under the mouse"
    for x, y, z, ground in said["kept"]:
        assert z == pytest.approx(ground, abs=1e-3), (x, y)
