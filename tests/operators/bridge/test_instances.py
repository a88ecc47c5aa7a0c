# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain is refined for each place where an instance of its collection shows it."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.bridge import instances
from adaptive_terrain.operators.bridge.instances import shown_places
from adaptive_terrain.operators.session import session


def add_instance(collection, name, place, into):
    """Add an empty that shows a collection, turned by 0.3 radians."""
    empty = bpy.data.objects.new(name, None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    empty.location, empty.rotation_euler = place, (0.0, 0.0, 0.3)
    into.objects.link(empty)
    return empty


@pytest.fixture
def land(scene, add_terrain):
    """Add a terrain in a collection that only an instance 5 km to the east shows."""
    terrain, collection = add_terrain(), bpy.data.collections.new("Land")
    collection.objects.link(terrain)
    scene.collection.objects.unlink(terrain)
    terrain.location, terrain.scale = (10.0, 20.0, 30.0), (1.0, 1.0, 2.0)
    collection.instance_offset = (5.0, 6.0, 7.0)
    add_instance(collection, "East", (5000.0, 0.0, 0.0), scene.collection)
    return terrain


def expected_places(terrain) -> list:
    """Return the matrices of the instances that Blender draws."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return sorted(
        np.array(item.matrix_world).round(2).tolist()
        for item in depsgraph.object_instances
        if item.object.original == terrain
    )


def found_places(terrain) -> list:
    depsgraph = bpy.context.evaluated_depsgraph_get()
    own = np.array(terrain.matrix_world, np.float64)
    return sorted((place @ own).round(2).tolist() for place in shown_places(terrain, depsgraph))


def test_places_are_those_that_blender_draws(land, scene):
    assert found_places(land) == expected_places(land) and len(found_places(land)) == 1
    outer = bpy.data.collections.new("Outer")
    add_instance(land.users_collection[0], "Inner", (0.0, 300.0, 0.0), outer)
    add_instance(outer, "Nested", (0.0, 0.0, 90.0), scene.collection)
    hidden = add_instance(outer, "Hidden", (0.0, 0.0, 0.0), scene.collection)
    hidden.hide_viewport = True
    assert found_places(land) == expected_places(land) and len(found_places(land)) == 2
    scene.collection.objects.link(land)
    bpy.context.view_layer.update()
    assert found_places(land) == expected_places(land) and len(found_places(land)) == 3


@pytest.mark.parametrize("others", [False, True])
def test_objects_are_not_searched_without_instances_of_terrains(scene, add_terrain, monkeypatch, others):
    terrain, trees = add_terrain(), bpy.data.collections.new("Trees")
    collection = bpy.data.collections.new("Land")
    collection.objects.link(terrain)
    for parent in scene.collection, bpy.data.collections.new("Parent"):
        parent.children.link(collection)
    collection.use_fake_user = True
    if others:
        trees.objects.link(bpy.data.objects.new("Tree", None))
        add_instance(trees, "Tree 2", (0.0, 0.0, 0.0), scene.collection)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    monkeypatch.setattr(instances, "_transforms", None)
    [place] = shown_places(terrain, depsgraph)
    assert (place == np.eye(4)).all()
    add_instance(bpy.data.collections["Parent"], "Parents", (0.0, 0.0, 0.0), scene.collection)
    with pytest.raises(TypeError):  # now they are
        shown_places(terrain, depsgraph)


def test_a_render_refines_a_terrain_that_only_an_instance_shows(land, scene):
    scene.camera.location.x = 5000.0
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
    scene.render.resolution_percentage = 10
    bpy.ops.render.render()
    [view] = session.record_of(land).status.request.views
    [place] = shown_places(land, bpy.context.evaluated_depsgraph_get())
    eye = np.linalg.inv(view.world_to_camera)[:3, 3]
    np.testing.assert_allclose(place @ [*eye, 1.0], [5000.0, -900.0, 400.0, 1.0], atol=1e-3)
    assert len(land.data.polygons) > 100
