# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers of a terrain in Blender: from settings to rules, the list, presets as files, painted images, the mesh."""

import math
from pathlib import Path

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import splat_rules as rules
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.layers import operators as splat_layers
from adaptive_terrain.operators.layers.panel import LayerPresets, LayersPanel
from adaptive_terrain.operators.layers.properties import BANDS, add_default_layers, colors_of, layers_of
from adaptive_terrain.operators.session import session
from blender_meshes import values_of
from demand_trees import colour, new_material, shows
from drawn_panels import draw_mocked

PRESETS = ("alpine", "desert", "dunes", "hills", "island", "moon")


@pytest.fixture
def terrain(scene, add_terrain):
    found = add_terrain()
    bpy.context.view_layer.objects.active = found
    return found


@pytest.fixture
def layers(terrain):
    return terrain.adaptive_terrain.layers


def shipped(name):
    return next(path for path in bpy.utils.preset_paths(splat_layers.PRESETS)[-1:]) + f"/{name}.py"


def execute(path):
    return bpy.ops.script.execute_preset(filepath=str(path), menu_idname=splat_layers.PRESET_PANEL)


def add(layers, name, **bands):
    layer = layers.add()
    layer.name = name
    for kind, values in bands.items():
        band = getattr(layer, kind)
        band.use = True
        for member, value in values.items():
            setattr(band, member, value)
    return layer


def test_open_ends_of_rules_read_as_such(layers):
    """The panel shows a float32: "inf" for the largest there is, else all its digits."""
    largest = float(np.finfo(np.float32).max)
    valleys = add(layers, "Valleys", flow={"low": 1000.0})
    for kind in BANDS:
        limits = getattr(valleys, kind).bl_rna.properties["high"]
        short = kind == rules.SLOPE or float(f"{limits.hard_max:.3g}") == limits.hard_max
        assert limits.hard_max == largest or short, kind
    [rule] = layers_of(layers.id_data.adaptive_terrain)[0].rules
    assert valleys.flow.high == largest and (rule.low, rule.high) == (1000.0, math.inf)


def test_settings_become_rules(layers, terrain):
    add(layers, "Grass")
    rock = add(layers, "Rock", slope={"low": 0.6, "edge": 0.2}, relief={"low": 0.25, "high": 0.75, "edge": 0.125})
    rock.on_top, rock.strength, rock.noise_size, rock.ragged, rock.seed = False, 0.5, 64.0, 0.25, 9
    snow = add(
        layers, "Snow", height={"low": 250.0}, aspect={"direction": 0.5, "within": math.radians(60), "edge": 0.5}
    )
    snow.mask = "Rock"
    grass, stone, white = layers_of(terrain.adaptive_terrain)
    assert grass == rules.Layer("Grass", (), 1.0, True, 200.0, grass.ragged, 0) and grass.ragged == pytest.approx(0.8)
    assert (stone.strength, stone.on_top, stone.noise_size, stone.ragged, stone.seed) == (0.5, False, 64.0, 0.25, 9)
    relief, slope = stone.rules
    assert relief == rules.Rule("relief", 0.25, 0.75, 0.125)
    assert (slope.low, slope.edge) == pytest.approx((0.6, 0.2))
    assert slope == rules.Rule("slope", slope.low, math.inf, slope.edge), "the end of a range is open"
    height, aspect, mask = white.rules
    assert height == rules.Rule("height", 250.0, math.inf, 50.0)
    assert aspect == rules.Rule("aspect", aspect.low, math.inf, 0.5, direction=0.5) and aspect.low == pytest.approx(0.5)
    assert mask == rules.cover_rule(1)


@pytest.mark.parametrize("kind", BANDS)
def test_each_band_is_a_rule_of_its_kind(layers, terrain, kind):
    band = getattr(add(layers, "x", **{kind: {}}), kind)
    (layer,) = layers_of(terrain.adaptive_terrain)
    (rule,) = layer.rules
    limits = band.bl_rna.properties["low"]
    band.low = band.high = 0.5 * (max(limits.hard_min, -1.0) + min(limits.hard_max, 1.0))
    (layer,) = layers_of(terrain.adaptive_terrain)
    assert rule.of == kind and layer.rules[0].low == layer.rules[0].high == band.low


def test_a_mask_that_is_no_layer_above_is_refused(layers, terrain):
    add(layers, "Grass").mask = "Rock"
    add(layers, "Rock")
    with pytest.raises(TerrainError, match="'Grass' is masked by 'Rock'; expected a layer above"):
        layers_of(terrain.adaptive_terrain)
    assert bpy.ops.adaptive_terrain.layer_move(by=1) == {"FINISHED"}
    assert layers_of(terrain.adaptive_terrain)[1].rules == (rules.cover_rule(0),)


def test_the_list_is_added_to_removed_from_and_moved(layers, terrain):
    settings = terrain.adaptive_terrain
    for _ in range(12):
        assert bpy.ops.adaptive_terrain.layer_add() == {"FINISHED"}
    assert len({layer.name for layer in layers}) == 12 and settings.active_layer == 11
    assert not splat_layers.AddLayer.poll(bpy.context), "twelve are the most"
    names = [layer.name for layer in layers]
    settings.active_layer = 3
    assert bpy.ops.adaptive_terrain.layer_move(by=-1) == {"FINISHED"} and settings.active_layer == 2
    assert [layer.name for layer in layers][2:4] == [names[3], names[2]]
    settings.active_layer = 0
    assert bpy.ops.adaptive_terrain.layer_move(by=-1) == {"CANCELLED"}
    while splat_layers.RemoveLayer.poll(bpy.context):
        bpy.ops.adaptive_terrain.layer_remove()
    assert len(layers) == settings.active_layer == 0


@pytest.mark.parametrize("name", PRESETS)
def test_a_shipped_preset_makes_layers_that_can_be(layers, terrain, name):
    add(layers, "Left over")
    assert execute(shipped(name)) == {"FINISHED"}
    found = layers_of(terrain.adaptive_terrain)
    assert 5 <= len(found) <= 12 and "Left over" not in {layer.name for layer in found}
    assert not found[0].rules and found[0].name, "the first is the ground"
    assert len({layer.name for layer in found}) == len(set(colors_of(terrain.adaptive_terrain))) == len(found)
    expected = Path(shipped(name)).read_text(encoding="utf-8")
    for layer in found:
        assert f'"{layer.name}"' in expected


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_survives_being_written_and_read(layers, terrain, tmp_path, name):
    execute(shipped(name))
    before = layers_of(terrain.adaptive_terrain), colors_of(terrain.adaptive_terrain)
    text = splat_layers.preset_text(layers)
    (tmp_path / "again.py").write_text(text, encoding="utf-8")
    layers.clear()
    execute(tmp_path / "again.py")
    assert (layers_of(terrain.adaptive_terrain), colors_of(terrain.adaptive_terrain)) == before
    assert splat_layers.preset_text(layers) == text


def test_a_users_preset_is_added_and_removed(layers, terrain, tmp_path, monkeypatch):
    monkeypatch.setattr(bpy.utils, "user_resource", lambda *_given, path="", **_more: _made(tmp_path / path))
    monkeypatch.setattr(bpy.utils, "preset_paths", lambda subdir: [str(tmp_path / "presets" / subdir)])
    add(layers, "Lava 'n' \"ash\"", slope={"low": 0.5})
    assert bpy.ops.adaptive_terrain.layer_preset_add(name="Mine") == {"FINISHED"}
    (file,) = (tmp_path / "presets" / splat_layers.PRESETS).iterdir()
    before = layers_of(terrain.adaptive_terrain)
    layers.clear()
    execute(file)
    assert layers_of(terrain.adaptive_terrain) == before
    assert bpy.ops.adaptive_terrain.layer_preset_add(name=file.stem, remove_name=True) == {"FINISHED"}
    assert not file.exists()


def _made(path):
    path.mkdir(parents=True, exist_ok=True)
    return str(path)


def test_the_panel_offers_the_presets(terrain):
    assert LayerPresets.__name__ == LayerPresets.bl_idname == splat_layers.AddPreset.preset_menu
    assert getattr(bpy.types, splat_layers.PRESET_PANEL) is LayerPresets
    assert LayersPanel.poll(bpy.context)
    found = {
        path.stem for folder in bpy.utils.preset_paths(LayerPresets.preset_subdir) for path in Path(folder).iterdir()
    }
    assert set(PRESETS) <= found


def painted(pixels):
    rows, columns = pixels.shape
    image = bpy.data.images.new("Mask", columns, rows, float_buffer=True, is_data=True)
    rgba = np.ones((rows, columns, 4), np.float32)
    rgba[..., 0] = pixels
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    return image


def test_a_painted_image_is_read_again_when_it_changes(layers, terrain):
    pixels = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)
    add(layers, "Ground")
    add(layers, "Path").image = image = painted(pixels)
    first = layers_of(terrain.adaptive_terrain)[1].rules[0]
    assert first.of == "image" and np.array_equal(first.image.values, pixels)
    assert layers_of(terrain.adaptive_terrain)[1].rules[0].image is first.image, "kept"
    rgba = np.zeros(48, np.float32)
    image.pixels.foreach_set(rgba)
    image.update()
    image.update_tag()
    bpy.context.view_layer.update()
    assert (layers_of(terrain.adaptive_terrain)[1].rules[0].image.values == 0).all()
    image.scale(2, 2)
    assert layers_of(terrain.adaptive_terrain)[1].rules[0].image.values.shape == (2, 2)


def test_the_mesh_carries_the_weights_that_the_material_reads(layers, terrain):
    terrain.data.materials.append(shows(new_material("Ground"), lambda tree: colour(tree, "splat_1")))
    add(layers, "Low")
    add(layers, "High", relief={"low": 0.5, "edge": 0.0}).ragged = 0.0
    session.update_object(terrain)
    assert "splat_1" in terrain.data.attributes and "splat_2" not in terrain.data.attributes
    weights = values_of(terrain.data, "splat_1")
    assert (weights.sum(axis=1) == 1).all() and not weights[:, 2:].any()
    assert set(np.unique(weights)) <= {0.0, 0.5, 1.0} and 0.1 < weights[:, 1].mean() < 0.9
    ran = session.record_of(terrain).status.effects
    assert ran["height"].readers == ("effect splat_1",) and ran["slope"].skipped and ran["flow"].skipped
    layers[1].relief.use = False
    session.update_object(terrain)
    assert (values_of(terrain.data, "splat_1") == (0.0, 1.0, 0.0, 0.0)).all()
    assert session.record_of(terrain).status.effects["height"].skipped


def test_limits_in_the_wrong_order_are_said(layers, terrain):
    terrain.data.materials.append(shows(new_material("Ground"), lambda tree: colour(tree, "splat_1")))
    add(layers, "Grass")
    rock = add(layers, "Rock", slope={"low": math.pi / 2, "high": 0.0}, flow={"low": 1e4, "high": 100.0, "edge": 1.5})
    terrain.adaptive_terrain.active_layer = 1

    def texts():
        return [call for call in draw_mocked(LayersPanel).mock_calls if "From is above To" in str(call)]

    def note():
        session.update_object(terrain)
        return session.record_of(terrain).status.effects["splat_1"].note

    assert note() == "Rock covers nothing: From is above To in Slope and Flow" and len(texts()) == 2
    rock.flow.edge = 2.5  # in powers of ten, so that the edges meet
    assert note() == "Rock covers nothing: From is above To in Slope" and len(texts()) == 1
    rock.slope.use = False
    assert note() == "" and texts() == []


def test_no_layers_are_the_usual_ones(terrain):
    terrain.data.materials.append(shows(new_material("Ground"), lambda tree: colour(tree, "splat_1")))
    session.update_object(terrain)
    assert layers_of(terrain.adaptive_terrain) == ()
    assert [name for name, _ in colors_of(terrain.adaptive_terrain)] == [layer.name for layer in rules.DEFAULT]
    assert "splat_1" in terrain.data.attributes


def test_an_added_terrain_has_the_four_default_layers(scene):
    assert bpy.ops.mesh.adaptive_terrain_add(size=30.0) == {"FINISHED"}
    settings = bpy.context.object.adaptive_terrain
    assert [layer.name for layer in settings.layers] == ["Grass", "Scree", "Rock", "Snow"]
    assert settings.layers["Snow"].relief.low == pytest.approx(0.66) and settings.layers["Rock"].color[0] < 0.2
    assert [layer.on_top for layer in settings.layers] == [False, True, True, True]
    assert execute(shipped("moon")) == {"FINISHED"} and "Snow" not in settings.layers


def test_default_layers_cover_what_no_layers_cover(layers, terrain):
    """Weights and colours of each vertex agree to 1e-5 with those of a terrain without layers."""
    terrain.data.materials.append(shows(new_material("Ground"), lambda tree: colour(tree, "splat_1")))
    found = []
    for _ in range(2):
        session.update_object(terrain)
        weights = values_of(terrain.data, "splat_1")
        found.append((weights, np.array([color for _, color in colors_of(terrain.adaptive_terrain)])))
        add_default_layers(terrain.adaptive_terrain)
    assert len(layers) == 8
    (before, usual), (after, colors) = found
    assert np.abs(before - after).max() < 1e-5 and np.abs(usual - colors).max() < 1e-6
    assert (before.max(axis=0) > 0.1).sum() >= 3
