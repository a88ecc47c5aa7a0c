# SPDX-License-Identifier: GPL-3.0-or-later
"""The mesh writer writes its arrays unchanged, and Blender finds nothing to correct."""

import tracemalloc

import bpy
import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.mesh.attributes import LEVEL, Attribute
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.run.buffers import shared
from adaptive_terrain.operators.bridge import memory as mesh_memory
from adaptive_terrain.operators.bridge.cleanup import Cleanup, clean_up, plan_triangles
from adaptive_terrain.operators.bridge.writer import UV_LAYER, write_mesh
from blender_meshes import read
from demand_trees import new_object


def test_the_mesh_holds_the_arrays(mesh, grid_surface):
    surface = grid_surface(5, 3)
    write_mesh(mesh, surface)
    assert (read(mesh.vertices, "co", 3) == surface.positions).all()
    assert (read(mesh.loops, "vertex_index", 1, np.int32) == surface.corner_verts).all()
    assert (read(mesh.loops, "edge_index", 1, np.int32) == surface.corner_edges).all()
    assert (read(mesh.edges, "vertices", 2, np.int32) == surface.edges).all()
    assert (read(mesh.polygons, "loop_start", 1, np.int32) == np.arange(0, 90, 3)).all()
    assert (read(mesh.attributes[LEVEL].data, "value", 1, np.int32) == surface.level).all()
    assert (read(mesh.uv_layers[UV_LAYER].uv, "vector", 2) == surface.uv[surface.corner_verts]).all()
    assert mesh.uv_layers.active.name == UV_LAYER


def test_validate_finds_nothing_to_change(mesh, grid_surface):
    for size in (4, 9, 2):
        write_mesh(mesh, grid_surface(size, size))
        assert mesh.validate(verbose=True) is False


def test_normals_are_those_of_the_surface(mesh, grid_surface):
    surface = grid_surface(4, 4)
    write_mesh(mesh, surface)
    assert mesh.has_custom_normals
    # Versions before 4.5 keep normals in two 16-bit numbers.
    np.testing.assert_allclose(read(mesh.corner_normals, "vector", 3), surface.normals[surface.corner_verts], atol=2e-4)


def test_flat_shading_has_face_normals(mesh, grid_surface):
    write_mesh(mesh, grid_surface(3, 3, lambda x, y: x * y), smooth=False)
    assert not mesh.has_custom_normals
    np.testing.assert_allclose(
        read(mesh.corner_normals, "vector", 3), np.repeat(read(mesh.polygon_normals, "vector", 3), 3, 0), atol=1e-6
    )
    write_mesh(mesh, grid_surface(3, 3))
    assert mesh.has_custom_normals and "sharp_face" not in mesh.attributes


def test_materials_stay(mesh, grid_surface):
    rock = bpy.data.materials.new("Rock")
    mesh.materials.append(rock)
    write_mesh(mesh, grid_surface(3, 3))
    write_mesh(mesh, grid_surface(5, 2))
    assert [material.name for material in mesh.materials] == [rock.name]
    bpy.data.materials.remove(rock)


def test_an_empty_surface_empties_the_mesh(mesh, grid_surface):
    write_mesh(mesh, grid_surface(2, 2))
    write_mesh(mesh, grid_surface(0, 0))
    assert len(mesh.polygons) == 0 and mesh.validate() is False


def test_a_mesh_with_shape_keys_is_refused_and_stays(grid_surface):
    mesh = bpy.data.meshes.new("Keyed")
    write_mesh(mesh, grid_surface(2, 2))
    obj = bpy.data.objects.new("Keyed", mesh)
    obj.shape_key_add(name="Basis")
    with pytest.raises(TerrainError, match="shape keys"):
        write_mesh(mesh, grid_surface(3, 3))
    assert len(mesh.vertices) == 9
    bpy.data.objects.remove(obj)
    bpy.data.meshes.remove(mesh)


def test_what_is_below_a_height_is_cut_away_at_that_height(mesh, grid_surface):
    surface = grid_surface(6, 2, lambda x, y: x)
    surface.normals[:, 0] = surface.positions[:, 0] / 10
    surface.normals[:, 2] = np.sqrt(1 - surface.normals[:, 0] ** 2)
    left = clean_up(surface, Cleanup(below=2.5))
    write_mesh(mesh, left)
    positions = read(mesh.vertices, "co", 3)
    assert positions[:, 0].min() == positions[:, 2].min() == 2.5
    assert (positions[:, 2] == 2.5).sum() == 3 + 2, "two sides of squares, a diagonal each"
    assert mesh.validate(verbose=True) is False
    assert sum(face.area for face in mesh.polygons) == pytest.approx(3.5 * 2 * 2**0.5)
    corners = read(mesh.loops, "vertex_index", 1, np.int32)
    np.testing.assert_allclose(read(mesh.corner_normals, "vector", 3)[:, 0], positions[corners, 0] / 10, atol=2e-3)


def test_nothing_is_left_below_a_height_above_all(mesh, grid_surface):
    left = clean_up(grid_surface(4, 3), Cleanup(below=1e5))
    write_mesh(mesh, left)
    assert not len(mesh.vertices) and not len(mesh.edges) and mesh.validate() is False


def test_what_is_outside_of_a_boundary_object_is_cut_away(mesh, grid_surface):
    boundary = new_object("Boundary", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    boundary.location = (103.0, 2.0, 50.0)
    bpy.context.view_layer.update()
    terrain_from_world = np.eye(4)
    terrain_from_world[0, 3] = -100.0
    triangles = plan_triangles(boundary, boundary.matrix_world, terrain_from_world, "boundary")
    assert triangles.shape == (2, 3, 2)
    write_mesh(mesh, clean_up(grid_surface(6, 4), Cleanup(boundary=triangles)))
    positions = read(mesh.vertices, "co", 3)
    assert len(mesh.polygons) == 8
    assert (positions[:, :2].min(0) == (2, 1)).all() and (positions[:, :2].max(0) == (4, 3)).all()
    assert mesh.validate(verbose=True) is False
    bpy.data.meshes.remove(boundary.data)  # and the object with it


def test_a_hundred_rebuilds_leave_no_datablock(mesh, grid_surface):
    before = len(bpy.data.meshes)
    for size in range(100):
        write_mesh(mesh, grid_surface(size % 7, 3))
    assert len(bpy.data.meshes) == before


def test_every_tested_version_writes_arrays_in_place():
    assert mesh_memory.writable_in_place()
    assert ".adaptive_terrain_probe" not in bpy.data.meshes


def test_a_blender_whose_memory_differs_gets_the_same_mesh(mesh, grid_surface, monkeypatch):
    monkeypatch.setattr(mesh_memory, "writable_in_place", lambda: False)
    test_the_mesh_holds_the_arrays(mesh, grid_surface)
    assert mesh.validate(verbose=True) is False


def test_two_threads_write_the_same_mesh(mesh, grid_surface, monkeypatch):
    monkeypatch.setattr(launch, "default_threads", lambda: 2)
    surface = grid_surface(170, 150)
    assert len(surface.triangles) > 2 * launch.SLICE_ITEMS
    for in_place in (True, False):
        monkeypatch.setattr(mesh_memory, "writable_in_place", lambda in_place=in_place: in_place)
        write_mesh(mesh, surface)
        assert (read(mesh.uv_layers[UV_LAYER].uv, "vector", 2) == surface.uv[surface.corner_verts]).all()
        assert (read(mesh.polygons, "loop_start", 1, np.int32) == 3 * np.arange(len(surface.triangles))).all()
        assert mesh.validate(verbose=True) is False


def test_the_copy_that_blender_evaluated_keeps_its_arrays(mesh, grid_surface):
    """Blender shares arrays between a mesh and its evaluated copy: writing in place must not reach the copy."""
    obj = bpy.data.objects.new("Terrain", mesh)
    bpy.context.collection.objects.link(obj)
    surface = grid_surface(5, 3)
    write_mesh(mesh, surface)
    bpy.context.view_layer.update()
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    before = read(evaluated.uv_layers[UV_LAYER].uv, "vector", 2)
    surface = surface.with_attributes({"uv": Attribute(surface.uv + 1, "POINT")})
    write_mesh(mesh, surface)
    assert (read(evaluated.uv_layers[UV_LAYER].uv, "vector", 2) == before).all()
    assert (read(evaluated.polygons, "loop_start", 1, np.int32) == np.arange(0, 90, 3)).all()
    bpy.context.view_layer.update()
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    assert (read(evaluated.uv_layers[UV_LAYER].uv, "vector", 2) == before + 1).all()
    bpy.data.objects.remove(obj)


def test_the_probe_writes_only_where_it_reads_its_values(monkeypatch):
    elsewhere = np.full(6, 7, np.int32)
    monkeypatch.setattr(mesh_memory, "_array_over", lambda items, dtype: shared(elsewhere[: len(items)], wp.int32))
    mesh_memory.writable_in_place.cache_clear()
    assert mesh_memory.writable_in_place() is False
    assert (elsewhere == 7).all()
    mesh_memory.writable_in_place.cache_clear()


def test_items_with_gaps_between_them_are_no_array():
    class Item:
        def __init__(self, address):
            self.as_pointer = lambda: address

    assert mesh_memory._array_over([Item(1000 + 12 * i) for i in range(5)], wp.int32) is None
    assert mesh_memory._array_over([], wp.int32) is None


def test_a_warm_write_makes_no_array_as_large_as_the_mesh(mesh, grid_surface):
    surface = grid_surface(60, 60)
    write_mesh(mesh, surface)
    tracemalloc.start()
    try:
        write_mesh(mesh, surface)
        assert tracemalloc.get_traced_memory()[1] < len(surface.triangles)
    finally:
        tracemalloc.stop()
