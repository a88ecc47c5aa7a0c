# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain's updates compute only attributes that its scene reads; the panel shows the reason."""

import math

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.run import warmup
from adaptive_terrain.operators.attributes.properties import changed_numbers
from adaptive_terrain.operators.attributes.sun_lamps import sun_lamps, suns_over
from adaptive_terrain.operators.session import live, session
from adaptive_terrain.operators.terrain.overrides import Overrides
from adaptive_terrain.operators.terrain.request import gather
from blender_meshes import positions, values_of
from demand_trees import Moved, colour, mix, new_material, shows
from live_windows import show_window, turns


@pytest.fixture
def worn(scene, add_terrain):
    """Add a terrain with a material that reads the slope and the height."""
    terrain = add_terrain()
    both = shows(
        new_material("Rock"), lambda tree: mix(tree, 0.5, colour(tree, "slope"), colour(tree, "height")).outputs[2]
    )
    terrain.data.materials.append(both)
    return terrain


def made(terrain):
    """Return the names of the effects that the mesh has."""
    return {name for name in ATTRIBUTES if name in terrain.data.attributes}


def statuses(terrain):
    return session.record_of(terrain).status.effects


def test_what_is_read_is_computed_and_nothing_else(worn):
    session.update_object(worn)
    assert made(worn) == {"slope", "height"}
    runs = session.record_of(worn).effects_runs
    assert set(runs) == {"slope", "height"}
    assert np.abs(values_of(worn.data, "height") - positions(worn)[:, 2]).max() < 5.0, "at the scale of a pixel"
    said = statuses(worn)
    assert list(said) == list(ATTRIBUTES)
    assert said["slope"].readers == ("material Rock, node Attribute",) and said["slope"].family == "PICTURE"
    assert said["slope"].computed == len(worn.data.vertices) and said["slope"].nbytes > 0 and not said["slope"].skipped
    assert said["aspect"].skipped == "nothing reads it" and said["aspect"].computed == 0


def test_unlinking_a_node_skips_its_attribute(worn):
    session.update_object(worn)
    tree = worn.material_slots[0].material.node_tree
    tree.links.remove(next(link for link in tree.links if link.from_node.type == "ATTRIBUTE"))
    before, record = len(worn.data.polygons), session.record_of(worn)
    runs = dict(record.effects_runs)
    update = session.update_object(worn)
    assert not update.changed and len(worn.data.polygons) == before
    assert made(worn) == {"height"} and statuses(worn)["slope"].skipped == "nothing reads it"
    assert record.effects_runs["slope"] == runs["slope"]


def test_nothing_is_computed_again_while_nothing_changes(worn):
    session.update_object(worn)
    record = session.record_of(worn)
    runs, shown = dict(record.effects_runs), record.shown
    session.update_object(worn)
    assert dict(record.effects_runs) == runs and record.shown == shown
    assert "mesh" not in record.status.ms


def test_an_attribute_that_a_user_removed_is_written_again(worn):
    session.update_object(worn)
    before = values_of(worn.data, "slope")
    worn.data.attributes["slope"].name = "mine"
    worn.data.attributes.remove(worn.data.attributes["height"])
    session.update_object(worn)
    assert made(worn) == {"slope", "height"} and "mine" not in worn.data.attributes
    assert np.array_equal(values_of(worn.data, "slope"), before)


def test_a_frozen_mesh_follows_what_is_read(worn):
    worn.adaptive_terrain.frozen = session.freeze(worn)
    session.update_object(worn)
    assert made(worn) == {"slope", "height"}
    worn.data.materials.clear()
    session.update_object(worn)
    assert made(worn) == set()


def test_the_viewport_waits_for_the_kernels_of_attributes(worn, monkeypatch):
    """Turn by turn: nothing is made before they are there, and then without another change."""
    asked = []
    monkeypatch.setattr(warmup, "prepare_modules", lambda modules: asked.append(modules) or len(asked) > 2)
    show_window(monkeypatch)
    bpy.context.evaluated_depsgraph_get()
    live.mark_dirty()
    assert [live.tick() for _ in range(2)] == [live.IDLE_S] * 2 and made(worn) == set()
    turns(changed=False)
    assert made(worn) == {"slope", "height"} and len(asked) == 3
    assert {"jet", "keep"} <= {module.__name__.rpartition(".")[2] for module in asked[0]}


def test_the_viewport_follows_without_being_asked(worn, monkeypatch):
    show_window(monkeypatch)
    bpy.context.evaluated_depsgraph_get()
    turns()
    assert made(worn) == {"slope", "height"}
    worn.material_slots[0].material.node_tree.nodes["Attribute"].mute = True
    bpy.context.view_layer.update()
    turns()
    assert made(worn) == {"height"}


def test_a_pin_computes_and_off_wins_and_says_so(worn):
    effects = worn.adaptive_terrain.effects
    effects.aspect.when, effects.slope.when, effects.plan_curvature.when = "PINNED", "OFF", "OFF"
    session.update_object(worn)
    assert made(worn) == {"aspect", "height"}
    said = statuses(worn)
    assert said["aspect"].readers == ("a pin",)
    assert said["slope"].skipped == "switched off, read by material Rock, node Attribute"
    assert said["plan_curvature"].skipped == "switched off"


def test_geometry_reads_at_one_scale_whatever_the_camera_sees(worn, scene):
    scene.render.resolution_percentage, worn.adaptive_terrain.viewport.error_px = 3, 0.02  # pixels of some 40 m
    session.update_object(worn)
    picture = values_of(worn.data, "slope")
    Moved(worn).reads("slope")
    session.update_object(worn)
    assert statuses(worn)["slope"].family == "GEOMETRY" and statuses(worn)["height"].family == "PICTURE"
    geometry = values_of(worn.data, "slope")
    assert not np.array_equal(picture, geometry)
    worn.adaptive_terrain.effects.geometry_metres = 160.0
    session.update_object(worn)
    assert values_of(worn.data, "slope").std() < 0.8 * geometry.std(), "a coarser scale is smoother"


def test_everything_is_computed_where_nobody_knows_what_is_read(worn):
    Moved(worn).reads_computed()
    session.update_object(worn)
    assert made(worn) == set(ATTRIBUTES)
    assert statuses(worn)["aspect"].readers == ("modifier Nodes, node Named Attribute (its Name is computed)",)


def test_a_command_may_name_effects_instead(worn):
    def asked(**override):
        request = gather(worn, bpy.context.evaluated_depsgraph_get(), "RENDER", overrides=Overrides(**override))
        return [(item.name, item.readers, item.family) for item in request.effects.requests]

    assert [item[0] for item in asked()] == ["height", "slope"]
    assert asked(effects=()) == []
    worn.adaptive_terrain.effects.aspect.when = "OFF"
    assert asked(effects=("aspect",)) == [("aspect", ("the export",), "GEOMETRY")]


def test_settings_are_made_from_the_declarations(worn):
    settings = worn.adaptive_terrain
    for name, effect in ATTRIBUTES.items():
        assert getattr(settings.effects, name).when == "DEMAND"
        assert changed_numbers(settings, name) == ()
        for parameter in effect.parameters:
            if isinstance(parameter.default, float) and math.isfinite(parameter.max):
                setattr(getattr(settings.effects, name), parameter.name, 2.0 * parameter.max)
                assert changed_numbers(settings, name) == ((parameter.name, parameter.max),), "kept in its range"
                getattr(settings.effects, name).property_unset(parameter.name)


def test_an_update_that_an_effect_stops_keeps_the_last_mesh(worn, monkeypatch):
    session.update_object(worn)
    before = len(worn.data.polygons)
    worn.adaptive_terrain.viewport.error_px = 8.0

    def fails(*_arguments, **_named):
        raise TerrainError("The effect 'slope' cannot be made; try another.")

    monkeypatch.setattr("adaptive_terrain.cbt_terrain.attributes.evaluate.evaluate", fails)
    with pytest.raises(TerrainError):
        session.update_object(worn)
    assert len(worn.data.polygons) == before and made(worn) == {"slope", "height"}
    assert session.record_of(worn).status.error.startswith("The effect 'slope'")
    monkeypatch.undo()
    session.update_object(worn)
    assert len(worn.data.polygons) < before and made(worn) == {"slope", "height"}


def sun(elevation, azimuth, energy=2.0):
    """Add a sun lamp; angles in degrees, azimuth clockwise from north."""
    lamp = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    lamp.data.energy, lamp.data.angle = energy, 0.01
    lamp.rotation_euler = math.radians(90 - elevation), 0.0, -math.radians(azimuth)
    bpy.context.scene.collection.objects.link(lamp)
    return lamp


def test_sun_lamps_that_shine_are_found(scene):
    lamp = sun(30.0, 180.0)
    for energy, hidden in ((0.0, False), (1.0, True)):
        other = sun(10.0, 0.0, energy)
        other.hide_viewport = other.hide_render = hidden
    [found] = sun_lamps(bpy.context.evaluated_depsgraph_get())
    assert (found.angle, found.strength) == (pytest.approx(0.01), 2.0)
    # The lamp's -Z points at the ground: turned by 60 degrees about X its +Z leans to -Y, then 180 degrees about Z.
    wanted = [0.0, math.cos(math.radians(30)), math.sin(math.radians(30))]
    assert found.direction == pytest.approx(wanted, abs=1e-6)
    lamp.scale = (3.0, 3.0, -3.0)
    [mirrored] = sun_lamps(bpy.context.evaluated_depsgraph_get())
    assert mirrored.direction == pytest.approx([-x for x in wanted], abs=1e-6), "it shines the other way"


def test_a_render_has_the_suns_that_it_shows(scene):
    """Other lamps may be hidden in renders than in viewports; instances shine, too."""
    shown, viewport_only = sun(30.0, 180.0), sun(50.0, 180.0)
    shown.hide_viewport, viewport_only.hide_render = True, True
    kit = bpy.data.collections.new("Kit")
    lamp = sun(70.0, 180.0)
    scene.collection.objects.unlink(lamp)
    kit.objects.link(lamp)
    for turned in (0.0, 30.0):
        empty = bpy.data.objects.new("Empty", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", kit
        empty.rotation_euler.x = math.radians(turned)
        scene.collection.objects.link(empty)
    found = {}

    def look(_scene, depsgraph):
        if depsgraph.mode == "RENDER":
            found[depsgraph.mode] = sorted(round(math.degrees(math.asin(s.direction[2]))) for s in sun_lamps(depsgraph))

    bpy.app.handlers.frame_change_post.append(look)
    scene.render.engine, scene.cycles.samples, scene.render.resolution_percentage = "CYCLES", 1, 2
    try:
        bpy.ops.render.render()
    finally:
        bpy.app.handlers.frame_change_post.remove(look)
    assert found == {"RENDER": [30, 70, 80]}


def test_the_widest_sun_lights_a_terrain(worn):
    """Blender's 180 degrees are more than pi, in float32."""
    sun(45.0, 0.0).data.angle = 4.0
    worn.adaptive_terrain.effects.sun.when = "PINNED"
    session.update_object(worn)
    assert 0.0 < values_of(worn.data, "sun").mean() < 1.0


def test_a_scene_without_a_sun_lamp_is_said(worn):
    worn.adaptive_terrain.effects.sun.when = "PINNED"

    def note():
        session.update_object(worn)
        return session.record_of(worn).status.effects["sun"].note

    assert note() == "0, since no sun lamp shines in the scene" and not values_of(worn.data, "sun").any()
    lamp = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    bpy.context.scene.collection.objects.link(lamp)
    bpy.context.view_layer.update()
    assert note() == "" and values_of(worn.data, "sun").any()


def test_suns_are_turned_into_the_terrains_own_space(scene):
    sun(45.0, 0.0)
    placement = np.array([[0.0, -2.0, 0.0, 7.0], [2.0, 0.0, 0.0, 8.0], [0.0, 0.0, 4.0, 9.0], [0.0, 0.0, 0.0, 1.0]])
    [(x, y, z, angle, strength)] = suns_over(placement, bpy.context.evaluated_depsgraph_get())
    back = placement[:3, :3] @ [x, y, z]
    [lamp] = sun_lamps(bpy.context.evaluated_depsgraph_get())
    assert back == pytest.approx(lamp.direction) and (angle, strength) == (pytest.approx(0.01), 2.0)
