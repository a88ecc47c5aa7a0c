# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs beside the window of the real program."""

import json

from program_window import wait_for, window
from real_program import SCRIPTS


def test_jobs_are_cancelled_finish_and_end_with_the_file(program, tmp_path):
    arguments = ["--python", str(SCRIPTS / "background_jobs.py"), "--", str(tmp_path)]
    with window(program, arguments, tmp_path) as blender:
        wait_for(tmp_path / "done.json", blender)
    found, log = json.loads((tmp_path / "done.json").read_text()), (tmp_path / "blender.log").read_text()
    assert "error" not in found and "Traceback" not in log, (found, log[-4000:])
    assert found["baking"] == ["RUNNING_MODAL"] and found["cancel"] == ["FINISHED"]
    assert found["cancelled"] == [7, []], "the scene is at its frame again, and no map is left"
    assert found["maps"] > 0 and found["store"].startswith("//")
    assert found["proposed"] == "Terrain_tileset.json" and found["tileset"] == [".glb", ".json"]
    assert found["after_opening"] == [0, []] and found["after_disabling"] == [0, []]
