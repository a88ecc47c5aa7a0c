# SPDX-License-Identifier: GPL-3.0-or-later
"""Detail below the raster's cells, asked for on the terrain."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.terrain.request import ground_of
from blender_meshes import digest_alone


def test_an_amplitude_adds_detail_and_none_takes_it_away(scene, add_terrain):
    obj = add_terrain()
    obj.adaptive_terrain.viewport.error_px = 4.0
    plain = session.update_object(obj)
    before = digest_alone(obj)
    obj.adaptive_terrain.ground.amplitude, obj.adaptive_terrain.ground.wavelength = 20.0, 50.0
    bpy.context.view_layer.update()
    detailed = session.update_object(obj)
    assert detailed.triangles > plain.triangles and digest_alone(obj) != before
    assert session.record_of(obj).field.detail.amplitude == 20.0
    obj.adaptive_terrain.ground.amplitude = 0.0
    bpy.context.view_layer.update()
    assert session.update_object(obj).triangles == plain.triangles and digest_alone(obj) == before


def test_a_number_that_cannot_be_names_the_terrain(scene, add_terrain):
    settings = add_terrain().adaptive_terrain
    settings.ground.amplitude = 1e9
    with pytest.raises(TerrainError, match="'Hill' cannot be refined. The detail's amplitude is .*; expected"):
        ground_of(settings, "Hill")


def painted(name, values) -> bpy.types.Image:
    image = bpy.data.images.new(name, values.shape[1], values.shape[0], float_buffer=True)
    image.pixels.foreach_set(np.repeat(values.astype(np.float32).reshape(-1), 4))
    image.update_tag()
    return image


def test_an_image_is_detail_and_painting_it_shows(scene, add_terrain):
    obj = add_terrain()
    before = session.update_object(obj).triangles
    ground = obj.adaptive_terrain.ground
    ground.image = painted("Stones", np.indices((8, 8)).sum(0) % 2)
    ground.tile, ground.amplitude = 80.0, 20.0
    bpy.context.view_layer.update()
    assert session.update_object(obj).triangles > before
    assert session.record_of(obj).field.detail.image.values.shape == (8, 8)
    chequered = digest_alone(obj)
    ground.image.pixels.foreach_set(np.full(8 * 8 * 4, 0.5, np.float32))
    ground.image.update_tag()
    bpy.context.view_layer.update()
    session.update_object(obj)
    assert digest_alone(obj) != chequered
    heights = session.record_of(obj).field.detail.image.values
    assert (heights == 0.5).all(), "a grey image is level"


def test_a_layer_has_detail_where_it_lies(scene, add_terrain):
    obj = add_terrain()
    settings = obj.adaptive_terrain
    settings.layers.add().name = "Grass"
    rock = settings.layers.add()
    rock.name, rock.image = "Rock", painted("West", np.array([[1.0, 0.0]]))
    rock.detail.amplitude, rock.detail.wavelength = 10.0, 40.0
    bpy.context.view_layer.update()
    session.update_object(obj)
    field = session.record_of(obj).field
    (layer,) = field.detail.layers
    assert layer.detail.amplitude == 10.0
    weights = layer.mask.values.mean(0) / 255
    quarter = len(weights) // 4
    assert weights[:quarter].min() > 0.5 > weights[-quarter:].max()
    rock.detail.amplitude = 0.0
    bpy.context.view_layer.update()
    session.update_object(obj)
    assert session.record_of(obj).field.detail is None
