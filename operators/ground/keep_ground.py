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
from ..properties.keep_properties import ON, any_kept
from ..request.request import RENDER, VIEWPORT
from . import vertical_moves as moves
from . import world_ground

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
    if not any_kept():
        return []
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
    grounds = world_ground.grounds_of(scene, depsgraph, mode, waits)
    _move_all(kept, grounds, depsgraph, frame_changes)
    if mode == RENDER and world_ground.is_made_for_views(scene):  # until now for a camera that has not been moved
        grounds = world_ground.grounds_of(scene, depsgraph, mode, waits)
        release(scene)
        _evaluate(kept, depsgraph, frame_changes)
        _move_all(kept, grounds, depsgraph, frame_changes)
    if mode == VIEWPORT:
        _settled[scene.session_uid] = _key(kept, grounds, depsgraph)
    return [_notes[obj.session_uid] for obj in kept if obj.session_uid in _notes]


def _move_all(kept: list, grounds: list, depsgraph, frame_changes: bool) -> None:
    """Move released objects to the ground; those that follow others after these."""
    for obj in kept:
        _notes.pop(obj.session_uid, None)
    everyone = set(kept)
    followed, moved, todo = {obj: _leaders(obj) & everyone for obj in kept}, {}, kept
    while off := _moves_of(todo, grounds, depsgraph, moved):
        held = [obj for obj in off if obj in moved and abs(off[obj][0]) > 0.5 * abs(moved[obj][0]) > 0.0]
        for obj in held:
            _set_free(obj)
            _notes[obj.session_uid] = f"{obj.name!r} is not moved: a constraint holds it where it is"
        now = [obj for obj in off if obj not in held and not followed[obj] & off.keys()]
        for obj in now:
            _apply(obj, depsgraph, *off[obj])
            moved.setdefault(obj, []).append(off[obj][0])
        todo = [obj for obj in todo if obj not in held and len(moved.get(obj, ())) < MOST_MOVES]
        _evaluate([*now, *held], depsgraph, frame_changes)
        if not now:
            break


def _evaluate(written: list, depsgraph, frame_changes: bool) -> None:
    for obj in written if frame_changes else ():
        obj.update_tag(refresh={"TIME"})
    depsgraph.update()


def _moves_of(objects: list, grounds: list, depsgraph, moved) -> dict:
    """By object: metres to rise and the normal to turn to, or None; of those that are not where they should be.

    Those that have been `moved` are not turned again.
    """
    shown = {obj: obj.evaluated_get(depsgraph) for obj in objects}
    shown = {obj: item for obj, item in shown.items() if item.is_evaluated and all(map(math.isfinite, _place(item)))}
    found = {}
    for only in {obj.adaptive_terrain_keep.terrain for obj in shown}:
        chosen = [obj for obj in shown if obj.adaptive_terrain_keep.terrain == only]
        own = [item for item in grounds if only is None or item.uid == only.session_uid]
        for obj in () if own or only is None else chosen:
            _notes[obj.session_uid] = f"{obj.name!r} is not moved: its terrain {only.name!r} is not in the scene"
        places = np.array([_place(shown[obj]) for obj in chosen], np.float64)
        under = world_ground.below(own, places)
        turning = [_turns(obj) and obj not in moved for obj in chosen]
        normals = world_ground.normals(own, places, under) if any(turning) else places
        for obj, height, normal, turns in zip(chosen, under.heights.tolist(), normals, turning, strict=True):
            rise = _rise_of(obj, shown[obj], height)
            if rise or (turns and math.isfinite(height)):
                found[obj] = rise, normal if turns else None
    return {obj: found[obj] for obj in objects if obj in found}


def _place(evaluated):
    return evaluated.matrix_world.translation


def _turns(obj) -> bool:
    return obj.adaptive_terrain_keep.how == ON and obj.adaptive_terrain_keep.align


def _rise_of(obj, evaluated, height: float) -> float:
    """Metres by which an object is to rise over ground of a height; 0 where it is right, or there is no ground."""
    settings, z = obj.adaptive_terrain_keep, _place(evaluated).z
    if settings.how == ON:
        rise = height + settings.offset - z
    else:
        rise = max(0.0, height + settings.clearance - z)
    return rise if math.isfinite(rise) and abs(rise) > moves.rounding(evaluated, height) else 0.0


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
        grounds = world_ground.grounds_of(scene, depsgraph, waits=False)
        if _settled.get(scene.session_uid) != _key(kept, grounds, depsgraph):
            settle_now(scene, depsgraph, waits=False)
    except TerrainError:
        pass  # the terrain says so itself
    return True


def _key(kept: list, grounds: list, depsgraph) -> tuple:
    """Equal as long as nothing has moved, neither objects nor ground."""
    objects = []
    for obj in kept:
        settings = obj.adaptive_terrain_keep
        numbers = settings.how, settings.offset, settings.clearance, settings.align
        only = settings.terrain.session_uid if settings.terrain else 0
        matrix = np.array(obj.evaluated_get(depsgraph).matrix_world).tobytes()
        objects.append((obj.session_uid, matrix, *numbers, only))
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
