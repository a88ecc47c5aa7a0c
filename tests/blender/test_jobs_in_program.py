# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs beside the window of the real program."""

import json

import numpy as np
import pytest
from PIL import Image
from program_window import wait_for, window
from real_program import SCRIPTS
from window_report import run_in_window

pytestmark = pytest.mark.thorough


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


def test_a_map_is_rendered_beside_the_window(program, tmp_path):
    """It has the pixels of a script's map, and opens no window."""
    report = run_in_window(program, "render_map.py", tmp_path)
    assert report["texts"] == [f"Rendering a map: Picture {number} of 2; Esc: cancel" for number in (1, 2)]
    for name in ("x0_y0", "x1_y0"):
        script, ours = (np.asarray(Image.open(tmp_path / f"{kind}_{name}.png")) for kind in ("script", "window"))
        assert script.shape == (200, 100, 4) and (script == ours).all() and script[:, :, :3].std() > 1.0
        assert (tmp_path / f"window_{name}.tif").exists()
    assert (report["windows"], report["border"]) == (1, False)
