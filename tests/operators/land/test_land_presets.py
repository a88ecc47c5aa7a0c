# SPDX-License-Identifier: GPL-3.0-or-later
"""Stacks as files: presets, the shipped ones and a user's own."""

import json
import os
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from adaptive_terrain.cbt_terrain.height_operators.stack import stack_from
from adaptive_terrain.operators.importing.imported import imported_of
from adaptive_terrain.operators.land import stack as land_stack
from adaptive_terrain.operators.land.entries import PRESETS
from adaptive_terrain.operators.land.panel import LandPresets
from adaptive_terrain.operators.land.presets import FOLDER, SHIPPED, ApplyLandPreset
from adaptive_terrain.operators.land.properties import GROUPS
from drawn_panels import DrawnLayout
from land_scenes import add, names


def test_a_preset_file_is_the_commands_file(terrain, tmp_path):
    given = {
        "version": 1,
        "entries": [
            {"effect": "rivers", "parameters": {"years": 20000}, "seed": 4, "name": "Old rivers"},
            {"effect": "snow", "on": False, "parameters": {"wind": 90, "line": 1200},
             "mask": {"factor": 0.5, "rules": [{"of": "height", "low": 600, "edge": 50},
                                               {"of": "slope", "high": 45, "edge": 10},
                                               {"of": "aspect", "low": 0, "edge": 0.5, "direction": 270}]}},
        ],
    }  # fmt: skip
    file = tmp_path / "stack.json"
    file.write_text(json.dumps(given))
    add("relief")
    assert bpy.ops.adaptive_terrain.land_preset(filepath=str(file)) == {"FINISHED"}
    land = terrain.adaptive_terrain.land
    assert names(terrain) == ["Old rivers", HEIGHT_OPERATORS["snow"].label]
    assert land.entries[1].snow.wind == pytest.approx(np.pi / 2) and land.entries[1].mask.slope.high == pytest.approx(
        np.pi / 4
    )
    rivers, snow = land_stack.preset_of(land).entries
    assert rivers.parameters == {"years": 20000.0} and (rivers.seed, rivers.mask) == (4, None)
    assert snow.parameters == pytest.approx({"wind": 90.0, "line": 1200.0}) and not snow.on
    found = [(rule.of, rule.low, rule.high, rule.edge, rule.direction) for rule in snow.mask.rules]
    for rule, expected in zip(
        found,
        [("height", 600, np.inf, 50, 0), ("slope", -np.inf, 45, 10, 0), ("aspect", 0, np.inf, 0.5, 270)],
        strict=True,
    ):
        assert rule[0] == expected[0] and rule[1:] == pytest.approx(expected[1:], abs=1e-4)
    file.write_text('{"version": 1, "entries": [{"effect": "rivers", "parameters": {"age": 3}}]}')
    with pytest.raises(RuntimeError, match="has a parameter 'age'; expected some of: years"):
        bpy.ops.adaptive_terrain.land_preset(filepath=str(file))
    assert names(terrain)[0] == "Old rivers"


def test_bundled_presets_can_be_applied(terrain):
    files = [path for folder in bpy.utils.preset_paths("adaptive_terrain/land") for path in sorted_files(folder)]
    assert len(files) >= 7
    for file in files:
        assert bpy.ops.adaptive_terrain.land_preset(filepath=file) == {"FINISHED"}
        assert len(terrain.adaptive_terrain.land.entries) >= 2


def test_a_preset_is_fitted_to_the_lands_heights(terrain, tmp_path):
    low, high = imported_of(terrain.adaptive_terrain).heights_m
    file, foot = tmp_path / "high.json", max(low, 0.0)
    given = {"version": 1, "heights": [1000, 3000], "entries": [{"effect": "snow", "parameters": {"line": 2500}}]}
    file.write_text(json.dumps(given))
    assert bpy.ops.adaptive_terrain.land_preset(filepath=str(file)) == {"FINISHED"}
    line = terrain.adaptive_terrain.land.entries[0].snow.line
    assert line == pytest.approx(foot + 0.75 * (high - foot)) and abs(line - 2500) > 100
    assert land_stack.preset_of(terrain.adaptive_terrain.land).heights is None


def sorted_files(folder: str) -> list[str]:

    return [os.path.join(folder, name) for name in sorted(os.listdir(folder)) if name.endswith(".json")]


def test_a_preset_is_saved_and_removed(terrain, tmp_path, monkeypatch):
    monkeypatch.setattr(bpy.utils, "user_resource", lambda _kind, path="", create=False: str(tmp_path))
    monkeypatch.setattr(
        bpy.utils, "preset_find", lambda name, _folder, ext: str(f) if (f := tmp_path / (name + ext)).exists() else None
    )
    add("scree", depth=44.0)
    assert bpy.ops.adaptive_terrain.land_preset_add(name="My land") == {"FINISHED"}
    [file] = tmp_path.glob("My*.json")
    assert json.loads(file.read_text())["entries"][0]["parameters"] == {"depth": 44.0}
    with pytest.raises(RuntimeError, match="There is a preset 'My land' already"):
        bpy.ops.adaptive_terrain.land_preset_add(name="My land")
    assert bpy.ops.adaptive_terrain.land_preset_add(name="My land", remove_name=True) == {"FINISHED"}
    assert not file.exists()


def test_a_preset_says_which_masks_it_cannot_hold(terrain, tmp_path, monkeypatch):
    monkeypatch.setattr(bpy.utils, "user_resource", lambda _kind, path="", create=False: str(tmp_path))
    entry = add("relief")
    entry.mask.kind, entry.mask.image = "IMAGE", bpy.data.images.new("Paint", 4, 4)
    for filepath in ("", f"/{'n' * 300}.png"):  # no file can have the second name
        entry.mask.image.filepath = filepath
        with pytest.raises(RuntimeError, match="'Paint', which masks 'Fine Relief', has no file"):
            bpy.ops.adaptive_terrain.land_preset_add(name="Painted")
    assert not list(tmp_path.glob("Painted*.json"))
    rules = [{"of": "aspect", "low": -0.5, "high": 0.5}]
    stack = stack_from({"version": 1, "entries": [{"effect": "relief", "mask": {"rules": rules}}]})
    [said] = land_stack.fill(terrain.adaptive_terrain.land, stack)
    assert said == "Entry 1, Fine Relief: its mask has a high limit of aspect, which is left out"


def test_the_menu_shows_kept_land_first_and_yours_last(terrain, tmp_path, monkeypatch):
    paths = bpy.utils.preset_paths
    monkeypatch.setattr(bpy.utils, "preset_paths", lambda subdir: [str(tmp_path), *paths(subdir)])
    for name in ("zebra.json", "Aardvark.json", "notes.txt"):
        (tmp_path / name).write_text("{}")
    drawn = SimpleNamespace(layout=DrawnLayout())
    LandPresets.draw(drawn, bpy.context)
    shown = [text for text in drawn.layout.texts if not text.startswith(("<", "adaptive_terrain."))]
    assert shown == [
        *("Keep the Land", "Light Weathering", "Water and Snow"),
        *("Wear the Land Down", "Desert", "Volcanic Island", "Old Hills"),
        *("Build Different Mountains", "Alpine", "Great Range"),
        *("Aardvark", "zebra"),
    ]


def test_a_shipped_preset_has_its_own_tooltip():
    def tooltip(file):
        return ApplyLandPreset.description(bpy.context, SimpleNamespace(filepath=str(file)))

    assert "different mountains" in tooltip(FOLDER / "alpine.json")
    assert tooltip("/elsewhere/alpine.json") == ""


@pytest.mark.parametrize("name", [name for group in SHIPPED.values() for name in group])
def test_the_panel_shows_the_numbers_of_shipped_presets(terrain, name):
    """And not 0.000 of a rise of 0.0004 m a year."""
    preset = bpy.utils.preset_find(name, PRESETS, ext=".json")
    for entry in stack_from(json.loads(Path(preset).read_text())).entries:
        for parameter, value in entry.parameters.items():
            shown = GROUPS[entry.effect].bl_rna.properties[parameter]
            digits = getattr(shown, "precision", 0)
            assert float(f"{value:.{digits}f}") == pytest.approx(value, rel=0.05), (entry.effect, parameter)
