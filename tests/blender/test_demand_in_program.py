# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene reads, found by the real program; a click there takes an effect away."""

import json
import os
from pathlib import Path

from program_window import read_screen, wait_for, window

HERE = Path(__file__).resolve().parent
SUPPORT = HERE.parent / "support"


def test_the_cases_of_demand_hold(program):
    said = program.script("demand_cases.py", SUPPORT)
    assert said["failed"] == []
    assert said["held"] >= 58


def test_a_click_that_unlinks_a_node_skips_its_effect(program, tmp_path):
    """The stroke that cuts a link in the Shader Editor; no triangle changes."""
    pictures = Path(os.environ.get("ADAPTIVE_TERRAIN_PICTURES", tmp_path))
    pictures.mkdir(parents=True, exist_ok=True)
    arguments = ["--python", str(HERE / "scripts" / "click_unlink.py"), "--", str(tmp_path)]
    with window(program, arguments, tmp_path) as blender:
        try:
            for moment in ("linked", "unlinked"):
                wait_for(tmp_path / moment, blender)
                read_screen(tmp_path).save(pictures / f"{moment}.png")
                (tmp_path / f"{moment}_pictured").touch()
            wait_for(tmp_path / "done.json", blender)
        finally:
            read_screen(tmp_path).save(pictures / "unlink_end.png")
    said = json.loads((tmp_path / "done.json").read_text())
    assert "error" not in said, said
    assert said["bare"]["made"] == [] and said["bare"]["runs"] == {}, "no reader, no run"
    assert said["worn"]["made"] == ["height", "slope"] and set(said["worn"]["runs"]) == {"height", "slope"}
    assert said["worn"]["said"]["slope"] == [["material Rock, node Attribute"], ""]
    assert said["removed"]["made"] == ["slope"] and said["links"] == 1
    assert said["cut"]["made"] == [] and said["cut"]["said"]["slope"] == [[], "nothing reads it"]
    assert said["cut"]["runs"]["slope"] == said["removed"]["runs"]["slope"]
    assert len({said[moment]["triangles"] for moment in ("bare", "worn", "removed", "cut")}) == 1
