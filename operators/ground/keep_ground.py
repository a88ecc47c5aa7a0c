# SPDX-License-Identifier: GPL-3.0-or-later
"""Kept objects: those that stay on or above the ground in every frame.

`release` sets their delta transforms to 0 before a frame is evaluated, which puts each where its animation, parents and
constraints place it. `settle` then moves each to the ground by its deltas and evaluates the frame again, before any
terrain is refined for a camera among them. So a frame is the same alone and in a sequence, and keyed channels never
change.
"""

import math
from contextlib import suppress

import numpy as np
from bpy.app.handlers import persistent

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run import warmup
from ..terrain.request import RENDER, VIEWPORT
from . import vertical_moves as moves
from . import world_ground
from .properties import ON, is_any_on_ground

MAX_MOVES = 3  # of an object: those after the first correct float32 rounding
_settled: dict[int, tuple] = {}  # session_uid of a scene -> key of its settled state in the viewport
_notes: dict[int, str] = {}  # session_uid of an object -> why it is not on the ground


def note_of(obj) -> str:
    """Return why a kept object is not on the ground, or ""."""
    return _notes.get(obj.session_uid, "")


def _set_note(obj, error: TerrainError) -> None:
    """Record why an object is not on the ground, for the panel."""
    _notes[obj.session_uid] = str(error)


def check_keepable(obj, align: bool = False) -> None:
    """Raise TerrainError for an object that cannot be kept on the ground: linked, locked, or with delta transforms.

    align: whether it is also to be turned.
    """
    moves.check_local(obj)
    moves.check_unlocked(obj, align)
    if align and obj.rotation_mode == "AXIS_ANGLE":
        raise TerrainError(
            f"The object {obj.name!r} turns by axis and angle, which has no delta", fix="choose another rotation mode"
        )
    if not obj.adaptive_terrain_keep.keep and (_has_deltas(obj) or moves.is_animated(obj, "delta_")):
        raise TerrainError(
            f"The object {obj.name!r} already has delta transforms, which keeping needs", fix="apply them first"
        )


def objects_on_ground(scene) -> list:
    """Return the objects of a scene that are kept on or above the ground and may be written."""
    if not is_any_on_ground():
        return []
    return [obj for obj in scene.objects if obj.adaptive_terrain_keep.keep and not moves.is_linked(obj)]


def let_go(obj) -> None:
    """Stop keeping an object; it returns to where its channels, parents and constraints place it."""
    obj.adaptive_terrain_keep.keep = False
    _reset_deltas(obj)
    _notes.pop(obj.session_uid, None)


def release(scene) -> None:
    """Set the deltas of kept objects to 0, so that the next evaluation places them without the ground."""
    for obj in objects_on_ground(scene):
        _reset_deltas(obj)


def settle(scene, depsgraph, mode: str, *, waits: bool, frame_changes: bool) -> list[str]:
    """Move the kept objects of a scene, which `release` has freed, to the ground; evaluate `depsgraph` again.

    Returns why some objects are not moved. Raises TerrainError if the ground cannot be computed.

    Args:
        mode: VIEWPORT or RENDER.
        waits: whether missing ground, such as land that is not shaped yet, is computed; otherwise the objects on it
            stay where they are.
        frame_changes: the frame was just set. Animated channels are then evaluated again, since the dependency
            graph of a render forgets animated values of written objects.
    """
    objects = objects_on_ground(scene)
    if not objects:
        return []
    grounds = world_ground.grounds_of(scene, depsgraph, mode, waits)
    _move_all(objects, grounds, depsgraph, frame_changes)
    if mode == RENDER and world_ground.depends_on_views(scene):  # the camera may have moved: use its new ground
        grounds = world_ground.grounds_of(scene, depsgraph, mode, waits)
        release(scene)
        _evaluate(objects, depsgraph, frame_changes)
        _move_all(objects, grounds, depsgraph, frame_changes)
    if mode == VIEWPORT:  # so that nothing moves again until something changes
        _settled[scene.session_uid] = _state_key(objects, grounds, depsgraph)
    return [_notes[obj.session_uid] for obj in objects if obj.session_uid in _notes]


def _move_all(objects: list, grounds: list, depsgraph, frame_changes: bool) -> None:
    """Move released objects to the ground, in rounds: an object waits until those that it follows are in place.

    grounds: list of WorldGround. frame_changes: the frame was just set, so animated channels are evaluated again.
    """
    for obj in objects:
        _notes.pop(obj.session_uid, None)
    everyone = set(objects)
    # By object: leaders are those that it follows; moved has the metres of its moves so far; needed has the metres to
    # rise and the normal, if it is not in place. todo: objects that may move again.
    leaders, moved, todo = {obj: _leaders(obj) & everyone for obj in objects}, {}, objects
    while needed := _find_moves(todo, grounds, depsgraph, moved):
        # A constraint holds an object if the distance left is more than half of its first move.
        held = [obj for obj in needed if obj in moved and abs(needed[obj][0]) > 0.5 * abs(moved[obj][0]) > 0.0]
        for obj in held:
            _reset_deltas(obj)
            _set_note(obj, TerrainError(f"{obj.name!r} is not moved, because a constraint holds it", fix="mute it"))
        now = [obj for obj in needed if obj not in held and not leaders[obj] & needed.keys()]
        for obj in now:
            _apply_move(obj, depsgraph, *needed[obj])
            moved.setdefault(obj, []).append(needed[obj][0])
        todo = [obj for obj in todo if obj not in held and len(moved.get(obj, ())) < MAX_MOVES]
        _evaluate([*now, *held], depsgraph, frame_changes)
        if not (now or held):  # the objects that are not in place follow each other
            break


def _evaluate(written: list, depsgraph, frame_changes: bool) -> None:
    """Evaluate the scene after objects were written, with their animation if `frame_changes`: it was just set."""
    if frame_changes:
        for obj in written:
            obj.update_tag(refresh={"TIME"})
    depsgraph.update()


def _find_moves(objects: list, grounds: list, depsgraph, moved) -> dict:
    """Return by object the metres to rise and the normal to turn to (None for no turn), for those not in place.

    moved: objects that were moved before, which are not turned again. An object that is not evaluated is left out; one
    whose only terrain is not among `grounds` gets a note.
    """
    pairs = [(obj, obj.evaluated_get(depsgraph)) for obj in objects]
    evaluated_by_object = {
        obj: evaluated
        for obj, evaluated in pairs
        if evaluated.is_evaluated and all(map(math.isfinite, _origin_of(evaluated)))
    }
    needed = {}
    for terrain in {obj.adaptive_terrain_keep.terrain for obj in evaluated_by_object}:  # None: any terrain
        chosen = [obj for obj in evaluated_by_object if obj.adaptive_terrain_keep.terrain == terrain]
        allowed = [ground for ground in grounds if terrain is None or ground.uid == terrain.session_uid]
        if terrain is not None and not allowed:
            for obj in chosen:
                what = f"{obj.name!r} is not moved, because its terrain {terrain.name!r} is not in the scene"
                _set_note(obj, TerrainError(what, fix="choose another terrain"))
        origins = np.array([_origin_of(evaluated_by_object[obj]) for obj in chosen], np.float64)
        below = world_ground.find_below(allowed, origins)  # its height is NaN without ground
        turning = [_is_aligned(obj) and obj not in moved for obj in chosen]
        normals = world_ground.normals_at(allowed, origins, below) if any(turning) else origins  # else not used
        for obj, height, normal, turns in zip(chosen, below.heights.tolist(), normals, turning, strict=True):
            rise = _rise_of(obj, evaluated_by_object[obj], height)
            if rise or (turns and math.isfinite(height)):
                needed[obj] = rise, normal if turns else None
    return {obj: needed[obj] for obj in objects if obj in needed}


def _origin_of(evaluated):
    """Return the origin of an evaluated object in the world."""
    return evaluated.matrix_world.translation


def _is_aligned(obj) -> bool:
    """Return whether an object is to be turned to the ground's normal."""
    return obj.adaptive_terrain_keep.how == ON and obj.adaptive_terrain_keep.align


def _rise_of(obj, evaluated, height: float) -> float:
    """Return the metres by which an object must rise; 0 if it is in place or has no ground.

    evaluated: the object as the dependency graph evaluated it. height: the ground's height below or above it, metres in
    the world; NaN without ground.
    """
    settings, z = obj.adaptive_terrain_keep, _origin_of(evaluated).z
    if settings.how == ON:
        rise = height + settings.offset - z
    else:
        rise = max(0.0, height + settings.clearance - z)
    return rise if math.isfinite(rise) and abs(rise) > moves.rounding(evaluated, height) else 0.0


def _apply_move(obj, depsgraph, rise: float, normal) -> None:
    """Move and turn an object by its delta transforms; if its channels cannot move it, note why.

    rise: metres in the world. normal: direction for its Z axis, None for no turn.
    """
    evaluated = obj.evaluated_get(depsgraph)
    try:
        frame = moves.channels_to_world(evaluated)
    except TerrainError as error:
        _set_note(obj, error)
        return
    if normal is not None:
        turn = moves.channel_turn(frame, moves.turn_to(evaluated, normal))
        if obj.rotation_mode == "QUATERNION":
            obj.delta_rotation_quaternion = turn
        elif obj.rotation_mode != "AXIS_ANGLE":  # for which Blender offers no delta rotation
            obj.delta_rotation_euler = turn.to_euler(obj.rotation_mode)
    obj.delta_location = obj.delta_location + moves.channel_rise(frame, rise)


def _leaders(obj) -> set:
    """Return the objects whose moves also move an object: parents and constraint targets, recursively."""
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
    """Place a scene's kept objects on the ground in the viewport at the present frame.

    waits: whether missing ground, such as land that is not shaped yet, is computed. Returns why some objects are not
    moved. Raises TerrainError.
    """
    release(scene)
    depsgraph.update()
    return settle(scene, depsgraph, VIEWPORT, waits=waits, frame_changes=False)


def settle_shown(scene, depsgraph) -> bool:
    """Place kept objects again if they or the ground changed, for the live update, which never waits for missing
    ground.

    Returns False while kernels are being compiled: call it again. An error of the ground is ignored here.
    """
    objects = objects_on_ground(scene)
    if not objects or depsgraph is None:
        return True
    if not warmup.prepare_modules(["query.ground", "query.rays"]):
        return False
    with suppress(TerrainError):  # the terrain's update reports it
        grounds = world_ground.grounds_of(scene, depsgraph, waits=False)
        if _settled.get(scene.session_uid) != _state_key(objects, grounds, depsgraph):
            settle_now(scene, depsgraph, waits=False)
    return True


def _state_key(objects: list, grounds: list, depsgraph) -> tuple:
    """Return a key that changes when one of the kept `objects`, its settings or a WorldGround of `grounds` changes."""
    keys = []
    for obj in objects:
        settings = obj.adaptive_terrain_keep
        numbers = settings.how, settings.offset, settings.clearance, settings.align
        only = settings.terrain.session_uid if settings.terrain else 0
        matrix = np.array(obj.evaluated_get(depsgraph).matrix_world).tobytes()
        keys.append((obj.session_uid, matrix, *numbers, only))
    return tuple(keys), tuple(item.key() for item in grounds)


def _has_deltas(obj) -> bool:
    """Return whether an object has delta transforms that move or turn it."""
    turned = any(obj.delta_rotation_euler) or tuple(obj.delta_rotation_quaternion) != (1.0, 0.0, 0.0, 0.0)
    return any(obj.delta_location) or turned


def _reset_deltas(obj) -> None:
    """Set the delta transforms of an object to 0, without notifying Blender if they are."""
    if not _has_deltas(obj):
        return
    obj.delta_location = obj.delta_rotation_euler = (0.0, 0.0, 0.0)
    obj.delta_rotation_quaternion = (1.0, 0.0, 0.0, 0.0)


@persistent
def forget(_file: str = "") -> None:
    """Forget the positions and messages of kept objects, since another file was opened."""
    _settled.clear()
    _notes.clear()
