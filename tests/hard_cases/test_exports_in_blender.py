# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 61: different viewport and render settings, frames other than 0, every format in every order."""

import json
import os
import random
from collections import Counter

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.terrain.request import RENDER
from blender_meshes import read
from mesh_files import read_mesh
from store_exports import run

FORMATS = ("npz", "ply", "obj", "glb", "stl", "blend")
FRAMES = (3, 8)
# Six permutations in which each format follows every other exactly once (a row-complete Latin square).
ORDERS = [[FORMATS[(step + turn) % 6] for step in (0, 5, 1, 4, 2, 3)] for turn in range(6)]
MORE = random.Random(61)  # `make fuzz` draws more of the 720 orders
ORDERS += [MORE.sample(FORMATS, 6) for _ in range(int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) // 500)]


@pytest.fixture(scope="module")
def expected():
    return {}


@pytest.fixture
def saved(flight, add_terrain, tmp_path, expected):
    """Save two terrains and a flying camera; one terrain is rotated, stretched and parented to an animated object."""
    rig = flight.camera.parent
    for name in ("Near", "Far"):
        terrain = add_terrain(name)
        terrain.adaptive_terrain.viewport.error_px, terrain.adaptive_terrain.render.error_px = 24.0, 8.0
    terrain.parent, terrain.rotation_euler = rig, (0.1, -0.2, 0.7)
    terrain.location, terrain.scale = (200.0, 900.0, 30.0), (0.6, 0.9, 1.3)
    path = tmp_path / "scene.blend"
    flight.frame_set(5)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    if not expected:
        for frame in FRAMES:
            flight.frame_set(frame)
            for obj in (flight.objects["Near"], flight.objects["Far"]):
                coarse = len(obj.data.polygons)
                session.update_object(obj, bpy.context.evaluated_depsgraph_get(), RENDER)
                assert len(obj.data.polygons) > 2 * coarse > 100
                expected[obj.name, frame] = mesh_of(obj.data), np.array(obj.matrix_world)
    return path


def mesh_of(mesh):
    """Return vertices and triangles of a Blender mesh in local space."""
    points, corners = read(mesh.vertices, "co", 3), read(mesh.loops, "vertex_index", 1, np.int32)
    return points.astype(np.float64), corners.reshape(-1, 3).astype(np.int64)


def read_blend(path, name):
    with bpy.data.libraries.load(str(path), link=False) as (_there, here):
        here.meshes = [name]
    [mesh] = here.meshes
    found = mesh_of(mesh)
    bpy.data.meshes.remove(mesh)
    return found


def assert_sheet(points, triangles):
    """Assert that every edge belongs to one or two triangles and that no two vertices coincide."""
    assert len(np.unique(points, axis=0)) == len(points)
    assert set(np.unique(triangles)) == set(range(len(points)))
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, 1)], -1).reshape(-1, 2), 1)
    assert set(np.unique(edges, axis=0, return_counts=True)[1]) == {1, 2}


@pytest.mark.parametrize(
    "order", [*ORDERS[:2], *(pytest.param(order, marks=pytest.mark.thorough) for order in ORDERS[2:])], ids="-".join
)
def test_case_61_every_format_in_every_order(order, saved, expected, tmp_path, capfd):
    """Every file of every frame holds the render's mesh, whatever formats and frames came before."""
    out = tmp_path / "out"
    argv = "--scene", saved, "--frames", "8,3", "--format", ",".join(order), "--out", out
    assert run("export", *argv) == 0, capfd.readouterr().err
    for (name, frame), ((points, triangles), place) in expected.items():
        summary = json.loads((out / f"frame_{frame:04d}.json").read_text())
        assert Counter(path.rsplit(".", 1)[1] for path in summary["files"]) == {f: 2 - (f == "blend") for f in order}
        [figures] = [terrain for terrain in summary["terrains"] if terrain["name"] == name]
        assert (figures["vertices"], figures["triangles"]) == (len(points), len(triangles))
        world = points @ place[:3, :3].T + place[:3, 3]
        size = np.ptp(world, axis=0).max()
        for form in order:
            if form == "blend":
                found, corners = read_blend(out / f"scene_{frame:04d}.blend", name)
            else:
                found, corners = read_mesh(out / f"{name}_{frame:04d}.{form}")
            wanted = points if form in ("npz", "blend") else world
            assert len(corners) == len(triangles), form
            assert np.allclose(found.min(0), wanted.min(0), atol=1e-5 * size), form
            assert np.allclose(found.max(0), wanted.max(0), atol=1e-5 * size), form
            assert np.allclose(found[corners], wanted[triangles], atol=1e-5 * size), form
            if form == "stl":
                found, inverse = np.unique(found, axis=0, return_inverse=True)
                corners = inverse.reshape(-1)[corners]
            assert_sheet(found, corners)
