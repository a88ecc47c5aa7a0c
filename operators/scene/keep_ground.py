# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that stay on the ground, or above it, in every frame.

Before a frame is evaluated, their delta transforms are set to 0 (`release`): so each is where its animation, its
parents and its constraints have it, whatever was before. Afterwards the deltas move it to the ground (`settle`), and
the frame is evaluated again, before any terrain is refined for a camera among them. So a frame is the same alone and in
a sequence, and what the user has keyed is never touched.
"""

import math

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run import warmup
from ...kernels.query import ground, rays
from . import vertical_moves as moves
from . import world_ground
from .keep_properties import ON
from .request import VIEWPORT

MOST_MOVES = 3  # of an object: one is enough, but for what float32 rounds
_settled: dict[int, tuple] = {}  # session_uid of a scene -> what its objects were settled to in the viewport
_notes: dict[int, str] = {}  # session_uid of an object -> what keeps it from the ground


def note_of(obj) -> str:
    """Why a kept object is not where it should be, or ""."""
    return _notes.get(obj.session_uid, "")


def refusal(obj, align: bool = False) -> str:
    """Why an object cannot be kept, as the end of a sentence that begins with its name, or ""."""
    if refused := moves.untouchable(obj) or moves.lock(obj, align):
        return refused
    if align and obj.rotation_mode == "AXIS_ANGLE":
        return "turns by axis and angle, which has no delta; choose another rotation mode"
    if not obj.adaptive_terrain_keep.keep and (_has_deltas(obj) or moves.is_animated(obj, "delta_")):
        return "has delta transforms of its own, which keeping needs; apply them first"
    return ""


def kept_of(scene) -> list:
    """The objects of a scene that are kept, and may be moved."""
    return [obj for obj in scene.objects if obj.adaptive_terrain_keep.keep and not moves.untouchable(obj)]


def let_go(obj) -> None:
    """Keep an object no longer: it is where its own channels have it."""
    obj.adaptive_terrain_keep.keep = False
    _set_free(obj)
    _notes.pop(obj.session_uid, None)


def release(scene) -> None:
    """Put kept objects where they would be without the ground, when they are evaluated next."""
    for obj in kept_of(scene):
        _set_free(obj)


def settle(scene, depsgraph, mode: str, *, waits: bool, frame_changes: bool) -> list[str]:
    """Move the released objects of a scene to the ground and evaluate `depsgraph` again; returns why some are not
    moved. Raises TerrainError where there is no knowing the ground.

    `waits`: see `grounds_of`. `frame_changes`: whether the frame was set just now. Then what is animated is evaluated
    anew, since the dependency graph of a render forgets animated values of what is written.
    """
    kept = kept_of(scene)
    if not kept:
        return []
    for obj in kept:
        _notes.pop(obj.session_uid, None)
    grounds = world_ground.grounds_of(scene, depsgraph, mode, waits)
    followed, moved, todo = {obj: _leaders(obj) & set(kept) for obj in kept}, {}, kept
    while off := _moves_of(todo, grounds, depsgraph, moved.keys()):
        held = [obj for obj in off if obj in moved and abs(off[obj][0]) > 0.5 * abs(moved[obj][0])]
        for obj in held:
            _set_free(obj)
            _notes[obj.session_uid] = f"{obj.name!r} is not moved: a constraint holds it where it is"
        now = [obj for obj in off if obj not in held and not followed[obj] & off.keys()]
        for obj in now:
            _apply(obj, depsgraph, *off[obj])
            moved.setdefault(obj, []).append(off[obj][0])
        todo = [obj for obj in todo if obj not in held and len(moved.get(obj, ())) < MOST_MOVES]
        for obj in (*now, *held) if frame_changes else ():
            obj.update_tag(refresh={"TIME"})
        depsgraph.update()
        if not now:
            break
    if mode == VIEWPORT:
        _settled[scene.session_uid] = _key(scene, kept, depsgraph)
    return [_notes[obj.session_uid] for obj in kept if obj.session_uid in _notes]


def _moves_of(objects: list, grounds: list, depsgraph, turned) -> dict:
    """By object: metres to rise and the normal to turn to, or None; of those that are not where they should be."""
    evaluated = [obj.evaluated_get(depsgraph) for obj in objects]
    objects = [obj for obj, shown in zip(objects, evaluated, strict=True) if shown.is_evaluated]
    places = np.array([obj.evaluated_get(depsgraph).matrix_world.translation for obj in objects]).reshape(-1, 3)
    found = {}
    for only in {obj.adaptive_terrain_keep.terrain for obj in objects}:
        chosen = [n for n, obj in enumerate(objects) if obj.adaptive_terrain_keep.terrain == only]
        chosen = [n for n in chosen if np.isfinite(places[n]).all()]
        own = [item for item in grounds if only is None or item.uid == only.session_uid]
        under = world_ground.below(own, places[chosen])
        normals = world_ground.normals(own, places[chosen], under)
        for n, height, normal in zip(chosen, under.heights, normals, strict=True):
            if np.isfinite(height):
                found[objects[n]] = _move_of(objects[n], depsgraph, float(height), normal, objects[n] not in turned)
    return {obj: found[obj] for obj in objects if found.get(obj) is not None}


def _move_of(obj, depsgraph, height: float, normal: np.ndarray, turns: bool) -> tuple | None:
    """None where an object is where it should be."""
    settings, evaluated = obj.adaptive_terrain_keep, obj.evaluated_get(depsgraph)
    z = evaluated.matrix_world.translation.z
    if settings.how == ON:
        rise = height + settings.offset - z
    else:
        rise = max(0.0, height + settings.clearance - z)
    if not math.isfinite(rise) or abs(rise) <= moves.rounding(evaluated, height):
        rise = 0.0
    turns = turns and settings.how == ON and settings.align
    return (rise, normal if turns else None) if rise or turns else None


def _apply(obj, depsgraph, rise: float, normal) -> None:
    evaluated = obj.evaluated_get(depsgraph)
    try:
        frame = moves.frame_of(evaluated)
    except TerrainError as error:
        _notes[obj.session_uid] = str(error)
        return
    if normal is not None:
        turn = moves.own_turn(frame, moves.turn_to(evaluated, normal))
        if obj.rotation_mode == "QUATERNION":
            obj.delta_rotation_quaternion = turn
        elif obj.rotation_mode != "AXIS_ANGLE":
            obj.delta_rotation_euler = turn.to_euler(obj.rotation_mode)
    obj.delta_location = obj.delta_location + moves.own_rise(frame, rise)


def _leaders(obj) -> set:
    """What an object's place follows: parents and targets of constraints, and what theirs follow."""
    found, ahead = set(), [obj]
    while ahead:
        item = ahead.pop()
        targets = (getattr(constraint, "target", None) for constraint in item.constraints)
        for other in (item.parent, *targets):
            if other is not None and other not in found and other != obj:
                found.add(other)
                ahead.append(other)
    return found


def settle_now(scene, depsgraph, waits: bool = True) -> list[str]:
    """Settle a scene's objects in the viewport at its frame; returns and raises as `settle`."""
    release(scene)
    depsgraph.update()
    return settle(scene, depsgraph, VIEWPORT, waits=waits, frame_changes=False)


def settle_shown(scene, depsgraph) -> bool:
    """The same for the live update, which never waits: only where something has changed, on ground that there is.
    Returns False if it has to be asked again, since kernels are being prepared."""
    kept = kept_of(scene)
    if not kept or depsgraph is None:
        return True
    if not warmup.ask([ground, rays]):
        return False
    try:
        if _settled.get(scene.session_uid) != _key(scene, kept, depsgraph):
            settle_now(scene, depsgraph, waits=False)
    except TerrainError:
        pass  # the terrain says so itself
    return True


def _key(scene, kept: list, depsgraph) -> tuple:
    """Equal as long as nothing has moved, neither objects nor ground."""
    objects = []
    for obj in kept:
        settings = obj.adaptive_terrain_keep
        numbers = settings.how, settings.offset, settings.clearance, settings.align
        only = settings.terrain.session_uid if settings.terrain else 0
        matrix = np.array(obj.evaluated_get(depsgraph).matrix_world).tobytes()
        objects.append((obj.session_uid, matrix, *numbers, only))
    grounds = world_ground.grounds_of(scene, depsgraph, waits=False)
    return tuple(objects), tuple(item.key() for item in grounds)


def _has_deltas(obj) -> bool:
    turned = any(obj.delta_rotation_euler) or tuple(obj.delta_rotation_quaternion) != (1.0, 0.0, 0.0, 0.0)
    return any(obj.delta_location) or turned


def _set_free(obj) -> None:
    """Deltas of 0, without telling Blender of a change where there is none."""
    if not _has_deltas(obj):
        return
    obj.delta_location = obj.delta_rotation_euler = (0.0, 0.0, 0.0)
    obj.delta_rotation_quaternion = (1.0, 0.0, 0.0, 0.0)


@persistent
def _forget(_file) -> None:
    _settled.clear()
    _notes.clear()


def register() -> None:
    bpy.app.handlers.load_pre.append(_forget)


def unregister() -> None:
    bpy.app.handlers.load_pre.remove(_forget)
    _forget("")
