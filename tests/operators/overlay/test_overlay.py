# SPDX-License-Identifier: GPL-3.0-or-later
"""The overlay: each triangle's error or level as attribute and colour, and no cost while it is off."""

import json
from types import SimpleNamespace
from unittest.mock import Mock

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.measure import triangle_errors
from adaptive_terrain.cbt_terrain.mesh.attributes import LEVEL
from adaptive_terrain.operators.bridge.writer import COLOUR_ATTRIBUTE
from adaptive_terrain.operators.overlay import colors as overlay
from adaptive_terrain.operators.overlay.colors import BEYOND, VIRIDIS, scale_colours
from adaptive_terrain.operators.overlay.panel import OverlayPanel
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.terrain.request import gather
from blender_meshes import read, values_of
from drawn_panels import draw_mocked

CELL_DEPTH = 15  # of the store's 129 x 129 samples: 2 x 7 + 1


def shown_colours(mesh):
    """Return the sRGB colour of each face (0 .. 255), and assert that its corners agree."""
    corners = read(mesh.attributes[COLOUR_ATTRIBUTE].data, "color_srgb", 4).reshape(-1, 3, 4)
    assert (corners == corners[:, :1]).all()
    return corners[:, 0, :3] * 255


def turn_on(terrain, kind):
    terrain.adaptive_terrain.overlay = kind
    bpy.context.view_layer.update()
    return session.update_object(terrain)


def errors_of(terrain, update):
    request = gather(terrain, bpy.context.evaluated_depsgraph_get())
    return triangle_errors(session.record_of(terrain).field, update.surface, request.views, request.placement)


def test_the_screen_error_is_an_attribute_of_the_faces(scene, add_terrain):
    terrain = add_terrain()
    update = turn_on(terrain, "ERROR")
    attribute = terrain.data.attributes["error_px"]
    assert (attribute.domain, attribute.data_type) == ("FACE", "FLOAT")
    errors = read(attribute.data, "value")
    assert (errors == errors_of(terrain, update)).all() and 0.0 < errors.max() <= update.bound_px
    assert terrain.data.attributes.active_color_name == COLOUR_ATTRIBUTE
    assert terrain.data.attributes[COLOUR_ATTRIBUTE].domain == "CORNER"
    np.testing.assert_allclose(shown_colours(terrain.data), 255 * scale_colours(errors), atol=0.6)
    assert terrain.data.validate(verbose=True) is False


def test_metres_are_shown_where_there_is_no_view(scene, add_terrain):
    terrain = add_terrain()
    terrain.adaptive_terrain.viewport.error_px, terrain.adaptive_terrain.viewport.error_m = 0.0, 4.0
    update = turn_on(terrain, "ERROR")
    errors = values_of(terrain.data, "error_m")
    assert 0.0 < errors.max() <= update.bound_m and "error_px" not in terrain.data.attributes
    np.testing.assert_allclose(shown_colours(terrain.data), 255 * scale_colours(errors / 4), atol=0.6)
    assert [text for text, _ in session.record_of(terrain).overlay.legend] == ["0 m", "1 m", "2 m", "3 m", "4 m"]


def test_more_than_was_asked_has_a_colour_of_its_own(scene, add_terrain):
    terrain = add_terrain()
    detail = terrain.adaptive_terrain.viewport
    detail.limit_triangles, detail.max_triangles = True, 500
    turn_on(terrain, "ERROR")
    errors = values_of(terrain.data, "error_px")
    beyond = (np.abs(shown_colours(terrain.data) - BEYOND) < 1).all(1)
    assert (beyond == (errors > 1.0)).all() and 0 < beyond.sum() < len(errors)
    text, colour = session.record_of(terrain).overlay.legend[-1]
    assert text == f"Above the criterion, up to {errors.max():.3g} px" and np.allclose(colour, np.array(BEYOND) / 255)


def test_the_level_has_the_same_colour_in_every_view(scene, add_terrain):
    terrain = add_terrain()
    found = {}
    for y in (-900.0, -2500.0):
        scene.camera.location.y = y
        turn_on(terrain, "LEVEL")
        levels = values_of(terrain.data, LEVEL)
        for level, colour in zip(levels.tolist(), shown_colours(terrain.data).round().tolist(), strict=True):
            assert found.setdefault(level, colour) == colour
    assert len({tuple(found[level]) for level in found if level <= CELL_DEPTH}) > 5
    assert all(found[level] != found[level + 1] for level in found if level + 1 in found)
    finer = [colour for level, colour in found.items() if level > CELL_DEPTH]
    assert finer and all(red > 100 and green == 0 for red, green, _ in finer), "finer than the raster"


def test_the_legend_of_levels_has_the_length_of_their_edges(scene, add_terrain):
    terrain = add_terrain()
    surface = turn_on(terrain, "LEVEL").surface
    plan = surface.positions[surface.triangles][:, :, :2]
    shortest = np.linalg.norm(plan - np.roll(plan, 1, axis=1), axis=2).min(axis=1)
    legend = session.record_of(terrain).overlay.legend
    assert len(legend) == 5
    for text, _ in legend:
        level = int(text.split(":")[0].removeprefix("Level "))
        edges = shortest[surface.level == level]
        assert text == f"Level {level}: edges of {edges[0]:.3g} m" and np.allclose(edges, edges[0], rtol=1e-4)


def test_nothing_is_computed_or_kept_while_it_is_off(scene, add_terrain, monkeypatch):
    terrain = add_terrain()
    made = Mock(side_effect=overlay.make_overlay)
    monkeypatch.setattr(session, "make_overlay", made)
    session.update_object(terrain)
    plain = sorted(terrain.data.attributes.keys())
    assert made.call_count == 0
    turn_on(terrain, "ERROR")
    assert made.call_count == 1 and session.record_of(terrain).status.ms["overlay"] > 0.0
    session.update_object(terrain)
    assert made.call_count == 1, "the same view, the same errors"
    turn_on(terrain, "NONE")
    assert sorted(terrain.data.attributes.keys()) == plain and made.call_count == 1
    assert session.record_of(terrain).overlay is None and terrain.data.attributes.active_color_name == ""


def test_a_bake_and_its_mesh_have_no_overlay(scene, add_terrain, monkeypatch):
    terrain = add_terrain()
    turn_on(terrain, "ERROR")
    monkeypatch.setattr(session, "make_overlay", Mock(side_effect=AssertionError))
    bpy.ops.adaptive_terrain.bake()
    [baked] = [obj for obj in scene.objects if obj.type == "MESH" and obj != terrain]
    assert COLOUR_ATTRIBUTE not in baked.data.attributes and "error_px" not in baked.data.attributes


def test_the_error_is_of_the_view_also_where_the_mesh_stays(scene, add_terrain):
    """At a limit another view may have the same mesh with other errors."""
    terrain = add_terrain()
    detail = terrain.adaptive_terrain.viewport
    detail.limit_depth, detail.max_depth = True, 4
    turn_on(terrain, "ERROR")
    before = values_of(terrain.data, "error_px")
    scene.camera.location.z += 300.0
    bpy.context.view_layer.update()
    update = session.update_object(terrain)
    assert update.changed is False
    after = values_of(terrain.data, "error_px")
    assert (after == errors_of(terrain, update)).all() and (after != before).any()


def test_it_survives_a_clean_up(scene, add_terrain):
    terrain = add_terrain()
    terrain.adaptive_terrain.cleanup.use_below, terrain.adaptive_terrain.cleanup.below = True, 10.0
    update = turn_on(terrain, "ERROR")
    errors = values_of(terrain.data, "error_px")
    assert 0 < len(errors) == len(terrain.data.polygons) < update.triangles
    np.testing.assert_allclose(shown_colours(terrain.data), 255 * scale_colours(errors), atol=0.6)
    assert terrain.data.attributes.active_color_name == COLOUR_ATTRIBUTE


def test_a_failure_is_told_and_the_mesh_stays(scene, add_terrain, monkeypatch):
    terrain = add_terrain()
    triangles = session.update_object(terrain).triangles
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.accuracy.measure.triangle_errors", lambda *arguments: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        turn_on(terrain, "ERROR")
    assert "ZeroDivisionError" in session.record_of(terrain).status.error
    assert len(terrain.data.polygons) == triangles and "error_px" not in terrain.data.attributes
    turn_on(terrain, "NONE")
    assert session.record_of(terrain).status.error == ""


def test_the_scale_is_viridis():
    np.testing.assert_allclose(scale_colours(np.array([0.0, 0.5, 1.0])) * 255, VIRIDIS[[0, 4, 8]], atol=0.6)
    matplotlib = pytest.importorskip("matplotlib")
    fractions = np.linspace(0, 1, 101)
    np.testing.assert_allclose(scale_colours(fractions), matplotlib.colormaps["viridis"](fractions)[:, :3], atol=0.07)


def test_the_panel_has_the_button_and_the_legend_while_it_is_on(scene, add_terrain):
    terrain = add_terrain()

    layout = draw_mocked(OverlayPanel, terrain)
    assert layout.operator.call_count == layout.label.call_count == 0
    turn_on(terrain, "ERROR")
    layout = draw_mocked(OverlayPanel, terrain)
    layout.operator.assert_called_once_with("adaptive_terrain.show_overlay", icon="SHADING_SOLID")
    assert [call.kwargs["text"] for call in layout.label.mock_calls] == [
        "0 px",
        "0.25 px",
        "0.5 px",
        "0.75 px",
        "1 px",
        "",
    ]


def test_the_button_shows_the_colours_in_every_viewport(scene, add_terrain):
    spaces = [SimpleNamespace(shading=SimpleNamespace(type="WIREFRAME", color_type="MATERIAL")) for _ in range(2)]
    areas = [SimpleNamespace(type="VIEW_3D", spaces=SimpleNamespace(active=space)) for space in spaces]
    areas.append(SimpleNamespace(type="OUTLINER", spaces=SimpleNamespace(active=None)))
    from adaptive_terrain.operators.overlay.panel import ShowOverlay

    ShowOverlay.execute(None, SimpleNamespace(screen=SimpleNamespace(areas=areas)))
    assert [(space.shading.type, space.shading.color_type) for space in spaces] == [("SOLID", "VERTEX")] * 2


def test_after_the_last_overlay_viewports_show_materials_again(scene, add_terrain):
    """Viewports do not show the weights of layers, which are colours, too."""
    terrains = [add_terrain(name) for name in ("A", "B")]
    [space, *_] = [
        area.spaces.active for area in bpy.data.window_managers[0].windows[0].screen.areas if area.type == "VIEW_3D"
    ]
    space.shading.color_type = "VERTEX"
    for terrain in terrains:
        terrain.adaptive_terrain.overlay = "LEVEL"
    shown = []
    for terrain in terrains:
        terrain.adaptive_terrain.overlay = "NONE"
        shown.append(space.shading.color_type)
    assert shown == ["VERTEX", "MATERIAL"]


def test_an_export_carries_the_overlay(scene, add_terrain, tmp_path):
    terrain = add_terrain()
    terrain.adaptive_terrain.overlay = "ERROR"
    assert bpy.ops.adaptive_terrain.export(filepath=str(tmp_path / "a.npz")) == {"FINISHED"}
    with np.load(tmp_path / "a.npz") as file:
        errors, info = file["error_px"], json.loads(str(file["info"]))
        assert len(errors) == len(file["triangles"]) and 0.0 < errors.max() <= info["bound_px"]
        assert file[COLOUR_ATTRIBUTE].shape == (3 * len(errors), 4)
    assert info["attributes"]["error_px"] == {"domain": "FACE", "unit": "px"}
