# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of a scatter: figures, reasons without points, and failures."""

from types import SimpleNamespace
from unittest.mock import Mock

import bpy
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.scatter.panel import ORPHAN, ScatterPanel, scatter_lines, summary
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.ui.panel_parts import LINE_LENGTH
from adaptive_terrain.operators.ui.status_row import ShowMessage, draw_failure
from drawn_panels import draw


def record_of(terrain, scatter):
    return session.record_of(terrain).scatters[scatter.session_uid]


def test_the_panel_says_how_many_and_what_they_took(terrain, scatter):
    record = session.record_of(terrain)
    assert summary(None) == ("-", "-") and len(scatter_lines(scatter.adaptive_scatter, None, record.status)) == 4
    session.update_object(terrain)
    lines = dict(scatter_lines(scatter.adaptive_scatter, record_of(terrain, scatter), record.status))
    assert lines["Points"] == f"{len(scatter.data.vertices):,}"
    assert lines["Update"].endswith(("ms", " s")) and lines["Off the mesh"].startswith("≤ ")
    assert lines["Off the mesh"].endswith(" px")
    scatter.location.z = 2.0
    bpy.context.view_layer.update()
    lines = dict(scatter_lines(scatter.adaptive_scatter, record_of(terrain, scatter), record.status))
    assert lines["Off the mesh"].startswith("moved")


def test_the_panel_says_that_the_camera_sees_no_points(scene, terrain, scatter):
    """Without a view there are no points, and a tick and "≤ 0 px" would look as if all were well."""
    bpy.context.view_layer.objects.active = scatter
    session.update_object(terrain)
    assert f"On {terrain.name}" in draw(ScatterPanel).texts
    scene.camera.location = (0.0, 0.0, -500.0)
    bpy.context.view_layer.update()
    session.update_object(terrain)
    texts = draw(ScatterPanel).texts
    assert "Camera underground" in texts and f"On {terrain.name}" not in texts
    assert not any(text.startswith("≤") for text in texts)


def test_the_panel_of_a_scatter_opens_what_went_wrong(scene, terrain, scatter):
    shown, manager, lines = Mock(), Mock(), Mock()
    bpy.context.view_layer.objects.active = scatter
    assert not draw_failure(shown, terrain) and shown.mock_calls == []
    scatter.adaptive_scatter.layer = "Gone"
    with pytest.raises(TerrainError, match="Its layer 'Gone' is none of the terrain's: choose another"):
        session.update_object(terrain)
    assert draw_failure(shown, terrain)
    (name,), button = shown.row().operator.call_args
    assert (name, button["text"]) == ("adaptive_terrain.show_message", "Not up to date: read why")
    assert bpy.ops.adaptive_terrain.show_message.poll()
    ShowMessage.execute(None, SimpleNamespace(object=scatter, window_manager=manager))
    manager.popup_menu.call_args.args[0](lines, None)
    text = " ".join(call.kwargs["text"] for call in lines.layout.label.call_args_list)
    failure = session.record_of(terrain).status.failure
    assert text == f"{failure.problem} Choose another." and failure.fix == "choose another"
    scatter.parent = None
    assert not bpy.ops.adaptive_terrain.show_message.poll()


def test_a_scatter_whose_terrain_is_gone_says_so(terrain, scatter):
    shown, context = Mock(), SimpleNamespace(object=scatter)
    assert ScatterPanel.poll(context)
    bpy.data.objects.remove(terrain)
    assert ScatterPanel.poll(context)
    ScatterPanel.draw(SimpleNamespace(layout=shown), context)
    said = [call.kwargs["text"] for call in shown.box().column().label.call_args_list]
    assert " ".join(said) == ORPHAN and all(len(line) <= LINE_LENGTH for line in said)
