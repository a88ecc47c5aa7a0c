# SPDX-License-Identifier: GPL-3.0-or-later
"""The terrains and objects that an operator of the ground acts on."""

from types import ModuleType

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run.warmup import import_kernels
from ..kernel_operator import KernelOperator
from ..session import session
from ..session.polls import IN_A_MODE
from ..terrain.overrides import Overrides
from ..terrain.request import gather
from ..terrain.request_kernels import kernels_for
from . import world_ground

NO_TERRAIN = "The scene has no terrain; add one"


class GroundOperator(KernelOperator):
    """Base of operators that measure the ground of the scene's terrains. `modules`: kernels of the measurement."""

    modules: tuple[str, ...] = ("query.ground", "query.rays")

    @classmethod
    def poll(cls, context):
        """Return whether the scene has a terrain and is in Object Mode; if not, set the reason."""
        if context.mode != "OBJECT":
            cls.poll_message_set(IN_A_MODE)
            return False
        cls.poll_message_set(NO_TERRAIN)
        return any(obj.adaptive_terrain.enabled for obj in context.scene.objects)

    def kernels(self, context) -> list[ModuleType]:
        """Return the modules of the measurement, and those of the terrains' surfaces."""
        depsgraph, found = context.evaluated_depsgraph_get(), import_kernels(self.modules)
        for obj in session.terrains_of(context.scene):
            if obj.adaptive_terrain.store:
                # ANY: a criterion that needs no camera; the surface does not depend on triangles. No attributes either.
                request = gather(obj, depsgraph, criterion=world_ground.ANY, overrides=Overrides(effects=()))
                found += kernels_for(request)
        return found


def active_terrain(context):
    """Return the active object if it is a selected terrain, which then is the only ground, else None."""
    obj = context.object
    return obj if obj is not None and session.is_terrain(obj) and obj.select_get() else None


def chosen_grounds(context, depsgraph) -> list[world_ground.WorldGround]:
    """Return the ground to act on: the active terrain if it is selected, else all terrains of the scene.

    Raises TerrainError if there is none.
    """
    terrain = active_terrain(context)
    if terrain is not None:
        return [world_ground.ground_of(terrain, depsgraph)]
    found = world_ground.grounds_of(context.scene, depsgraph)
    if not found:
        raise TerrainError(f"The scene {context.scene.name!r} has no terrain with a height field", fix="import one")
    return found


def terrain_at(context, points: np.ndarray, what: str, depsgraph):
    """Return the terrain that an operator acts on, and its WorldGround.

    It is the active terrain if that is selected, else the one below or above most of the `points`, float64 [n, 3] in
    the world. what: name of the points for the error. Raises TerrainError if no terrain is there.
    """
    terrain = active_terrain(context)
    if terrain is not None:
        return terrain, world_ground.ground_of(terrain, depsgraph)
    found = world_ground.grounds_of(context.scene, depsgraph)
    which = world_ground.find_below(found, points).which  # positions in `found`, -1 without ground
    if not (which >= 0).any():
        fix = "move it over one, or select the terrain as well"
        raise TerrainError(f"There is no terrain above or below {what}", fix=fix)
    ground = found[np.bincount(which[which >= 0]).argmax()]
    return next(obj for obj in session.terrains_of(context.scene) if obj.session_uid == ground.uid), ground


def selected_objects(context) -> list:
    """Return the selected objects that are not terrains."""
    return [obj for obj in context.selected_objects if not obj.adaptive_terrain.enabled]


def objects_to_move(objects) -> list:
    """Return the objects to move in place of `objects`, each once.

    An object is replaced by its topmost ancestor, below any terrain, that is an armature or one of `objects`.
    """
    found = []
    for obj in objects:
        ancestor = obj
        while ancestor.parent is not None and not ancestor.parent.adaptive_terrain.enabled:
            ancestor = ancestor.parent
            if ancestor.type == "ARMATURE" or ancestor in objects:
                obj = ancestor
        if obj not in found:
            found.append(obj)
    return found
