# SPDX-License-Identifier: GPL-3.0-or-later
"""Polls of operators that act on the active terrain, with the reason for the tooltip, and their errors."""

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import bpy

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
    """Return whether the active object is an editable terrain in Object Mode; if not, set the reason."""
    if not on_terrain(operator, context):
        return False
    operator.poll_message_set(IN_A_MODE)
    return context.mode == "OBJECT"


class TerrainOperator:
    """Base of operators on the active terrain."""

    @classmethod
    def poll(cls, context):
        """Return whether the active object is an editable terrain; if not, set the reason that Blender shows."""
        return on_terrain(cls, context)


class TerrainObjectOperator:
    """Base of operators on the active terrain in Object Mode."""

    @classmethod
    def poll(cls, context):
        """Return whether the active object is an editable terrain in Object Mode; if not, set the reason."""
        return on_terrain_object(cls, context)


class ObjectModeOperator:
    """Base of operators in Object Mode on any object."""

    @classmethod
    def poll(cls, context):
        """Return whether Blender is in Object Mode; if not, set the reason that it shows."""
        cls.poll_message_set(IN_A_MODE)
        return context.mode == "OBJECT"


def remember_object(operator, context) -> None:
    """Store the session_uid of the context's object in the operator, for `remembered_object`.

    A button in a panel sets the context's object, but only until the operator opens a dialog or waits.
    """
    operator.object_uid = None if context.object is None else context.object.session_uid


@contextmanager
def remembered_object(operator, context) -> Iterator[None]:
    """Make the remembered object the context's `object` inside the block; change nothing for an operator without one.

    Raises TerrainError if it is gone.
    """
    uid = getattr(operator, "object_uid", None)
    if uid is None:
        yield
        return
    obj = next((obj for obj in bpy.data.objects if obj.session_uid == uid), None)
    if obj is None:
        raise TerrainError("The object is gone", fix="try again with another one")
    with context.temp_override(object=obj):
        yield


def invoke_with_file(operator, context) -> set[str]:
    """Invoke an operator anew with the file that its dialog has chosen: a dialog calls `execute`, which cannot wait.

    The operator has a property `is_chosen`, and has remembered its object. Return Blender's result set.
    """
    again = getattr(bpy.ops.adaptive_terrain, type(operator).bl_idname.partition(".")[2])
    with remembered_object(operator, context):
        options = operator.as_keywords(ignore=("is_chosen",))
        return run_nested(operator, again, "INVOKE_DEFAULT", is_chosen=True, **options)


def run_nested(operator, run: Callable, how: str, **properties) -> set[str]:
    """Run another operator from `operator`, which reports its errors; return FINISHED, or CANCELLED after an error.

    run: the other's function in bpy.ops. how: INVOKE_DEFAULT or EXEC_DEFAULT.
    """
    try:
        run(how, **properties)
    except RuntimeError as error:  # the text of the nested operator's reports, which Blender shows nowhere
        operator.report({"ERROR"}, str(error).strip().removeprefix("Error: "))
        return {"CANCELLED"}
    return {"FINISHED"}


def cancelled_by_errors(execute: Callable) -> Callable:
    """Decorate `execute` or another method of an operator: a TerrainError or an OSError is reported and cancels it."""

    @functools.wraps(execute)
    def run(self, context, **options):  # Blender counts the positional arguments
        """Run the operator; report a TerrainError or an OSError and cancel instead of raising it."""
        try:
            return execute(self, context, **options)
        except (TerrainError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    return run
