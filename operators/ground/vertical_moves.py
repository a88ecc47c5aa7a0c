# SPDX-License-Identifier: GPL-3.0-or-later
"""Moving and turning an object in the world by its own channels, whatever its parents and constraints are."""

import numpy as np
from mathutils import Matrix, Quaternion, Vector

from ...cbt_terrain.errors import TerrainError
from ..demand.trees import animated_paths

# Constraints after which an object is still where its own channels and its parent have it.
STAY = {"TRACK_TO", "DAMPED_TRACK", "LOCKED_TRACK", "COPY_ROTATION", "LIMIT_ROTATION", "COPY_SCALE", "LIMIT_SCALE",
        "MAINTAIN_VOLUME", "STRETCH_TO", "TRANSFORM_CACHE", "CAMERA_SOLVER"}  # fmt: skip


def frame_of(evaluated) -> Matrix:
    """3 x 3: what an evaluated object's own location, in its channels, becomes in the world.

    Of constraints that carry an object (Follow Path, Child Of), too. Raises TerrainError where it is flat.
    """
    acting, world = [c.type for c in evaluated.constraints if not c.mute], evaluated.matrix_world
    if acting and STAY.issuperset(acting):  # what turns it at its place is left out
        frame = world @ evaluated.matrix_local.inverted_safe()
        if evaluated.parent is not None:
            frame = frame @ evaluated.matrix_parent_inverse
    else:
        frame = world @ evaluated.matrix_basis.inverted_safe()
    frame = frame.to_3x3()
    if not np.isfinite(np.array(frame)).all() or frame.determinant() == 0.0:
        raise TerrainError(f"The object {evaluated.name!r} or its parent has a scale of 0; expected another scale.")
    return frame


def own_move(frame: Matrix, by) -> Vector:
    """What to add to an object's location, of a `frame_of`, so that it moves by a vector of the world."""
    return frame.inverted() @ Vector(by)


def own_rise(frame: Matrix, metres: float) -> Vector:
    """The same, so that it rises by so many metres."""
    return own_move(frame, (0.0, 0.0, metres))


def own_turn(frame: Matrix, turn: Quaternion) -> Quaternion:
    """A rotation in the world as one before the object's own."""
    around = frame.to_quaternion()
    return around.inverted() @ turn @ around


def turn_to(evaluated, normal: np.ndarray) -> Quaternion:
    """The least rotation in the world that brings an evaluated object's Z axis to `normal`."""
    up = evaluated.matrix_world.to_3x3().col[2]
    return up.rotation_difference(Vector(normal.tolist())) if up.length > 0.0 else Quaternion()


def rounding(evaluated, height: float) -> float:
    """Metres of height that float32 may be off: four of its steps, there."""
    largest = max(abs(height), *(abs(v) for v in evaluated.matrix_world.translation))
    return 1e-6 + 4.0 * largest * 2.0**-23


def is_animated(obj, *channels: str) -> bool:
    """Whether an action, a track or a driver has curves for any of these channels of an object."""
    return any(path.startswith(channels) for path in animated_paths(obj))


def untouchable(obj) -> str:
    """Why an object may not be written, as the end of a sentence that begins with its name, or ""."""
    linked = obj.library is not None or obj.override_library is not None
    return "is linked from a library; make it local" if linked else ""


def lock(obj, turns: bool = False) -> str:
    """As `untouchable`, of channels that the user has locked."""
    locked = any(obj.lock_location) or (turns and any(obj.lock_rotation))
    return "has locked transforms; unlock them in its Transform panel" if locked else ""
