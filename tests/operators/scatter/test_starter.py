# SPDX-License-Identifier: GPL-3.0-or-later
"""The starter collection: sizes, triangles and materials of its objects, and its place in the file."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.scatter import starter
from adaptive_terrain.operators.scatter.operators import new_scatter
from adaptive_terrain.operators.scatter.panel import ScatterPanel
from adaptive_terrain.operators.scatter.starter import KINDS, ROOT
from adaptive_terrain.operators.session import session
from blender_meshes import positions, read, values_of

# Height in metres of the first object of a kind, or, of rocks, their largest and smallest extent; and its materials.
HEIGHTS = {"Conifers": 18.0, "Broadleaves": 12.0, "Bushes": 1.5, "Grass": 0.4}
MATERIALS = {
    "Conifers": {"Bark", "Needles"},
    "Broadleaves": {"Bark", "Leaves"},
    "Bushes": {"Leaves"},
    "Grass": {"Grass"},
    "Rocks": {"Stone"},
}


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Return the folder where the first test that builds a kind leaves its objects."""
    return tmp_path_factory.mktemp("starter")


@pytest.fixture(autouse=True)
def built_once(library, monkeypatch):
    """Build the objects of each kind once, since their trees of hundreds of nodes take a second; then load them."""
    build = starter._build

    def build_or_load(context, kind, materials):
        path = str(library / f"{kind}.blend")
        if not (library / f"{kind}.blend").exists():
            objects = build(context, kind, materials)
            bpy.data.libraries.write(path, set(objects))
            return objects
        with bpy.data.libraries.load(path) as (there, here):
            here.objects = there.objects
        for mesh in (obj.data for obj in here.objects):
            for number, material in enumerate(list(mesh.materials)):
                mesh.materials[number] = materials[material.name.partition(".")[0]]
        for material in [m for m in bpy.data.materials if m not in materials.values()]:
            bpy.data.materials.remove(material)
        return here.objects

    monkeypatch.setattr(starter, "_build", build_or_load)


def add(kind="CONIFERS"):
    assert bpy.ops.adaptive_terrain.starter_add(kind=kind) == {"FINISHED"}


def test_starter_objects_have_real_sizes(empty):
    add()
    for name, height in HEIGHTS.items():
        tallest = max(positions(obj)[:, 2].max() for obj in bpy.data.collections[name].objects)
        assert tallest == pytest.approx(height, rel=0.1), name
    extents = [np.ptp(positions(obj), axis=0).max() for obj in bpy.data.collections["Rocks"].objects]
    assert max(extents) == pytest.approx(2.0, rel=0.2) and min(extents) == pytest.approx(0.3, rel=0.2)
    assert {collection.name for collection in bpy.data.collections[ROOT].children} == {*HEIGHTS, "Rocks"}


def test_starter_objects_are_light_and_stand_in_the_ground(empty):
    add()
    for name, expected in MATERIALS.items():
        objects = bpy.data.collections[name].objects
        assert len({tuple(positions(obj)[-1]) for obj in objects}) == len(objects) >= 3, "all differ"
        for obj in objects:
            mesh = obj.data
            mesh.calc_loop_triangles()
            assert 200 < len(mesh.loop_triangles) < 2000 and not obj.modifiers
            assert -0.35 * np.ptp(positions(obj)[:, 2]) < positions(obj)[:, 2].min() < 0.0
            assert {material.name for material in mesh.materials} == expected
            used = read(mesh.polygons, "material_index", 1, np.int32)
            assert set(used.tolist()) == set(range(len(expected)))
            shade = values_of(mesh, "shade")
            assert np.isfinite(shade).all() and np.ptp(shade) > 0.2


def test_starter_collections_are_added_once_and_excluded(empty):
    add()
    before = len(bpy.data.objects), len(bpy.data.materials), len(bpy.data.meshes), len(bpy.data.node_groups)
    bpy.data.collections["Rocks"].name = "Boulders"
    add("ROCKS")
    after = len(bpy.data.objects), len(bpy.data.materials), len(bpy.data.meshes), len(bpy.data.node_groups)
    assert after == before == (16, 5, 16, 0)
    assert bpy.context.view_layer.layer_collection.children[ROOT].exclude
    assert not bpy.context.scene.collection.objects[:]
    bpy.data.collections.remove(bpy.data.collections["Bushes"])
    add("BUSHES")
    assert len(bpy.data.collections["Bushes"].objects) == 3 and "Conifers.001" not in bpy.data.collections


def test_a_kind_is_put_on_the_active_scatter(scene, add_terrain):
    """Its instances are shown, although the view layer excludes their collection, and have the objects' height."""
    terrain = add_terrain()
    scatter = new_scatter(terrain, 12.0)
    bpy.context.view_layer.objects.active = scatter
    add("CONIFERS")
    settings = scatter.adaptive_scatter
    assert settings.collection == bpy.data.collections["Conifers"] and 4.0 < settings.spacing < 8.0
    session.update_object(terrain)
    names, sizes = set(), []
    for item in bpy.context.evaluated_depsgraph_get().object_instances:
        if item.is_instance and item.parent.original == scatter:
            names.add(item.object.name)
            sizes.append(np.linalg.norm(np.array(item.matrix_world)[:3, 2]))
    assert names == {"Conifer 1", "Conifer 2", "Conifer 3"} and len(sizes) == len(scatter.data.vertices) > 1000
    assert 1.1 < max(sizes) <= 1.2 + 1e-5


@pytest.mark.parametrize("kind", ["GRASS", "ROCKS"])
def test_the_panel_offers_the_starter_until_one_is_chosen(scene, add_terrain, kind):
    scatter = new_scatter(add_terrain(), 12.0)

    def offered():
        shown = MagicMock()
        context = SimpleNamespace(object=scatter, scene=scene, space_data=None)
        ScatterPanel.draw(SimpleNamespace(layout=shown), context)
        return [call.args for call in shown.column().operator_menu_enum.call_args_list]

    assert offered() == [("adaptive_terrain.starter_add", "kind")]
    bpy.context.view_layer.objects.active = scatter
    add(kind)
    assert offered() == [] and scatter.adaptive_scatter.collection.name == KINDS[kind][0]


def test_add_scatter_puts_a_kind_on_its_ground(scene, add_terrain):
    """Trees keep off steep slopes and make woods; with rules they stand closer at no greater number."""
    terrain = add_terrain()
    bpy.context.view_layer.objects.active = terrain
    assert bpy.ops.adaptive_terrain.scatter_add(kind="CONIFERS") == {"FINISHED"}
    scatter = bpy.context.object
    where = scatter.adaptive_scatter.where
    assert scatter.adaptive_scatter.collection == bpy.data.collections["Conifers"]
    assert where.slope.use and where.noise.use and not where.relief.use, "low land has no tree line"
    assert scatter.adaptive_scatter.full_until == pytest.approx(140 * scatter.adaptive_scatter.spacing)
    points = len(scatter.data.vertices)
    where.slope.use = where.noise.use = False
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert 0.1 < points / len(scatter.data.vertices) < 0.7
    bpy.context.view_layer.objects.active = terrain
    bpy.ops.adaptive_terrain.scatter_add(kind="ROCKS")
    assert not bpy.context.object.adaptive_scatter.where.slope.use


def test_rules_of_the_user_stay(scene, add_terrain):
    scatter = new_scatter(add_terrain(), 12.0)
    height = scatter.adaptive_scatter.where.height
    height.use, height.high = True, 50.0
    bpy.context.view_layer.objects.active = scatter
    add("BROADLEAVES")
    assert not scatter.adaptive_scatter.where.slope.use and height.high == 50.0
