# SPDX-License-Identifier: GPL-3.0-or-later
"""A demand is cached until one of its sources changes."""

import bpy
import pytest
from adaptive_terrain.operators.bridge.demand import demand_cache
from demand_trees import Moved, colour, new_material, new_object, shows


@pytest.fixture
def gathered(monkeypatch):
    """Return the list of calls that gathered the demand."""
    calls = []

    def counted(*arguments):
        calls.append(arguments)
        return found(*arguments)

    found = demand_cache.find_demand
    monkeypatch.setattr(demand_cache, "find_demand", counted)
    demand_cache.forget()
    return calls


@pytest.fixture
def worn(scene, add_terrain):
    """Return a terrain with a material that reads the slope."""
    terrain = add_terrain()
    terrain.data.materials.append(shows(new_material("Rock"), lambda tree: colour(tree, "slope")))
    return terrain


def read(terrain):
    """Return the attributes that the viewport reads after Blender's update."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return set(demand_cache.demand_of(terrain, depsgraph, "VIEWPORT"))


def test_nothing_is_gathered_while_nothing_changes(worn, gathered, scene):
    from adaptive_terrain.operators.session import session

    session.update_object(worn)
    session.update_object(worn)
    del gathered[:]
    for frame in range(1, 6):
        scene.camera.location.x += 40.0
        session.update_object(worn)
        scene.frame_set(frame)
    assert len(worn.data.polygons) > 0 and gathered == []


def test_a_render_always_gathers(worn, gathered):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for _ in range(2):
        demand_cache.demand_of(worn, depsgraph, "RENDER")
    assert len(gathered) == 2


def unlink(terrain):
    tree = terrain.material_slots[0].material.node_tree
    tree.links.remove(tree.links[0])


def mute(terrain):
    terrain.material_slots[0].material.node_tree.nodes["Attribute"].mute = True


def take_the_material_off(terrain):
    terrain.data.materials.clear()


def another_material(terrain):
    terrain.material_slots[0].material = shows(new_material(), lambda tree: colour(tree, "height"))


def another_name(terrain):
    terrain.material_slots[0].material.node_tree.nodes["Attribute"].attribute_name = "height"


def a_modifier(terrain):
    Moved(terrain).reads("height")


def anothers_modifier(terrain):
    moved = Moved(new_object("Other"))
    taken = moved.tree.nodes.new("GeometryNodeObjectInfo")
    taken.inputs["Object"].default_value = terrain
    moved.tree.links.new(taken.outputs["Geometry"], moved.mover.inputs[0])
    moved.reads("height")


def an_override(_terrain):
    bpy.context.view_layer.material_override = shows(new_material(), lambda tree: colour(tree, "height"))


CHANGES = {
    unlink: set(),
    mute: set(),
    take_the_material_off: set(),
    another_material: {"height"},
    another_name: {"height"},
    a_modifier: {"slope", "height"},
    anothers_modifier: {"slope", "height"},
    an_override: {"height"},
}


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_what_changes_is_noticed(worn, gathered, change):
    from adaptive_terrain.operators.session import session

    session.update_object(worn)
    assert read(worn) == {"slope"}
    change(worn)
    assert read(worn) == CHANGES[change]
    session.update_object(worn)
    del gathered[:]
    assert read(worn) == CHANGES[change] and gathered == []


def test_a_modifiers_own_settings_are_noticed(worn, gathered):
    moved = Moved(worn)
    node = moved.named("")
    moved.tree.links.new(moved.given.outputs["Name"], node.inputs["Name"])
    moved.tree.links.new(node.outputs[0], moved.offset)
    for name in ("height", "aspect", "height"):
        moved.put("Name", name)
        worn.update_tag()  # as the panel does; Blender does not notice changes by scripts
        assert read(worn) == {"slope", name}
    moved.modifier.show_viewport = False
    assert read(worn) == {"slope"}


def test_another_file_is_another_demand(worn, gathered):
    assert read(worn) == {"slope"}
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert demand_cache._cached == {}
