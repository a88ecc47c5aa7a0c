# SPDX-License-Identifier: GPL-3.0-or-later
"""The water of *Add Water* that scatters keep out of: the triangles of its object, as the user has left them."""

from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np

from ..bridge.evaluated import transform_points
from ..land.water_object import existing_water

if TYPE_CHECKING:
    from ...cbt_terrain.mesh.plan_triangles import PlanTriangles

FILM_M = 0.05  # depth of rain that runs off a slope: ground below it counts as dry
# Triangles by the session_uid of the water, its place and the depth that counts, and the arrays that they are made of,
# as long as a scatter uses them: water that has not changed has the same object.
_plans: "WeakValueDictionary[tuple, PlanTriangles]" = WeakValueDictionary()
_arrays_of: "WeakKeyDictionary[PlanTriangles, tuple[np.ndarray, ...]]" = WeakKeyDictionary()


def water_to_avoid(terrain, where) -> "PlanTriangles | None":
    """Return the triangles of a terrain's water object, in plan, that a scatter keeps out of; None for none.

    The rule *Water Depth* decides: with a *From* of 0 its scatter keeps out of water that is deeper than its *To*, and
    out of all water if *To* is a film. Hidden water counts, too. where: the rules of the scatter, evaluated.
    """
    rule, water = where.water_depth, existing_water(terrain)
    if water is None or not rule.use or rule.low > 0.0:
        return None
    arrays = vertices, triangles, depth = _read_mesh(water.data)
    wadeable = rule.high if rule.high > FILM_M * (1 + 1e-6) else 0.0  # the rule's limit is float32
    in_plan = np.array(water.matrix_local, np.float64)[[0, 1, 3]]  # a move upwards changes nothing
    key = water.session_uid, in_plan.tobytes(), wadeable
    plan = _plans.get(key)
    if plan is None or not all(map(_are_equal, _arrays_of[plan], arrays)):
        plan = _plans[key] = _in_plan(vertices, triangles[(depth[triangles] > wadeable).any(axis=1)], water)
        _arrays_of[plan] = arrays
    return plan


def _read_mesh(mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the vertices, float32 [v, 3], triangles, int32 [n, 3], and depths, float32 [v] metres, of a water's mesh.

    Vertices without a depth have an infinite one.
    """
    vertices, depth = np.zeros((len(mesh.vertices), 3), np.float32), np.full(len(mesh.vertices), np.inf, np.float32)
    corners = np.empty((len(mesh.polygons), 3), np.int32)
    if len(vertices):
        mesh.attributes["position"].data.foreach_get("vector", vertices.reshape(-1))
    if len(mesh.loops) == corners.size:  # in 1 ms of 150 for 474,000 triangles
        if corners.size:
            mesh.attributes[".corner_vert"].data.foreach_get("value", corners.reshape(-1))
    else:
        mesh.calc_loop_triangles()
        corners = np.empty((len(mesh.loop_triangles), 3), np.int32)
        mesh.loop_triangles.foreach_get("vertices", corners.reshape(-1))
    attribute = mesh.attributes.get("water_depth")
    if attribute is not None and attribute.domain == "POINT" and attribute.data_type == "FLOAT":
        attribute.data.foreach_get("value", depth)
    return vertices, corners, depth


def _are_equal(array: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two arrays have the same numbers of 32 bits, NaN included."""
    return np.array_equal(array.view(np.int32), other.view(np.int32))


def _in_plan(vertices: np.ndarray, triangles: np.ndarray, water) -> "PlanTriangles":
    """Return triangles of a terrain's water object in plan, in the terrain's space, without those that are not finite.

    vertices: float32 [v, 3] metres; triangles: int32 [n, 3].
    """
    from ...cbt_terrain.mesh.outline import counter_clockwise
    from ...cbt_terrain.mesh.plan_triangles import PlanTriangles

    placed = transform_points(water.matrix_local, vertices)[triangles][:, :, :2]
    return PlanTriangles(counter_clockwise(placed[np.isfinite(placed).all(axis=(1, 2))]))
