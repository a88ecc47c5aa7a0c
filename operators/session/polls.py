# SPDX-License-Identifier: GPL-3.0-or-later
"""Polls of operators that act on the active terrain, with the reason for the tooltip, and their errors."""

import functools
from collections.abc import Callable

from ...cbt_terrain.errors import TerrainError
from . import session

LEFT_ALONE = (
    "The terrain or its mesh is linked from a library, or overrides one, and cannot be changed: make it local "
    "(Object > Relations > Make Local)"
)
NOT_ACTIVE = "Make a terrain the active object"
IN_A_MODE = "Switch to Object Mode"


def on_terrain(operator: type, context) -> bool:
    """Return whether the active object is an editable terrain, for an operator's `poll`.

    If not, set the reason, which the tooltip or a script's error shows.
    """
    obj = context.object
    if obj is None or obj.type != "MESH" or not obj.adaptive_terrain.enabled:
        operator.poll_message_set(NOT_ACTIVE)
        return False
    if not session.is_terrain(obj):
        operator.poll_message_set(LEFT_ALONE)
        return False
    return True


def on_terrain_object(operator: type, context) -> bool:
    """Return whether the active object is an editable terrain in Object Mode."""
    if not on_terrain(operator, context):
        return False
    operator.poll_message_set(IN_A_MODE)
    return context.mode == "OBJECT"


class TerrainOperator:
    """Base of operators on the active terrain."""

    @classmethod
    def poll(cls, context):
        return on_terrain(cls, context)


class TerrainObjectOperator:
    """Base of operators on the active terrain in Object Mode."""

    @classmethod
    def poll(cls, context):
        return on_terrain_object(cls, context)


def cancelled_by_errors(execute: Callable) -> Callable:
    """Decorate an operator's `execute`: a TerrainError or an OSError is reported and cancels the operator."""

    @functools.wraps(execute)
    def run(self, context):  # Blender counts the arguments
        """Run the operator, and report a TerrainError and cancel instead of raising it."""
        try:
            return execute(self, context)
        except (TerrainError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    return run
