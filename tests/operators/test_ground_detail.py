# SPDX-License-Identifier: GPL-3.0-or-later
"""Detail below the raster's cells, asked for on the terrain."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.scene import session
from adaptive_terrain.operators.scene.ground_properties import ground_of


def positions(obj) -> bytes:
    array = np.empty(3 * len(obj.data.vertices), np.float32)
    obj.data.vertices.foreach_get("co", array)
    return array.tobytes()


def test_an_amplitude_adds_detail_and_none_takes_it_away(scene, add_terrain):
    obj = add_terrain()
    plain = session.update_object(obj)
    before = positions(obj)
    obj.adaptive_terrain.ground.amplitude, obj.adaptive_terrain.ground.wavelength = 20.0, 50.0
    bpy.context.view_layer.update()
    detailed = session.update_object(obj)
    assert detailed.triangles > plain.triangles and positions(obj) != before
    assert session.record_of(obj).field.detail.amplitude == 20.0
    obj.adaptive_terrain.ground.amplitude = 0.0
    bpy.context.view_layer.update()
    assert session.update_object(obj).triangles == plain.triangles and positions(obj) == before


def test_a_number_that_cannot_be_names_the_terrain(scene, add_terrain):
    ground = add_terrain().adaptive_terrain.ground
    ground.amplitude = 1e9
    with pytest.raises(TerrainError, match="'Hill' cannot be refined. The detail's amplitude is .*; expected"):
        ground_of(ground, "Hill")
