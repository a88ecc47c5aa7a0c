# SPDX-License-Identifier: GPL-3.0-or-later
"""Terrain from File, and the menu with every operator."""

import re

import bpy
import pytest
from adaptive_terrain.cbt_terrain.importing.source_formats import FORMATS
from adaptive_terrain.operators.farm.outside_files import HEIGHT_MAP_SUFFIXES
from adaptive_terrain.operators.importing import menus
from adaptive_terrain.operators.importing.imported import imported_of
from adaptive_terrain.operators.ui.object_menu import OPERATORS
from rasters import hills, write_raster

# A row of a list, an internal step, or the answer to a click.
NOT_IN_MENU = re.compile(
    "cancel_job|import_added|land_(add|duplicate|move|preset|preset_add|remove|rule_add)|layer_.*|offer_pack|pick_ground|"
    "shape_finish|show_(effect|message)"
)


def test_a_file_becomes_a_terrain(scene, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    file = write_raster(tmp_path / "dem.png", (hills() * 50).astype("uint16"))
    assert bpy.ops.mesh.adaptive_terrain_from_file(filepath=str(file)) == {"FINISHED"}
    terrain = bpy.context.object
    assert terrain.name == "dem" and terrain.select_get() and scene.render.use_lock_interface
    assert imported_of(terrain.adaptive_terrain).heights_m == pytest.approx((0.0, 39 / 4), abs=1e-4)
    assert len(terrain.data.polygons) > 2
    arguments = {"filepath": str(file), "use_heights": True, "lowest": 100.0, "highest": 130.0}
    bpy.ops.mesh.adaptive_terrain_from_file(**arguments)
    settings = bpy.context.object.adaptive_terrain
    assert imported_of(settings).heights_m == pytest.approx((100.0, 130.0), abs=1e-3)


@pytest.mark.parametrize("path", ["", "/nowhere/a.tif"])
def test_a_missing_file_leaves_no_object(scene, path):
    with pytest.raises(RuntimeError):
        bpy.ops.mesh.adaptive_terrain_from_file(filepath=path)
    assert [item.name for item in scene.objects] == ["Camera"] and not bpy.data.meshes


def test_every_format_can_be_dropped(scene):
    assert bpy.types.FileHandler.bl_rna_get_subclass_py("ADAPTIVE_TERRAIN_FH_height_map") is menus.HeightMapDropped
    assert menus.HeightMapDropped.bl_file_extensions.split(";") == list(FORMATS)
    assert {".tif", ".r16", ".nc", ".laz", ".zip"} <= set(FORMATS) <= HEIGHT_MAP_SUFFIXES
    offered = bpy.ops.mesh.adaptive_terrain_from_file.get_rna_type().properties["filter_glob"].default
    assert offered.split(";") == [f"*{suffix}" for suffix in FORMATS]


def test_the_object_menu_has_every_operator(scene):
    listed = {name for names in OPERATORS for name in names}
    every = {name for name in dir(bpy.ops.adaptive_terrain) if not NOT_IN_MENU.fullmatch(name)}
    assert listed == every
