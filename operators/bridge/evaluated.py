# SPDX-License-Identifier: GPL-3.0-or-later
"""An object that a setting names, as it is in the frame that is refined.

Naming an object in a setting does not make Blender evaluate it. An object that is hidden in renders, disabled in
viewports or in an excluded collection is not evaluated there: its matrix is that of another frame, or unset after
loading, and its modifiers are not applied.
"""

import numpy as np
from mathutils import Matrix

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.view.linear import determinant, product

RENDER = "RENDER"


def evaluated_or_still(depsgraph, obj, what: str) -> tuple:
    """Return the object `obj` with its data as `depsgraph` evaluated them, and its matrix to the world.

    An object that Blender has not evaluated, because it is hidden, is returned as it was made if nothing can have
    moved or changed it since. Raises TerrainError if something can. what: noun for the error.
    """
    obj = obj.original
    if _is_evaluated(obj, depsgraph):
        found = obj.evaluated_get(depsgraph)
        return found, found.matrix_world
    if _may_have_changed(obj.data) or any(_is_enabled(modifier, depsgraph.mode) for modifier in obj.modifiers):
        raise _hidden_error(obj, depsgraph, what, obj)
    return obj, _still_matrix(obj, depsgraph, what, obj)


def _is_evaluated(obj, depsgraph) -> bool:
    """Return whether a dependency graph has evaluated an object."""
    # Among 20,000 objects this takes 0.7 ms, where a loop takes 12 ms; a linked object may have the same name.
    by_name = depsgraph.ids.get(obj.name)
    return (by_name and by_name.original == obj) or any(found.original == obj for found in depsgraph.ids)


def _still_matrix(obj, depsgraph, what: str, named) -> Matrix:
    """Return an object's matrix to the world: evaluated, else as it was set if nothing can move it or its parents.

    Raises TerrainError if animation, physics or a constraint can. what, named: role and object in the error, which for
    a parent are those of the child that is looked up.
    """
    if _is_evaluated(obj, depsgraph):
        return obj.evaluated_get(depsgraph).matrix_world
    moving = is_animated(obj) or obj.rigid_body or any(not constraint.mute for constraint in obj.constraints)
    if moving or (obj.parent and obj.parent_type != "OBJECT"):
        raise _hidden_error(obj, depsgraph, what, named)
    if obj.parent is None:
        return obj.matrix_basis
    return _still_matrix(obj.parent, depsgraph, what, named) @ obj.matrix_parent_inverse @ obj.matrix_basis


def is_animated(block) -> bool:
    """Return whether a data-block has an action, drivers or tracks."""
    animation = getattr(block, "animation_data", None)  # images have none
    return animation is not None and bool(animation.action or animation.drivers or animation.nla_tracks)


def _may_have_changed(data) -> bool:
    """Return whether the data of an object may differ from the stored ones: animation or shape keys."""
    return data is not None and (is_animated(data) or getattr(data, "shape_keys", None) is not None)


def _is_enabled(modifier, mode: str) -> bool:
    """Return whether a modifier is on in a render or in viewports."""
    return modifier.show_render if mode == RENDER else modifier.show_viewport


def _hidden_error(obj, depsgraph, what: str, named) -> TerrainError:
    """Return the error for a hidden object that has animation, modifiers or constraints, or whose parent has.

    obj: the one that has them. what, named: role and object in the error.
    """
    owner = "it" if obj == named else f"its parent {obj.name!r}"
    where = "renders" if depsgraph.mode == RENDER else "viewports"
    return TerrainError(
        f"The {what} {named.name!r} is hidden in {where}. There Blender evaluates no animation, constraints or "
        f"modifiers of it, and {owner} has some",
        fix="show it, or apply them",
    )


def placement_of(terrain) -> np.ndarray:
    """Return float64 [4, 4]: from the space of an evaluated terrain to the world.

    Raises TerrainError if it is not finite or singular.
    """
    placement, name = np.array(terrain.matrix_world, np.float64), terrain.name
    if not np.isfinite(placement).all():
        raise TerrainError(
            f"The terrain {name!r} has a matrix that is not finite", fix="check its transform and parents"
        )
    if determinant(placement[:3, :3]) == 0.0:
        raise TerrainError(f"The terrain {name!r} has a scale of 0", expected="another scale on each axis")
    return placement


def anchor_of(terrain) -> tuple[float, float]:
    """Return the point of a terrain that is its object's origin, metres east and north of the raster's middle."""
    x, y = terrain.adaptive_terrain.anchor
    return x, y


def raster_placement_of(terrain) -> np.ndarray:
    """Return float64 [4, 4]: from metres about the raster's middle to the world. Raises TerrainError."""
    return about_middle(placement_of(terrain), anchor_of(terrain))


def transform_points(matrix, points: np.ndarray) -> np.ndarray:
    """Transform points [n, 3] by a 4 x 4 matrix; return float64 [n, 3], the same bits on every processor."""
    matrix = np.array(matrix, np.float64)
    return product(points, matrix[:3, :3].T) + matrix[:3, 3]


def about_middle(placement: np.ndarray, anchor: tuple[float, float]) -> np.ndarray:
    """Return the placement, float64 [4, 4], of a space that begins at the raster's middle instead of the anchor."""
    shift = np.eye(4)
    shift[:2, 3] = np.negative(anchor)
    return product(placement, shift)
