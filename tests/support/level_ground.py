# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of level ground, where only edges and areas ask."""

from functools import cache

import numpy as np
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, View


@cache
def level_scenes() -> tuple[tuple[HeightField, Criterion, list[View], float], ...]:
    """Ground that hardly rises, seen from near and far, edges and areas asked for, and a vertical scale.

    Of the last half some are seen without perspective, by two views at once, from the height of the ground, or asked
    for an error, too.
    """
    rng, found = np.random.default_rng(23), []
    for k in range(30):
        shape = ((33, 33), (65, 129), (100, 37), (5, 3))[k % 4] if k % 3 else (129, 129)
        slope = (0.0, 0.003, 0.03)[k % 3]
        z = np.add.outer(np.arange(shape[0]) * slope, np.arange(shape[1]) * -slope)
        z[:, : shape[1] // 2] += (0.0, 1e-4, 3.0)[k // 2 % 3] * rng.standard_normal((shape[0], shape[1] // 2))
        field = from_array(z.astype(np.float32), *10 ** rng.uniform(-1, 3, 2))
        size = (field.lattice.width * field.lattice.step_x, field.lattice.height * field.lattice.step_y)
        kind = ("PERSPECTIVE", PANORAMIC)[k // 4 % 2]
        eye = rng.uniform(-0.6, 0.6, 3) * [*size, 10 ** rng.uniform(-3, 0.3) * max(size)]
        eye[2] *= k < 15 or k % 5 > 0
        target = rng.uniform(-0.5, 0.5, 3) * [*size, 0]
        views = [View.look(eye, target, kind=kind, **({"fov_deg": 360} if kind == PANORAMIC else {}))]
        if k >= 15 and k % 5 == 1:
            views = [View.look(eye, target, kind=ORTHOGRAPHIC, ortho_width=0.3 * size[0])]
        if k >= 15 and k % 5 == 2:
            views.append(View.look(0.5 * eye, target))
        px = float(10 ** rng.uniform(0.6, 2))
        asked = ({"edge_px": px}, {"area_px": px**2}, {"edge_px": px, "area_px": 0.3 * px**2})[k % 3]
        if k >= 15 and k % 5 == 3:
            asked = asked | {"error_px": 0.1 * px}
        limits = {"max_triangles": int(rng.choice([500, 60_000])), "max_depth": [None, 7, 14][rng.integers(3)]}
        found.append(
            (field, Criterion(**{"error_px": 0.0} | asked | limits), views, float(rng.choice([1.0, -2.0, 0.0])))
        )
    return tuple(found)
