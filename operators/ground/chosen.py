# SPDX-License-Identifier: GPL-3.0-or-later
"""What an operator of the ground is about: the terrain that counts, and the objects to move."""

from ...cbt_terrain.errors import TerrainError
from ..scene import session
from ..scene.polls import IN_A_MODE
from . import world_ground

NO_TERRAIN = "The scene has no terrain; add one"


def has_ground(cls, context) -> bool:
    """For the poll of an operator."""
    if context.mode != "OBJECT":
        cls.poll_message_set(IN_A_MODE)
        return False
    if any(obj.adaptive_terrain.enabled for obj in context.scene.objects):
        return True
    cls.poll_message_set(NO_TERRAIN)
    return False


def active_terrain(context):
    """The active object if it is a selected terrain: then it alone counts as ground; else None."""
    obj = context.object
    return obj if obj is not None and session.is_terrain(obj) and obj.select_get() else None


def grounds(context, depsgraph) -> list[world_ground.Ground]:
    """The active terrain if it is selected, else all of the scene. Raises TerrainError."""
    terrain = active_terrain(context)
    if terrain is not None:
        return [world_ground.ground_of(terrain, depsgraph)]
    found = world_ground.grounds_of(context.scene, depsgraph)
    if not found:
        raise TerrainError(f"The scene {context.scene.name!r} has no terrain with a height field; import one.")
    return found


def selected(context) -> list:
    """The selected objects that are no terrains."""
    return [obj for obj in context.selected_objects if not obj.adaptive_terrain.enabled]


def movers(objects) -> list:
    """What is moved so that `objects` move: of a mesh on an armature that; nothing whose parent is moved, too."""
    tops = []
    for obj in objects:
        up = obj
        while up.parent is not None and not up.parent.adaptive_terrain.enabled:
            up = up.parent
            if up.type == "ARMATURE" or up in objects:
                obj = up
        if obj not in tops:
            tops.append(obj)
    return tops
