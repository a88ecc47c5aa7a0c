# SPDX-License-Identifier: GPL-3.0-or-later
"""Undo in the real program, by keys, while work runs beside the window."""

import json

from program_window import wait_for, window
from real_program import SCRIPTS


def test_a_terrain_that_comes_back_is_imported_anew(program, tmp_path):
    """Undone and redone, or deleted and undone, before its height map is there: it is never left without. Afterwards
    adding and importing are one step."""
    arguments = ["--python", str(SCRIPTS / "undo_import.py"), "--", str(tmp_path)]
    with window(program, arguments, tmp_path) as blender:
        wait_for(tmp_path / "done.json", blender)
    said = json.loads((tmp_path / "done.json").read_text())
    assert "error" not in said, (said, (tmp_path / "blender.log").read_text()[-4000:])
    assert said["undone"] == said["deleted"] == ["", 1], "no store yet, one import"
    assert said["imported"] and said["left"] == [0, 0]
    assert said["one_step"] == [True, True, 0], "the store and the camera's range are back, and nothing is imported"
