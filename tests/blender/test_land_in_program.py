# SPDX-License-Identifier: GPL-3.0-or-later
"""The land in the real program: rivers, a preview that never blocks, shaping, Undo, and what hiding saves."""

import json
import os
from pathlib import Path

from program_window import read_screen, wait_for, window
from real_program import SCRIPTS

MOMENTS = ("preview", "shaping", "shaped", "finer")


def test_land_is_shaped_beside_the_window(program, tmp_path):
    pictures = Path(os.environ.get("ADAPTIVE_TERRAIN_PICTURES", tmp_path))
    pictures.mkdir(parents=True, exist_ok=True)
    arguments = ["--python", str(SCRIPTS / "click_land.py"), "--", str(tmp_path)]
    with window(program, arguments, tmp_path) as blender:
        try:
            for moment in MOMENTS:
                wait_for(tmp_path / moment, blender)
                read_screen(tmp_path).save(pictures / f"land_{moment}.png")
                (tmp_path / f"{moment}_pictured").touch()
            wait_for(tmp_path / "done.json", blender)
        finally:
            read_screen(tmp_path).save(pictures / "land_end.png")
    said = json.loads((tmp_path / "done.json").read_text())
    assert "error" not in said, (said, (tmp_path / "blender.log").read_text()[-4000:])
    assert said["preview"] < said["source"] - 1.0, "rivers cut: the mean of the mesh sinks"
    assert abs(said["shaped"] - said["preview"]) < 0.5 * abs(said["preview"] - said["source"]) + 20.0
    assert said["previews_a_step"] == 1 and said["tiles"] is None
    assert said["progress"] and said["after_cancel"] == "Preview"
    assert said["tiles_shaped"][0] == said["tiles_shaped"][1] > 1, "without views to choose by, all are built"
    assert "press Shape Now first" in said["not_baked"], "it would hold up the window"
    assert said["baked"] == [True, 0] and said["baked_differs_m"] == 0.0
    assert said["stores_for_undo"] == 0, "what was shaped before is found again"
    assert said["hidden_cost"] == [0, 0] and said["shown_cost"] == [1, 0]
    assert said["slider_ends_it"] and 0 < said["tiles_of_views"][0] < said["tiles_of_views"][1]
    times = ("slider_s", "longest_turn_s", "longest_turn_shaping_s", "shaped_s", "longest_turn_resting_s", "finer_s")
    print({name: said[name] for name in times})
