# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain in Blender whose maps are baked into a separate folder."""

import bpy
import pytest
from adaptive_terrain.cbt_terrain.attributes.folder import read_index
from adaptive_terrain.operators.maps import images as map_images


@pytest.fixture
def terrain(scene, store, tmp_path, add_terrain):
    obj = add_terrain()
    obj.adaptive_terrain.maps.folder = str(tmp_path / "maps")
    bpy.context.view_layer.objects.active = obj
    return obj


def bake(obj) -> None:
    assert bpy.ops.adaptive_terrain.bake_maps() == {"FINISHED"}


def keys(obj) -> dict[str, str]:
    maps = read_index(map_images.map_folder(obj))["maps"]
    return {tile["file"]: tile["key"] for entry in maps.values() for tile in entry["tiles"]}
