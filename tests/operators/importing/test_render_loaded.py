# SPDX-License-Identifier: GPL-3.0-or-later
"""F12 during a large import waits until the tiles of the picture are loaded."""

from types import SimpleNamespace
from unittest.mock import Mock

import bpy
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.operators import jobs
from adaptive_terrain.operators.importing import render_loaded
from adaptive_terrain.operators.importing.imported import loaded_text
from held_imports import HeldImport, held_import, large_terrain, look_down, store_of, tiles_of, until  # noqa: F401
from modal_runs import RunningOperator, to_the_end, turn


@pytest.fixture
def f12(held, monkeypatch):
    """Press F12 during the held import; return the operator that waits, and the list of renders."""
    rendered = []
    monkeypatch.setattr(render_loaded, "_render_soon", lambda _window: rendered.append("a render"))
    operator = RunningOperator(operator_class=render_loaded.RenderLoaded, report=Mock())
    operator.context = SimpleNamespace(**vars(held.context) | {"window_manager": Mock(), "workspace": Mock()})
    assert render_loaded.unfinished(bpy.context.scene) == [held.context.object]
    assert operator.invoke(operator.context, None) == {"RUNNING_MODAL"}
    return operator, rendered


def test_f12_during_an_import_waits_until_the_tiles_suffice(terrain, held, f12):
    waiting, rendered = f12
    before = tiles_of(terrain)
    terrain.adaptive_terrain.render.error_px = 1.0  # finer than the tiles
    look_down(terrain, 700.0, 400.0)
    until(held, lambda: turn(waiting) == {"PASS_THROUGH"} and tiles_of(terrain) > before)
    assert turn(waiting, "F12") == {"RUNNING_MODAL"} and rendered == [], "between its samples may be more than a pixel"
    terrain.adaptive_terrain.render.error_px = open_store(store_of(terrain)).max_height
    until(held, lambda: turn(waiting) == {"FINISHED"})
    assert rendered == ["a render"]
    assert jobs.find(jobs.IMPORT, terrain) is not None and loaded_text(terrain.adaptive_terrain)
    HeldImport.is_released = True
    assert to_the_end(held) == {"FINISHED"} and loaded_text(terrain.adaptive_terrain) == ""


def test_esc_ends_the_wait_of_f12_alone(terrain, held, f12):
    waiting, rendered = f12
    assert turn(waiting, "ESC") == {"CANCELLED"} and rendered == []
    waiting.context.workspace.status_text_set.assert_called_with(None)
    job = jobs.find(jobs.IMPORT, terrain)
    assert not job.stopped, "the import goes on"
    job.stop()
    assert to_the_end(held) == {"FINISHED"} and render_loaded.unfinished(bpy.context.scene) == []
