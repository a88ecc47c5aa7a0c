# SPDX-License-Identifier: GPL-3.0-or-later
"""Shift objects in all frames, and keep a terrain's children in place while its origin moves."""

import numpy as np
from mathutils import Matrix, Vector

from ..land import water_object
from ..scatter.request import scatters_of
from . import add_collider


def shift_location(obj, by: Vector, shifted: set[int]) -> bool:
    """Add `by` to an object's location in all frames; return False if a driver or a track moves the object.

    Its delta location is moved then. shifted: pointers of the animation curves that are shifted already, since objects
    may share an action.
    """
    animation = obj.animation_data
    is_driven = animation is not None and (
        any(driver.data_path == "location" for driver in animation.drivers)
        or any(len(track.strips) for track in animation.nla_tracks)
    )
    if is_driven:
        obj.delta_location = Vector(obj.delta_location) + by
        return False
    obj.location = Vector(obj.location) + by
    for curve in curves_of(animation, "location"):
        if curve.as_pointer() not in shifted:
            shifted.add(curve.as_pointer())
            for key in curve.keyframe_points:
                for point in (key.co, key.handle_left, key.handle_right):
                    point.y += by[curve.array_index]
            curve.update()
    return True


def curves_of(animation, *paths: str) -> list:
    """Return the animation curves of an object's channels `paths`, in its slot of the action."""
    action = None if animation is None else animation.action
    if action is None:
        return []
    curves = getattr(action, "fcurves", ())
    if len(getattr(action, "layers", ())):  # from Blender 4.4 on
        bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
        curves = [curve for bag in bags if bag.slot == animation.action_slot for curve in bag.fcurves]
    return [curve for curve in curves if curve.data_path in paths]


def keep_children(obj, by: np.ndarray) -> None:
    """Keep the children of a terrain in their places on the ground after its origin has moved.

    by: move of the origin in the terrain's space, float64 [2] metres.
    """
    back = Matrix.Translation((*(-by).tolist(), 0.0))
    static = {found for found in (water_object.existing_water(obj), add_collider.collider_of(obj)) if found is not None}
    for child in obj.children:
        if child in static:  # meshes in the terrain's space
            child.data.transform(back)
        elif child not in scatters_of(obj):  # their points follow the anchor by themselves
            child.matrix_parent_inverse = back @ child.matrix_parent_inverse
