# SPDX-License-Identifier: GPL-3.0-or-later
"""Freeze Detail: the same triangles for every camera, also of a file that was saved and opened again."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.mesh.archive import read_npz
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.operators.accuracy.panel import summary_lines
from adaptive_terrain.operators.export.frame_sources import scene_piece
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.terrain import frozen
from adaptive_terrain.operators.terrain.overrides import Overrides
from blender_meshes import positions
from rasters import hills, store_heights


@pytest.fixture
def terrain(scene, add_terrain):
    obj = add_terrain()
    session.update_object(obj)
    return obj


def freeze():
    assert bpy.ops.adaptive_terrain.freeze() == {"FINISHED"}


def look_from(y: float):
    bpy.context.scene.camera.location.y = y
    bpy.context.view_layer.update()


def test_a_frozen_mesh_keeps_its_triangles(terrain):
    before = positions(terrain)
    freeze()
    for y in (-2500.0, -400.0):
        look_from(y)
        update = session.update_object(terrain)
        assert (positions(terrain) == before).all()
    assert not update.changed, "a camera that moves costs nothing"
    freeze()
    assert not terrain.adaptive_terrain.frozen
    assert session.update_object(terrain).changed and len(positions(terrain)) != len(before)


def test_heights_still_follow_scale_and_offset(terrain):
    before = positions(terrain)
    freeze()
    terrain.adaptive_terrain.vertical_scale, terrain.adaptive_terrain.vertical_offset = 2.0, 8.0
    look_from(-2500.0)
    update = session.update_object(terrain)
    np.testing.assert_allclose(positions(terrain), before * [1, 1, 2] + [0, 0, 8], atol=1e-4)
    status = session.record_of(terrain).status
    assert update.bound_px is None and summary_lines(status)[1][0] == "Vertical error"


def test_renders_and_exports_keep_frozen_triangles(terrain):
    terrain.adaptive_terrain.render.error_px = 8.0
    depsgraph = bpy.context.evaluated_depsgraph_get()
    free = len(scene_piece(terrain, depsgraph, 1).surface.triangles)
    session.update_object(terrain)
    shown = len(terrain.data.polygons)
    freeze()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert len(scene_piece(terrain, depsgraph, 1).surface.triangles) == shown > free
    asked = scene_piece(terrain, depsgraph, 1, overrides=Overrides({"error_px": 8.0}))
    assert len(asked.surface.triangles) == free


@pytest.mark.parametrize("is_frozen", [False, True])
def test_an_export_has_the_tree_and_with_it_its_mesh(terrain, tmp_path, is_frozen):
    settings = terrain.adaptive_terrain
    settings.render.error_px, settings.render.meshlet, settings.vertical_offset = 8.0, 1, 3.0
    settings.render.smooth_transitions = False  # a tree has no camera for a geomorph
    if is_frozen:  # with the triangles of the viewport, which has no meshlets
        freeze()
        look_from(-2500.0)
    assert bpy.ops.adaptive_terrain.export(filepath=str(tmp_path / "a.npz")) == {"FINISHED"}
    file = read_npz(tmp_path / "a.npz")
    assert file["info"]["frozen"] is is_frozen and file["info"]["tree"]["meshlet"] == (0 if is_frozen else 1)
    again = Terrain(open_store(settings.store)).restore(file["tree"].tobytes(), **file["info"]["tree"])
    for name, array in again.surface.arrays().items():
        assert name.startswith("corner_") or (file[name] == array).all(), name
    assert (file["triangles"] == again.surface.triangles).all()


def test_it_survives_the_file(terrain, tmp_path):
    freeze()
    before, size = positions(terrain), len(terrain.adaptive_terrain.frozen)
    assert size < len(terrain.data.polygons), "less than a byte a triangle"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "frozen.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "frozen.blend"))
    look_from(-2500.0)
    again = bpy.data.objects["Terrain"]
    session.update_object(again)
    assert (positions(again) == before).all()


def test_frozen_triangles_of_other_heights_name_the_remedy(terrain, tmp_path):
    """The triangles of one square do not fit together on five, as after an import of a copy that shares the store."""
    freeze()
    terrain.adaptive_terrain.store = str(store_heights(tmp_path / "long", hills(600, 129), 10.0))
    with pytest.raises(TerrainError, match="belong to other heights: switch Freeze Detail off and on again"):
        session.update_object(terrain)
    freeze()
    freeze()
    assert session.update_object(terrain).triangles > 0


def test_invalid_frozen_triangles_are_refused(terrain):
    freeze()
    saved = terrain.adaptive_terrain.frozen
    for text in ("nonsense", "0 ####", f"9 {saved.split()[1]}", saved[: len(saved) // 2]):
        terrain.adaptive_terrain.frozen = text
        with pytest.raises(TerrainError, match="Freeze Detail|saved tree"):
            session.update_object(terrain)
    freeze()
    assert session.update_object(terrain).triangles > 0
    assert frozen.decode_tree(saved)[1] == 0
