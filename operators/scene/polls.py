# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether an operator can act on the active object, and why not."""

from . import session

LEFT_ALONE = (
    "The terrain or its mesh is linked from a library, or overrides one, and is left alone: make it local "
    "(Object > Relations > Make Local)"
)
NOT_ACTIVE = "Make a terrain the active object"
IN_A_MODE = "Leave the mode for Object Mode"


def on_terrain(operator: type, context) -> bool:
    """Whether the active object is a terrain that may be changed. The tooltip of a button says why not, and so does the
    error of a script that calls it."""
    obj = context.object
    if obj is None or obj.type != "MESH" or not obj.adaptive_terrain.enabled:
        operator.poll_message_set(NOT_ACTIVE)
        return False
    if not session.is_terrain(obj):
        operator.poll_message_set(LEFT_ALONE)
        return False
    return True


def on_terrain_object(operator: type, context) -> bool:
    """The same of one that acts in Object Mode only."""
    if not on_terrain(operator, context):
        return False
    operator.poll_message_set(IN_A_MODE)
    return context.mode == "OBJECT"
