# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that run beside the window, in turns of a timer as Blender gives them."""

import time
from types import SimpleNamespace
from unittest.mock import Mock

NAMES = ("work", "finish", "clean_up", "_new_job", "_end", "_finish", "_failed", "modal", "cancel", "invoke")


def running(operator_class, obj, names=NAMES):
    """The operator, begun on the object."""
    import bpy

    operator = SimpleNamespace(report=Mock())
    for name in names:
        setattr(operator, name, getattr(operator_class, name).__get__(operator))
    operator.context = SimpleNamespace(
        window_manager=Mock(),
        window=None,
        object=obj,
        scene=bpy.context.scene,
        view_layer=bpy.context.view_layer,
        evaluated_depsgraph_get=bpy.context.evaluated_depsgraph_get,
    )
    operator.began = operator.invoke(operator.context, None)
    return operator


def to_the_end(operator):
    """Turns of the timer until the operator has ended; what it ended with."""
    for _ in range(4000):
        ended = operator.modal(operator.context, SimpleNamespace(type="TIMER"))
        if ended != {"PASS_THROUGH"}:
            operator.context.window_manager.event_timer_remove.assert_called_once()
            return ended
        time.sleep(0.01)
    raise AssertionError("measuring never ended")
