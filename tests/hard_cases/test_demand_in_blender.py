# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 72: the attributes that a scene reads."""

import pytest

bpy = pytest.importorskip("bpy")

from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES  # noqa: E402
from adaptive_terrain.operators.session import session  # noqa: E402
from demand_trees import Moved, attribute, colour, emit, group, mix, new_material  # noqa: E402


@pytest.fixture
def terrain(scene, add_terrain):
    """Return an updated terrain whose material uses one group twice, each time with its own mix factor."""
    obj, material = add_terrain(), new_material("Rock")
    obj.data.materials.append(material)
    tree = material.node_tree
    sockets = ("A", "Color"), ("B", "Color"), ("F", "Float")
    inner, given, end = group("Pick", "ShaderNodeTree", sockets, [("C", "Color")])
    picked = mix(inner, 0.5, given.outputs[0], given.outputs[1])
    inner.links.new(given.outputs[2], picked.inputs[0])
    inner.links.new(picked.outputs[2], end.inputs[0])
    uses = []
    for name, (first, second), factor in (("One", ("slope", "aspect"), 0.0), ("Two", ("flow", "height"), 1.0)):
        used = tree.nodes.new("ShaderNodeGroup")
        used.name, used.node_tree = name, inner
        used.inputs[2].default_value = factor
        tree.links.new(colour(tree, first), used.inputs[0])
        tree.links.new(colour(tree, second), used.inputs[1])
        uses.append(used.outputs[0])
    attribute(tree, "plan_curvature")
    emit(tree, mix(tree, 0.5, *uses).outputs[2], tree.nodes["Material Output"])
    session.update_object(obj)
    return obj


def made(obj):
    """Return the names of the attributes that a fresh update computes, which the mesh then has."""
    record = session.record_of(obj)
    record.effects_runs.clear()
    if record.terrain is not None:
        record.terrain.history.values = None
    session.update_object(obj)
    has = {name for name in ATTRIBUTES if name in obj.data.attributes}
    assert set(record.effects_runs) == has
    return has


def test_case_72_groups_used_twice_with_constant_factors(terrain):
    """A group used twice reads with the factor of each use; inputs hidden by a factor of 0 or 1 are not computed."""
    assert made(terrain) == {"slope", "height"}
    terrain.material_slots[0].material.node_tree.nodes["One"].inputs[2].default_value = 0.25
    assert made(terrain) == {"slope", "aspect", "height"}


def test_case_72_muted_nodes_and_links(terrain):
    """A muted group passes its first input on, a muted link passes nothing, and unmuting restores both."""
    tree = terrain.material_slots[0].material.node_tree
    tree.nodes["Two"].mute = True
    assert made(terrain) == {"slope", "flow"}
    tree.nodes["Two"].mute = False
    [link] = [link for link in tree.links if link.from_node.name == "One"]
    link.is_muted = True
    assert made(terrain) == {"height"}
    link.is_muted = False
    assert made(terrain) == {"slope", "height"}


def test_case_72_driven_and_animated_factors(terrain):
    """A factor with a driver or keyframes hides nothing, whatever its current value."""
    tree = terrain.material_slots[0].material.node_tree
    tree.nodes["One"].inputs[2].driver_add("default_value")
    tree.nodes["Two"].inputs[2].keyframe_insert("default_value", frame=1)
    assert made(terrain) == {"slope", "aspect", "flow", "height"}


def test_case_72_drivers_that_read_the_mesh(terrain):
    """A driver variable that names an attribute counts as a geometry reader."""
    curve = bpy.context.scene.camera.driver_add("location", 2)
    target = curve.driver.variables.new().targets[0]
    target.id, target.data_path = terrain, 'data.attributes["plan_curvature"].data[0].value'
    assert made(terrain) == {"slope", "height", "plan_curvature"}
    status = session.record_of(terrain).status.effects["plan_curvature"]
    assert status.family == "GEOMETRY" and status.readers[0].startswith("driver of Camera, location")


def test_case_72_computed_names_are_everything_with_a_reason(terrain):
    """A computed attribute name makes everything computed, and the panel shows the reason."""
    Moved(terrain).reads_computed()
    session.update_object(terrain)
    statuses = session.record_of(terrain).status.effects
    assert all(not status.skipped for status in statuses.values())
    assert statuses["aspect"].readers == ("modifier Nodes, node Named Attribute (its Name is computed)",)
