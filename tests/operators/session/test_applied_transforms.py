# SPDX-License-Identifier: GPL-3.0-or-later
"""Apply and Set Origin of a terrain are taken back, because its mesh is computed anew; its ground stays in place."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.session import session
from blender_meshes import positions
from mathutils import Matrix, Vector

KEEPS = "Terrain keeps its transform and its origin"
EDITED = "The mesh of Terrain was edited"


@pytest.fixture
def placed(scene, add_terrain):
    """Add a terrain that is moved, turned and stretched, with two children: an empty and an object of its space."""
    terrain = add_terrain()
    terrain.location, terrain.rotation_euler, terrain.scale = (30.0, -20.0, 5.0), (0.0, 0.1, 0.4), (1.5, 1.5, 2.0)
    for name in ("Empty", "Water"):
        child = bpy.data.objects.new(name, None)
        scene.collection.objects.link(child)
        child.parent = terrain
    bpy.data.objects["Empty"].location = (100.0, 50.0, 10.0)
    scene.frame_set(2)
    terrain.select_set(True)
    return terrain


def state(terrain) -> np.ndarray:
    """Return the mesh's box in the world and the matrices of the children, rounded to millimetres."""
    bpy.context.view_layer.update()
    placement = np.array(terrain.matrix_world)
    points = positions(terrain) @ placement[:3, :3].T + placement[:3, 3]
    matrices = [np.array(child.matrix_world).ravel() for child in terrain.children]
    return np.concatenate([points.min(axis=0), points.max(axis=0), *matrices])


OPERATIONS = [
    lambda: bpy.ops.object.transform_apply(),
    lambda: bpy.ops.object.transform_apply(location=False, rotation=False),
    lambda: bpy.ops.object.origin_set(type="ORIGIN_GEOMETRY"),
]


@pytest.mark.parametrize("operation", OPERATIONS)
def test_applied_transforms_are_restored(placed, scene, operation, capsys):
    before, basis = state(placed), np.array(placed.matrix_basis)
    assert operation() == {"FINISHED"}
    np.testing.assert_allclose(state(placed), before, atol=2e-3)
    scene.frame_set(3)
    np.testing.assert_allclose(state(placed), before, atol=2e-3)
    np.testing.assert_allclose(placed.matrix_basis, basis, atol=1e-6)
    water = bpy.data.objects["Water"]
    assert water.matrix_basis == water.matrix_parent_inverse == Matrix()
    assert capsys.readouterr().out.count(KEEPS) == 1


def test_a_transform_applied_in_an_opened_file_is_restored(placed, tmp_path):
    before = state(placed)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "placed.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "placed.blend"))
    assert bpy.ops.object.transform_apply() == {"FINISHED"}
    np.testing.assert_allclose(state(bpy.data.objects["Terrain"]), before, atol=2e-3)


def test_redo_of_an_applied_transform_is_restored(placed, scene, capsys):
    bpy.ops.ed.undo_push(message="placed")
    before = state(placed)
    bpy.ops.object.transform_apply("EXEC_DEFAULT", True)  # pushes a step before the transform is restored
    scene.frame_set(4)
    placed.location.x += 1.0
    placed.adaptive_terrain.viewport.error_px = 5.0
    scene.frame_set(4)
    bpy.ops.ed.undo_push(message="move")
    bpy.ops.ed.undo()
    bpy.ops.ed.undo()
    bpy.ops.ed.redo()
    bpy.context.view_layer.update()
    assert capsys.readouterr().out.count(KEEPS) == 3, "Undo came by it, too"
    np.testing.assert_allclose(state(bpy.data.objects["Terrain"]), before, atol=2e-3)


def test_moved_vertices_are_written_again_in_the_same_view(placed, scene, capsys):
    before = state(placed)
    assert bpy.ops.object.origin_set(type="GEOMETRY_ORIGIN") == {"FINISHED"}
    assert np.abs(state(placed) - before).max() > 1.0
    session.update_object(placed)
    np.testing.assert_allclose(state(placed), before, atol=1e-6)
    assert KEEPS not in capsys.readouterr().out


def test_an_ordinary_move_is_not_taken_back(placed, capsys):
    placed.location.x += 10.0
    placed.scale = (3.0, 3.0, 3.0)
    bpy.context.view_layer.update()
    assert placed.location == Vector((40.0, -20.0, 5.0)) and KEEPS not in capsys.readouterr().out


def test_a_joined_object_is_reported_before_it_is_replaced(placed, scene, capsys):
    before, faces = state(placed), len(placed.data.polygons)
    bpy.ops.mesh.primitive_cube_add(size=50.0)
    placed.select_set(True)
    bpy.context.view_layer.objects.active = placed
    assert bpy.ops.object.join() == {"FINISHED"}
    bpy.context.view_layer.update()
    assert capsys.readouterr().out.count(EDITED) == 1 and len(placed.data.polygons) == faces + 6
    scene.frame_set(3)
    np.testing.assert_allclose(state(placed), before, atol=1e-6)
    assert EDITED not in capsys.readouterr().out


def test_undo_to_an_unknown_mesh_is_no_edit(placed, scene, capsys):
    bpy.ops.ed.undo_push(message="coarse")
    for number in range(40):
        placed.adaptive_terrain.viewport.error_px = 2.0 + number / 10
        scene.frame_set(2)
    bpy.ops.ed.undo_push(message="fine")
    bpy.ops.ed.undo()
    bpy.context.view_layer.update()
    bpy.context.scene.frame_set(3)
    assert EDITED not in capsys.readouterr().out
