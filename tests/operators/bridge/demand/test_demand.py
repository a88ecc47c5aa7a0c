# SPDX-License-Identifier: GPL-3.0-or-later
"""A demand has exactly the attributes that a scene reads, each with its readers."""

import bpy
import pytest
from adaptive_terrain.operators.bridge.demand.demand import find_demand
from adaptive_terrain.operators.bridge.demand.found import Reader
from demand_cases import CASES
from demand_trees import Moved, colour, emit, group, mix, new_object, worn


def demanded(obj, mode="RENDER"):
    return find_demand(obj, bpy.context.evaluated_depsgraph_get(), mode)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_every_read_attribute_is_found(case):
    for label, found, wanted in case(demanded):
        assert set(found) == wanted, label


def test_readers_have_names_and_families():
    obj, tree, output = worn()
    inner, _, end = group("Snow", "ShaderNodeTree", outputs=[("C", "Color")])
    inner.links.new(colour(inner, "slope"), end.inputs[0])
    used = tree.nodes.new("ShaderNodeGroup")
    used.node_tree = inner
    emit(tree, used.outputs[0], output)
    Moved(obj).reads("height")
    taker = new_object("Trees")
    moved = Moved(taker)
    taken = moved.tree.nodes.new("GeometryNodeObjectInfo")
    taken.inputs["Object"].default_value = obj
    moved.tree.links.new(taken.outputs["Geometry"], moved.mover.inputs[0])
    moved.reads("slope")
    found = demanded(obj)
    assert found["height"] == [Reader("modifier Nodes, node Named Attribute", "GEOMETRY")]
    assert found["slope"] == [
        Reader("object Trees, modifier Nodes, node Named Attribute", "GEOMETRY"),
        Reader("material M, group Snow, node Attribute", "PICTURE"),
    ]


def test_an_image_on_an_empty_reads_nothing():
    obj, _, _ = worn()
    empty = bpy.data.objects.new("Reference", None)
    empty.empty_display_type, empty.data = "IMAGE", bpy.data.images.new("Photo", 4, 4)
    bpy.context.scene.collection.objects.link(empty)
    assert not demanded(obj)


def test_everything_is_demanded_with_its_reason():
    obj, _, _ = worn()
    Moved(obj).reads_computed()
    assert demanded(obj)["*"] == [Reader("modifier Nodes, node Named Attribute (its Name is computed)", "GEOMETRY")]


def nested(tree, depth, times):
    """Add a group node with `depth` nested groups, each of which uses the next one `times` times."""
    nested_tree = None
    for number in range(depth):
        inner, _, end = group(f"G{number}", "ShaderNodeTree", outputs=[("C", "Color")])
        sources = [colour(inner, "deep")] if nested_tree is None else []
        for _ in range(times if nested_tree else 0):
            used = inner.nodes.new("ShaderNodeGroup")
            used.node_tree = nested_tree
            sources.append(used.outputs[0])
        mixed = mix(inner, 0.5, sources[0], sources[-1])
        inner.links.new(mixed.outputs[2], end.inputs[0])
        nested_tree = inner
    used = tree.nodes.new("ShaderNodeGroup")
    used.node_tree = nested_tree
    return used


@pytest.mark.parametrize("depth, times, wanted", [(20, 1, {"deep"}), (60, 1, {"*"}), (15, 2, {"*", "deep"})])
def test_groups_in_groups_end_the_walk(depth, times, wanted):
    obj, tree, output = worn()
    emit(tree, nested(tree, depth, times).outputs[0], output)
    assert set(demanded(obj)) == wanted


def test_aovs_in_groups_in_groups_are_found():
    obj, tree, _ = worn()
    inner, _, _ = group("Inner", "ShaderNodeTree")
    aov = inner.nodes.new("ShaderNodeOutputAOV")
    aov.aov_name = "wet"
    inner.links.new(colour(inner, "w"), aov.inputs[0])
    outer, _, _ = group("Outer", "ShaderNodeTree")
    outer.nodes.new("ShaderNodeGroup").node_tree = inner
    tree.nodes.new("ShaderNodeGroup").node_tree = outer
    bpy.context.view_layer.aovs.add().name = "wet"
    assert set(demanded(obj)) == {"w"}
