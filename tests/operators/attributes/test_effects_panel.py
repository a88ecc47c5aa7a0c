# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel Attributes, Terrain Material and `effects --scene` list the attributes that are read, by reader."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.mesh.archive import read_npz
from adaptive_terrain.operators.attributes import panel as effects_panel
from adaptive_terrain.operators.bridge.demand.trees import tree_of_new
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.ui.panel_parts import LINE_LENGTH, wrap_words
from blender_meshes import values_of
from drawn_panels import DrawnLayout, draw
from store_exports import run


@pytest.fixture
def terrain(scene, add_terrain):
    obj = add_terrain("Hills")
    bpy.context.view_layer.objects.active = obj
    return obj


def read_by_material(obj, name: str):
    """Give the object a material that shows an attribute; return the node that reads it."""
    made = bpy.data.materials.new("Rock")
    tree = tree_of_new(made)
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_name = name
    tree.links.new(node.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    obj.data.materials.append(made)
    return node


def lines(obj) -> list[str]:
    """Return the texts of the panel with those of its list."""
    context = SimpleNamespace(object=obj)
    settings, layout = obj.adaptive_terrain.effects, DrawnLayout()
    rows = effects_panel.AttributeList
    members = settings.bl_rna.properties.values()
    flags, _ = rows.filter_items(SimpleNamespace(filter_name="", bitflag_filter_item=1), None, settings.bl_rna, "")
    for member, flag in zip(members, flags, strict=True):
        if flag:
            rows.draw_item(None, context, layout, settings.bl_rna, member, 0, settings, "active")
    return draw(effects_panel.EffectsPanel, context).texts + layout.texts


def choose(obj, name: str) -> None:
    obj.adaptive_terrain.effects.active = obj.adaptive_terrain.effects.bl_rna.properties.find(name)


def test_the_rows_stay_in_place_whatever_is_read(terrain):
    before = lines(terrain)
    node = read_by_material(terrain, "slope")
    session.update_object(terrain)
    read = lines(terrain)
    assert [text for text in read if text.startswith("<")] == [text for text in before if text.startswith("<")]
    assert len(read) == len(before) and "1 of" in read[read.index("Computed") + 1]
    node.attribute_name = "none of ours"
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert len(lines(terrain)) == len(before) and "0 of" in lines(terrain)[read.index("Computed") + 1]


def test_the_details_are_those_of_the_effect_that_was_clicked(terrain):
    read_by_material(terrain, "slope")
    session.update_object(terrain)
    choose(terrain, "slope")
    said = " ".join(lines(terrain))
    assert "Read by material Rock, node Attribute" in said and "Slope (rad): Angle of the ground" in said
    choose(terrain, "wetness")
    assert "Skipped, nothing reads it" in " ".join(lines(terrain))
    terrain.adaptive_terrain.effects.slope.when = "OFF"
    session.update_object(terrain)
    choose(terrain, "slope")
    assert "Skipped, switched off, read by" in " ".join(lines(terrain))
    assert all(len(text) <= LINE_LENGTH + 4 for text in lines(terrain))


def test_the_list_finds_attributes_by_their_names(terrain):
    members = terrain.adaptive_terrain.effects.bl_rna
    sought = SimpleNamespace(filter_name="SLO", bitflag_filter_item=1)
    flags, _ = effects_panel.AttributeList.filter_items(sought, None, members, "")
    assert [name for name, flag in zip(members.properties.keys(), flags, strict=True) if flag] == ["slope"]
    choose(terrain, "geometry_metres")
    assert effects_panel.chosen_attribute(terrain.adaptive_terrain.effects) == next(iter(ATTRIBUTES))


def test_what_an_effect_is_and_why_it_is_nothing_is_not_cut_off(terrain):
    assert all(
        len(wrap_words(effects_panel.about_text(name), LINE_LENGTH)) <= effects_panel.ABOUT_LINES for name in ATTRIBUTES
    )
    read_by_material(terrain, "sun")
    terrain.data.materials[0].name = "The northern cliffs, whose rock is of another kind than all of the others"
    session.update_object(terrain)
    choose(terrain, "sun")
    said = " ".join(lines(terrain))
    assert "0, since no sun lamp shines in the scene. Read by material The northern cliffs" in said


def test_the_button_reads_the_layers_and_nothing_else(terrain):
    terrain.data.materials.clear()
    assert bpy.ops.adaptive_terrain.terrain_material() == {"FINISHED"}
    session.update_object(terrain)
    computed = {name for name, s in session.record_of(terrain).status.effects.items() if not s.skipped}
    [group] = [node for node in terrain.data.materials[0].node_tree.nodes if node.type == "GROUP"]
    assert {node.attribute_name for node in group.node_tree.nodes if node.type == "ATTRIBUTE"} == {"splat_1"}
    assert "splat_1" in computed
    assert computed - {"splat_1"} == {"height", "slope"}, "what the default layers' rules are about"
    assert (values_of(terrain.data, "splat_1").sum(1, dtype=np.float32) == 1.0).all()
    assert bpy.ops.adaptive_terrain.terrain_material(sky=True) == {"FINISHED"}
    assert len(bpy.data.materials) == 1
    session.update_object(terrain)
    assert not session.record_of(terrain).status.effects["sky"].skipped


def test_the_command_says_who_reads_what(terrain, tmp_path, capsys):
    read_by_material(terrain, "slope")
    path = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert run("effects", "--scene", path) == 0
    said = capsys.readouterr().out
    assert "slope: read by material Rock, node Attribute; " in said and " ms, " in said
    assert "wetness: skipped, nothing reads it" in said
    assert said.count("skipped, nothing reads it") == len(ATTRIBUTES) - 1


@pytest.mark.parametrize(
    ("asked", "has"), [("auto", {"slope"}), ("none", set()), ("height,aspect", {"height", "aspect"})]
)
def test_an_export_of_a_scene_carries_what_is_asked(terrain, tmp_path, asked, has):
    read_by_material(terrain, "slope")
    path, out = tmp_path / "shot.blend", tmp_path / "out"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert run("export", "--scene", path, "--frames", 1, "--format", "npz", "--effects", asked, "--out", out) == 0
    mesh = read_npz(out / "Hills_0001.npz")
    assert mesh.keys() & ATTRIBUTES.keys() == has
