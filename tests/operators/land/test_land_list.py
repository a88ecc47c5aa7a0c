# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of the stack that shapes the land, and its list."""

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field import lands
from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from adaptive_terrain.operators.importing import store_location
from adaptive_terrain.operators.land import properties as land_properties
from adaptive_terrain.operators.land import shaped_land
from adaptive_terrain.operators.land import stack as land_stack
from adaptive_terrain.operators.land.entries import free_name
from adaptive_terrain.operators.session import session
from land_scenes import add, names, stack_now


@pytest.mark.parametrize("effect", HEIGHT_OPERATORS)
def test_settings_are_those_of_the_declarations(terrain, tmp_path, effect):
    """Name by name; the default is the declaration's own to the last bit, the ends of the range are reached."""
    entry = add(effect)
    group = getattr(entry, effect)
    declared = HEIGHT_OPERATORS[effect].parameters
    assert set(group.bl_rna.properties.keys()) - {"rna_type", "name"} == {parameter.name for parameter in declared}
    assert stack_now(terrain, tmp_path).entries[0].parameters == {}
    for parameter in declared:
        assert land_properties.number_of(parameter, group) == parameter.default
        for value in (parameter.min, parameter.max):
            land_properties.set_number(parameter, group, value)
            assert land_properties.number_of(parameter, group) == pytest.approx(value, rel=1e-6, abs=1e-12)
    stack_now(terrain, tmp_path).check()


def test_lengths_and_angles_have_their_units():
    declared = [(name, parameter) for name, effect in HEIGHT_OPERATORS.items() for parameter in effect.parameters]
    for name, parameter in declared:
        item = land_properties.GROUPS[name].__annotations__[parameter.name].keywords
        if parameter.unit == "m":
            assert item["unit"] == "LENGTH", (name, parameter.name)
        elif parameter.unit == land_properties.DEGREES:
            assert item["subtype"] == "ANGLE" and item["max"] <= 2 * np.pi + 1e-6, (name, parameter.name)
        elif parameter.unit:
            unit = parameter.unit.replace("m2", "m²")
            said = "unit" in item or parameter.unit == parameter.name or f"({unit})" in item["name"]
            assert said or item["description"].endswith(f"({unit})"), (name, parameter.name)
            assert len(item["name"]) <= 15, "what is longer is cut off on a panel of the usual width"
        assert item["options"] == set(), "another number is another land: nothing is animated"


def test_the_list_is_worked_as_a_list_of_modifiers(terrain):
    add("relief", wave=80.0)
    add("scree")
    add("relief")
    assert names(terrain) == ["Fine Relief", HEIGHT_OPERATORS["scree"].label, "Fine Relief.001"]
    land = terrain.adaptive_terrain.land
    assert [entry.seed for entry in land.entries] == [0, 1, 2]
    land.active = 0
    assert bpy.ops.adaptive_terrain.land_duplicate() == {"FINISHED"}
    assert names(terrain)[:2] == ["Fine Relief", "Fine Relief.002"] and land.active == 1
    assert land.entries[1].relief.wave == 80.0 and land.entries[1].seed == land.entries[0].seed
    assert bpy.ops.adaptive_terrain.land_move(by=1) == {"FINISHED"}
    assert names(terrain)[2] == "Fine Relief.002" and land.active == 2
    assert bpy.ops.adaptive_terrain.land_move(by=5) == {"CANCELLED"}
    assert bpy.ops.adaptive_terrain.land_remove() == {"FINISHED"}
    assert names(terrain)[2:] == ["Fine Relief.001"] and land.active == 2
    while land.entries:
        bpy.ops.adaptive_terrain.land_remove()
    assert not bpy.ops.adaptive_terrain.land_remove.poll()


def test_names_are_numbered_as_blender_does():
    assert free_name("Snow", set()) == "Snow"
    assert free_name("Snow", {"Snow", "Snow.001"}) == "Snow.002"
    assert free_name("Snow.001", {"Snow.001"}) == "Snow.002" or free_name("Snow.001", {"Snow.001"}) == "Snow.003"


def test_a_copied_object_has_a_stack_of_its_own(terrain):
    add("relief", wave=80.0)
    copy = terrain.copy()
    copy.adaptive_terrain.land.entries[0].relief.wave = 40.0
    assert terrain.adaptive_terrain.land.entries[0].relief.wave == 80.0
    assert copy.adaptive_terrain.land.entries[0].effect == "relief"


def test_a_stack_is_saved_and_opened(terrain, tmp_path):
    entry = add("scree", depth=12.5)
    entry.on, entry.mask.kind, entry.mask.height.use = False, "RULE", True
    path = str(tmp_path / "land.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    entry = bpy.data.objects["Terrain"].adaptive_terrain.land.entries[0]
    assert (entry.effect, entry.on, entry.scree.depth, entry.mask.kind) == ("scree", False, 12.5, "RULE")


def test_an_entry_of_an_older_file_keeps_its_numbers(terrain):
    """Scree was named thermal."""
    entry = add("scree", depth=12.5)
    stack = land_stack.preset_of(terrain.adaptive_terrain.land)
    entry.property_unset("scree")
    entry.effect, entry.thermal.depth = "thermal", 12.5
    assert land_stack.preset_of(terrain.adaptive_terrain.land) == stack
    session.update_object(terrain)
    assert [layer.name for layer in shaped_land.layers_left_by(terrain.adaptive_terrain.land)][:1] == ["scree"]


def test_an_effect_of_another_version_is_told_of(terrain):
    entry = add("relief")
    entry.effect = "glacier"
    with pytest.raises(session.TerrainError, match="'glacier' is not one of this version's; expected one of rivers"):
        session.update_object(terrain)
    entry.on = False
    session.update_object(terrain)


def test_a_linked_terrain_says_why_it_cannot_be_changed(terrain, tmp_path):
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {terrain})
    with bpy.data.libraries.load(path, link=True) as (there, here):
        here.objects = [name for name in there.objects if name == terrain.name]
    [linked] = here.objects
    bpy.context.scene.collection.objects.link(linked)
    bpy.context.view_layer.objects.active = linked
    for name in ("import_source", "land_add", "shape", "land_preset", "bake_land", "export_heights", "water_surface"):
        with pytest.raises(RuntimeError, match="overrides one, and cannot be changed: make"):
            getattr(bpy.ops.adaptive_terrain, name)()


@pytest.mark.parametrize("land", [pytest.param("CANYON", marks=pytest.mark.thorough), "DUNES"])
def test_a_built_in_land_is_added_with_its_stack(scene, monkeypatch, tmp_path, land):
    """Of dunes there is none, and they get the size that was asked for."""
    given = lands.LANDS[land.lower()]
    monkeypatch.setattr(store_location, "data_folder", lambda: tmp_path)
    assert bpy.ops.mesh.adaptive_terrain_add(land=land, shape=True, size=40.0) == {"FINISHED"}
    settings = bpy.context.object.adaptive_terrain
    if not given.preset:
        assert tuple(settings.extent) == (40.0, 40.0) and not settings.land.entries
        return
    assert settings.extent[0] == given.side and settings.height_scale == 1.0
    [file] = (f for folder in bpy.utils.preset_paths("adaptive_terrain/land") for f in Path(folder).glob("desert.json"))
    expected = [entry["effect"] for entry in json.loads(file.read_text())["entries"]]
    assert [entry.effect for entry in settings.land.entries] == expected
    assert shaped_land.state_of(bpy.context.object).shown == "Preview", "the rest when it is asked for"
