# SPDX-License-Identifier: GPL-3.0-or-later
"""Random node trees: attributes without demand are never computed, and do not change pictures and geometry."""

import os
import random

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.operators.bridge.demand.demand import find_demand
from adaptive_terrain.operators.session import session
from blender_meshes import positions
from random_trees import NAMES, geometry_scene, geometry_tree, picture_scene, shader_tree, write
from rendered_pictures import rendered

FUZZ = int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0"))
COUNTED, PICTURES, GEOMETRIES = (500, 500, 500) if FUZZ >= 10_000 else (70, 6, 20)


def asked(found, names):
    return [name for name in names if name in found or "*" in found]


def look(obj, mode):
    return find_demand(obj, bpy.context.evaluated_depsgraph_get(), mode)


def test_attributes_without_demand_run_zero_times(scene, add_terrain):
    """Half of the trees are materials and half geometry nodes; they read random names, including all effects."""
    terrain = add_terrain()
    terrain.adaptive_terrain.viewport.error_px = 50.0
    names = [*ATTRIBUTES, "uv_of_others", "mine"]
    material = bpy.data.materials.new("M")
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    terrain.data.materials.append(material)
    session.update_object(terrain)
    never, demanded = 0, 0
    for number in range(COUNTED):
        source = random.Random(number)
        terrain.modifiers.clear()
        material.node_tree.nodes.clear()
        for tree in list(bpy.data.node_groups):
            bpy.data.node_groups.remove(tree)
        if number % 2:
            shader_tree(material, source, names)
        else:
            geometry_tree(terrain, source, names)
        record = session.record_of(terrain)
        record.effects_runs.clear()
        session.update_object(terrain)
        found = asked(look(terrain, "VIEWPORT"), ATTRIBUTES)
        steps = {name for name, output in record.status.effects.items() if not output.skipped}
        inputs = {name for name in steps if all(r.startswith("effect ") for r in record.status.effects[name].readers)}
        assert set(+record.effects_runs) <= steps and steps - inputs == set(found), number
        assert {name for name in ATTRIBUTES if name in terrain.data.attributes} == set(found), number
        never += len(ATTRIBUTES) - len(steps)
        demanded += len(found)
    assert never > COUNTED and demanded > COUNTED / 2, "both are seen often"


@pytest.mark.parametrize("seed", range(PICTURES))
def test_a_picture_is_the_same_without_what_is_not_demanded(empty, seed, tmp_path):
    obj, material = picture_scene()
    shader_tree(material, random.Random(seed), NAMES)
    names = asked(look(obj, "RENDER"), NAMES)
    write(obj.data, NAMES)
    everything = rendered(tmp_path / "all.exr", 2)
    write(obj.data, names)
    assert np.array_equal(rendered(tmp_path / "some.exr", 2), everything, equal_nan=True), names


def test_pictures_show_what_is_demanded(empty, tmp_path):
    """Each demanded attribute changes the picture, or the test above would pass for any demand."""
    shown, demanded = 0, 0
    for seed in range(12 if FUZZ >= 10_000 else 5):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        obj, material = picture_scene()
        shader_tree(material, random.Random(seed), NAMES)
        names = asked(look(obj, "RENDER"), NAMES)
        write(obj.data, names)
        everything = rendered(tmp_path / "all.exr", 2)
        for name in names:
            write(obj.data, [other for other in names if other != name])
            shown += not np.array_equal(rendered(tmp_path / "some.exr", 2), everything, equal_nan=True)
            demanded += 1
    assert demanded > 3 and shown > 0.8 * demanded, (shown, demanded)


@pytest.mark.parametrize("seed", range(GEOMETRIES))
def test_geometry_is_the_same_without_what_is_not_demanded(empty, seed):
    obj = geometry_scene()
    geometry_tree(obj, random.Random(seed), NAMES)
    names = asked(look(obj, "VIEWPORT"), NAMES)

    def shown(given):
        write(obj.data, given)
        return positions(obj.evaluated_get(bpy.context.evaluated_depsgraph_get()))

    assert np.array_equal(shown(NAMES), shown(names), equal_nan=True), names
