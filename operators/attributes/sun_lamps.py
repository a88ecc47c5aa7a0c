# SPDX-License-Identifier: GPL-3.0-or-later
"""The sun lamps of a scene, in a terrain's own space."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ...cbt_terrain.view.linear import inverse


class Sun(NamedTuple):
    """A sun lamp.

    `direction`: float64 [3], unit length, of the world, towards the sun. `angle`: diameter of its disc, radians.
    `strength`: W/m^2.
    """

    direction: np.ndarray
    angle: float
    strength: float


def sun_lamps(depsgraph) -> list[Sun]:
    """Return every sun lamp, with light and a direction, that the evaluated view layer of a dependency graph shows."""
    found = []
    for lamp in _evaluated_suns(depsgraph):
        axis = np.array(lamp.matrix_world.col[2][:3], np.float64)  # it shines along its own -Z
        length = float(np.sqrt((axis * axis).sum()))
        if lamp.data.energy > 0.0 and np.isfinite(length) and length > 0.0:
            angle = min(lamp.data.angle, math.pi)  # Blender's float32 of pi is larger
            found.append(Sun(axis / length, angle, lamp.data.energy))
    return found


def suns_over(placement: np.ndarray, depsgraph) -> tuple[tuple[float, ...], ...]:
    """Return a row for each sun lamp of the scene: x, y, z towards it in the terrain's space, its angle and strength.

    placement: matrix from the terrain's space to the world, whose scale changes the length of x, y, z. Rows are sorted.
    A point is in shadow in that space exactly if it is in the world. The angle (the diameter of the sun's disc,
    radians) is that in the world: a scale that differs by axis would make an ellipse of the disc.
    """
    to_local = inverse(placement)[:3, :3]
    rows = []
    for sun in sun_lamps(depsgraph):
        x, y, z = (float((row * sun.direction).sum()) for row in to_local)
        rows.append((x, y, z, float(sun.angle), float(sun.strength)))
    return tuple(sorted(rows))


def _evaluated_suns(depsgraph) -> Iterator:
    """Yield evaluated sun lamps, each valid until the next one: Blender reuses one object for all instances.

    A render's graph lists all visible objects and instances; in a viewport those may be many.
    """
    if depsgraph.mode == "RENDER":
        yield from filter(_is_sun, (instance.object for instance in depsgraph.object_instances))
    else:
        layer = depsgraph.view_layer
        shown = (obj for obj in layer.objects if _is_sun(obj) and obj.visible_get(view_layer=layer))
        yield from (obj.evaluated_get(depsgraph) for obj in shown)


def _is_sun(obj) -> bool:
    """Return whether an object is a sun lamp."""
    return obj.type == "LIGHT" and obj.data.type == "SUN"
