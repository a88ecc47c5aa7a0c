# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that run beside the window, in turns of a timer as Blender gives them."""

import inspect
import threading
import time
from contextlib import contextmanager
from functools import partial
from types import SimpleNamespace
from unittest.mock import Mock


class RunningOperator(SimpleNamespace):
    """A stand-in for an operator that Blender runs: it has the methods of `operator_class`."""

    def __getattr__(self, name):
        value = getattr(self.operator_class, name)
        return value.__get__(self) if inspect.isfunction(value) else value


@contextmanager
def _overridden(context, object):
    """Make another object the context's inside the block."""
    before, context.object = context.object, object
    yield
    context.object = before


def running(operator_class, obj, **properties):
    """Invoke an operator with some properties on an object and return it."""
    import bpy

    operator = RunningOperator(operator_class=operator_class, report=Mock(), **properties)
    operator.context = SimpleNamespace(
        window_manager=Mock(),
        window=None,
        object=obj,
        mode="OBJECT",
        selected_objects=bpy.context.selected_objects,
        collection=bpy.context.collection,
        scene=bpy.context.scene,
        view_layer=bpy.context.view_layer,
        evaluated_depsgraph_get=bpy.context.evaluated_depsgraph_get,
    )
    operator.context.temp_override = partial(_overridden, operator.context)
    operator.began = operator.invoke(operator.context, None)
    return operator


def hold(monkeypatch, module, name: str) -> threading.Event:
    """Let a function of a module wait, on a job's thread, until the returned event is set."""
    event, function = threading.Event(), getattr(module, name)
    monkeypatch.setattr(module, name, lambda *given, **named: (event.wait(600), function(*given, **named))[1])
    return event


def turn(operator, event: str = "TIMER"):
    """Send one event and return the operator's answer."""
    return operator.modal(operator.context, SimpleNamespace(type=event, value="PRESS"))


def to_the_end(operator):
    """Send timer events until the operator has ended; return its last answer."""
    for _ in range(30_000):
        ended = turn(operator)
        if ended != {"PASS_THROUGH"}:
            operator.context.window_manager.event_timer_remove.assert_called_once()
            return ended
        time.sleep(0.01)
    raise AssertionError("the job never ended")
