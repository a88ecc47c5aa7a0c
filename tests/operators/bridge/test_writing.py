# SPDX-License-Identifier: GPL-3.0-or-later
"""Timers write where Blender's flag forbids it: a poll function is such a place without a window."""

import threading

import bpy
import pytest
from adaptive_terrain.operators.bridge import writing


@pytest.fixture
def forbidden():
    """Give a function that calls another where Python may not write, and returns what that returns or raises."""
    found = []

    class Forbidden(bpy.types.Operator):
        bl_idname = "adaptive_terrain_test.forbidden"
        bl_label = "Forbidden"
        function = None

        @classmethod
        def poll(cls, _context):
            try:
                found.append(cls.function())
            except Exception as error:
                found.append(error)
            return False

    def call(function):
        Forbidden.function = staticmethod(function)
        found.clear()
        bpy.ops.adaptive_terrain_test.forbidden.poll()
        return found[0]

    bpy.utils.register_class(Forbidden)
    yield call
    bpy.utils.unregister_class(Forbidden)


def write() -> float:
    scene = bpy.data.scenes[0]
    scene.frame_step += 1
    bpy.ops.object.select_all(action="DESELECT")
    return 0.25


def test_a_timer_writes_where_the_flag_forbids_it(scene, forbidden):
    scene = bpy.data.scenes[0]
    before = scene.frame_step
    assert isinstance(forbidden(write), AttributeError), "Blender forbids it without the decorator"
    assert forbidden(writing.allow_writing(write)) == 0.25
    assert writing.allow_writing(write)() == 0.25, "and as well where nothing forbids it"
    assert scene.frame_step == before + 2


def test_a_render_waits_for_drawing_to_end(scene, monkeypatch):
    """On another thread it goes on as soon as the flag is unset."""
    answers, on = iter((False, False, True)), []
    monkeypatch.setattr(writing, "may_write", lambda: next(answers))
    handler = writing.allow_writing(lambda: on.append(threading.current_thread()))
    thread = threading.Thread(target=handler)
    thread.start()
    thread.join()
    assert on == [thread] and next(answers, None) is None


def test_the_flag_is_seen_and_nothing_written(scene, forbidden):
    before = dict(bpy.data.scenes[0].items())
    assert writing.may_write() and not forbidden(writing.may_write)
    assert dict(bpy.data.scenes[0].items()) == before


def test_errors_reach_the_caller_of_a_timer(scene, forbidden):
    def fail():
        raise ZeroDivisionError

    assert isinstance(forbidden(writing.allow_writing(fail)), ZeroDivisionError)
    with pytest.raises(ZeroDivisionError):
        writing.allow_writing(fail)()
