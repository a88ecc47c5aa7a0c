# SPDX-License-Identifier: GPL-3.0-or-later
"""What is exported is the piece's own, undisturbed, and counted again before the file gets its name."""

import sys
from functools import partial
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators import handlers
from adaptive_terrain.operators.export import blender_exporters
from adaptive_terrain.operators.export.frame_sources import scene_piece
from adaptive_terrain.operators.export.read_back import BLOCK, count_triangles
from adaptive_terrain.operators.session import session
from blender_meshes import digest_alone
from mathutils import Vector
from mesh_files import read_mesh, read_ply_fields

FORMATS = ("ply", "obj", "stl", "glb", "usda")


@pytest.fixture
def terrain(scene, add_terrain):
    obj = add_terrain("Hills")
    obj.adaptive_terrain.viewport.error_px, obj.adaptive_terrain.render.error_px = 24.0, 8.0
    scene.frame_set(7)
    return obj


def export(path):
    return bpy.ops.adaptive_terrain.export(filepath=str(path))


@pytest.mark.parametrize("form", FORMATS)
def test_a_file_is_counted_as_another_reader_counts_it(terrain, tmp_path, form):
    path = tmp_path / f"hills.{form}"
    assert export(path) == {"FINISHED"}
    assert count_triangles(path) == len(read_mesh(path)[1]) > len(terrain.data.polygons)
    if form != "obj":  # whose head counts nothing
        data = path.read_bytes()
        for damaged in (data[:-1], data[: len(data) // 2], data[:30], b"", data + b"more"):
            path.write_bytes(damaged)
            with pytest.raises(ValueError):
                count_triangles(path)


@pytest.mark.parametrize("name", [f"{'n' * 300}/hills.ply", f"{'n' * 300}.ply"])
def test_a_path_that_is_too_long_is_one_error_with_a_fix(terrain, tmp_path, name):
    with pytest.raises(RuntimeError, match=r"a name of 30\d bytes; expected 255 at most: choose a shorter one"):
        export(tmp_path / name)


@pytest.mark.parametrize("form", ("ply", "obj", "stl"))
def test_faces_of_a_mirrored_terrain_point_up(terrain, tmp_path, form):
    terrain.scale.x = -terrain.scale.x
    bpy.context.view_layer.update()
    path = tmp_path / f"hills.{form}"
    assert export(path) == {"FINISHED"}
    vertices, triangles = read_mesh(path)
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    assert np.cross(b - a, c - a)[:, 2].min() > 0
    if form == "ply":
        assert read_ply_fields(path)["nz"].min() > 0


def test_a_sheared_terrain_is_in_its_place_or_not_written(terrain, tmp_path):
    """Turned, below a parent of uneven scale: a node of glTF has no such place, and Blender would write another."""
    parent = bpy.data.objects.new("Parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.scale, terrain.rotation_euler, terrain.parent = (3.0, 0.5, 1.0), (0.0, 0.0, 0.7), parent
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="'Hills' is sheared by its parent's scale, which a glb cannot hold"):
        export(tmp_path / "hills.glb")
    assert not list(tmp_path.glob("*.glb"))
    assert export(tmp_path / "hills.ply") == {"FINISHED"}
    far = np.abs(read_mesh(tmp_path / "hills.ply")[0][:, :2]).max(axis=0)
    corners = [terrain.matrix_world @ Vector(corner) for corner in terrain.bound_box]
    assert far == pytest.approx(np.abs(np.array(corners)[:, :2]).max(axis=0), rel=1e-5)
    parent.scale, terrain.scale = (2.0, 2.0, 2.0), (-1.0, 3.0, 0.01)  # neither is shear
    bpy.context.view_layer.update()
    assert export(tmp_path / "hills.glb") == {"FINISHED"}


def test_usd_files_have_the_place_and_the_attributes(terrain, tmp_path):
    """Turned below a parent of uneven scale, as ply; a file with a quadrangle or without an end is refused."""
    parent = bpy.data.objects.new("Parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.scale, terrain.rotation_euler, terrain.parent = (3.0, 0.5, 1.0), (0.0, 0.0, 0.7), parent
    bpy.context.view_layer.update()
    for form in ("ply", "usda"):
        assert export(tmp_path / f"hills.{form}") == {"FINISHED"}
    found = [read_mesh(tmp_path / f"hills.{form}") for form in ("ply", "usda")]
    a, b = (points[triangles] for points, triangles in found)
    assert np.allclose(a, b, atol=1e-5 * np.ptp(a))
    text = (tmp_path / "hills.usda").read_text()
    assert 'upAxis = "Z"' in text and "metersPerUnit = 1" in text and "primvars:terrain_level" in text
    (tmp_path / "bad.usda").write_text(text.replace("Counts = [3", "Counts = [4", 1))
    with pytest.raises(ValueError, match="no triangles"):
        count_triangles(tmp_path / "bad.usda")


def test_a_blender_without_usd_says_so(terrain, tmp_path, monkeypatch):
    without = SimpleNamespace(app=SimpleNamespace(build_options=SimpleNamespace(usd=False)))
    monkeypatch.setitem(sys.modules, "bpy", without)
    with pytest.raises(TerrainError, match="built without USD"):
        blender_exporters.export_usda(terrain, str(tmp_path / "hills.usda"))


def test_faces_at_the_ends_of_blocks_are_counted_once(tmp_path):
    path = tmp_path / "long.obj"
    for first in range(BLOCK - 5, BLOCK + 1):
        path.write_bytes(b"#" * first + b"\nf 1 2 3\nf 2 3 4\nvf \n")
        assert count_triangles(path) == 2


@pytest.mark.parametrize("form", FORMATS)
def test_another_mesh_than_the_summary_says_is_an_error(terrain, tmp_path, form, monkeypatch):
    """A handler of another extension rewrites the mesh while Blender exports it."""
    path, write = tmp_path / f"hills.{form}", getattr(blender_exporters, f"export_{form}")

    def disturbed(obj, name):
        terrain.data.clear_geometry()
        terrain.data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
        write(obj, name)

    monkeypatch.setattr(blender_exporters, f"export_{form}", disturbed)
    with pytest.raises(RuntimeError, match=f"hills.{form} would hold 1 triangles where the terrain 'Hills' has"):
        export(path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("cut", [False, True])
def test_an_update_leaves_the_surface_of_a_piece_alone(terrain, cut):
    terrain.adaptive_terrain.cleanup.use_below = cut
    piece = scene_piece(terrain, bpy.context.evaluated_depsgraph_get(), 7)
    before = {name: array.tobytes() for name, array in piece.surface.arrays().items()}
    session.update_object(terrain)
    assert len(terrain.data.polygons) < len(piece.surface.triangles), "the viewport's, by the same engine"
    assert {name: array.tobytes() for name, array in piece.surface.arrays().items()} == before


def test_no_handler_runs_while_blender_exports(terrain, tmp_path, monkeypatch):
    ran = []

    def to_another_frame(write, obj, name):
        bpy.context.scene.frame_set(3)
        write(obj, name)
        bpy.context.scene.frame_set(7)

    monkeypatch.setattr(handlers, "update_all", lambda *_: ran.append(1) or [])
    for form in FORMATS:
        name = f"export_{form}"
        monkeypatch.setattr(blender_exporters, name, partial(to_another_frame, getattr(blender_exporters, name)))
        assert export(tmp_path / f"hills.{form}") == {"FINISHED"}
    assert not ran
    bpy.context.scene.frame_set(4)
    assert ran, "afterwards they run again"


@pytest.mark.parametrize("form", FORMATS)
def test_modifiers_are_left_out_of_every_format(terrain, tmp_path, form):
    """The bound is that of the terrain's own mesh."""
    export(tmp_path / f"plain.{form}")
    terrain.modifiers.new("Finer", "SUBSURF").levels = 1
    assert export(tmp_path / f"modified.{form}") == {"FINISHED"}
    plain, modified = (read_mesh(tmp_path / f"{name}.{form}") for name in ("plain", "modified"))
    assert np.array_equal(plain[0], modified[0]) and np.array_equal(plain[1], modified[1])


def test_a_terrain_that_cannot_be_selected_is_refused(terrain, tmp_path):
    terrain.hide_select, shown = True, digest_alone(terrain)
    with pytest.raises(RuntimeError, match="'Hills' cannot be selected, .*: make it selectable"):
        export(tmp_path / "hills.stl")
    assert list(tmp_path.iterdir()) == [] and digest_alone(terrain) == shown, "the viewport gets its mesh back"
