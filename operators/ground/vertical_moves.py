# SPDX-License-Identifier: GPL-3.0-or-later
"""Move and turn an object in the world by its channels, under any parents and constraints."""

import numpy as np
from mathutils import Matrix, Quaternion, Vector

from ...cbt_terrain.errors import TerrainError
from ..bridge.demand.trees import animated_paths

# Constraints that do not move an object.
STAY = {"TRACK_TO", "DAMPED_TRACK", "LOCKED_TRACK", "COPY_ROTATION", "LIMIT_ROTATION", "COPY_SCALE", "LIMIT_SCALE",
        "MAINTAIN_VOLUME", "STRETCH_TO", "TRANSFORM_CACHE", "CAMERA_SOLVER"}  # fmt: skip


def channels_to_world(evaluated) -> Matrix:
    """Return the 3 x 3 matrix from an evaluated object's location channels to the world.

    It includes constraints that carry an object (Follow Path, Child Of). Raises TerrainError if it is singular.
    """
    acting, world = [c.type for c in evaluated.constraints if not c.mute], evaluated.matrix_world
    # The matrix to the world without the object's own channels (matrix_basis). Constraints that only turn the object
    # are in matrix_world and matrix_local: they cancel, and the parent's matrix remains.
    if acting and STAY.issuperset(acting):
        frame = world @ evaluated.matrix_local.inverted_safe()
        if evaluated.parent is not None:
            frame = frame @ evaluated.matrix_parent_inverse
    else:
        frame = world @ evaluated.matrix_basis.inverted_safe()
    frame = frame.to_3x3()
    if not np.isfinite(np.array(frame)).all() or frame.determinant() == 0.0:
        raise TerrainError(f"The object {evaluated.name!r} or its parent has a scale of 0", expected="another scale")
    return frame


def channel_move(frame: Matrix, by) -> Vector:
    """Return the change of an object's location channels for a vector of the world.

    frame: result of `channels_to_world`.
    """
    return frame.inverted() @ Vector(by)


def channel_rise(frame: Matrix, metres: float) -> Vector:
    """Return the change of an object's location channels for a rise in metres of the world.

    frame: result of `channels_to_world`.
    """
    return channel_move(frame, (0.0, 0.0, metres))


def channel_turn(frame: Matrix, turn: Quaternion) -> Quaternion:
    """Convert a rotation in the world to one that is multiplied from the left to the object's rotation channels.

    frame: result of `channels_to_world`.
    """
    rotation = frame.to_quaternion()
    return rotation.inverted() @ turn @ rotation


def turn_to(evaluated, normal: np.ndarray) -> Quaternion:
    """Return the smallest rotation in the world that turns an evaluated object's Z axis to `normal`, float64 [3]."""
    up = evaluated.matrix_world.to_3x3().col[2]
    return up.rotation_difference(Vector(normal.tolist())) if up.length > 0.0 else Quaternion()


def rounding(evaluated, height: float) -> float:
    """Return the tolerance in metres for heights at an object: four float32 steps of its largest coordinate."""
    largest = max(abs(height), *(abs(v) for v in evaluated.matrix_world.translation))
    return 1e-6 + 4.0 * largest * 2.0**-23


def is_animated(obj, *channels: str) -> bool:
    """Return whether an action, a track or a driver animates any of these channels of an object."""
    return any(path.startswith(channels) for path in animated_paths(obj))


def is_linked(data) -> bool:
    """Return whether a library holds a data-block, which then may not be written."""
    return data.library is not None or data.override_library is not None


def check_local(obj) -> None:
    """Raise TerrainError for an object that may not be written."""
    if is_linked(obj):
        raise TerrainError(f"The object {obj.name!r} is linked from a library", fix="make it local")


def check_unlocked(obj, turns: bool = False) -> None:
    """Raise TerrainError for an object with any locked channel of location, or of rotation if it `turns`."""
    if any(obj.lock_location) or (turns and any(obj.lock_rotation)):
        raise TerrainError(
            f"The object {obj.name!r} has locked transforms", fix="unlock them in the Transform panel of the sidebar"
        )
