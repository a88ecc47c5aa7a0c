# SPDX-License-Identifier: GPL-3.0-or-later
"""A viewport shows a preview of the sky at once, and at rest the values of a full update."""

import time

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import sky_layer
from adaptive_terrain.cbt_terrain.field import store
from adaptive_terrain.operators.session import live, previews, session
from blender_meshes import values_of
from demand_trees import colour, new_material, shows
from live_windows import show_window


@pytest.fixture
def lit(scene, add_terrain, monkeypatch):
    """Return a terrain in a window whose material reads the sky, without a cache in its store."""
    monkeypatch.setattr(store, "data_folder", lambda field: None)
    terrain = add_terrain()
    terrain.data.materials.append(shows(new_material("Sky"), lambda tree: colour(tree, "sky")))
    show_window(monkeypatch)
    bpy.context.evaluated_depsgraph_get()
    yield terrain
    live._unrefined.clear()


def turns(until=lambda: False) -> int:
    """Run the timer until it rests or until the condition holds, and return the number of turns."""
    live.mark_dirty()
    for turn in range(100_000):
        if (live.tick() == live.IDLE_S and not live._unrefined) or until():
            return turn
        time.sleep(0.002)
    raise AssertionError("the live update never ended")


def test_a_preview_is_refined_to_the_bits_of_an_update(lit):
    turns(until=lambda: live._unrefined)
    first = values_of(lit.data, "sky")
    turns()
    refined = values_of(lit.data, "sky")
    assert not np.array_equal(first, refined) and not live._unrefined
    session.clear()
    session.update_object(lit)
    assert np.array_equal(values_of(lit.data, "sky"), refined)
    record = session.record_of(lit)
    request = record.status.request
    assert previews.with_previews(request, record.field) is request, "known: no preview"


def test_the_view_can_change_between_the_steps_of_refining(lit, monkeypatch):
    steps = []
    whole = previews.refine
    monkeypatch.setattr(previews, "refine", lambda *about: steps.append(1) or whole(*about))
    turns(until=lambda: len(steps) == 3)
    lit.adaptive_terrain.viewport.error_px = 3.0
    bpy.context.view_layer.update()
    turns()
    assert len(steps) == 16, "finished steps are not repeated"
    update = session.update_object(lit)
    assert len(lit.data.polygons) == update.triangles and sky_layer.is_known(session.record_of(lit).field, 1.0)


def test_a_terrain_in_edit_mode_rests_and_is_refined_after_it(lit):
    turns(until=lambda: live._unrefined)
    first = values_of(lit.data, "sky")
    bpy.ops.object.mode_set(mode="EDIT")
    ended = time.monotonic() + 300.0
    resting = 0
    while resting < 20 and time.monotonic() < ended:
        resting = resting + 1 if live.tick() == live.IDLE_S else 0
        time.sleep(0.002)
    assert resting == 20, "nothing is computed for a mesh that cannot be written"
    bpy.ops.object.mode_set(mode="OBJECT")
    turns()
    assert not np.array_equal(values_of(lit.data, "sky"), first)


def test_a_view_without_a_reader_of_the_sky_makes_nothing_ahead(lit):
    lit.data.materials.clear()
    bpy.context.view_layer.update()
    turns()
    assert not live._unrefined and "sky" not in lit.data.attributes
    assert session.record_of(lit).field.cache.results == {}
