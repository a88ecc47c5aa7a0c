# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of level ground, where only edges and areas ask."""

import numpy as np
from adaptive_terrain.cbt_terrain.criterion import Criterion
from adaptive_terrain.cbt_terrain.heightfield import HeightField, from_array
from adaptive_terrain.cbt_terrain.view import PANORAMIC, View


def level_scenes() -> list[tuple[HeightField, Criterion, list[View], float]]:
    """Ground that hardly rises, seen from near and far, edges and areas asked for, and a vertical scale."""
    rng, found = np.random.default_rng(23), []
    for k in range(60):
        shape = ((33, 33), (65, 129), (100, 37), (5, 3))[k % 4] if k % 3 else (129, 129)
        slope = (0.0, 0.003, 0.03)[k % 3]
        z = np.add.outer(np.arange(shape[0]) * slope, np.arange(shape[1]) * -slope)
        z[:, : shape[1] // 2] += (0.0, 1e-4, 3.0)[k // 2 % 3] * rng.standard_normal((shape[0], shape[1] // 2))
        field = from_array(z.astype(np.float32), *10 ** rng.uniform(-1, 3, 2))
        size = (field.lattice.width * field.lattice.step_x, field.lattice.height * field.lattice.step_y)
        kind = ("PERSPECTIVE", PANORAMIC)[k // 4 % 2]
        view = View.look(
            rng.uniform(-0.6, 0.6, 3) * [*size, 10 ** rng.uniform(-3, 0.3) * max(size)],
            rng.uniform(-0.5, 0.5, 3) * [*size, 0],
            kind=kind,
            **({"fov_deg": 360} if kind == PANORAMIC else {}),
        )
        px = float(10 ** rng.uniform(0.3, 2))
        asked = ({"edge_px": px}, {"area_px": px**2}, {"edge_px": px, "area_px": 0.3 * px**2})[k % 3]
        limits = {"max_triangles": int(rng.choice([500, 60_000])), "max_depth": [None, 7, 14][rng.integers(3)]}
        found.append((field, Criterion(error_px=0.0, **asked, **limits), [view], float(rng.choice([1.0, -2.0, 0.0]))))
    return found
